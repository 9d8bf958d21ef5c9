"""Simulated flights written as ROS recordings, and read back by the official libraries and here."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.errors import NoGyroError, UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.flight import Flight
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.sources.assembly import channel_table
from fdilog.writing import write
from fdilog_readers import mcap_writer, rosbag2_writer
from tests.bags import AXES, losses, stream

UTC_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def flight() -> Flight:
    silent = Fault(kind="dropout", channel="imu1", start_s=3.0, end_s=4.0)
    return simulate(9.0, 25.0, seed=3, faults=[silent], sources=2)


def written(flight: Flight, kind: str, folder: Path) -> Path:
    recording = replace(flight.recording(), utc_at_zero_ns=UTC_NS)
    path = folder / f"flight.{kind.partition(' ')[0]}"
    if kind in {"mcap json", "mcap protobuf"}:
        mcap_writer.write(recording, path, "json" if "json" in kind else "protobuf")
    elif kind.startswith("folder"):
        storage: Any = kind.split()[1]
        rosbag2_writer.write_folder(recording, path, storage, "message")
    else:
        write(recording, path)
    return path


KINDS = ["mcap", "mcap json", "mcap protobuf", "bag", "db3", "folder sqlite3", "folder mcap"]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_written_reads_back_bit_for_bit(flight: Flight, kind: str, tmp_path: Path) -> None:
    recording = read(written(flight, kind, tmp_path))
    assert losses(recording) == []
    assert [s.name for s in recording.streams] == ["/attitude", "/imu0/data", "/imu1/data"]
    for source in flight.sources:
        found = stream(recording, f"/{source.name}/data")
        assert np.array_equal(found.time_ns, source.time_ns + UTC_NS)
        assert source.acceleration_m_s2 is not None
        for k, axis in enumerate(AXES):
            rate, force = f"angular_velocity.{axis}", f"linear_acceleration.{axis}"
            assert found.columns[rate].tobytes() == source.rate_rad_s[:, k].tobytes()
            assert found.columns[force].tobytes() == source.acceleration_m_s2[:, k].tobytes()
        assert found.units[rate] == "rad/s"
    attitude = stream(recording, "/attitude")
    assert (attitude.origin, attitude.gyro) == ("derived", ())
    before = flight.recording().streams[-1]
    for name in ("qw", "qx", "qy", "qz"):
        assert np.allclose(attitude.columns[name], before.columns[name], rtol=0, atol=1e-15)
    table = channel_table(recording)
    witness = [f"att.{axis}" for axis in AXES]
    assert [channel.name for channel in table.channels] == [*flight.channels, *witness]


@pytest.mark.parametrize("kind", ["bag", "db3", "folder sqlite3", "folder mcap"])
def test_the_official_library_reads_what_is_written(
    flight: Flight, kind: str, tmp_path: Path
) -> None:
    from rosbags.highlevel import AnyReader

    with AnyReader([written(flight, kind, tmp_path)]) as reader:
        found: dict[str, list[Any]] = {}
        for connection, time_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    source = flight.sources[1]
    messages = found["/imu1/data"]
    assert [time_ns for time_ns, _ in messages] == (source.time_ns + UTC_NS).tolist()
    rates = [[getattr(m.angular_velocity, axis) for axis in AXES] for _, m in messages]
    assert np.array_equal(rates, source.rate_rad_s)
    assert {m.header.frame_id for _, m in messages} == {"imu1"}
    # no orientation was known, and the message says so
    assert {m.orientation_covariance[0] for _, m in messages} == {-1.0}
    assert {m.linear_acceleration_covariance[0] for _, m in messages} == {0.0}
    assert len(found["/attitude"]) == len(flight.attitude_time_ns)


def test_the_official_library_checks_and_reads_the_mcap_file(
    flight: Flight, tmp_path: Path
) -> None:
    from mcap.reader import make_reader

    for kind in ("mcap", "mcap json", "mcap protobuf"):
        with written(flight, kind, tmp_path).open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            counts = [0] * 3
            for _, channel, _ in reader.iter_messages():
                counts[channel.id - 1] += 1
        assert counts == [len(source.time_ns) for source in flight.sources] + [
            len(flight.attitude_time_ns)
        ]


def test_the_protobuf_descriptors_are_those_of_the_official_library(
    flight: Flight, tmp_path: Path
) -> None:
    decoder = pytest.importorskip("mcap_protobuf.decoder")
    from mcap.reader import make_reader

    with written(flight, "mcap protobuf", tmp_path).open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        messages = [d for *_, d in reader.iter_decoded_messages(topics=["/imu0/data"])]
    source = flight.sources[0]
    rates = [[getattr(m.angular_velocity, axis) for axis in AXES] for m in messages]
    assert np.array_equal(rates, source.rate_rad_s)
    assert [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages] == (
        source.time_ns + UTC_NS
    ).tolist()


@pytest.mark.parametrize("kind", ["mcap", "mcap json", "mcap protobuf", "bag", "db3"])
def test_the_same_recording_gives_the_same_bytes(flight: Flight, kind: str, tmp_path: Path) -> None:
    first = written(flight, kind, tmp_path).read_bytes()
    assert written(flight, kind, tmp_path).read_bytes() == first
    assert [path.name for path in tmp_path.iterdir()] == [f"flight.{kind.partition(' ')[0]}"]


def of(time_ns: list[int], columns: dict[str, Any], **settings: Any) -> Recording:
    made = Stream(
        name="s",
        time_ns=np.array(time_ns, np.int64),
        columns=columns,
        units=dict.fromkeys(columns, "rad/s"),
        **settings,
    )
    return Recording(path="", format="", bytes=0, streams=(made,))


def test_a_reading_that_is_no_number_stays_one(tmp_path: Path) -> None:
    columns = {axis: np.array([1.0, np.nan, -np.inf, 2.0]) for axis in AXES}
    recording = of([1, 2, 3, 4], columns, gyro=AXES)
    for name in ("a.mcap", "a.json.mcap", "a.protobuf.mcap", "a.bag", "a.db3"):
        write(recording, tmp_path / name)
        found = stream(read(tmp_path / name), "/imu0/data").columns["angular_velocity.x"]
        assert np.array_equal(found, [1.0, np.nan, np.nan, 2.0], equal_nan=True)


def test_what_a_message_cannot_hold_is_one_clear_line(tmp_path: Path) -> None:
    two = {name: np.ones(3) for name in ("g1", "g2")}
    skewed = of([1, 2, 3], two, gyro=("g1", "g2"), channel_names=("g1", "g2"))
    early = of([-5, 2, 3], {axis: np.ones(3) for axis in AXES}, gyro=AXES)
    nothing = of([1, 2, 3], {})
    for name in ("a.mcap", "a.bag", "a.db3"):
        with pytest.raises(UsageError, match=r"g1, g2; a .csv holds any"):
            write(skewed, tmp_path / name)
        with pytest.raises(UsageError, match="cannot be before 1970"):
            write(early, tmp_path / name)
        with pytest.raises(NoGyroError):
            write(nothing, tmp_path / name)
        with pytest.raises(UsageError, match="no such file or directory"):
            write(of([1], {a: np.ones(1) for a in AXES}, gyro=AXES), tmp_path / "absent" / name)
    assert not list(tmp_path.iterdir())
    (tmp_path / "there").mkdir()
    with pytest.raises(FileExistsError):
        rosbag2_writer.write_folder(early, tmp_path / "there")
