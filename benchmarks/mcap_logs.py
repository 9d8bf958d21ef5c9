"""How fast MCAP is read, against the official library's message loop, in one run.

Writes ten minutes of two gyros at 500 Hz among odometry, pictures and diagnostics, reads them both
ways in turn, checks that both give the same numbers to the last bit, and prints one line per file;
ends with 1 below a goal. Needs mcap-ros2-support, and mcap-protobuf-support for Protobuf.

    python benchmarks/mcap_logs.py [--minutes 10] [--rounds 3] [--only zstd]
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from ros_comparison import ROUNDS, Arrays, Case, Rows, arrays, compare
from ros_traffic import IMU_TOPICS, TYPES, messages, typestore

CDR_KINDS: dict[str, tuple[dict[str, Any], float]] = {
    "zstd": ({"compression": CompressionType.ZSTD}, 25.0),
    "lz4": ({"compression": CompressionType.LZ4}, 30.0),
    "uncompressed": ({"compression": CompressionType.NONE}, 30.0),
    "unchunked": ({"use_chunking": False}, 15.0),
}
JSON_GOAL, PROTOBUF_GOAL = 5.0, 8.0

Message = tuple[str, int, bytes]


def write(
    path: Path,
    encoding: str,
    schema: Callable[[str], tuple[str, str, bytes]],
    traffic: Iterator[Message],
    **options: Any,
) -> None:
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("", "benchmark")
        channels = {
            topic: writer.register_channel(topic, encoding, writer.register_schema(*schema(kind)))
            for topic, kind in TYPES.items()
        }
        for topic, time_ns, data in traffic:
            writer.add_message(channels[topic], time_ns, data, time_ns)
        writer.finish()


def write_cdr(path: Path, minutes: float, **options: Any) -> None:
    store = typestore(2)

    def schema(kind: str) -> tuple[str, str, bytes]:
        return kind, "ros2msg", store.generate_msgdef(kind, ros_version=2)[0].encode()

    write(path, "cdr", schema, messages(minutes), **options)


def write_json(path: Path, minutes: float) -> None:
    store = typestore(2)

    def schema(kind: str) -> tuple[str, str, bytes]:
        return kind, "jsonschema", b'{"type": "object"}'

    def traffic() -> Iterator[Message]:
        for topic, time_ns, raw in messages(minutes):
            if topic in IMU_TOPICS or topic == "/odom":
                message = _plain(store.deserialize_cdr(raw, TYPES[topic]))
            else:
                message = {"data": raw.hex()}
            yield topic, time_ns, json.dumps(message).encode()

    write(path, "json", schema, traffic())


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    names = getattr(value, "__dataclass_fields__", ())
    return {n: _plain(getattr(value, n)) for n in names if n[0] != "_"} if names else value


def write_protobuf(path: Path, minutes: float) -> None:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    file = descriptor_pb2.FileDescriptorProto(name="i.proto", package="bench", syntax="proto3")

    def message(name: str, **fields: int | str) -> None:
        described = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            repeated = field.endswith("covariance")
            added = described.field.add(name=field, number=number, label=3 if repeated else 1)
            added.type = 11 if isinstance(kind, str) else kind
            if isinstance(kind, str):
                added.type_name = f".bench.{kind}"

    message("Time", sec=3, nanosec=13)
    message("Header", stamp="Time", frame_id=9)
    message("Vector3", x=1, y=1, z=1)
    message("Quaternion", x=1, y=1, z=1, w=1)
    message("Blob", data=12)
    message(
        "Imu",
        header="Header",
        orientation="Quaternion",
        orientation_covariance=1,
        angular_velocity="Vector3",
        angular_velocity_covariance=1,
        linear_acceleration="Vector3",
        linear_acceleration_covariance=1,
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    imu_type, blob_type = (
        message_factory.GetMessageClass(pool.FindMessageTypeByName(f"bench.{name}"))
        for name in ("Imu", "Blob")
    )
    described = descriptor_pb2.FileDescriptorSet(file=[file]).SerializeToString()
    store = typestore(2)

    def schema(kind: str) -> tuple[str, str, bytes]:
        name = "Imu" if kind.endswith("Imu") else "Blob"
        return f"bench.{name}", "protobuf", described

    def traffic() -> Iterator[Message]:
        for topic, time_ns, raw in messages(minutes):
            if topic not in IMU_TOPICS:
                yield topic, time_ns, blob_type(data=raw).SerializeToString()
                continue
            imu, made = store.deserialize_cdr(raw, TYPES[topic]), imu_type()
            made.header.frame_id = imu.header.frame_id
            made.header.stamp.sec = imu.header.stamp.sec
            made.header.stamp.nanosec = imu.header.stamp.nanosec
            for part in ("orientation", "angular_velocity", "linear_acceleration"):
                vector, target = getattr(imu, part), getattr(made, part)
                for axis in "xyzw"[: 4 if part == "orientation" else 3]:
                    setattr(target, axis, getattr(vector, axis))
                getattr(made, f"{part}_covariance").extend(getattr(imu, f"{part}_covariance"))
            yield topic, time_ns, made.SerializeToString()

    write(path, "protobuf", schema, traffic())


def _collect(decoded: Iterator[tuple[str, Any]]) -> Arrays:
    rows: Rows = {topic: [] for topic in IMU_TOPICS}
    for topic, imu in decoded:
        stamp, rate = imu.header.stamp, imu.angular_velocity
        rows[topic].append((stamp.sec * 10**9 + stamp.nanosec, rate.x, rate.y, rate.z))
    return arrays(rows)


def official_cdr(path: Path) -> Arrays:
    """Read as a user of mcap and mcap-ros2-support does."""
    from mcap_ros2.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = reader.iter_decoded_messages(topics=IMU_TOPICS)
        return _collect((channel.topic, imu) for _, channel, _, imu in decoded)


def official_protobuf(path: Path) -> Arrays:
    """Read as a user of mcap and mcap-protobuf-support does."""
    from mcap_protobuf.decoder import DecoderFactory

    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = reader.iter_decoded_messages(topics=IMU_TOPICS)
        return _collect((channel.topic, imu) for _, channel, _, imu in decoded)


def official_json(path: Path) -> Arrays:
    """Read as a user of mcap does."""
    rows: Rows = {topic: [] for topic in IMU_TOPICS}
    with path.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(topics=IMU_TOPICS):
            imu = json.loads(message.data)
            stamp, rate = imu["header"]["stamp"], imu["angular_velocity"]
            row = (stamp["sec"] * 10**9 + stamp["nanosec"], rate["x"], rate["y"], rate["z"])
            rows[channel.topic].append(row)
    return arrays(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--only", action="append", help="name of a file; may be repeated")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="how often both take turns")
    arguments = parser.parse_args()
    rounds = arguments.rounds
    only = arguments.only or [*CDR_KINDS, "JSON", "Protobuf"]
    met = True
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "benchmark.mcap"
        for kind, (options, goal) in CDR_KINDS.items():
            if kind in only:
                write_cdr(path, arguments.minutes, **options)
                met &= compare(Case(f"MCAP {kind}", path, "mcap", official_cdr, goal), rounds)
        if "JSON" in only:
            write_json(path, arguments.minutes)
            met &= compare(Case("MCAP JSON", path, "mcap", official_json, JSON_GOAL), rounds)
        if "Protobuf" in only:
            write_protobuf(path, arguments.minutes)
            met &= compare(
                Case("MCAP Protobuf", path, "mcap", official_protobuf, PROTOBUF_GOAL), rounds
            )
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
