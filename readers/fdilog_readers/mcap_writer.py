"""Writing MCAP, with the official library: an Imu topic for each gyro, in CDR, JSON or Protobuf."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

from fdilog.recording import Recording
from fdilog_readers.ros_writing import (
    ATTITUDE,
    IMU,
    Message,
    Published,
    published,
    replacing,
    serialised,
    typestore,
)

suffix = ".mcap"

Encoding = Literal["cdr", "json", "protobuf"]
AXES, TURN = ("x", "y", "z"), ("w", "x", "y", "z")


def write(recording: Recording, path: Path, encoding: Encoding | None = None) -> None:
    """Write the gyros of a recording as ``/imu0/data`` ..., and its attitude as ``/attitude``.

    Parameters
    ----------
    encoding
        ``cdr`` as ROS 2 writes it, or ``json`` or ``protobuf`` with the same fields; if not said,
        what stands before the suffix (``flight.json.mcap``), else ``cdr``.

    Raises
    ------
    NoGyroError, UsageError
        If there is no gyro, or one that a message cannot hold.
    """
    from mcap.writer import Writer

    if encoding is None:
        named = path.stem.lower().rpartition(".")[2]
        encoding = "json" if named == "json" else "protobuf" if named == "protobuf" else "cdr"
    topics = published(recording)
    store = typestore(2) if encoding == "cdr" else None
    part = replacing(path)
    try:
        with part.open("wb") as file:
            writer = Writer(file)
            writer.start("ros2" if encoding == "cdr" else "", "fdilog")
            channels = {}
            for topic in topics:
                schema = writer.register_schema(*_schema(topic, encoding, store))
                channels[topic.topic] = writer.register_channel(topic.topic, encoding, schema)
            for sequence, (time_ns, name, data) in enumerate(_messages(topics, encoding, store)):
                writer.add_message(channels[name], time_ns, data, time_ns, sequence)
            writer.finish()  # type: ignore[no-untyped-call]
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _schema(topic: Published, encoding: Encoding, store: Any) -> tuple[str, str, bytes]:
    if encoding == "cdr":
        text = store.generate_msgdef(topic.type, ros_version=2)[0]
        return topic.type, "ros2msg", text.encode()
    name = topic.type.replace("/msg/", ".")
    if encoding == "json":
        return name, "jsonschema", json.dumps(JSON_SCHEMAS[topic.type]).encode()
    return name, "protobuf", _descriptors()


def _messages(topics: list[Published], encoding: Encoding, store: Any) -> Iterator[Message]:
    if encoding == "cdr":
        yield from serialised(topics, store, 2)
        return
    import heapq

    make = _json if encoding == "json" else _protobuf

    def of(topic: Published) -> Iterator[Message]:
        for k, time_ns in enumerate(topic.time_ns.tolist()):
            yield time_ns, topic.topic, make(topic, k)

    yield from heapq.merge(*map(of, topics), key=lambda message: message[0])


def _parts(topic: Published, k: int) -> dict[str, dict[str, float]]:
    """Return the vectors of a message that there are, by the names of their fields."""
    turn = "orientation" if topic.type == IMU else "quaternion"
    vectors = {
        "angular_velocity": (topic.rate_rad_s, AXES),
        "linear_acceleration": (topic.force_m_s2, AXES),
        turn: (topic.turn, TURN),
    }
    return {
        name: dict(zip(axes, values[k].tolist(), strict=True))
        for name, (values, axes) in vectors.items()
        if values is not None
    }


def _json(topic: Published, k: int) -> bytes:
    seconds, nanoseconds = divmod(int(topic.time_ns[k]), 1_000_000_000)
    stamp = {"sec": seconds, "nanosec": nanoseconds}
    parts = {
        name: {axis: value if math.isfinite(value) else None for axis, value in part.items()}
        for name, part in _parts(topic, k).items()
    }
    message = {"header": {"stamp": stamp, "frame_id": topic.frame}, **parts}
    return json.dumps(message, separators=(",", ":")).encode()


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_NUMBER, _INTEGER = {"type": "number"}, {"type": "integer"}
_HEADER = _object(
    stamp=_object(sec=_INTEGER, nanosec=_INTEGER),
    frame_id={"type": "string"},
)
_VECTOR = _object(**dict.fromkeys(AXES, _NUMBER))
_QUATERNION = _object(**dict.fromkeys(TURN, _NUMBER))
JSON_SCHEMAS = {
    IMU: _object(
        header=_HEADER,
        orientation=_QUATERNION,
        angular_velocity=_VECTOR,
        linear_acceleration=_VECTOR,
    ),
    ATTITUDE: _object(header=_HEADER, quaternion=_QUATERNION),
}

# Protobuf: field name to the type of its part, in the order of their numbers from one.
_PROTOBUF: dict[str, dict[str, dict[str, str]]] = {
    "std_msgs": {
        "Time": {"sec": "int64", "nanosec": "uint32"},
        "Header": {"stamp": ".std_msgs.Time", "frame_id": "string"},
    },
    "geometry_msgs": {
        "Vector3": dict.fromkeys(AXES, "double"),
        "Quaternion": dict.fromkeys(TURN, "double"),
        "QuaternionStamped": {
            "header": ".std_msgs.Header",
            "quaternion": ".geometry_msgs.Quaternion",
        },
    },
    "sensor_msgs": {
        "Imu": {
            "header": ".std_msgs.Header",
            "orientation": ".geometry_msgs.Quaternion",
            "angular_velocity": ".geometry_msgs.Vector3",
            "linear_acceleration": ".geometry_msgs.Vector3",
        },
    },
}
# Numbers of types in FieldDescriptorProto.
_TYPES = {"double": 1, "int64": 3, "string": 9, "uint32": 13}
_MESSAGE, _OPTIONAL = 11, 1


def _descriptors() -> bytes:
    """Serialise the FileDescriptorSet of the messages above."""
    files = b""
    for package, messages in _PROTOBUF.items():
        inside = _text(1, f"{package}.proto") + _text(2, package)
        imports = {kind[1:].partition(".")[0] for m in messages.values() for kind in m.values()}
        for other in sorted(imports & _PROTOBUF.keys() - {package}):
            inside += _text(3, f"{other}.proto")
        for name, fields in messages.items():
            described = _text(1, name)
            for number, (field, kind) in enumerate(fields.items(), 1):
                part = _text(1, field) + _number(3, number) + _number(4, _OPTIONAL)
                part += _number(5, _TYPES.get(kind, _MESSAGE))
                described += _bytes(2, part + (_text(6, kind) if kind not in _TYPES else b""))
            inside += _bytes(4, described)
        files += _bytes(1, inside + _text(12, "proto3"))
    return files


def _protobuf(topic: Published, k: int) -> bytes:
    seconds, nanoseconds = divmod(int(topic.time_ns[k]), 1_000_000_000)
    stamp = _number(1, seconds) + _number(2, nanoseconds)
    package, _, name = topic.type.partition("/msg/")
    numbers = {field: n for n, field in enumerate(_PROTOBUF[package][name], 1)}
    message = _bytes(numbers["header"], _bytes(1, stamp) + _text(2, topic.frame))
    for field, vector in sorted(_parts(topic, k).items(), key=lambda part: numbers[part[0]]):
        values = b"".join(
            _varint(number << 3 | 1) + struct.pack("<d", value)
            for number, value in enumerate(vector.values(), 1)
        )
        message += _bytes(numbers[field], values)
    return message


def _varint(value: int) -> bytes:
    parts = bytearray()
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    parts.append(value)
    return bytes(parts)


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _text(field: int, content: str) -> bytes:
    return _bytes(field, content.encode())
