"""Numbers in Protobuf messages: the wire format walked through for all messages at once.

Every step reads one field of every message. Messages of one topic have the same fields in the same
order, nearly always, so a step is a few array operations for all of them.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.message_batch import Batch, Columns, Mask
from fdilog_readers.message_schema import NUMBERS, SEQUENCE, Field, Schema, UnknownTypeError

# The types of FieldDescriptorProto that are numbers: their NumPy type and how they are written.
_TYPES = {
    1: ("float64", "fixed"),
    2: ("float32", "fixed"),
    3: ("int64", "varint"),
    4: ("uint64", "varint"),
    5: ("int32", "varint"),
    6: ("uint64", "fixed"),
    7: ("uint32", "fixed"),
    8: ("bool", "varint"),
    13: ("uint32", "varint"),
    14: ("int32", "varint"),
    15: ("int32", "fixed"),
    16: ("int64", "fixed"),
    17: ("int32", "zigzag"),
    18: ("int64", "zigzag"),
}
_MESSAGE, _REPEATED = 11, 3
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

# More fields in one message than this is no sensor's message.
MAX_STEPS = 4096
MAX_DEPTH = 8
# The longest number is ten bytes long; so much may be read behind a message's end.
MARGIN = 16

Places = NDArray[np.int64]


def protobuf_schema(descriptors: bytes) -> Schema:
    """Read a serialised ``FileDescriptorSet``: message name with its package to fields.

    Raises
    ------
    UnknownTypeError
        If it cannot be read.
    """
    types: dict[str, tuple[Field, ...]] = {}
    for number, file in _fields(descriptors):
        if number != 1 or not isinstance(file, bytes):
            continue
        inside = list(_fields(file))
        package = next((_text(value) for n, value in inside if n == 2), "")
        for n, value in inside:
            if n == 4 and isinstance(value, bytes):
                _message_type(types, value, f"{package}." if package else "", 0)
    return types


def _message_type(types: dict[str, tuple[Field, ...]], raw: bytes, prefix: str, depth: int) -> None:
    inside = list(_fields(raw))
    name = prefix + next((_text(value) for n, value in inside if n == 1), "")
    fields = []
    for n, value in inside:
        if n == 2 and isinstance(value, bytes):
            fields.append(_field(dict(_fields(value))))
        elif n == 3 and isinstance(value, bytes) and depth < MAX_DEPTH:
            _message_type(types, value, f"{name}.", depth + 1)
    types[name] = tuple(fields)


def _field(described: dict[int, int | bytes]) -> Field:
    kind, number = described.get(5, 0), described.get(3, 0)
    length = SEQUENCE if described.get(4) == _REPEATED else None
    type_name, encoding = "bytes", "bytes"
    if kind == _MESSAGE:
        type_name = _text(described.get(6, b"")).lstrip(".")
    elif isinstance(kind, int) and kind in _TYPES:
        type_name, encoding = _TYPES[kind]
    return Field(
        _text(described.get(1, b"")),
        type_name,
        length,
        number=number if isinstance(number, int) else 0,
        encoding=encoding,
    )


def _text(value: int | bytes) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else ""


def _fields(raw: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Yield number and value of each field of one message, for descriptors only."""
    at = 0
    while at < len(raw):
        key, at = _varint(raw, at)
        number, wire = key >> 3, key & 7
        if wire == VARINT:
            value, at = _varint(raw, at)
            yield number, value
        elif wire in {FIXED32, FIXED64}:
            at += 4 if wire == FIXED32 else 8
        elif wire == BYTES:
            length, at = _varint(raw, at)
            if at + length > len(raw):
                raise UnknownTypeError("its Protobuf descriptor is cut")
            yield number, raw[at : at + length]
            at += length
        else:
            raise UnknownTypeError("its Protobuf descriptor cannot be read")


def _varint(raw: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(raw):
            break
        byte = raw[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise UnknownTypeError("its Protobuf descriptor cannot be read")


class ProtobufLayout:
    """Reads some leaves of one message type.

    A number that a message leaves out is zero, as Protobuf has it; the numbers of a part that it
    leaves out are not-a-number where they are floating point.
    """

    batch_bytes = 1 << 20

    def __init__(self, schema: Schema, name: str, wanted: Collection[str]) -> None:
        if name not in schema:
            raise UnknownTypeError(f"{name} is not defined in the log")
        self._schema = schema
        self._name = name
        self._wanted = {leaf.rpartition("[")[0] if leaf.endswith("]") else leaf for leaf in wanted}
        parts = [leaf.split(".") for leaf in self._wanted]
        self._parents = {".".join(part[:k]) for part in parts for k in range(len(part))}

    def columns(self, batch: Batch) -> tuple[Columns, Mask]:
        """Read the wanted leaves of all messages; see ``Layout``."""
        walk = _Walk(self._schema, self._wanted, self._parents, batch)
        count, width = batch.rows.shape
        starts = np.arange(count, dtype=np.int64) * width + batch.lead
        everything = np.arange(count)
        walk.message(self._name, "", _Spans(everything, starts, starts + batch.lengths), 0)
        return walk.columns, walk.fits


@dataclass(frozen=True, eq=False)
class _Spans:
    """Where the walk is in some of the messages, and where the part it is in ends."""

    rows: Places
    at: Places
    end: Places

    def only(self, mask: Mask) -> _Spans:
        return _Spans(self.rows[mask], self.at[mask], self.end[mask])

    def move(self, at: Places) -> _Spans:
        return _Spans(self.rows, at, self.end)


class _Walk:
    def __init__(
        self, schema: Schema, wanted: Collection[str], parents: Collection[str], batch: Batch
    ) -> None:
        self.schema = schema
        self.wanted = wanted
        self.parents = parents
        self.count = len(batch)
        self.fits: Mask = np.ones(self.count, np.bool_)
        self.columns: Columns = {}
        self.bytes = np.concatenate([batch.rows.reshape(-1), np.zeros(MARGIN, np.uint8)])

    def message(self, name: str, path: str, spans: _Spans, depth: int) -> None:
        """Take the fields of a message, or of a part of one, in some rows."""
        fields = {item.number: item for item in self.schema.get(name, ())}
        for item in fields.values():
            leaf = f"{path}{item.name}"
            if item.type in NUMBERS and item.length is None and leaf in self.wanted:
                self._column(leaf, item)[spans.rows] = 0
        for _ in range(MAX_STEPS):
            going = spans.at < spans.end
            if not going.all():
                spans = spans.only(going)
            if not len(spans.rows):
                return
            keys, at = self._varints(spans.at)
            spans = spans.move(at)
            following = at.copy()
            first = keys[0]
            if (keys == first).all():
                following = self._field(fields, int(first), path, spans, depth)
            else:
                for key in np.unique(keys).tolist():
                    here = keys == key
                    following[here] = self._field(fields, key, path, spans.only(here), depth)
            spans = spans.move(following)
        self.fits[spans.rows] = False

    def _column(self, leaf: str, item: Field) -> NDArray[np.generic]:
        if leaf not in self.columns:
            number = np.dtype(NUMBERS[item.type])
            self.columns[leaf] = np.full(self.count, np.nan if number.kind == "f" else 0, number)
        return self.columns[leaf]

    def _field(
        self, fields: dict[int, Field], key: int, path: str, spans: _Spans, depth: int
    ) -> Places:
        """Take one field of the same key in some rows; return where the next one begins."""
        item = fields.get(key >> 3)
        leaf = f"{path}{item.name}" if item else ""
        wire = key & 7
        if wire == BYTES:
            lengths, start = self._varints(spans.at)
            inner = _Spans(spans.rows, start, self._bounded(spans.move(start), lengths))
            if item is None or item.encoding != "bytes":
                if item is not None and leaf in self.wanted and item.length == SEQUENCE:
                    self._packed(leaf, item, inner)
            elif leaf in self.parents and item.length is None and depth < MAX_DEPTH:
                self.message(item.type, f"{leaf}.", inner, depth + 1)
            return inner.end
        if wire == VARINT:
            values, following = self._varints(spans.at)
            if item is not None and leaf in self.wanted and item.encoding in {"varint", "zigzag"}:
                self._column(leaf, item)[spans.rows] = _of_varint(values, item)
        elif wire in {FIXED32, FIXED64}:
            following = self._fixed(item, leaf, spans, 4 if wire == FIXED32 else 8)
        else:
            self.fits[spans.rows] = False
            return spans.end
        over = following > spans.end
        if over.any():
            self.fits[spans.rows[over]] = False
            following = np.minimum(following, spans.end)
        return following

    def _fixed(self, item: Field | None, leaf: str, spans: _Spans, size: int) -> Places:
        if item is not None and leaf in self.wanted and item.encoding == "fixed":
            number = np.dtype(NUMBERS[item.type])
            if number.itemsize == size and item.length is None:
                inside = np.minimum(spans.at, len(self.bytes) - size)
                self._column(leaf, item)[spans.rows] = self._gather(inside, number)
        return spans.at + size

    def _bounded(self, spans: _Spans, lengths: NDArray[Any]) -> Places:
        """Return where a part ends; messages in which that is beyond their end do not fit."""
        following: Places = spans.at + lengths
        over = (following > spans.end) | (following < spans.at)
        if over.any():
            self.fits[spans.rows[over]] = False
            following = np.where(over, spans.end, following)
        return following

    def _gather(self, at: Places, number: np.dtype[np.generic]) -> NDArray[np.generic]:
        opaque = np.dtype((np.void, number.itemsize))
        places = len(self.bytes) - number.itemsize + 1
        found: NDArray[np.generic] = np.ndarray((places,), opaque, self.bytes, 0, (1,))[at].view(
            number
        )
        return found

    def _varints(self, at: Places) -> tuple[NDArray[Any], Places]:
        """Read the number of varying length at each place; return where what follows it begins.

        The numbers are bytes where all are that short, as keys and lengths mostly are, else int64.
        """
        byte = self.bytes[at]
        at = at + 1
        more = np.flatnonzero(byte >= 0x80)
        if not len(more):
            return byte, at
        values = (byte & 0x7F).astype(np.uint64)
        for shift in range(7, 70, 7):
            byte = self.bytes[np.minimum(at[more], len(self.bytes) - 1)]
            values[more] |= (byte & 0x7F).astype(np.uint64) << np.uint64(shift)
            at[more] += 1
            more = more[byte >= 0x80]
            if not len(more):
                break
        return values.view(np.int64), at

    def _packed(self, leaf: str, item: Field, spans: _Spans) -> None:
        """Take a list of numbers of one size, of which the first three may be a vector."""
        number = np.dtype(NUMBERS[item.type])
        if item.encoding != "fixed":
            return
        counts = (spans.end - spans.at) // number.itemsize
        for k in range(min(int(counts.max(initial=0)), 64)):
            column = self._column(f"{leaf}[{k}]", Field(leaf, "float64"))
            here = counts > k
            places = spans.at[here] + k * number.itemsize
            column[spans.rows[here]] = self._gather(places, number)


def _of_varint(values: NDArray[Any], item: Field) -> NDArray[Any]:
    if item.encoding == "zigzag":
        bits = values.astype(np.uint64)
        values = (bits >> np.uint64(1)).view(np.int64) ^ -(bits & np.uint64(1)).view(np.int64)
    return values.astype(NUMBERS[item.type])
