"""Layouts of the topics of a ULog, and the values of its information and parameters."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

MAGIC = b"ULog\x01\x12\x35"
FILE_HEADER_BYTES = 16
HEADER_BYTES = 3
MOST_BYTES = 0xFFFF
SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])

# Flags and characters are numbers of one byte, as the official reader has them.
TYPES = {
    "int8_t": "i1", "uint8_t": "u1", "int16_t": "<i2", "uint16_t": "<u2", "int32_t": "<i4",
    "uint32_t": "<u4", "int64_t": "<i8", "uint64_t": "<u8", "float": "<f4", "double": "<f8",
    "bool": "i1", "char": "i1",
}  # fmt: skip
FIELD = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,5})\])? (\w+)")
FORMAT = re.compile(rb"([\w/-]+):((?:[A-Za-z_]\w*(?:\[\d{1,5}\])? \w+;)+)")
NAME = re.compile(rb"[\w/-]+")
KEY = re.compile(r"([A-Za-z_]\w*)(?:\[(\d{1,5})\])? ([!-~]+)")
PADDING = "_padding"


Value = str | int | float


class BadDefinitionError(Exception):
    """A definition that cannot be used; the text says why."""


@dataclass(frozen=True)
class Field:
    """One field of a format: ``count`` is 0 for what is no array."""

    type: str
    count: int
    name: str


def parse_format(body: bytes) -> tuple[str, tuple[Field, ...]] | None:
    """Return name and fields of a format definition, or None if this is none."""
    match = FORMAT.fullmatch(body)
    if match is None:
        return None
    fields = FIELD.findall(match[2].decode())
    return match[1].decode(), tuple(Field(t, int(n or 0), name) for t, n, name in fields)


@dataclass(frozen=True, eq=False)
class Layout:
    """How the records of a topic lie in memory, nested formats unfolded.

    Parameters
    ----------
    least, most
        Bytes of a record's fields, without and with the padding at the end. [byte]
    dtype
        Fields by the names that the official reader gives them; arrays are one field.
    """

    least: int
    most: int
    dtype: np.dtype[Any]


def layout_of(name: str, formats: Mapping[str, tuple[Field, ...]]) -> Layout:
    """Lay out a topic.

    Raises
    ------
    BadDefinitionError
        If the format, or one nested in it, is missing, endless, or larger than a record can be.
    """
    most = _size(name, formats, {})
    fields = _unfold(name, formats, "")
    while fields and fields[-1][0].startswith(PADDING):
        fields.pop()
    names = [field[0] for field in fields]
    if len({*names}) < len(names):
        raise BadDefinitionError(f"format {name} has two fields of one name")
    dtype = np.dtype(fields)
    if "timestamp" not in names or dtype["timestamp"] != np.uint64:
        raise BadDefinitionError(f"format {name} has no timestamp")
    return Layout(dtype.itemsize, most, dtype)


def _size(name: str, formats: Mapping[str, tuple[Field, ...]], known: dict[str, int | None]) -> int:
    """Size of a format in bytes, found before anything of that size is made.

    ``known`` holds the sizes found so far, and None for formats that are being looked at.
    """
    if name not in known:
        if name not in formats:
            raise BadDefinitionError(f"format {name} is missing")
        known[name] = None
        size = 0
        for field in formats[name]:
            kind = TYPES.get(field.type)
            one = np.dtype(kind).itemsize if kind else _size(field.type, formats, known)
            size += one * max(field.count, 1)
            if size > MOST_BYTES - 2:
                raise BadDefinitionError(f"format {name} is larger than a record can be")
        known[name] = size
    found = known[name]
    if found is None:
        raise BadDefinitionError(f"format {name} contains itself")
    return found


def _unfold(
    name: str, formats: Mapping[str, tuple[Field, ...]], prefix: str
) -> list[tuple[Any, ...]]:
    fields: list[tuple[Any, ...]] = []
    for field in formats[name]:
        if field.type in TYPES:
            kind = TYPES[field.type]
            entry = (prefix + field.name, kind)
            fields.append((*entry, (field.count,)) if field.count else entry)
        elif field.count:
            for k in range(field.count):
                fields += _unfold(field.type, formats, f"{prefix}{field.name}[{k}].")
        else:
            fields += _unfold(field.type, formats, f"{prefix}{field.name}.")
    return fields


def parse_value(body: bytes) -> tuple[str, Value] | None:
    """Return key and value of an information or parameter message, or None if this is none.

    Arrays other than texts come as their bytes in hexadecimal.
    """
    key, raw = body[1 : 1 + body[0]] if body else b"", body[1 + body[0] :] if body else b""
    match = KEY.fullmatch(key.decode(errors="replace"))
    if match is None:
        return None
    kind, count, name = match[1], match[2], match[3]
    if kind == "char" and count is not None:
        return name, raw.decode(errors="replace")
    if kind not in TYPES or count is not None:
        return name, raw.hex()
    dtype = np.dtype(TYPES[kind])
    if len(raw) != dtype.itemsize:
        return None
    value: Value = np.frombuffer(raw, dtype)[0].item()
    return name, value
