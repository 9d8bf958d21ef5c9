"""MCAP files of every kind that is in use, written by the official library and read back."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import chunks, mcap
from fdilog_readers.json_layout import JsonLayout
from fdilog_readers.message_batch import Batch
from tests import bags
from tests.bags import IMU, assert_part, assert_same, by_time, losses, readings, stream

LEFT, RIGHT = readings(400, seed=1), readings(397, seed=2)
TWO = {"/imu/left": IMU, "/imu/right": IMU}
OPTIONS: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False},
    "without checksums": {"enable_crcs": False},
    "with a data checksum": {"enable_crcs": False, "enable_data_crcs": True},
    "without message index": {"index_types": IndexType.CHUNK},
    "without chunk index": {"index_types": IndexType.MESSAGE},
    "without repeated channels": {"repeat_channels": False, "repeat_schemas": False},
    "without summary": {
        "index_types": IndexType.NONE,
        "repeat_channels": False,
        "repeat_schemas": False,
        "use_statistics": False,
        "use_summary_offsets": False,
    },
}
UNCHECKED = {"unchunked", "without checksums"}


def two(ros: int = 2) -> list[bags.Message]:
    return by_time(
        bags.imu_messages("/imu/left", LEFT, ros=ros),
        bags.imu_messages("/imu/right", RIGHT, ["base", "a longer frame id"], ros=ros),
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return bags.write_mcap(tmp_path_factory.mktemp("mcap") / "whole.mcap", two(), TWO)


@pytest.mark.parametrize("kind", OPTIONS)
def test_two_imus_are_read_bit_for_bit_however_the_file_is_laid_out(
    kind: str, tmp_path: Path
) -> None:
    path = bags.write_mcap(tmp_path / "two.mcap", two(), TWO, **OPTIONS[kind])
    recording = mcap.read(path)
    assert [s.name for s in recording.streams] == ["/imu/left", "/imu/right"]
    for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT)):
        found = stream(recording, name)
        assert_same(found, imus)
        assert (found.gyro, found.accelerometer) == (bags.GYRO, bags.FORCE)
        assert (found.clock, found.count, found.origin) == ("header.stamp", len(imus), "sensor")
        assert found.units["angular_velocity.y"] == "rad/s"
        assert found.rate_hz == pytest.approx(100.0)
    assert losses(recording) == []
    assert any("no checksum" in p.what for p in recording.problems) == (kind in UNCHECKED)
    assert recording.utc_at_zero_ns == 0


def test_ros_1_messages_in_mcap_are_read(tmp_path: Path) -> None:
    recording = mcap.read(bags.write_mcap(tmp_path / "one.mcap", two(ros=1), TWO, ros=1))
    assert_same(stream(recording, "/imu/left"), LEFT)
    assert_same(stream(recording, "/imu/right"), RIGHT)


def test_idl_definitions_are_read(tmp_path: Path) -> None:
    idl = "\n".join(
        "=" * 80 + f"\nIDL: {name}\n" + body
        for name, body in {
            IMU: """module sensor_msgs { module msg {
              typedef double double__9[9];
              struct Imu { std_msgs::msg::Header header;
                geometry_msgs::msg::Quaternion orientation; double__9 orientation_covariance;
                geometry_msgs::msg::Vector3 angular_velocity;
                double__9 angular_velocity_covariance;
                geometry_msgs::msg::Vector3 linear_acceleration;
                double__9 linear_acceleration_covariance; }; }; };""",
            "std_msgs/msg/Header": """module std_msgs { module msg { struct Header {
              builtin_interfaces::msg::Time stamp; string frame_id; }; }; };""",
            "builtin_interfaces/msg/Time": """module builtin_interfaces { module msg {
              struct Time { int32 sec; uint32 nanosec; }; }; };""",
            "geometry_msgs/msg/Vector3": """module geometry_msgs { module msg {
              struct Vector3 { double x; double y; double z; }; }; };""",
            "geometry_msgs/msg/Quaternion": """module geometry_msgs { module msg {
              struct Quaternion { double x; double y; double z; double w; }; }; };""",
        }.items()
    ).encode()
    schemas = dict.fromkeys(TWO, ("ros2idl", idl))
    recording = mcap.read(bags.write_mcap(tmp_path / "idl.mcap", two(), TWO, schemas=schemas))
    assert_same(stream(recording, "/imu/right"), RIGHT)


def test_a_topic_without_a_definition_is_read_as_the_standard_type(tmp_path: Path) -> None:
    schemas = {"/imu/left": ("ros2msg", b""), "/imu/right": ("ros2msg", b"")}
    recording = mcap.read(bags.write_mcap(tmp_path / "no.mcap", two(), TWO, schemas=schemas))
    assert_same(stream(recording, "/imu/left"), LEFT)


def test_two_channels_of_one_topic_are_one_stream_in_file_order(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "channels.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000)
        writer.start("ros2", "test")
        schema = writer.register_schema(IMU, "ros2msg", bags.definition(IMU))
        numbers = [writer.register_channel("/imu", "cdr", schema) for _ in range(2)]
        for k, (_, time_ns, data) in enumerate(bags.imu_messages("/imu", LEFT)):
            writer.add_message(numbers[(k // 3) % 2], time_ns, data, time_ns)
        writer.finish()  # type: ignore[no-untyped-call]
    recording = mcap.read(path)
    assert_same(stream(recording, "/imu"), LEFT)
    assert stream(recording, "/imu").count == len(LEFT)


def nested(count: int, inner_stamp_ns: int | None) -> list[bags.Message]:
    kind = bags.store().types["test_msgs/msg/Nested"]
    return [
        (
            "/unit",
            int(LEFT.log_ns[k]),
            bags.serialise(
                kind(
                    header=bags.header(int(LEFT.stamp_ns[k]), "unit"),
                    label="x" * (k % 5),
                    imu=bags.imu(LEFT, k, "a", stamp_ns=inner_stamp_ns),
                    pair=[bags.imu(RIGHT, k, "bb"), bags.imu(LEFT, k, "c" * (k % 3))],
                ),
                "test_msgs/msg/Nested",
            ),
        )
        for k in range(count)
    ]


def test_imus_inside_other_messages_are_streams_of_their_own(tmp_path: Path) -> None:
    types = {"/unit": "test_msgs/msg/Nested"}
    recording = mcap.read(bags.write_mcap(tmp_path / "nested.mcap", nested(90, None), types))
    names = ["/unit:imu", "/unit:pair[0]", "/unit:pair[1]"]
    assert [s.name for s in recording.streams] == names
    for name, imus in zip(names, (LEFT, RIGHT, LEFT), strict=True):
        assert_same(stream(recording, name), imus, slice(90))
        assert stream(recording, name).clock.endswith("header.stamp")


@pytest.mark.parametrize("ros", [1, 2])
def test_a_list_of_imus_is_a_stream_for_each(tmp_path: Path, ros: int) -> None:
    name = "test_msgs/msg/Several"
    kind = bags.store(ros).types[name]
    messages = []
    for k in range(80):
        imus = [bags.imu(LEFT, k, "x" * (k % 4), ros), bags.imu(RIGHT, k, "y" * (k % 3), ros)]
        if k == 50:  # one of the sensors was silent
            imus = imus[:1]
        made = kind(bags.header(int(LEFT.stamp_ns[k]), "", ros), ["a"] * (k % 3), imus, 1)
        messages.append(("/units", int(LEFT.log_ns[k]), bags.serialise(made, name, ros)))
    path = bags.write_mcap(tmp_path / "s.mcap", messages, {"/units": name}, ros=ros)
    recording = mcap.read(path)
    assert [s.name for s in recording.streams] == ["/units:imus[0]", "/units:imus[1]"]
    keep = np.setdiff1d(np.arange(80), [50])
    assert_same(stream(recording, "/units:imus[0]"), LEFT, keep)
    assert_same(stream(recording, "/units:imus[1]"), RIGHT, keep)
    assert losses(recording) == [f"1 messages on /units do not fit their type {name}"]


def test_a_constant_inner_stamp_gives_way_to_the_outer_one_and_says_so(tmp_path: Path) -> None:
    types = {"/unit": "test_msgs/msg/Nested"}
    recording = mcap.read(bags.write_mcap(tmp_path / "n.mcap", nested(90, 5), types))
    found = stream(recording, "/unit:imu")
    assert_same(found, LEFT, slice(90))
    assert found.clock == "header.stamp (imu.header.stamp stands still)"


def test_constant_stamps_give_way_to_the_log_time(tmp_path: Path) -> None:
    messages = [
        ("/imu", int(LEFT.log_ns[k]), bags.serialise(bags.imu(LEFT, k, stamp_ns=0), IMU))
        for k in range(50)
    ]
    found = stream(mcap.read(bags.write_mcap(tmp_path / "c.mcap", messages, {"/imu": IMU})), "/imu")
    assert np.array_equal(found.time_ns, LEFT.log_ns[:50])
    assert found.clock == "log time (header.stamp stands still)"


def test_odometry_is_derived_and_a_commanded_twist_is_no_witness(tmp_path: Path) -> None:
    types = bags.store().types
    vector = types["geometry_msgs/msg/Vector3"]
    twist = types["geometry_msgs/msg/Twist"](vector(1.0, 2.0, 3.0), vector(4.0, 5.0, 6.0))
    odometry = types["nav_msgs/msg/Odometry"](
        bags.header(bags.START_NS, "odom"),
        "base",
        types["geometry_msgs/msg/PoseWithCovariance"](
            types["geometry_msgs/msg/Pose"](
                types["geometry_msgs/msg/Point"](0.0, 0.0, 0.0),
                types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            ),
            np.zeros(36),
        ),
        types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )
    kinds = {
        "/odom": "nav_msgs/msg/Odometry",
        "/twist": "geometry_msgs/msg/Twist",
        "/robot/cmd_vel": "geometry_msgs/msg/Twist",
    }
    messages = [
        (topic, bags.START_NS + k, bags.serialise(odometry if "odom" in topic else twist, kind))
        for k, (topic, kind) in enumerate(kinds.items())
    ]
    recording = mcap.read(bags.write_mcap(tmp_path / "o.mcap", messages, kinds))
    odom = stream(recording, "/odom")
    assert (odom.origin, odom.clock) == ("derived", "header.stamp")
    assert [float(odom.columns[name][0]) for name in odom.gyro] == [4.0, 5.0, 6.0]
    bare = stream(recording, "/twist")
    assert (bare.origin, bare.gyro[2], bare.clock) == ("derived", "angular.z", "log time")
    command = stream(recording, "/robot/cmd_vel")
    assert (command.gyro, command.count, dict(command.columns)) == ((), 1, {})


def test_other_topics_are_listed_and_read_only_on_request(tmp_path: Path) -> None:
    kind = bags.store().types["sensor_msgs/msg/JointState"]
    messages = [
        (
            "/joints",
            bags.START_NS + 10**7 * k,
            bags.serialise(
                kind(
                    bags.header(bags.START_NS + 10**7 * k, ""),
                    ["left", "right"],
                    np.array([k, 0.5]),
                    np.array([]),
                    np.array([1.0] * (k % 2)),
                ),
                "sensor_msgs/msg/JointState",
            ),
        )
        for k in range(6)
    ]
    types = {"/joints": "sensor_msgs/msg/JointState"}
    path = bags.write_mcap(tmp_path / "j.mcap", messages, types)
    listed = stream(mcap.read(path), "/joints")
    assert (listed.count, len(listed.time_ns), dict(listed.columns)) == (6, 0, {})
    found = stream(mcap.read(path, also=["/joints"]), "/joints")
    assert found.columns["position[0]"].tolist() == [0, 1, 2, 3, 4, 5]
    assert found.columns["position[1]"].tolist() == [0.5] * 6
    assert np.array_equal(found.columns["effort[0]"], [np.nan, 1] * 3, equal_nan=True)
    assert found.gyro == ()
    assert found.clock == "header.stamp"
    assert found.time_ns[1] == bags.START_NS + 10**7


def test_a_type_that_is_not_known_is_named(tmp_path: Path) -> None:
    schemas = {"/x": ("ros2msg", b"robot_msgs/Thing thing\n")}
    types = {"/x": "robot_msgs/msg/Box"}
    path = bags.write_mcap(tmp_path / "x.mcap", [("/x", 1, b"123")], types, schemas=schemas)
    recording = mcap.read(path)
    assert stream(recording, "/x").count == 1
    (problem,) = recording.problems
    assert problem.note
    assert "/x (robot_msgs/msg/Box)" in problem.what
    assert "robot_msgs/msg/Thing" in problem.what


def test_messages_that_do_not_fit_their_type_are_counted(tmp_path: Path) -> None:
    messages = bags.imu_messages("/imu/left", LEFT)
    for k in (3, 50):
        topic, time_ns, data = messages[k]
        messages[k] = (topic, time_ns, data[:200])
    path = bags.write_mcap(tmp_path / "short.mcap", messages, {"/imu/left": IMU})
    recording = mcap.read(path)
    keep = np.setdiff1d(np.arange(len(LEFT)), [3, 50])
    assert_same(stream(recording, "/imu/left"), LEFT, keep)
    assert losses(recording) == [
        "2 messages on /imu/left do not fit their type sensor_msgs/msg/Imu"
    ]


# JSON and Protobuf


def json_messages(count: int = 60) -> list[bags.Message]:
    return [
        (
            "/imu",
            int(LEFT.log_ns[k]),
            json.dumps(
                {
                    "header": {
                        "stamp": {
                            "sec": int(LEFT.stamp_ns[k]) // 10**9,
                            "nsec": int(LEFT.stamp_ns[k]) % 10**9,
                        },
                        "frame_id": "f" * (k % 7),
                    },
                    "orientation": dict(zip("wxyz", LEFT.turn[k].tolist(), strict=True)),
                    "angular_velocity": dict(zip("xyz", LEFT.gyro[k].tolist(), strict=True)),
                    "linear_acceleration": dict(zip("xyz", LEFT.force[k].tolist(), strict=True)),
                }
            ).encode(),
        )
        for k in range(count)
    ]


VECTOR_SCHEMA = {"type": "object", "properties": {a: {"type": "number"} for a in "xyz"}}
STAMP_SCHEMA = {"type": "object", "properties": {n: {"type": "integer"} for n in ("sec", "nsec")}}
IMU_SCHEMA = {
    "type": "object",
    "properties": {
        "header": {"type": "object", "properties": {"stamp": STAMP_SCHEMA}},
        "orientation": {"$ref": "#/$defs/turn"},
        "angular_velocity": VECTOR_SCHEMA,
        "linear_acceleration": VECTOR_SCHEMA,
    },
    "$defs": {"turn": {"properties": {axis: {"type": "number"} for axis in "wxyz"}}},
}


@pytest.mark.parametrize("schema", [IMU_SCHEMA, {"type": "object"}, None])
def test_json_is_read_by_its_schema_or_else_by_its_first_message(
    schema: dict[str, Any] | None, tmp_path: Path
) -> None:
    schemas = {} if schema is None else {"/imu": ("jsonschema", json.dumps(schema).encode())}
    path = bags.write_mcap(
        tmp_path / "j.mcap", json_messages(), {"/imu": "Imu"}, encoding="json", schemas=schemas
    )
    recording = mcap.read(path)
    found = stream(recording, "/imu")
    assert_same(found, LEFT, slice(60))
    assert found.clock == "header.stamp"
    assert losses(recording) == []
    assert any("rad/s and m/s^2 are assumed" in p.what for p in recording.problems)


def test_json_numbers_that_are_none_or_missing_are_no_samples(tmp_path: Path) -> None:
    texts = [
        b'{"angular_velocity": {"x": 1, "y": 2, "z": 3}}',
        b'{"angular_velocity": {"x": NaN, "y": -Infinity, "z": 3}}',
        b'{"angular_velocity": {"x": null, "z": 3}}',
        b'{"angular_velocity": {"x": "one", "z": 3}}',
        b"{",
        b"[" * 5000,
        b'{"angular_velocity": {"x": 1e400, "y": 1, "z": 2}}',
    ]
    messages = [("/g", 10**9 * (k + 1), text) for k, text in enumerate(texts)]
    path = bags.write_mcap(tmp_path / "n.mcap", messages, {"/g": "G"}, encoding="json", schemas={})
    recording = mcap.read(path)
    found = stream(recording, "/g")
    x = [1.0, np.nan, np.nan, np.inf]
    assert np.array_equal(found.columns["angular_velocity.x"], x, equal_nan=True)
    assert np.array_equal(found.columns["angular_velocity.y"], [2, -np.inf, np.nan, 1], True)
    assert found.time_ns.tolist() == [10**9, 2 * 10**9, 3 * 10**9, 7 * 10**9]
    assert losses(recording) == ["3 messages on /g do not fit their type "]


@pytest.mark.parametrize("lead", [0, 31])
def test_json_messages_of_any_lengths_stand_side_by_side(lead: int) -> None:
    layout = JsonLayout(["x"])
    for longest in range(8, 44):
        texts = [b'{"x":%d%s}' % (k, b" " * (k * longest // 3)) for k in range(4)]
        lengths = np.array([len(text) for text in texts])
        for spare in (0, 1, 5):
            rows = np.full((4, lead + int(lengths.max()) + spare), ord("]"), np.uint8)
            for row, text in zip(rows, texts, strict=True):
                row[lead : lead + len(text)] = np.frombuffer(text, np.uint8)
            columns, fits = layout.columns(Batch(rows, lead, lengths))
            assert fits.all()
            assert columns["x"].tolist() == [0, 1, 2, 3]


def test_a_rate_given_as_a_list_is_a_gyro(tmp_path: Path) -> None:
    messages = [
        ("/g", k, json.dumps({"angularVelocity": LEFT.gyro[k].tolist()}).encode())
        for k in range(1, 9)
    ]
    path = bags.write_mcap(tmp_path / "l.mcap", messages, {"/g": "G"}, encoding="json", schemas={})
    found = stream(mcap.read(path), "/g")
    assert found.gyro == tuple(f"angularVelocity[{k}]" for k in range(3))
    assert np.array_equal(found.columns["angularVelocity[1]"], LEFT.gyro[1:9, 1])


@pytest.fixture(scope="module")
def proto() -> Any:
    """The messages of a Protobuf file, by the official library."""
    descriptors = pytest.importorskip("google.protobuf.descriptor_pb2")
    descriptor_pool = pytest.importorskip("google.protobuf.descriptor_pool")
    message_factory = pytest.importorskip("google.protobuf.message_factory")

    file = descriptors.FileDescriptorProto(name="imu.proto", package="test", syntax="proto3")

    def message(name: str, **fields: int | str) -> None:
        described = file.message_type.add(name=name)
        for number, (field, kind) in enumerate(fields.items(), 1):
            named = isinstance(kind, str)
            added = described.field.add(
                name=field, number=number * 9, label=1, type=11 if named else kind
            )
            if named:
                added.type_name = f".test.{kind}"

    message("Time", seconds=3, nanos=5)
    message("Vector", x=1, y=1, z=1)
    message("Turn", w=1, x=1, y=1, z=1)
    message(
        "Imu",
        timestamp="Time",
        frame=9,
        level=17,
        linear_acceleration="Vector",
        angular_velocity="Vector",
        orientation="Turn",
        small=2,
        flag=8,
        fixed=15,
        below="Imu",
    )
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    made = message_factory.GetMessageClass(pool.FindMessageTypeByName("test.Imu"))
    return made, descriptors.FileDescriptorSet(file=[file]).SerializeToString()


def proto_messages(made: Any, count: int) -> Iterator[bags.Message]:
    for k in range(count):
        imu = made(frame="f" * (k % 200), level=-k, small=k / 3, flag=k % 2 == 1, fixed=-k)
        imu.timestamp.seconds, imu.timestamp.nanos = divmod(int(LEFT.stamp_ns[k]), 10**9)
        for part, values in (
            (imu.linear_acceleration, LEFT.force[k]),
            (imu.angular_velocity, LEFT.gyro[k]),
        ):
            part.x, part.y, part.z = values.tolist()
        turn = imu.orientation
        turn.w, turn.x, turn.y, turn.z = LEFT.turn[k].tolist()
        if k % 3 == 0:
            imu.below.angular_velocity.x = k
        yield "/imu", int(LEFT.log_ns[k]), imu.SerializeToString()


def test_protobuf_is_read_bit_for_bit(proto: Any, tmp_path: Path) -> None:
    made, descriptors = proto
    schemas = {"/imu": ("protobuf", descriptors)}
    path = bags.write_mcap(
        tmp_path / "p.mcap",
        proto_messages(made, 300),
        {"/imu": "test.Imu"},
        encoding="protobuf",
        schemas=schemas,
    )
    found = stream(mcap.read(path, also=["/imu"]), "/imu")
    assert_same(found, LEFT, slice(300))
    assert found.clock == "timestamp"
    assert found.columns["level"].tolist() == [-k for k in range(300)]
    assert found.columns["fixed"].tolist() == [-k for k in range(300)]
    assert found.columns["flag"].tolist() == [k % 2 == 1 for k in range(300)]
    assert np.array_equal(found.columns["small"], (np.arange(300) / 3).astype(np.float32))


def test_protobuf_leaves_out_zeros_but_a_missing_part_is_no_sample(
    proto: Any, tmp_path: Path
) -> None:
    made, descriptors = proto
    still, absent = made(), made(level=1)
    still.angular_velocity.SetInParent()
    messages = [("/imu", 1, still.SerializeToString()), ("/imu", 2, absent.SerializeToString())]
    messages += [("/imu", 3, b"\x2d\x00"), ("/imu", 4, b"\xff" * 20), ("/imu", 5, b"\x0b")]
    path = bags.write_mcap(
        tmp_path / "z.mcap",
        messages,
        {"/imu": "test.Imu"},
        encoding="protobuf",
        schemas={"/imu": ("protobuf", descriptors)},
    )
    recording = mcap.read(path)
    x = stream(recording, "/imu").columns["angular_velocity.x"]
    assert np.array_equal(x, [0.0, np.nan], equal_nan=True)
    assert losses(recording) == ["3 messages on /imu do not fit their type test.Imu"]


# Damage


def chunk_places(path: Path) -> list[Any]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return summary.chunk_indexes


def both(recording: Recording) -> int:
    """Check that what is left of both topics is as written; return how many samples that is."""
    left, right = stream(recording, "/imu/left"), stream(recording, "/imu/right")
    return assert_part(left, LEFT) + assert_part(right, RIGHT)


def damaged(path: Path, target: Path, at: int, data: bytes) -> Path:
    raw = bytearray(path.read_bytes())
    raw[at : at + len(data)] = data
    target.write_bytes(raw)
    return target


def test_a_damaged_chunk_is_left_out_and_counted(whole: Path, tmp_path: Path) -> None:
    places = chunk_places(whole)
    hit = places[2]
    at = hit.chunk_start_offset + hit.chunk_length // 2
    recording = mcap.read(damaged(whole, tmp_path / "d.mcap", at, b"\x55" * 16))
    assert 0 < len(LEFT) + len(RIGHT) - both(recording) < 80
    (problem,) = [p for p in recording.problems if not p.note]
    assert (problem.offset, problem.bytes_lost) == (hit.chunk_start_offset, hit.chunk_length)
    span_ns = hit.message_end_time - hit.message_start_time
    assert problem.seconds_lost == pytest.approx(span_ns / 1e9)
    assert "chunk is damaged" in problem.what


def test_a_hole_over_a_chunks_head_costs_only_that_chunk(whole: Path, tmp_path: Path) -> None:
    places = chunk_places(whole)
    at = places[1].chunk_start_offset - 20
    recording = mcap.read(damaged(whole, tmp_path / "h.mcap", at, bytes(60)))
    lost = len(LEFT) - assert_part(stream(recording, "/imu/left"), LEFT)
    assert 0 < lost < 40
    assert losses(recording)


@pytest.mark.parametrize("summary", [True, False])
def test_a_hole_without_an_index_is_stepped_over(
    whole: Path, tmp_path: Path, summary: bool
) -> None:
    places = chunk_places(whole)
    at = places[1].chunk_start_offset - 20
    path = damaged(whole, tmp_path / "h.mcap", at, bytes(60))
    if not summary:
        end = places[-1].chunk_start_offset + places[-1].chunk_length
        path.write_bytes(path.read_bytes()[:end])
    recording = mcap.read(path)
    assert assert_part(stream(recording, "/imu/right"), RIGHT) > 0.8 * len(RIGHT)
    assert any("damaged part" in what for what in losses(recording)) or summary


def test_a_cut_file_gives_every_whole_chunk_before_the_cut(whole: Path, tmp_path: Path) -> None:
    places = chunk_places(whole)
    raw = whole.read_bytes()
    cut = tmp_path / "cut.mcap"
    for keep in (3, 5):
        start, length = places[keep].chunk_start_offset, places[keep].chunk_length
        cut.write_bytes(raw[: start + length // 2])
        recording = mcap.read(cut)
        last_ns = places[keep].message_start_time
        for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT)):
            assert_same(stream(recording, name), imus, imus.log_ns < last_ns)
        assert any("not closed" in what for what in losses(recording))
        inside = [p for p in recording.problems if p.offset == start]
        assert [p.bytes_lost for p in inside] == [length // 2]


@pytest.mark.parametrize("checked", [True, False])
def test_of_a_cut_chunk_only_what_needs_no_checksum_is_believed(
    tmp_path: Path, checked: bool
) -> None:
    path = bags.write_mcap(
        tmp_path / "c.mcap", two(), TWO, compression=CompressionType.NONE, enable_crcs=checked
    )
    last = chunk_places(path)[4]
    raw = path.read_bytes()
    path.write_bytes(raw[: last.chunk_start_offset + last.chunk_length // 2])
    recording = mcap.read(path)
    before = sum(imus.log_ns.searchsorted(last.message_start_time) for imus in (LEFT, RIGHT))
    assert (both(recording) > before) == (not checked)
    assert both(recording) >= before
    assert any("not closed" in what for what in losses(recording))


def test_a_cut_file_of_loose_messages_gives_every_one_before_the_cut(tmp_path: Path) -> None:
    path = bags.write_mcap(tmp_path / "u.mcap", two(), TWO, use_chunking=False)
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    recording = mcap.read(path)
    assert both(recording) >= (len(raw) // 2 - 3000) // (324 + 20 + 31)
    assert len(losses(recording)) == 2


def test_damage_among_loose_messages_costs_few_of_them(tmp_path: Path) -> None:
    path = bags.write_mcap(tmp_path / "u.mcap", two(), TWO, use_chunking=False)
    recording = mcap.read(damaged(path, path, 100_000, b"\xee" * 400))
    assert len(LEFT) + len(RIGHT) - 6 <= both(recording) < len(LEFT) + len(RIGHT)
    assert any("damaged part" in what for what in losses(recording))


def test_a_wrong_index_entry_is_not_believed(tmp_path: Path) -> None:
    path = bags.write_mcap(
        tmp_path / "i.mcap", two(), TWO, compression=CompressionType.NONE, enable_crcs=False
    )
    place = chunk_places(path)[1]
    index = place.message_index_offsets[1]
    for at, data in ((15 + 8, b"\x01"), (15 + 16, b"\x77"), (9, b"\x02"), (11, b"\x10")):
        recording = mcap.read(damaged(path, tmp_path / "w.mcap", index + at, data))
        assert_same(stream(recording, "/imu/left"), LEFT)
        assert_same(stream(recording, "/imu/right"), RIGHT)


def test_a_summary_with_a_wrong_checksum_is_not_used(whole: Path, tmp_path: Path) -> None:
    raw = whole.read_bytes()
    at = raw.rindex(struct.pack("<Q", chunk_places(whole)[1].chunk_start_offset))
    recording = mcap.read(damaged(whole, tmp_path / "s.mcap", at, b"\x00\x00"))
    assert_same(stream(recording, "/imu/left"), LEFT)
    assert losses(recording) == ["the index's checksum is wrong; every record was read instead"]


@pytest.mark.parametrize("compression", list(CompressionType))
def test_chunks_too_large_for_memory_are_taken_in_windows(
    compression: CompressionType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunks, "LARGE_BYTES", 30_000)
    monkeypatch.setattr(chunks, "WINDOW_BYTES", 7_000)
    path = bags.write_mcap(
        tmp_path / "l.mcap", two(), TWO, chunk_size=100_000, compression=compression
    )
    recording = mcap.read(path)
    assert_same(stream(recording, "/imu/left"), LEFT)
    assert_same(stream(recording, "/imu/right"), RIGHT)
    assert losses(recording) == []
    place = chunk_places(path)[1]
    at = place.chunk_start_offset + place.chunk_length - 900
    broken = mcap.read(damaged(path, path, at, b"\x03\xfc" * 8))
    assert assert_part(stream(broken, "/imu/left"), LEFT) < len(LEFT)
    assert [p.offset for p in broken.problems] == [place.chunk_start_offset]


def test_a_promise_of_many_bytes_takes_no_memory(whole: Path, tmp_path: Path) -> None:
    place = chunk_places(whole)[0]
    size = struct.pack("<Q", 1 << 40)
    path = damaged(whole, tmp_path / "b.mcap", place.chunk_start_offset + 25, size)
    recording = mcap.read(path)
    assert assert_part(stream(recording, "/imu/left"), LEFT) > 300
    assert [p.offset for p in recording.problems] == [place.chunk_start_offset]


def test_what_is_no_mcap_file_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"not a log")
    with pytest.raises(UnreadableLogError, match=r"no MCAP file: it begins with b'not a lo'"):
        mcap.read(path)
    with pytest.raises(UnreadableLogError, match="no such file"):
        mcap.read(tmp_path / "absent.mcap")
    assert mcap.sniff(b"\x89MCAP0\r\n rest")
    assert not mcap.sniff(b"\x89MCAP1\r\n")
