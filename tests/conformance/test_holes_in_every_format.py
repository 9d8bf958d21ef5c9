"""A hole of 4 kB in a log: told with its place, and paid for by what it touches alone.

`benchmarks/damage.py` does the same with long logs at twenty places each.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

from fdilog import read as read_log
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording
from fdilog.writing import write
from tests import bags
from tests.bags import IMU, by_time, readings

HOLE_BYTES = 4096
CHUNK_BYTES = 20_000
LEFT, RIGHT = readings(900, seed=1), readings(900, seed=2)
TYPES = {"/imu/left": IMU, "/imu/right": IMU}
IMU_BYTES = 324  # the smallest of these records is shorter still

Write = Callable[[Path], Path]


def mcap_log(**options: Any) -> Write:
    def written(folder: Path) -> Path:
        two = by_time(bags.imu_messages("/imu/left", LEFT), bags.imu_messages("/imu/right", RIGHT))
        return bags.write_mcap(folder / "l.mcap", two, TYPES, chunk_size=CHUNK_BYTES, **options)

    return written


def bag(compression: str) -> Write:
    def written(folder: Path) -> Path:
        two = by_time(
            bags.imu_messages("/imu/left", LEFT, ros=1),
            bags.imu_messages("/imu/right", RIGHT, ros=1),
        )
        return bags.write_rosbag1(folder / "l.bag", two, TYPES, compression)

    return written


def database(folder: Path) -> Path:
    two = by_time(bags.imu_messages("/imu/left", LEFT), bags.imu_messages("/imu/right", RIGHT))
    return bags.write_rosbag2(folder / "l", two, TYPES) / "l.db3"


def flight(suffix: str) -> Write:
    def written(folder: Path) -> Path:
        path = folder / f"l{suffix}"
        write(simulate(20.0, 100.0, sources=2, seed=4).recording(), path)
        return path

    return written


# How much of a log one unit is that is believed or not as a whole: a chunk; else a few records.
FORMATS: dict[str, tuple[Write, int]] = {
    "mcap zstd": (mcap_log(), CHUNK_BYTES),
    "mcap without checksums": (
        mcap_log(enable_crcs=False, compression=CompressionType.NONE),
        CHUNK_BYTES,
    ),
    "mcap unchunked": (mcap_log(use_chunking=False), 2 * IMU_BYTES),
    "bag none": (bag("none"), 2 * IMU_BYTES),
    "db3": (database, 2 * 4096),
    "tlog": (flight(".tlog"), 2 * IMU_BYTES),
    "ulog": (flight(".ulg"), 2 * IMU_BYTES),
    "dataflash": (flight(".bin"), 2 * IMU_BYTES),
    "csv": (flight(".csv"), 2 * IMU_BYTES),
}


@pytest.fixture(scope="module", params=FORMATS)
def log(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Any:
    written, unit_bytes = FORMATS[request.param]
    path = written(tmp_path_factory.mktemp("holes"))
    return path, path.read_bytes(), read_log(path), unit_bytes


def rows(recording: Recording) -> dict[str, set[tuple[float, ...]]]:
    """Time and rates of every sample, by stream."""
    return {
        s.name: set(zip(s.time_ns.tolist(), *(s.columns[g].tolist() for g in s.gyro), strict=True))
        for s in recording.streams
        if s.gyro and s.origin == "sensor"
    }


@pytest.mark.parametrize("filling", ["zeros", "noise"])
@pytest.mark.parametrize("at", [0.3, 0.5, 0.77])
def test_a_hole_costs_what_it_touches_and_is_told_with_its_place(
    log: Any, tmp_path: Path, at: float, filling: str
) -> None:
    path, raw, whole, unit_bytes = log
    start = int(at * len(raw))
    hole = bytes(HOLE_BYTES) if filling == "zeros" else np.random.default_rng(7).bytes(HOLE_BYTES)
    holed = tmp_path / path.name
    holed.write_bytes(raw[:start] + hole + raw[start + HOLE_BYTES :])
    recording = read_log(holed)

    before, left = rows(whole), rows(recording)
    n_before = sum(map(len, before.values()))
    kept = sum(len(left[name] & before[name]) for name in before)
    made_up = {name: left[name] - before[name] for name in before if left[name] - before[name]}
    assert made_up == {}
    # The share of the file that the hole and the units at its ends are, and a little for luck.
    touched = (HOLE_BYTES + 2 * unit_bytes) / len(raw)
    assert kept >= n_before * (1 - 1.3 * touched) - 4

    losses = [problem for problem in recording.problems if not problem.note]
    assert any(
        problem.offset is not None
        and problem.offset < start + HOLE_BYTES
        and problem.offset + (problem.bytes_lost or 0) >= start - 2 * unit_bytes
        for problem in losses
    )


@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_a_hole_in_nothing_but_a_message_index_is_told(tmp_path: Path, kind: str) -> None:
    path = (mcap_log() if kind == "mcap" else bag("none"))(tmp_path)
    raw = bytearray(path.read_bytes())
    whole = rows(read_log(path))
    if kind == "mcap":
        from mcap.reader import make_reader

        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        place = summary.chunk_indexes[3]
        at, end = place.chunk_start_offset + place.chunk_length, place.message_index_length
        end += at
    else:
        at = raw.index(b"\x04\0\0\0op=\x04")  # an index record
        end = at + 400
    raw[at + 60 : end - 60] = bytes(end - at - 120)
    path.write_bytes(raw)
    recording = read_log(path)
    assert rows(recording) == whole
    (loss,) = [problem for problem in recording.problems if not problem.note]
    assert "index" in loss.what
    assert loss.offset is not None
    assert loss.offset <= end
    assert loss.offset + (loss.bytes_lost or 0) >= at


def test_rows_are_found_though_no_page_leads_to_them(tmp_path: Path) -> None:
    path = database(tmp_path)
    raw = bytearray(path.read_bytes())
    whole = rows(read_log(path))
    inner = [page for page in range(1, len(raw) // 4096) if raw[4096 * page] == 5]
    for page in inner:
        raw[4096 * page : 4096 * (page + 1)] = bytes(4096)
    assert inner
    path.write_bytes(raw)
    recording = read_log(path)
    assert rows(recording) == whole
    (loss,) = [problem for problem in recording.problems if not problem.note]
    assert "1800 were found on pages that nothing leads to" in loss.what
    assert loss.offset in {4096 * page for page in inner}
