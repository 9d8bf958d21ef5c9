"""Telemetry logs that we write are read by the official library, and by our own reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import choose
from fdilog_readers import mavlink, mavlink_writer
from tests.mavlink_oracle import official

UTC_NS = 1_700_000_000_000_000_000
MILLI = 0.5e-3 * (1 + 1e-9)


def recorded(sources: int) -> Recording:
    flight = simulate(8.0, 25.0, sources=sources, seed=4)
    recording = flight.recording()
    return Recording(
        path="",
        format="simulated",
        bytes=0,
        streams=recording.streams,
        armed=recording.armed,
        utc_at_zero_ns=UTC_NS,
    )


def test_three_sensors_are_sent_as_ardupilot_sends_them(tmp_path: Path) -> None:
    recording = recorded(3)
    mavlink_writer.write(recording, tmp_path / "flight.tlog")
    found = official(tmp_path / "flight.tlog")
    for name, stream in zip(mavlink_writer.SENSOR_MESSAGES, recording.streams, strict=False):
        messages = found[1, 1, name]
        for axis, column in zip("xyz", stream.gyro, strict=True):
            sent = np.array([getattr(m, f"{axis}gyro") for m in messages]) / 1000
            assert np.abs(sent - stream.columns[column]).max() <= MILLI
        stamps = np.array([m._timestamp for m in messages])
        assert np.abs(stamps - (UTC_NS + stream.time_ns) / 1e9).max() < 1e-5
    angles = [(m.roll, m.pitch, m.yaw) for m in found[1, 1, "ATTITUDE"]]
    attitude = np.column_stack([recording.streams[-1].columns[a] for a in ("roll", "pitch", "yaw")])
    assert np.array_equal(angles, attitude.astype(np.float32))
    assert {m.autopilot for m in found[1, 1, "HEARTBEAT"]} == {3}
    assert "BAD_DATA" not in {name for *_, name in found}


def test_our_reader_reads_a_written_log_back(tmp_path: Path) -> None:
    recording = recorded(3)
    mavlink_writer.write(recording, tmp_path / "flight.tlog")
    again = mavlink.read(tmp_path / "flight.tlog")
    assert all(problem.note for problem in again.problems)
    gyros, _ = choose(again, Config())
    assert [gyro.name for gyro in gyros] == ["imu0", "imu1", "imu2"]
    for gyro, stream in zip(gyros, recording.streams, strict=False):
        sent = np.column_stack([stream.columns[column] for column in stream.gyro])
        assert np.abs(gyro.rate_rad_s - sent).max() <= MILLI
        assert np.abs(gyro.time_ns - stream.time_ns).max() < 10**6
    assert again.utc_at_zero_ns is not None
    assert abs(again.utc_at_zero_ns - UTC_NS) < 10**6
    assert recording.armed is not None
    assert again.armed is not None
    assert np.abs(np.array(again.armed) - np.array(recording.armed)).max() <= 1.1e9


def test_more_sensors_go_out_in_single_precision_with_their_number(tmp_path: Path) -> None:
    recording = recorded(5)
    mavlink_writer.write(recording, tmp_path / "flight.tlog")
    gyros, _ = choose(mavlink.read(tmp_path / "flight.tlog"), Config())
    assert len(gyros) == 5
    for gyro, stream in zip(gyros, recording.streams, strict=False):
        sent = np.column_stack([stream.columns[column] for column in stream.gyro])
        assert np.array_equal(gyro.rate_rad_s, sent.astype(np.float32))
        assert np.array_equal(gyro.time_ns, stream.time_ns)


def test_a_rate_beyond_16_bits_saturates_and_what_is_no_number_is_not_sent(tmp_path: Path) -> None:
    recording = recorded(1)
    recording.streams[0].columns["gyro_x"][5:8] = 50.0, -50.0, np.nan
    mavlink_writer.write(recording, tmp_path / "flight.tlog")
    sent = official(tmp_path / "flight.tlog")[1, 1, "RAW_IMU"]
    assert [m.xgyro for m in sent[5:7]] == [32767, -32768]
    assert len(sent) == recording.streams[0].count - 1


def test_a_device_that_is_no_triad_is_refused(tmp_path: Path) -> None:
    recording = simulate(5.0, 25.0, geometry="dodecahedron", seed=1).recording()
    with pytest.raises(UsageError, match="no message for the 6 gyros"):
        mavlink_writer.write(recording, tmp_path / "flight.tlog")
    assert not (tmp_path / "flight.tlog").exists()


def test_the_same_recording_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        mavlink_writer.write(recorded(3), tmp_path / name)
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_compass_and_velocity_are_read_back(tmp_path: Path) -> None:
    recording = recorded(1)
    imu, *others = recording.streams
    field = {
        f"m{axis}": np.linspace(-k * 1e-5, 3e-5, len(imu.time_ns)) for k, axis in enumerate("xyz")
    }
    imu = replace(
        imu,
        columns={**imu.columns, **field},
        units={**imu.units, **dict.fromkeys(field, "T")},
        compass=tuple(field),
    )
    time_ns = np.arange(0, 8 * 10**9, 2 * 10**8)
    ground = {"north": np.linspace(-3.0, 3.0, len(time_ns)), "east": np.full(len(time_ns), -1.5)}
    ground["north"][7] = np.nan
    gps = Stream(name="gps", time_ns=time_ns, columns=ground, velocity=("north", "east"))
    mavlink_writer.write(replace(recording, streams=(imu, *others, gps)), tmp_path / "flight.tlog")
    again = mavlink.read(tmp_path / "flight.tlog")
    (seen,) = [s for s in again.streams if s.compass]
    for theirs, ours in zip(seen.compass, field.values(), strict=True):
        np.testing.assert_allclose(seen.columns[theirs], ours, atol=0.5e-7)  # milligauss
    (moving,) = [s for s in again.streams if s.velocity]
    known = np.arange(len(time_ns)) != 7
    for theirs, ours in zip(moving.velocity, ground.values(), strict=True):
        np.testing.assert_allclose(moving.columns[theirs][known], ours[known], atol=0.006)
        assert np.isnan(moving.columns[theirs][7])
