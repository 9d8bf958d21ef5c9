"""PX4 logs that we write are read by the official library, and by our own reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.recording import Recording
from fdilog.simulate import simulate
from fdilog.sources import choose
from fdilog_readers import ulog, ulog_writer
from tests.ulog_oracle import official

UTC_NS = 1_700_000_000_000_000_000


def recorded(sources: int = 3) -> Recording:
    flight = simulate(8.0, 25.0, sources=sources, seed=4)
    return replace(flight.recording(), utc_at_zero_ns=UTC_NS)


def test_the_official_library_reads_every_reading_back(tmp_path: Path) -> None:
    recording = recorded()
    ulog_writer.write(recording, tmp_path / "flight.ulg")
    theirs = official(tmp_path / "flight.ulg")
    for k, stream in enumerate(recording.streams[:3]):
        for topic, names in (
            ("sensor_gyro", stream.gyro),
            ("sensor_accel", stream.accelerometer),
        ):
            columns = theirs[topic, k]
            assert (
                columns["timestamp"].astype(np.int64) * 1000
            ).tolist() == stream.time_ns.tolist()
            for axis, name in zip("xyz", names, strict=True):
                assert np.array_equal(columns[axis], stream.columns[name].astype(np.float32))
    attitude = recording.streams[-1]
    for k, part in enumerate("wxyz"):
        sent = theirs["vehicle_attitude", 0][f"q[{k}]"]
        assert np.array_equal(sent, attitude.columns[f"q{part}"].astype(np.float32))


def test_our_reader_reads_a_written_log_back(tmp_path: Path) -> None:
    recording = recorded()
    ulog_writer.write(recording, tmp_path / "flight.ulg")
    again = ulog.read(tmp_path / "flight.ulg")
    assert all(problem.note for problem in again.problems)
    gyros, _ = choose(again, Config())
    assert [gyro.name for gyro in gyros] == ["imu0", "imu1", "imu2"]
    for gyro, stream in zip(gyros, recording.streams, strict=False):
        assert np.array_equal(gyro.time_ns, stream.time_ns)
        sent = np.column_stack([stream.columns[name] for name in stream.gyro])
        assert np.array_equal(gyro.rate_rad_s, sent.astype(np.float32))
        assert gyro.alive
    assert again.armed == recording.armed
    assert again.utc_at_zero_ns == UTC_NS


def test_an_attitude_of_angles_is_written_as_a_quaternion(tmp_path: Path) -> None:
    recording = recorded(1)
    angles = recording.streams[-1]
    bare = {name: angles.columns[name] for name in ("roll", "pitch", "yaw")}
    streams = (*recording.streams[:-1], replace(angles, columns=bare))
    ulog_writer.write(replace(recording, streams=streams), tmp_path / "flight.ulg")
    sent = official(tmp_path / "flight.ulg")["vehicle_attitude", 0]["q[2]"]
    assert np.abs(sent - angles.columns["qy"]).max() < 1e-7


def test_a_device_that_is_no_triad_is_refused(tmp_path: Path) -> None:
    recording = simulate(5.0, 25.0, geometry="dodecahedron", seed=1).recording()
    with pytest.raises(UsageError, match="no topic for the 6 gyros"):
        ulog_writer.write(recording, tmp_path / "flight.ulg")
    assert not (tmp_path / "flight.ulg").exists()


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        ulog_writer.write(recorded(), tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
