"""Recorded bags read by this project and by mcap and rosbags, compared bit for bit."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.errors import NoGyroError
from fdilog.recording import Recording
from fdilog.registry import read
from fdilog.sources.assembly import channel_table
from tests.bags import AXES, losses, stream

IMUS = {
    "mcap/car_circles_nested_imu.mcap": ("/imu", "imu"),
    "rosbag1/ground_robot_50hz.bag": ("/imu/data", ""),
    "rosbag1/phidgets_250hz.bag": ("/imu/data_raw", ""),
    "rosbag1/vn100_impulses.bag": ("/imu", "imu"),
    "rosbag2/constant_imu": ("/imu", ""),
}
WITHOUT = ["json_logs.mcap", "no_imu_bz2.bag", "no_imu_lz4.bag", "valid_but_empty.mcap"]


def official(path: Path, topic: str) -> list[tuple[int, Any]]:
    """Every message of a topic, with the time of its recording, by rosbags."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=store) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        return [
            (time_ns, reader.deserialize(raw, connection.msgtype))
            for connection, time_ns, raw in reader.messages(connections)
        ]


def stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


@pytest.mark.parametrize("name", IMUS)
def test_every_imu_equals_what_the_official_library_reads(real_logs: Path, name: str) -> None:
    topic, owner = IMUS[name]
    recording = read(real_logs / name)
    found = stream(recording, f"{topic}:{owner}" if owner else topic)
    messages = official(real_logs / name, topic)
    assert len(messages) == found.count == len(found.time_ns)
    imus = [getattr(message, owner) if owner else message for _, message in messages]
    for part, names in (("angular_velocity", AXES), ("linear_acceleration", AXES)):
        for axis in names:
            expected = np.array([getattr(getattr(imu, part), axis) for imu in imus], np.float64)
            assert found.columns[f"{part}.{axis}"].tobytes() == expected.tobytes()
    for axis in ("w", "x", "y", "z"):
        expected = np.array([getattr(imu.orientation, axis) for imu in imus], np.float64)
        assert found.columns[f"orientation.{axis}"].tobytes() == expected.tobytes()
    inner = owner and found.clock.startswith("header.stamp")
    stamped = [message for _, message in messages] if inner else imus
    assert found.clock.startswith(("header.stamp", "imu.header.stamp"))
    assert found.time_ns.tolist() == [stamp_ns(message) for message in stamped]
    assert losses(recording) == []


def test_the_twist_of_an_odometry_equals_what_the_official_library_reads(real_logs: Path) -> None:
    path = real_logs / "rosbag1/ground_robot_50hz.bag"
    topic = "/jackal_velocity_controller/odom"
    found = stream(read(path), topic)
    messages = [message for _, message in official(path, topic)]
    assert found.origin == "derived"
    for axis, name in zip(AXES, found.gyro, strict=True):
        expected = [getattr(message.twist.twist.angular, axis) for message in messages]
        assert found.columns[name].tolist() == expected


def test_every_number_of_every_topic_equals_what_the_official_library_reads(
    real_logs: Path,
) -> None:
    compared = 0
    for name in ("rosbag1/ground_robot_50hz.bag", "no-gyro/no_imu_lz4.bag", "rosbag2/constant_imu"):
        path = real_logs / name
        names = [s.name for s in read(path).streams]
        recording = read(path, also=names)
        for found in recording.streams:
            messages = [message for _, message in official(path, found.name)]
            assert found.count == len(messages)
            for leaf, column in found.columns.items():
                expected = [_leaf(message, leaf) for message in messages]
                assert np.array_equal(column, expected, equal_nan=True), (name, found.name, leaf)
                compared += 1
    assert compared > 60


def _leaf(message: Any, leaf: str) -> Any:
    if leaf in {"qw", "qx", "qy", "qz"}:  # an odometry's attitude is called as everywhere
        leaf = f"pose.pose.orientation.{leaf[1]}"
    for part in leaf.split("."):
        field, _, index = part.rstrip("]").partition("[")
        message = getattr(message, field)
        if index:
            message = message[int(index)] if int(index) < len(message) else np.nan
    return message


def test_the_listed_topics_and_their_counts_are_those_of_the_official_libraries(
    real_logs: Path,
) -> None:
    from mcap.reader import make_reader
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    for path in [*real_logs.glob("*/*.bag"), *(real_logs / "rosbag2").iterdir()]:
        counts: dict[str, int] = defaultdict(int)
        store = get_typestore(Stores.ROS2_HUMBLE)
        with AnyReader([path], default_typestore=store) as reader:
            for connection in reader.connections:
                counts[connection.topic] += connection.msgcount
        assert listed(read(path)) == dict(counts)
    for path in real_logs.glob("*/*.mcap"):
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        numbers = summary.statistics.channel_message_counts
        topics = {channel.topic: numbers[n] for n, channel in summary.channels.items()}
        assert listed(read(path)) == topics


def listed(recording: Recording) -> dict[str, int]:
    return {s.name.partition(":")[0]: s.count for s in recording.streams}


@pytest.mark.parametrize("name", WITHOUT)
def test_a_log_without_a_gyro_is_read_and_says_so(real_logs: Path, name: str) -> None:
    recording = read(real_logs / "no-gyro" / name)
    assert losses(recording) == []
    assert not any(s.gyro for s in recording.streams)
    with pytest.raises(NoGyroError, match="no gyro channels"):
        channel_table(recording)


def test_a_type_that_the_bag_does_not_define_is_named_and_not_guessed(real_logs: Path) -> None:
    recording = read(real_logs / "rosbag2/car_circle_custom_type")
    assert not any(s.gyro for s in recording.streams)
    assert any("imu_msg/msg/IMUmsg" in problem.what for problem in recording.problems)
    with pytest.raises(NoGyroError, match="/imu"):
        channel_table(recording)


def test_the_impulses_of_the_damaged_serial_line_are_where_they_were_recorded(
    real_logs: Path,
) -> None:
    path = real_logs / "rosbag1/vn100_impulses.bag"
    found = stream(read(path), "/imu:imu")
    recorded_ns = np.array([time_ns for time_ns, _ in official(path, "/imu")])
    z = found.columns["angular_velocity.z"]
    wild = np.flatnonzero(np.abs(z) > 4.5)
    assert z[wild].round(2).tolist() == [-4.99, -13.0, -30945.0]
    seconds = (recorded_ns[wild] - recorded_ns[0]) / 1e9
    assert np.allclose(seconds, [27.75, 52.78, 100.11], atol=0.01)
    assert np.allclose((found.time_ns[wild] - found.time_ns[0]) / 1e9, seconds, atol=0.06)
