"""Every standard ROS type, filled at random, read as the official deserialiser reads it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype

from fdilog_readers.gyro_search import find_gyros, number_leaves
from fdilog_readers.message_batch import Batch, Columns, Mask
from fdilog_readers.message_schema import (
    NUMBERS,
    SEQUENCE,
    Field,
    UnknownTypeError,
    ros_schema,
    short_name,
)
from fdilog_readers.ros_layout import RosLayout
from tests import bags

LEAD = 5
# What the generator of definitions makes of a type without fields.
EMPTY = "structure_needs_at_least_one_member"


def batch(messages: list[bytes]) -> Batch:
    """Put messages side by side behind some bytes of framing; what is behind them is noise."""
    width = LEAD + max(map(len, messages), default=0) + 3
    random = np.random.default_rng(1)
    rows = random.integers(0, 256, (len(messages), width), dtype=np.uint8)
    for row, message in zip(rows, messages, strict=True):
        row[LEAD : LEAD + len(message)] = np.frombuffer(message, np.uint8)
    return Batch(rows, LEAD, np.array([len(m) for m in messages], np.int64))


def filled(types: Any, name: str, random: np.random.Generator) -> Any:
    """Make a message with random numbers, texts and lengths of lists."""
    values = {field: _value(types, kind, random) for field, kind in types.fielddefs[name][1]}
    if name.startswith("builtin_interfaces/"):  # rosbags takes ROS 1 times for ROS 2 ones: signs
        values = {field: value & 0x7FFFFFFF for field, value in values.items()}
    return types.types[name](*values.values())


def _value(types: Any, kind: Any, random: np.random.Generator) -> Any:
    what, inner = kind
    if what == Nodetype.NAME:
        return filled(types, inner, random)
    if what == Nodetype.BASE:
        return _one(inner[0], random)
    (element, element_kind), length = inner
    count = length if what == Nodetype.ARRAY else int(random.integers(0, 4))
    if element == Nodetype.BASE and element_kind[0] != "string":
        return np.array([_one(element_kind[0], random) for _ in range(count)], _dtype(element_kind))
    return [_value(types, (element, element_kind), random) for _ in range(count)]


def holds_nothing(types: Any, name: str) -> bool:
    """Whether a type, or a part of it, has no fields: rosbags gives it a byte, ROS 1 gave none."""
    fields = types.fielddefs[name][1]
    parts = [inner if what == Nodetype.NAME else inner[0][1] for _, (what, inner) in fields]
    own = any(field == EMPTY for field, _ in fields)
    return own or any(holds_nothing(types, p) for p in parts if p in types.fielddefs)


def _dtype(kind: Any) -> Any:
    return np.dtype(NUMBERS[kind[0]])


def _one(name: str, random: np.random.Generator) -> Any:
    if name == "string":
        return "t" * int(random.integers(0, 12))
    raw = random.bytes(8)
    if name == "bool":
        return bool(raw[0] & 1)
    dtype = np.dtype(NUMBERS[name])
    if dtype.kind == "f":
        return float(np.frombuffer(raw, np.int64)[0].astype(dtype))
    return int(np.frombuffer(raw, dtype)[0])


def leaf_value(message: Any, leaf: str) -> Any:
    for part in leaf.split("."):
        name, _, index = part.rstrip("]").partition("[")
        message = getattr(message, name, None)
        if index and message is not None:
            message = message[int(index)] if int(index) < len(message) else np.nan
    return message


def decode(
    name: str, messages: list[bytes], ros: int, leaves: Any = None
) -> tuple[Columns, Mask, tuple[str, ...]]:
    text = bags.definition(name, ros).decode()
    schema = ros_schema(name, "ros2msg", text, ros)
    wanted = number_leaves(schema, short_name(name)) if leaves is None else leaves
    layout = RosLayout(schema, short_name(name), wanted, packed=ros == 1)
    columns, fits = layout.columns(batch(messages))
    return columns, fits, wanted


@pytest.mark.parametrize("ros", [1, 2])
def test_every_standard_type_reads_as_the_official_deserialiser_reads_it(ros: int) -> None:
    types = bags.store(ros)
    compared = 0
    for name in sorted(types.fielddefs):
        if ros == 1 and holds_nothing(types, name):
            continue
        random = np.random.default_rng(len(name))
        made = [filled(types, name, random) for _ in range(4)]
        raw = [bags.serialise(message, name, ros) for message in made]
        columns, fits, wanted = decode(name, raw, ros)
        assert fits.all(), name
        back = [
            types.deserialize_ros1(r, name) if ros == 1 else types.deserialize_cdr(r, name)
            for r in raw
        ]
        for leaf in wanted:
            if leaf not in columns:
                longest = max((len(leaf_value(m, leaf)) for m in back), default=0)
                found = [f"{leaf}[{k}]" for k in range(longest)]
            else:
                found = [leaf]
            for column in found:
                expected = [leaf_value(message, column) for message in back]
                assert np.array_equal(columns[column], expected, equal_nan=True), (name, column)
                compared += 1
    assert compared > 600


def test_big_endian_messages_are_read() -> None:
    types = bags.store()
    random = np.random.default_rng(4)
    for name in ("sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState", "test_msgs/msg/Custom"):
        made = [filled(types, name, random) for _ in range(5)]
        big = [bytes(types.serialize_cdr(m, name, little_endian=False)) for m in made]
        little = [bags.serialise(m, name) for m in made]
        mixed, fits, _ = decode(name, [*big, *little], 2)
        alone, _, _ = decode(name, little, 2)
        assert fits.all()
        for leaf, column in alone.items():
            assert np.array_equal(mixed[leaf][5:], column, equal_nan=True)
            assert np.array_equal(mixed[leaf][:5], column, equal_nan=True)
            assert mixed[leaf].dtype.isnative


def test_eight_byte_numbers_lie_at_multiples_of_four_in_the_second_cdr_version() -> None:
    head = bytes([0, 7, 0, 0])
    body = b"\x01\x00\x00\x00" + np.array([1.5, -2.5, 3.5]).tobytes()
    schema = {"t/T": (Field("n", "int32"), Field("angular_velocity", "float64", 3))}
    layout = RosLayout(schema, "t/T", ["angular_velocity[2]", "n"], packed=False)
    columns, fits = layout.columns(batch([head + body]))
    assert fits.all()
    assert (columns["angular_velocity[2]"].tolist(), columns["n"].tolist()) == ([3.5], [1])


def test_strings_that_vary_are_followed_in_every_message() -> None:
    imus = bags.readings(64, seed=3)
    frames = ["", "a", "imu_link", "x" * 33, "é"]
    raw = [data for _, _, data in bags.imu_messages("/i", imus, frames)]
    columns, fits, _ = decode(bags.IMU, raw, 2, [*bags.GYRO, *bags.FORCE])
    assert fits.all()
    for names, values in ((bags.GYRO, imus.gyro), (bags.FORCE, imus.force)):
        for k, name in enumerate(names):
            assert np.array_equal(columns[name], values[:, k])


def test_messages_of_one_length_are_not_taken_for_messages_of_one_layout() -> None:
    """Two strings that are together as long, but each differently, put the numbers elsewhere."""
    kind = bags.store().types["test_msgs/msg/Custom"]
    name = "test_msgs/msg/Custom"
    messages = [
        kind(names, np.array([1, 2, 3], np.float32) * k, 1, np.array([k + 0.5] * count))
        for k, (names, count) in enumerate([(["aaaaaaaa"], 1), ([""], 2), (["a", "b"], 1)], 1)
    ]
    raw = [bags.serialise(message, name) for message in messages]
    columns, fits, _ = decode(name, raw, 2)
    assert fits.all()
    assert columns["angular_velocity[1]"].tolist() == [2.0, 4.0, 6.0]
    assert np.array_equal(columns["data[1]"], [np.nan, 2.5, np.nan], equal_nan=True)


def test_lengths_that_lie_never_lead_outside_a_message() -> None:
    imus = bags.readings(40, seed=5)
    raw = [bytearray(data) for _, _, data in bags.imu_messages("/i", imus)]
    for k, lie in enumerate((0xFFFFFFFF, 0x7FFFFFFF, 400, 310, 5, 0)):
        raw[k][12:16] = lie.to_bytes(4, "little")
    columns, fits, _ = decode(bags.IMU, [bytes(r) for r in raw], 2, bags.GYRO)
    # "imu" with its NUL is four bytes, and the numbers follow at a multiple of eight: so they do
    # not move for 0 to 4, but for 5 they do, and then the message is too short.
    assert fits.tolist() == [False] * 5 + [True] * 35
    assert np.array_equal(columns[bags.GYRO[0]][6:], imus.gyro[6:, 0])


@pytest.mark.parametrize(
    "data", [b"", b"\x00", b"\x00\x01\x00\x00", b"\x00\x63\x00\x00" + bytes(320)]
)
def test_what_is_no_message_does_not_fit(data: bytes) -> None:
    good = bags.imu_messages("/i", bags.readings(3))
    _, fits, _ = decode(bags.IMU, [data, good[0][2], data], 2, bags.GYRO)
    assert fits.tolist() == [False, True, False]
    _, fits, _ = decode(bags.IMU, [data], 2, bags.GYRO)
    assert fits.tolist() == [False]


def test_gyros_are_found_by_schema_alone() -> None:
    vector = (Field("x", "float64"), Field("y", "float64"), Field("z", "float64"))
    schema = {
        "v": vector,
        "flat": (Field("x", "float64"), Field("y", "float64")),
        "state": (Field("position", "v"), Field("angular_velocity", "v")),
        "geometry_msgs/Twist": (Field("linear", "v"), Field("angular", "v")),
        "top": (
            Field("angular_velocity", "flat"),
            Field("states", "state", 2),
            Field("many", "state", SEQUENCE),
            Field("own", "deep"),
            Field("t", "geometry_msgs/Twist"),
        ),
        "deep": (Field("angular_velocity", "float32", 3), Field("loop", "top")),
    }
    found = {gyro.owner: gyro for gyro in find_gyros(schema, "top")}
    assert list(found) == ["states[0]", "states[1]", "own", "t"]
    assert found["states[0]"].origin == "derived"
    assert found["own"].rate[2] == "own.angular_velocity[2]"
    assert (found["own"].origin, found["own"].known_unit) == ("sensor", False)
    assert (found["t"].origin, found["t"].known_unit) == ("derived", True)


def test_definitions_as_recorders_write_them_are_read() -> None:
    text = (
        "# comment\r\nint32 A=1\nstring NAME=a # b\nfloat64[<=3] list\nstring<=7 s\nuint8 n 4\n"
        "Header header\ntime at\nInner[2] two\n"
        + "=" * 80
        + "\nMSG: pkg/Inner\nduration d\nother_pkg/Thing t\n"
        + "=" * 80
        + "\nMSG: other_pkg/Thing\nbool[4] b\n"
    )
    schema = ros_schema("pkg/Top", "ros1msg", text, 1)
    assert schema["pkg/Top"] == (
        Field("list", "float64", SEQUENCE),
        Field("s", "string"),
        Field("n", "uint8"),
        Field("header", "std_msgs/Header"),
        Field("at", "builtin_interfaces/Time"),
        Field("two", "pkg/Inner", 2),
    )
    assert schema["std_msgs/Header"][0].name == "seq"
    assert schema["other_pkg/Thing"] == (Field("b", "bool", 4),)
    with pytest.raises(UnknownTypeError, match="the line 'what-is this'"):
        ros_schema("pkg/Bad", "ros2msg", "float64 x\nwhat-is this\n", 2)


def test_definitions_read_as_the_official_parser_reads_them() -> None:
    for ros in (1, 2):
        types = bags.store(ros)
        for name in sorted(types.fielddefs):
            schema = ros_schema(name, "ros2msg", bags.definition(name, ros).decode(), ros)
            official = [f for f in types.fielddefs[name][1] if f[0] != EMPTY]
            own = tuple(field for field in schema[short_name(name)] if field.name != EMPTY)
            assert [field for field, _ in official] == [field.name for field in own]
            for (_, (kind, what)), field in zip(official, own, strict=True):
                if kind == Nodetype.ARRAY:
                    assert field.length == what[1]
                else:
                    assert field.length == (SEQUENCE if kind == Nodetype.SEQUENCE else None)
