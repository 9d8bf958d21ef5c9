"""A robot's traffic for benchmarks: two gyros at 500 Hz among odometry, pictures, diagnostics."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

START_NS = 1_700_000_000_000_000_000
IMU_HZ = 500
ODOMETRY_HZ = 50
PICTURE_HZ = 20
DIAGNOSTICS_HZ = 2
PICTURE_BYTES = 16_000
IMU_TOPICS = ("/imu/left", "/imu/right")

TYPES = {
    "/imu/left": "sensor_msgs/msg/Imu",
    "/imu/right": "sensor_msgs/msg/Imu",
    "/odom": "nav_msgs/msg/Odometry",
    "/picture": "sensor_msgs/msg/CompressedImage",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}


def typestore(ros: int) -> Any:
    """Return the message types of ROS 1 or ROS 2, with their serialisers."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)


def messages(minutes: float, ros: int = 2) -> Iterator[tuple[str, int, bytes]]:
    """Yield topic, time in ns, and serialised message, in the order of time."""
    store = typestore(ros)
    seconds = minutes * 60.0
    random = np.random.default_rng(20240229)
    parts = [_imus(store, ros, topic, round(seconds * IMU_HZ), random) for topic in IMU_TOPICS]
    parts.append(_odometry(store, ros, round(seconds * ODOMETRY_HZ), random))
    parts.append(_pictures(store, ros, round(seconds * PICTURE_HZ), random))
    parts.append(_diagnostics(store, ros, round(seconds * DIAGNOSTICS_HZ), random))
    import heapq

    yield from heapq.merge(*parts, key=lambda message: message[1])


def _stamps(count: int, rate_hz: int) -> NDArray[np.int64]:
    return START_NS + np.arange(count, dtype=np.int64) * (1_000_000_000 // rate_hz)


def _serialise(store: Any, ros: int, message: Any, name: str) -> bytes:
    return bytes((store.serialize_ros1 if ros == 1 else store.serialize_cdr)(message, name))


def _header(store: Any, ros: int, stamp_ns: int, frame: str) -> Any:
    time = store.types["builtin_interfaces/msg/Time"](*divmod(int(stamp_ns), 1_000_000_000))
    extra = {"seq": 0} if ros == 1 else {}
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **extra)


def _template(store: Any, ros: int, name: str, message: Any, places: dict[str, float]) -> Any:
    """Serialise one message and find the fields by the marks that were put into them."""
    raw = _serialise(store, ros, message, name)
    found = {field: raw.index(np.float64(mark).tobytes()) for field, mark in places.items()}
    stamp = raw.index(np.array([START_NS // 10**9, 0], "<u4").tobytes())
    return np.dtype(
        {
            "names": ["stamp", *found],
            "formats": ["(2,)<u4", *["<f8"] * len(found)],
            "offsets": [stamp, *found.values()],
            "itemsize": len(raw),
        }
    ), raw


def _rows(dtype: Any, raw: bytes, stamps: NDArray[np.int64]) -> Any:
    rows = np.frombuffer(bytearray(raw * len(stamps)), dtype)
    rows["stamp"][:, 0] = stamps // 10**9
    rows["stamp"][:, 1] = stamps % 10**9
    return rows


AXES = ("x", "y", "z")


def _imus(
    store: Any, ros: int, topic: str, count: int, random: np.random.Generator
) -> Iterator[tuple[str, int, bytes]]:
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    message = types["sensor_msgs/msg/Imu"](
        header=_header(store, ros, START_NS, topic[1:].replace("/", "_")),
        orientation=quaternion(1.25e-7, 2.25e-7, 3.25e-7, 4.25e-7),
        orientation_covariance=np.full(9, 1e-4),
        angular_velocity=vector(5.25e-7, 6.25e-7, 7.25e-7),
        angular_velocity_covariance=np.full(9, 2e-5),
        linear_acceleration=vector(8.25e-7, 9.25e-7, 10.25e-7),
        linear_acceleration_covariance=np.full(9, 3e-3),
    )
    places = {"q0": 1.25e-7, "q1": 2.25e-7, "q2": 3.25e-7, "q3": 4.25e-7}
    places |= {"gx": 5.25e-7, "gy": 6.25e-7, "gz": 7.25e-7}
    places |= {"ax": 8.25e-7, "ay": 9.25e-7, "az": 10.25e-7}
    dtype, raw = _template(store, ros, "sensor_msgs/msg/Imu", message, places)
    stamps = _stamps(count, IMU_HZ)
    rows = _rows(dtype, raw, stamps)
    for field in places:
        rows[field] = random.normal(9.8 if field == "az" else 0.0, 0.05, count)
    data = rows.tobytes()
    jitter = random.integers(100_000, 500_000, count)
    for k in range(count):
        yield topic, int(stamps[k] + jitter[k]), data[k * len(raw) : (k + 1) * len(raw)]


def _odometry(
    store: Any, ros: int, count: int, random: np.random.Generator
) -> Iterator[tuple[str, int, bytes]]:
    types = store.types
    vector, quaternion = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](1.25e-7, 2.25e-7, 0.0), quaternion(0.0, 0.0, 0.0, 1.0)
    )
    twist = types["geometry_msgs/msg/Twist"](vector(3.25e-7, 0.0, 0.0), vector(0.0, 0.0, 4.25e-7))
    message = types["nav_msgs/msg/Odometry"](
        header=_header(store, ros, START_NS, "odom"),
        child_frame_id="base_link",
        pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, np.full(36, 0.01)),
        twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, np.full(36, 0.02)),
    )
    places = {"x": 1.25e-7, "y": 2.25e-7, "v": 3.25e-7, "w": 4.25e-7}
    dtype, raw = _template(store, ros, "nav_msgs/msg/Odometry", message, places)
    stamps = _stamps(count, ODOMETRY_HZ)
    rows = _rows(dtype, raw, stamps)
    for field in places:
        rows[field] = random.normal(0.0, 1.0, count)
    data = rows.tobytes()
    for k in range(count):
        yield "/odom", int(stamps[k] + 700_000), data[k * len(raw) : (k + 1) * len(raw)]


def _pictures(
    store: Any, ros: int, count: int, random: np.random.Generator
) -> Iterator[tuple[str, int, bytes]]:
    # Half noise, half runs: what a weakly compressed picture looks like to a compressor.
    noise = random.integers(0, 256, PICTURE_BYTES * 8, dtype=np.uint8)
    kind = store.types["sensor_msgs/msg/CompressedImage"]
    for stamp in _stamps(count, PICTURE_HZ):
        at = int(random.integers(0, PICTURE_BYTES * 7))
        picture = np.concatenate(
            [noise[at : at + PICTURE_BYTES // 2], np.repeat(noise[at : at + 80], 100)]
        )
        message = kind(_header(store, ros, stamp, "camera"), "jpeg", picture)
        raw = _serialise(store, ros, message, "sensor_msgs/msg/CompressedImage")
        yield "/picture", int(stamp + 5_000_000), raw


def _diagnostics(
    store: Any, ros: int, count: int, random: np.random.Generator
) -> Iterator[tuple[str, int, bytes]]:
    types = store.types
    status, pair = (
        types["diagnostic_msgs/msg/DiagnosticStatus"],
        types["diagnostic_msgs/msg/KeyValue"],
    )
    for stamp in _stamps(count, DIAGNOSTICS_HZ):
        temperature = f"{random.normal(40.0, 2.0):.2f}"
        states = [
            status(0, f"motor {k}", "ok", "", [pair("temperature", temperature)]) for k in range(4)
        ]
        message = types["diagnostic_msgs/msg/DiagnosticArray"](
            _header(store, ros, stamp, ""), states
        )
        raw = _serialise(store, ros, message, "diagnostic_msgs/msg/DiagnosticArray")
        yield "/diagnostics", int(stamp + 1_000_000), raw
