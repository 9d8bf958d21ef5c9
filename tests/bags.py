"""ROS messages and recordings for tests, made by the official serialisers and writers."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Recording, Stream

START_NS = 1_700_000_000_123_456_789
IMU = "sensor_msgs/msg/Imu"
AXES = ("x", "y", "z")
GYRO = tuple(f"angular_velocity.{axis}" for axis in AXES)
FORCE = tuple(f"linear_acceleration.{axis}" for axis in AXES)
TURN = tuple(f"orientation.{axis}" for axis in ("w", "x", "y", "z"))

Message = tuple[str, int, bytes]


@functools.cache
def store(ros: int = 2) -> Any:
    """Message types and serialisers of ROS 1 or 2, with custom types that hold Imus."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    text = "std_msgs/Header header\nstring label\nsensor_msgs/Imu imu\nsensor_msgs/Imu[2] pair\n"
    types.register(get_types_from_msg(text, "test_msgs/msg/Nested"))
    text = "std_msgs/Header header\nstring[] names\nsensor_msgs/Imu[] imus\nuint8 flag\n"
    types.register(get_types_from_msg(text, "test_msgs/msg/Several"))
    text = "string[] names\nfloat32[3] angular_velocity\nuint8 flag\nfloat64[] data\n"
    types.register(get_types_from_msg(text, "test_msgs/msg/Custom"))
    return types


@dataclass(frozen=True, eq=False)
class Imus:
    """Readings of one Imu topic; log_ns is a little later than the stamps, and uneven."""

    stamp_ns: NDArray[np.int64]
    log_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    force: NDArray[np.float64]
    turn: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.stamp_ns)


def readings(count: int, seed: int = 0, rate_hz: int = 100) -> Imus:
    """Draw readings; every bit of every number is arbitrary."""
    random = np.random.default_rng(seed)
    stamp_ns = START_NS + np.arange(count, dtype=np.int64) * (10**9 // rate_hz)
    return Imus(
        stamp_ns,
        np.sort(stamp_ns + random.integers(100_000, 900_000, count)),
        random.normal(0, 1, (count, 3)),
        random.normal(0, 9, (count, 3)),
        random.normal(0, 1, (count, 4)),
    )


def header(stamp_ns: int, frame: str, ros: int = 2) -> Any:
    """Make a std_msgs/Header."""
    types = store(ros).types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(int(stamp_ns), 10**9))
    extra = {"seq": 7} if ros == 1 else {}
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **extra)


def imu(imus: Imus, k: int, frame: str = "imu", ros: int = 2, stamp_ns: int | None = None) -> Any:
    """Make a sensor_msgs/Imu of one reading."""
    types = store(ros).types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    w, x, y, z = imus.turn[k].tolist()
    return types[IMU](
        header=header(int(imus.stamp_ns[k]) if stamp_ns is None else stamp_ns, frame, ros),
        orientation=quaternion(x=x, y=y, z=z, w=w),
        orientation_covariance=np.arange(9.0),
        angular_velocity=vector(*imus.gyro[k].tolist()),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*imus.force[k].tolist()),
        linear_acceleration_covariance=np.zeros(9),
    )


def serialise(message: Any, name: str, ros: int = 2) -> bytes:
    """Serialise with rosbags: CDR for ROS 2."""
    types = store(ros)
    made = types.serialize_ros1(message, name) if ros == 1 else types.serialize_cdr(message, name)
    return bytes(made)


def imu_messages(
    topic: str, imus: Imus, frames: Sequence[str] = ("imu",), ros: int = 2
) -> list[Message]:
    """Serialise all readings; frame ids take turns."""
    return [
        (
            topic,
            int(imus.log_ns[k]),
            serialise(imu(imus, k, frames[k % len(frames)], ros), IMU, ros),
        )
        for k in range(len(imus))
    ]


def by_time(*topics: Iterable[Message]) -> list[Message]:
    """Merge messages in the order of their recording."""
    return sorted((message for topic in topics for message in topic), key=lambda m: m[1])


def definition(name: str, ros: int = 2) -> bytes:
    """Return the text that a recorder writes for a type."""
    text: str = store(ros).generate_msgdef(name, ros_version=ros)[0]
    return text.encode()


def write_mcap(
    path: Path,
    messages: Iterable[Message],
    types: dict[str, str],
    *,
    ros: int = 2,
    encoding: str = "",
    schemas: dict[str, tuple[str, bytes]] | None = None,
    **options: Any,
) -> Path:
    """Write with the official library; options are those of its Writer."""
    from mcap.writer import Writer

    default = ("ros1msg", "ros1") if ros == 1 else ("ros2msg", "cdr")
    with path.open("wb") as file:
        writer = Writer(file, **({"chunk_size": 20_000} | options))
        writer.start("ros2" if ros == 2 else "ros1", "test")
        channels = {}
        for topic, name in types.items():
            if schemas is None:
                number = writer.register_schema(name, default[0], definition(name, ros))
            elif topic in schemas:
                number = writer.register_schema(name, *schemas[topic])
            else:
                number = 0
            channels[topic] = writer.register_channel(topic, encoding or default[1], number)
        for sequence, (topic, time_ns, data) in enumerate(messages):
            writer.add_message(channels[topic], time_ns, data, time_ns, sequence)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def write_rosbag1(
    path: Path, messages: Iterable[Message], types: dict[str, str], compression: str = "none"
) -> Path:
    """Write with rosbags; a topic may end in '#2' to be a second connection of the same name."""
    from rosbags.rosbag1 import Writer

    path.unlink(missing_ok=True)
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        connections = {
            topic: writer.add_connection(
                topic.partition("#")[0], name, typestore=store(1), callerid=f"/{topic[-1]}"
            )
            for topic, name in types.items()
        }
        for topic, time_ns, data in messages:
            writer.write(connections[topic], time_ns, data)
    return path


def write_rosbag2(
    path: Path,
    messages: Iterable[Message],
    types: dict[str, str],
    *,
    storage: str = "sqlite3",
    compression: str = "",
) -> Path:
    """Write a directory with rosbags; compression is 'message', 'file' or 'storage'."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store(2))
            for topic, name in types.items()
        }
        for topic, time_ns, data in messages:
            writer.write(connections[topic], time_ns, data)
    return path


def stream(recording: Recording, name: str) -> Stream:
    """Return the one stream of this name."""
    found = [stream for stream in recording.streams if stream.name == name]
    assert len(found) == 1, [stream.name for stream in recording.streams]
    return found[0]


def assert_same(found: Stream, imus: Imus, keep: Any = slice(None)) -> None:
    """Compare every bit of a stream with the readings that were written."""
    assert found.time_ns.dtype == np.int64
    assert np.array_equal(found.time_ns, imus.stamp_ns[keep])
    for names, values in ((GYRO, imus.gyro), (FORCE, imus.force), (TURN, imus.turn)):
        for k, name in enumerate(names):
            column = found.columns[name]
            assert column.dtype == np.float64
            assert column.tobytes() == np.ascontiguousarray(values[keep, k]).tobytes()


def assert_part(found: Stream, imus: Imus) -> int:
    """Check that every sample is one that was written, in order; return how many there are."""
    places = np.searchsorted(imus.stamp_ns, found.time_ns)
    assert (np.diff(places) > 0).all()
    assert_same(found, imus, places)
    return len(places)


def losses(recording: Recording) -> list[str]:
    """Return what was lost, in words."""
    return [problem.what for problem in recording.problems if not problem.note]
