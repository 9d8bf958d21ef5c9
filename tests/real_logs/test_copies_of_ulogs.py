"""A fault put into a real ULog, as an analysis of the copy sees it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.experiments.faults import Fault, FaultKind
from fdilog.experiments.injection import inject
from fdilog.recording import Recording
from fdilog.registry import read
from fdilog.sources.assembly import assemble
from fdilog.sources.gyros import Gyro, choose
from fdilog.writing import write_injected
from tests.ulog_oracle import official

# The channel that fails, and how many physical gyros there are: one that is bit for bit another is
# none of its own.
LOGS = [
    ("quad_250hz", "imu0.y", 1),
    ("cube_3gyros_1hz", "imu1.y", 3),
    ("sil_motor_fault", "imu1.y", 2),
]
# Half of the least step of a tlog's messages, and what single precision leaves of 2 rad/s.
ROUNDING_RAD_S = {".tlog": 0.5e-3, ".ulg": 2e-7}


def gyros_of(recording: Recording) -> list[Gyro]:
    """Give those that an analysis uses."""
    used = {info.name for info in assemble(recording, Config()).sources if info.used}
    return [gyro for gyro in choose(recording, Config())[0] if gyro.name in used]


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
@pytest.mark.parametrize("failing", LOGS)
def test_a_copy_has_each_gyro_once_and_the_fault_in_one_channel(
    real_logs: Path, tmp_path: Path, failing: tuple[str, str, int], suffix: str
) -> None:
    name, channel, count = failing
    log, copy = real_logs / "ulog" / f"{name}.ulg", tmp_path / f"copy{suffix}"
    recording = read(log)
    bias = Fault(kind="bias", channel=channel, start_s=2.1, end_s=5.9, size=0.125)
    write_injected(inject(recording, [bias]), log, copy)
    again = read(copy)
    before, after = gyros_of(recording), gyros_of(again)
    assert len(before) == count
    assert [g.channel_names for g in after] == [g.channel_names for g in before]
    assert [g.alive for g in after] == [g.alive for g in before]
    assert len([s for s in again.streams if s.gyro and s.origin == "sensor"]) == count
    tables = [assemble(one, Config()).table for one in (recording, again)]
    assert tables[1].names == tables[0].names
    first_ns = min(int(gyro.time_ns[0]) for gyro in before)
    for old, new in zip(before, after, strict=True):
        expected = old.rate_rad_s.copy()
        if channel in old.channel_names:
            time_s = (old.time_ns - first_ns) / 1e9
            inside = (time_s >= 2.1) & (time_s <= 5.9)
            assert inside.any()
            assert not inside.all()
            expected[inside, old.channel_names.index(channel)] += 0.125
        np.testing.assert_allclose(
            new.rate_rad_s, expected, rtol=1e-6, atol=ROUNDING_RAD_S[suffix] * (1 + 1e-6)
        )


@pytest.mark.parametrize("kind", ["bias", "dead"])
def test_a_fault_of_a_whole_flight_makes_no_second_sensor_of_a_twin(
    real_logs: Path, tmp_path: Path, kind: FaultKind
) -> None:
    log, copy = real_logs / "ulog" / "sil_motor_fault.ulg", tmp_path / "copy.ulg"
    recording = read(log)
    size = 0.125 if kind == "bias" else None
    fault = Fault(kind=kind, channel="imu1.x", start_s=0.0, end_s=np.inf, size=size)
    write_injected(inject(recording, [fault]), log, copy)
    before, after = (assemble(one, Config()).table for one in (recording, read(copy)))
    assert after.names == before.names
    assert len(choose(recording, Config())[0]) == 3
    assert len(before.gyros.names) == 6
    apart = np.abs(after.gyros.rate_rad_s - before.gyros.rate_rad_s)
    assert [n for n, a in zip(before.gyros.names, apart.T, strict=True) if np.nanmax(a) > 1e-5] == [
        "imu1.x"
    ]


def test_the_official_library_sees_the_gyro_of_a_log_that_holds_the_selected_one_alone(
    real_logs: Path, tmp_path: Path
) -> None:
    log, copy = real_logs / "ulog" / "quad_250hz.ulg", tmp_path / "copy.ulg"
    stuck = Fault(kind="dropout", channel="imu0", start_s=10.0, end_s=12.0)
    injection = inject(read(log), [stuck])
    write_injected(injection, log, copy)
    removed = int(injection.changes[0].removed.sum())
    assert removed > 400
    theirs = official(log)["sensor_combined", 0]
    kept = ~injection.changes[0].removed
    sent = official(copy)["sensor_gyro", 0]
    for k, axis in enumerate("xyz"):
        assert np.array_equal(sent[axis], theirs[f"gyro_rad[{k}]"][kept])
