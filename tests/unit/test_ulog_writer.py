"""PX4 logs that we write are read by the official library, and by our own reader."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config, GyroSource
from fdilog.errors import NoGyroError, UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.sources.gyros import choose
from fdilog.writing import write, write_injected
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


def logged_twice() -> Recording:
    """Three sensors of which the second has another stream, of every reading but the first."""
    recording = recorded()
    second = recording.streams[1]
    rest = replace(
        second,
        name="again",
        time_ns=second.time_ns[1:],
        columns={name: column[1:] for name, column in second.columns.items()},
        offsets=None,
        count=-1,
    )
    return replace(recording, streams=(*recording.streams, rest))


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_a_sensor_that_is_logged_twice_is_written_once(tmp_path: Path, suffix: str) -> None:
    write(logged_twice(), tmp_path / f"flight{suffix}")
    again = read(tmp_path / f"flight{suffix}")
    gyros, _ = choose(again, Config())
    assert [gyro.name for gyro in gyros] == ["imu0", "imu1", "imu2"]
    assert len([s for s in again.streams if s.gyro and s.origin == "sensor"]) == 3
    assert len(gyros[1].time_ns) == recorded().streams[1].count


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_a_copy_does_not_hide_the_fault_behind_another_stream_of_the_sensor(
    tmp_path: Path, suffix: str
) -> None:
    silent = Fault(kind="dropout", channel="imu1", start_s=2.0, end_s=4.0)
    injection = inject(logged_twice(), [silent])
    write_injected(injection, tmp_path / "flight.csv", tmp_path / f"copy{suffix}")
    gyros = choose(read(tmp_path / f"copy{suffix}"), Config())[0]
    assert injection.changes[0].removed.sum() > 40
    assert len(gyros[1].time_ns) == len(gyros[0].time_ns) - injection.changes[0].removed.sum()


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_sensors_keep_their_numbers_when_one_is_missing(tmp_path: Path, suffix: str) -> None:
    recording = recorded()
    first, _, third, *others = recording.streams
    write(replace(recording, streams=(first, third, *others)), tmp_path / f"flight{suffix}")
    gyros = choose(read(tmp_path / f"flight{suffix}"), Config())[0]
    assert [gyro.name for gyro in gyros] == ["imu0", "imu2"]


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_what_the_autopilot_selected_is_written_where_nothing_else_was_logged(
    tmp_path: Path, suffix: str
) -> None:
    recording = recorded(1)
    chosen = replace(recording.streams[0], origin="selected", sensor=None)
    write(replace(recording, streams=(chosen,)), tmp_path / f"flight{suffix}")
    (gyro,) = choose(read(tmp_path / f"flight{suffix}"), Config())[0]
    sent = np.column_stack([chosen.columns[name] for name in chosen.gyro])
    assert gyro.name == "imu0"
    assert np.abs(gyro.rate_rad_s - sent).max() <= 0.5001e-3


@pytest.mark.parametrize("suffix", [".ulg", ".tlog"])
def test_a_log_without_a_gyro_is_refused(tmp_path: Path, suffix: str) -> None:
    recording = recorded(1)
    with pytest.raises(NoGyroError, match="no gyro channels"):
        write(replace(recording, streams=recording.streams[-1:]), tmp_path / f"flight{suffix}")
    assert not (tmp_path / f"flight{suffix}").exists()


def test_an_accelerometer_in_a_stream_of_its_own_stays_beside_its_gyro(tmp_path: Path) -> None:
    recording = recorded(1)
    both, *others = recording.streams
    apart = (replace(both, accelerometer=()), replace(both, name="forces", gyro=()))
    write(replace(recording, streams=(*apart, *others)), tmp_path / "flight.ulg")
    sent = official(tmp_path / "flight.ulg")["sensor_accel", 0]
    for axis, name in zip("xyz", both.accelerometer, strict=True):
        assert np.array_equal(sent[axis], both.columns[name].astype(np.float32))


def test_readings_that_a_sensor_never_tells_keep_no_rate_back_in_a_tlog(tmp_path: Path) -> None:
    recording = recorded(1)
    first = recording.streams[0]
    first.columns["temperature"][:] = np.nan
    write(recording, tmp_path / "flight.tlog")
    (gyro,) = choose(read(tmp_path / "flight.tlog"), Config())[0]
    assert len(gyro.time_ns) == first.count


def test_a_tlog_in_which_no_reading_would_be_whole_is_refused(tmp_path: Path) -> None:
    recording = recorded(1)
    recording.streams[0].columns["gyro_x"][:] = np.nan
    with pytest.raises(UsageError, match="no message of imu0"):
        write(recording, tmp_path / "flight.tlog")
    assert not (tmp_path / "flight.tlog").exists()


def test_a_fault_of_a_source_that_the_configuration_describes_is_in_the_copy(
    tmp_path: Path,
) -> None:
    recording = recorded(2)
    second = recording.streams[1]
    left = GyroSource(name="left", topic=second.name, fields=second.gyro, unit="rad/s")
    config = Config(sources=replace(Config().sources, gyro=(left,)))
    bias = Fault(kind="bias", channel="left.y", start_s=2.0, end_s=4.0, size=0.125)
    write_injected(
        inject(recording, [bias], config=config), tmp_path / "flight.csv", tmp_path / "copy.ulg"
    )
    after = choose(read(tmp_path / "copy.ulg"), Config())[0][1].rate_rad_s
    apart = after - np.column_stack([second.columns[name] for name in second.gyro])
    assert (np.abs(apart) > 1e-3).any(axis=0).tolist() == [False, True, False]
    assert apart.max() == pytest.approx(0.125, abs=1e-6)


def test_a_fault_that_no_gyro_of_the_copy_would_hold_is_refused(tmp_path: Path) -> None:
    recording = recorded(2)
    second = replace(recording.streams[1], gyro=(), sensor=None)
    streams = (recording.streams[0], second, *recording.streams[2:])
    fields = recording.streams[1].gyro
    left = GyroSource(name="left", topic=second.name, fields=fields, unit="rad/s")
    config = Config(sources=replace(Config().sources, gyro=(left,)))
    bias = Fault(kind="bias", channel="left.y", start_s=2.0, end_s=4.0, size=0.125)
    injection = inject(replace(recording, streams=streams), [bias], config=config)
    with pytest.raises(UsageError, match="would not hold imu1, where the fault is"):
        write_injected(injection, tmp_path / "flight.csv", tmp_path / "copy.ulg")
    assert not (tmp_path / "copy.ulg").exists()


def test_compass_and_velocity_are_read_back(tmp_path: Path) -> None:
    recording = recorded(1)
    time_ns = np.arange(0, 8 * 10**9, 2 * 10**8)
    field = {
        axis: np.linspace(start, 5e-5, len(time_ns))
        for axis, start in zip("xyz", (1e-5, 2e-5, 3e-5), strict=True)
    }
    compass = Stream(
        name="compass", time_ns=time_ns, columns=field, units=dict.fromkeys(field, "T"),
        compass=tuple(field),
    )  # fmt: skip
    ground = {"north": np.linspace(-3.0, 3.0, len(time_ns)), "east": np.full(len(time_ns), 1.5)}
    ground["north"][7] = np.nan
    gps = Stream(name="gps", time_ns=time_ns, columns=ground, velocity=("north", "east"))
    recording = replace(recording, streams=(*recording.streams, compass, gps))
    ulog_writer.write(recording, tmp_path / "flight.ulg")
    again = ulog.read(tmp_path / "flight.ulg")
    (seen,) = [s for s in again.streams if s.compass]
    for theirs, ours in zip(seen.compass, field.values(), strict=True):
        np.testing.assert_allclose(seen.columns[theirs], ours * 1e4, rtol=1e-6)
    (moving,) = [s for s in again.streams if s.velocity]
    for theirs, ours in zip(moving.velocity, ground.values(), strict=True):
        known = np.arange(len(time_ns)) != 7
        np.testing.assert_allclose(moving.columns[theirs][known], ours[known], rtol=1e-6)
        assert np.isnan(moving.columns[theirs][7])
    assert again.utc_at_zero_ns == UTC_NS
