"""Every gyro sample of the logs that the project ships, against the official libraries."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from fdilog.conformance import Columns
from fdilog.conformance.claims import samples
from fdilog.conformance.of_whole_logs import same_gyros
from fdilog.registry import read
from tests import official_readers

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"
LOGS = sorted(json.loads((SAMPLE_LOGS / "truth.json").read_text(encoding="utf-8")))
OFFICIAL: dict[str, Callable[[Path], Columns]] = {
    "": official_readers.rosbags,
    ".bag": official_readers.rosbags,
    ".bin": official_readers.dataflash,
    ".csv": official_readers.table,
    ".mcap": official_readers.mcap,
    ".tlog": official_readers.tlog,
    ".ulg": official_readers.ulog,
}


DAMAGED = "damaged.bin"


@pytest.mark.parametrize("name", [name for name in LOGS if name != DAMAGED])
def test_every_sample_is_what_the_official_library_reads(name: str) -> None:
    path = SAMPLE_LOGS / name
    same_gyros(read(path), OFFICIAL[path.suffix](path))


def test_of_damaged_bytes_no_sample_is_made() -> None:
    """The damage begins in an attitude, so that no reader could take what it spoils for a gyro."""
    flown = samples(read(SAMPLE_LOGS / "three_imus_healthy.bin"))
    left = samples(read(SAMPLE_LOGS / DAMAGED))
    theirs = official_readers.dataflash(SAMPLE_LOGS / DAMAGED)
    counts = {name: len(columns["time_ns"]) for name, columns in theirs.items()}
    assert left.keys() == counts.keys() == flown.keys()
    assert all(set(rows) <= set(flown[name]) for name, rows in left.items())
    assert sum(counts.values()) == sum(map(len, left.values()))
