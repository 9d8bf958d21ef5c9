"""Recorded PX4 logs: every number that the official library gives, to the last bit."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from fdilog_readers import ulog
from tests.ulog_oracle import official

LOGS = ("cube_3gyros_1hz.ulg", "quad_250hz.ulg", "sil_motor_fault.ulg")
SECONDS_FOR_A_SAMPLE = 2.0


@pytest.mark.parametrize("name", LOGS)
def test_every_field_of_every_topic_is_what_pyulog_gives(real_logs: Path, name: str) -> None:
    path = real_logs / "ulog" / name
    theirs = official(path)
    recording = ulog.read(path, also={topic for topic, _ in theirs})
    ours = {stream.name: stream for stream in recording.streams if stream.columns}
    several = {topic for topic, instance in theirs if instance}
    compared = 0
    for (topic, instance), columns in theirs.items():
        stream = ours.pop(f"{topic}[{instance}]" if topic in several else topic)
        assert (stream.time_ns // 1000).tolist() == columns[stream.clock.partition(" ")[0]].tolist()
        for field, column in columns.items():
            if field == stream.clock.partition(" ")[0]:
                continue
            got = stream.columns[field]
            assert got.dtype == column.dtype
            assert np.array_equal(got, column, equal_nan=got.dtype.kind == "f")
            compared += len(got)
    assert not ours
    assert compared > 100_000
    assert not [p for p in recording.problems if not p.note and "dropout" not in p.what]


def test_dropouts_are_those_of_pyulog(real_logs: Path) -> None:
    from pyulog import ULog

    for name in LOGS:
        path = real_logs / "ulog" / name
        theirs = [dropout.duration / 1000 for dropout in ULog(str(path)).dropouts]
        problems = ulog.read(path).problems
        assert [p.seconds_lost for p in problems if p.seconds_lost is not None] == theirs


def test_three_gyros_of_a_flight_are_three_sensors(real_logs: Path) -> None:
    recording = ulog.read(real_logs / "ulog" / "cube_3gyros_1hz.ulg")
    sensors = {s.name: s.sensor for s in recording.streams if s.gyro and s.origin == "sensor"}
    assert sensors == {
        **{f"sensor_gyro[{k}]": k for k in range(3)},
        **{f"vehicle_imu[{k}]": k for k in range(3)},
    }
    by_name = {s.name: s for s in recording.streams}
    for k in range(3):
        fast, slow = by_name[f"sensor_gyro[{k}]"], by_name[f"vehicle_imu[{k}]"]
        at = np.abs(slow.time_ns[:, None] - fast.time_ns).argmin(axis=0)
        for axis in "xyz":
            apart = slow.columns[f"gyro_{axis}"][at] - fast.columns[axis]
            assert np.abs(apart).max() < 0.1


@pytest.mark.parametrize("name", LOGS)
@pytest.mark.parametrize("damage", ["hole", "random", "cut", "ends", "flips"])
def test_a_damaged_copy_is_read_in_time_and_told(
    real_logs: Path, tmp_path: Path, name: str, damage: str
) -> None:
    rng = np.random.default_rng(3)
    content = bytearray((real_logs / "ulog" / name).read_bytes())
    entire = {s.name: s.count for s in ulog.read(real_logs / "ulog" / name).streams}
    if damage in {"hole", "random"}:
        for at in rng.integers(len(content) // 4, len(content) - 4096, 5).tolist():
            content[at : at + 4096] = bytes(4096) if damage == "hole" else rng.bytes(4096)
    elif damage == "cut":
        del content[len(content) * 2 // 3 :]
    elif damage == "ends":
        content = bytearray(rng.bytes(5000)) + content + rng.bytes(5000)
    else:
        for at in rng.integers(len(content) // 4, len(content), 300).tolist():
            content[at] ^= 1 << int(rng.integers(8))
    path = tmp_path / name
    path.write_bytes(content)
    started = time.perf_counter()
    recording = ulog.read(path)
    assert time.perf_counter() - started < SECONDS_FOR_A_SAMPLE
    left = sum(s.count for s in recording.streams)
    share = {"hole": 0.95, "random": 0.95, "cut": 0.6, "ends": 0.999, "flips": 0.98}[damage]
    assert left > share * sum(entire.values())
    if damage == "cut":
        assert all(p.note or "dropout" in p.what for p in recording.problems)
    else:
        assert sum(p.bytes_lost or 0 for p in recording.problems if not p.note) > 0


@pytest.mark.parametrize("name", LOGS)
def test_a_cut_copy_gives_what_pyulog_gives(real_logs: Path, tmp_path: Path, name: str) -> None:
    content = (real_logs / "ulog" / name).read_bytes()
    path = tmp_path / name
    for share in (0.4, 0.7, 0.99):
        path.write_bytes(content[: int(len(content) * share)])
        theirs = official(path)
        ours = {s.name: s.count for s in ulog.read(path).streams}
        for (topic, instance), columns in theirs.items():
            found = ours.get(topic, ours.get(f"{topic}[{instance}]"))
            assert found == len(columns["timestamp"])
