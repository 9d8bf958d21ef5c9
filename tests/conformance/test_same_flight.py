"""One flight with one fault, in every format that can be written: the same is said of it."""

from __future__ import annotations

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.cli import main
from fdilog.config import Config
from fdilog.registry import plugins, read
from fdilog.sources.gyros import choose

Results = dict[str, tuple[int, dict[str, Any]]]

SAMPLE_LOGS = Path(__file__).parents[2] / "sample_logs"
LOGS = sorted(path.name for path in SAMPLE_LOGS.glob("same_flight*"))
REFERENCE = "same_flight_cdr.mcap"
RATE_HZ = 20.0
MILLIRADIAN = 1e-3
"""Step of the rates in MAVLink's RAW_IMU and SCALED_IMU, and of the stamps of the latter in s."""


@pytest.fixture(scope="module")
def results() -> Results:
    """Exit code and result of ``fdilog analyse --json`` for every format."""
    found: Results = {}
    for name in LOGS:
        printed = StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
            patch.setattr("sys.argv", ["fdilog", "analyse", "--json", str(SAMPLE_LOGS / name)])
            with pytest.raises(SystemExit) as left:
                main()
        found[name] = (left.value.code, json.loads(printed.getvalue()))
    return found


def step_rad_s(name: str) -> float:
    """How much a format rounds a reading, at most by half of this."""
    if name.endswith(".tlog"):
        return MILLIRADIAN
    return 1e-6 if name.endswith((".bin", ".ulg")) else 0.0


def test_every_format_that_can_be_written_is_there(results: Results) -> None:
    formats = {result["log"]["format"] for _, result in results.values()}
    assert formats == set(plugins("writers"))
    assert {"same_flight_protobuf.mcap", "same_flight_json.mcap", REFERENCE} <= set(LOGS)
    assert {"same_flight_sqlite3", "same_flight_mcap"} <= set(LOGS)


@pytest.mark.parametrize("name", LOGS)
def test_the_readings_are_those_of_the_flight(name: str) -> None:
    gyros, _ = choose(read(SAMPLE_LOGS / name), Config())
    flown, _ = choose(read(SAMPLE_LOGS / REFERENCE), Config())
    assert [gyro.channel_names for gyro in gyros] == [gyro.channel_names for gyro in flown]
    for gyro, true in zip(gyros, flown, strict=True):
        assert np.abs(gyro.rate_rad_s - true.rate_rad_s).max() <= 0.5000001 * step_rad_s(name)
        # of stamps that are UTC and stamps since boot, what has passed since the first
        since = [(g.time_ns - flown[0].time_ns[0]) for g in (gyro, true)]
        late_ns = since[0] - since[1]
        stamp_ns = 1_000_000 if name.endswith(".tlog") else 0
        assert np.ptp(late_ns) <= stamp_ns


@pytest.mark.parametrize("name", LOGS)
def test_verdict_channel_and_kind_are_the_same(results: Results, name: str) -> None:
    code, result = results[name]
    assert (code, result["verdict"], result["completeness"]["whole"]) == (1, "failed", True)
    (finding,) = result["findings"]
    assert (finding["kind"], finding["suspects"]) == ("bias", ["imu1.y"])


@pytest.mark.parametrize("name", LOGS)
def test_times_agree_within_a_sample_and_sizes_within_the_rounding(
    results: Results, name: str
) -> None:
    ((_, result), (_, reference)) = results[name], results[REFERENCE]
    (finding,), (expected,) = result["findings"], reference["findings"]
    assert abs(finding["start_s"] - expected["start_s"]) <= 1.0 / RATE_HZ
    assert abs(finding["end_s"] - expected["end_s"]) <= 1.0 / RATE_HZ
    rounding = step_rad_s(name) / 2 + 1e-12
    for part in ("estimate", "low", "high"):
        assert abs(finding["size"][part] - expected["size"][part]) <= rounding, part
    assert finding["size"]["low"] <= np.radians(5.0) <= finding["size"]["high"]


@pytest.mark.parametrize("name", LOGS)
def test_it_is_what_the_truth_says(results: Results, name: str) -> None:
    truth = json.loads((SAMPLE_LOGS / "truth.json").read_text(encoding="utf-8"))[name]
    _, result = results[name]
    assert result["verdict"] == truth["verdict"]
    assert [finding["suspects"] for finding in result["findings"]] == truth["suspects"]
    (finding,), (fault,) = result["findings"], truth["faults"]
    assert finding["kind"] == fault["kind"]
    assert abs(finding["start_s"] - fault["start_s"]) <= 2.0 / RATE_HZ
    assert abs(finding["end_s"] - fault["end_s"]) <= 2.0 / RATE_HZ
