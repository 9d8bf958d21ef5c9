"""A recording as ROS messages: what drivers of its sensors would have published."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.recording import Recording, Stream
from fdilog.sources.attitude import logged_attitude
from fdilog.sources.gyros import Gyro, choose

Floats = NDArray[np.float64]
Message = tuple[int, str, bytes]

IMU, ATTITUDE = "sensor_msgs/msg/Imu", "geometry_msgs/msg/QuaternionStamped"
ATTITUDE_TOPIC = "/attitude"
# By convention of sensor_msgs/Imu: what the first element of a covariance says of a missing part.
NOT_GIVEN = -1.0


@dataclass(frozen=True, eq=False)
class Published:
    """What one topic carries.

    Parameters
    ----------
    time_ns : (n,) int64
        Stamps. [ns]
    rate_rad_s : (n, 3) or None
        None for a topic that only says how the vehicle is turned. [rad/s]
    force_m_s2 : (n, 3) or None
        [m/s^2]
    turn : (n, 4) or None
        Quaternion w, x, y, z, body to world. [1]
    """

    topic: str
    time_ns: NDArray[np.int64]
    rate_rad_s: Floats | None = None
    force_m_s2: Floats | None = None
    turn: Floats | None = None

    @property
    def type(self) -> str:
        """Name of the message type."""
        return ATTITUDE if self.rate_rad_s is None else IMU

    @property
    def frame(self) -> str:
        """Name of the frame that the sensor is fixed to."""
        return self.topic.split("/")[1]


def published(recording: Recording) -> list[Published]:
    """Choose what is to be written: a topic for each gyro, and one for a logged attitude.

    Raises
    ------
    NoGyroError
        If there is no gyro.
    UsageError
        If a source has not the three gyros x, y, z of a message, or a stamp is before 1970.
    """
    shift_ns = recording.utc_at_zero_ns or 0
    topics = [_imu(gyro, shift_ns) for gyro in choose(recording, Config())[0]]
    for stream in recording.streams:
        turn = None if stream.gyro else logged_attitude(stream.columns)
        if turn is not None and stream.origin == "derived":
            topics.append(Published(ATTITUDE_TOPIC, stream.time_ns + shift_ns, turn=turn))
            break
    for topic in topics:
        if len(topic.time_ns) and int(topic.time_ns.min()) < 0:
            raise UsageError(f"{topic.topic}: a ROS time cannot be before 1970")
    return topics


def _imu(gyro: Gyro, shift_ns: int) -> Published:
    stream = gyro.stream
    letters = "".join(name[-1:] for name in gyro.channel_names)
    if len(stream.gyro) != 3 or letters != "xyz":
        raise UsageError(
            f"a ROS Imu has gyros x, y, z, but {stream.name} has {', '.join(gyro.channel_names)};"
            " a .csv holds any"
        )
    return Published(
        f"/{gyro.name}/data",
        stream.time_ns + shift_ns,
        gyro.rate_rad_s,
        _force(stream),
        logged_attitude(stream.columns),
    )


def _force(stream: Stream) -> Floats | None:
    if len(stream.accelerometer) != 3:
        return None
    return np.column_stack([np.asarray(stream.columns[n], float) for n in stream.accelerometer])


def typestore(ros: int) -> Any:
    """Return the message types of ROS 1 or 2, with their serialisers."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)


def serialised(topics: list[Published], store: Any, ros: int) -> Iterator[Message]:
    """Yield time, topic and message in the order of time."""

    def of(topic: Published) -> Iterator[Message]:
        serialise = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        # A recorder's clock does not run backwards, whatever a stamp does.
        log_ns = np.maximum.accumulate(topic.time_ns).tolist()
        for k, time_ns in enumerate(log_ns):
            yield time_ns, topic.topic, bytes(serialise(_message(topic, k, store, ros), topic.type))

    yield from heapq.merge(*map(of, topics), key=lambda message: message[0])


def _message(topic: Published, k: int, store: Any, ros: int) -> Any:
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(int(topic.time_ns[k]), 1_000_000_000))
    extra = {"seq": k % (1 << 32)} if ros == 1 else {}
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=topic.frame, **extra)
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    w, x, y, z = (1.0, 0.0, 0.0, 0.0) if topic.turn is None else topic.turn[k].tolist()
    turn = quaternion(x=x, y=y, z=z, w=w)
    if topic.rate_rad_s is None:
        return types[ATTITUDE](header=header, quaternion=turn)
    force = [0.0] * 3 if topic.force_m_s2 is None else topic.force_m_s2[k].tolist()
    return types[IMU](
        header=header,
        orientation=turn,
        orientation_covariance=_covariance(topic.turn),
        angular_velocity=vector(*topic.rate_rad_s[k].tolist()),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*force),
        linear_acceleration_covariance=_covariance(topic.force_m_s2),
    )


def _covariance(values: Floats | None) -> Floats:
    covariance = np.zeros(9)
    if values is None:
        covariance[0] = NOT_GIVEN
    return covariance


def replacing(path: Path) -> Path:
    """Return a path beside, to write to first: the official writers want one that is free."""
    return path.with_name(f".{path.name}.part")
