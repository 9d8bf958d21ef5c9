"""What a message holds: the fields of every type, in whatever language they were defined.

ROS definitions (``.msg`` text of ROS 1 and 2, ROS 2 IDL) are read here; Protobuf descriptors and
JSON schemas become the same ``Schema`` in their own modules, so that one search finds the gyros.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

_WIDTHS = {"int": (8, 16, 32, 64), "uint": (8, 16, 32, 64), "float": (32, 64)}

# The names of the numbers that a message can hold, and of their NumPy types.
NUMBERS = {f"{kind}{bits}": f"{kind}{bits}" for kind, widths in _WIDTHS.items() for bits in widths}
NUMBERS |= {"bool": "bool", "byte": "int8", "char": "uint8", "octet": "uint8"}

SEQUENCE = -1
TIME, DURATION = "builtin_interfaces/Time", "builtin_interfaces/Duration"


class UnknownTypeError(Exception):
    """A message type is not defined, or in words that cannot be read; the text says which."""


@dataclass(frozen=True)
class Field:
    """One field of a message type.

    Parameters
    ----------
    type
        A key of ``NUMBERS``, ``string``, ``wstring``, or the name of another type.
    length
        None for one value, n for a fixed array, ``SEQUENCE`` for a list of any length.
    counted
        Whether it is a list all the same, which has ``length`` elements in every message.
    number
        The field's number in Protobuf.
    encoding
        How Protobuf writes it: ``varint``, ``zigzag``, ``fixed`` or ``bytes``.
    """

    name: str
    type: str
    length: int | None = None
    counted: bool = False
    number: int = field(default=0, compare=False)
    encoding: str = field(default="", compare=False)

    @property
    def is_number(self) -> bool:
        """Whether it is a single number."""
        return self.length is None and self.type in NUMBERS


Schema = Mapping[str, tuple[Field, ...]]

_ROS2_TIMES: Schema = {
    TIME: (Field("sec", "int32"), Field("nanosec", "uint32")),
    DURATION: (Field("sec", "int32"), Field("nanosec", "uint32")),
}
_ROS1_TIMES: Schema = {
    TIME: (Field("sec", "uint32"), Field("nanosec", "uint32")),
    DURATION: (Field("sec", "int32"), Field("nanosec", "int32")),
}

_SEPARATOR = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
_SECTION = re.compile(r"\s*(MSG|IDL):[ \t]*(\S+)[ \t]*\n?")
_LINE = re.compile(
    r"(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?"
    r"(?P<array>\[(?:<=)?(?P<count>\d*)\])?"
    r"\s+(?P<name>[A-Za-z]\w*)\s*(?P<rest>.*)"
)


def ros_schema(name: str, encoding: str, text: str, ros: int) -> Schema:
    """Read a ROS message definition with all that it refers to.

    Parameters
    ----------
    name
        The message's type: ``sensor_msgs/msg/Imu`` or ``sensor_msgs/Imu``.
    encoding
        ``ros2idl``, or ``ros1msg`` or ``ros2msg``.
    text
        The definition; empty where the log has none, then the standard type of that name serves.

    Raises
    ------
    UnknownTypeError
        If a type is neither defined here nor a standard one, or a definition cannot be read.
    """
    own: dict[str, tuple[Field, ...]] = {}
    if text.strip():
        own = _idl_types(text) if encoding == "ros2idl" else _msg_types(name, text)
    schema = {**own, **(_ROS1_TIMES if ros == 1 else _ROS2_TIMES)}
    missing = [short_name(name)]
    while missing:
        for type_name in missing:
            if type_name not in schema:
                schema[type_name] = _standard_type(type_name, ros)
        missing = [
            f.type
            for fields in schema.values()
            for f in fields
            if f.type not in NUMBERS and f.type not in {"string", "wstring", *schema}
        ]
    return schema


def short_name(name: str) -> str:
    """Return ``sensor_msgs/Imu`` for ``sensor_msgs/msg/Imu``; other names stay as they are."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[2]}" if len(parts) == 3 else name


def _msg_types(name: str, text: str) -> dict[str, tuple[Field, ...]]:
    types: dict[str, tuple[Field, ...]] = {}
    sections = _SEPARATOR.split(text.replace("\r\n", "\n"))
    for index, section in enumerate(sections):
        section_name, body = name, section
        if heading := _SECTION.match(section):
            section_name, body = heading[2], section[heading.end() :]
        elif index:
            continue
        section_name = short_name(section_name)
        package = section_name.rpartition("/")[0]
        types[section_name] = tuple(_msg_fields(section_name, package, body.splitlines()))
    return types


def _msg_fields(owner: str, package: str, lines: Iterable[str]) -> Iterable[Field]:
    for line in lines:
        words = line.strip()
        if not words or words.startswith(("#", "@")):
            continue
        match = _LINE.match(words)
        if match is None:
            raise UnknownTypeError(f"the definition of {owner} has the line {words[:60]!r}")
        if match["rest"].startswith("="):
            continue  # a constant takes no place in the message
        length = None
        if match["array"]:
            bounded = "<=" in match["array"] or not match["count"]
            length = SEQUENCE if bounded else int(match["count"])
        yield Field(match["name"], _type_name(match["type"], package), length)


def _type_name(word: str, package: str) -> str:
    if word in NUMBERS or word in {"string", "wstring"}:
        return word
    if word in {"time", "duration"}:
        return TIME if word == "time" else DURATION
    if word in {"Header", "roslib/Header"}:
        return "std_msgs/Header"
    return short_name(word) if "/" in word or not package else f"{package}/{word}"


def _idl_types(text: str) -> dict[str, tuple[Field, ...]]:
    from rosbags.typesys import TypesysError, get_types_from_idl

    types: dict[str, tuple[Field, ...]] = {}
    for section in _SEPARATOR.split(text):
        heading = _SECTION.match(section)
        body = section[heading.end() :] if heading else section
        if not body.strip():
            continue
        try:
            parsed = get_types_from_idl(body)
        except (TypesysError, AssertionError, LookupError, ValueError, RecursionError) as error:
            what = " ".join(str(error).split())[:80]
            raise UnknownTypeError(f"an IDL definition cannot be read: {what}") from error
        types |= {short_name(name): _described(fields) for name, (_, fields) in parsed.items()}
    return types


def _standard_type(name: str, ros: int) -> tuple[Field, ...]:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.LATEST)
    full = name.replace("/", "/msg/", 1)
    if full not in store.fielddefs:
        raise UnknownTypeError(f"{full} is not defined in the log, nor a standard type")
    return _described(store.fielddefs[full][1])


def _described(fields: Iterable[tuple[str, tuple[object, object]]]) -> tuple[Field, ...]:
    """Translate the field descriptions of rosbags, whose first number tells the kind of field."""
    from rosbags.interfaces import Nodetype

    def one(name: str, kind: object, what: object) -> Field:
        if kind == Nodetype.NAME:
            return Field(name, short_name(str(what)))
        assert isinstance(what, tuple)  # noqa: S101  the other three kinds come with a pair
        if kind == Nodetype.BASE:
            return Field(name, str(what[0]))
        (inner_kind, inner), count = what
        length = int(count) if kind == Nodetype.ARRAY else SEQUENCE
        return Field(name, one(name, inner_kind, inner).type, length)

    return tuple(one(name, kind, what) for name, (kind, what) in fields)
