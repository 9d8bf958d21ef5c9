"""The records of a ROS 1 bag, format 2.0: headers of named fields, each with data behind it.

Layouts follow http://wiki.ros.org/Bags/Format/2.0.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.chunks import ChunkHead
from fdilog_readers.columns import Bytes, Chain, Offsets

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = range(2, 8)

# What the header of each kind of record has for certain.
FIELDS = {
    MESSAGE: ("conn", "time"),
    BAG: ("index_pos",),
    INDEX: ("conn", "count"),
    CHUNK: ("compression", "size"),
    CHUNK_INFO: ("chunk_pos", "count"),
    CONNECTION: ("conn",),
}

U32 = struct.Struct("<I")
TIME = struct.Struct("<II")

# Connection headers hold a message definition; the largest in use are below 1 MB.
LARGEST_HEADER = 1 << 20
INDEX_ENTRY = np.dtype([("seconds", "<u4"), ("nanoseconds", "<u4"), ("offset", "<u4")])
COUNT_ENTRY = struct.Struct("<II")

Header = dict[str, bytes]


class DamagedRecordError(Exception):
    """A record's own lengths contradict each other, or a field is missing; the text says which."""


class CutRecordError(DamagedRecordError):
    """What there is may be the beginning of a record."""


@dataclass(frozen=True)
class Record:
    """One record: its header, and where its data lies in what it was read from. [byte]"""

    opcode: int
    header: Header
    data_at: int
    data_length: int

    @property
    def end(self) -> int:
        """Where the next record begins. [byte]"""
        return self.data_at + self.data_length


def parse_header(raw: bytes | memoryview) -> Header:
    """Read the fields of a header.

    Raises
    ------
    DamagedRecordError
        If their lengths do not fill it.
    """
    fields: Header = {}
    at = 0
    while at < len(raw):
        if at + U32.size > len(raw):
            raise DamagedRecordError("a header ends inside a field")
        (length,) = U32.unpack_from(raw, at)
        at += U32.size
        if length > len(raw) - at:
            raise DamagedRecordError("a field is longer than its header")
        name, separator, value = bytes(raw[at : at + length]).partition(b"=")
        if not separator or not name:
            raise DamagedRecordError("a header has a field without a name")
        fields[name.decode("latin-1")] = value
        at += length
    return fields


def parse_record(raw: bytes | memoryview, at: int = 0) -> Record:
    """Read a record's header and the length of its data, which may lie beyond what there is.

    Raises
    ------
    DamagedRecordError
        If no record begins here.
    """
    if at + U32.size > len(raw):
        raise CutRecordError("the record is cut")
    (length,) = U32.unpack_from(raw, at)
    if length > LARGEST_HEADER:
        raise DamagedRecordError("a header has an impossible length")
    data_at = at + U32.size + length + U32.size
    if data_at > len(raw):
        raise CutRecordError("the record is cut")
    header = parse_header(raw[at + U32.size : data_at - U32.size])
    opcode = header.get("op", b"")
    if len(opcode) != 1 or opcode[0] not in FIELDS:
        raise DamagedRecordError("a header tells no kind of record")
    if any(name not in header for name in FIELDS[opcode[0]]):
        raise DamagedRecordError("a header lacks a field of its kind of record")
    (data_length,) = U32.unpack_from(raw, data_at - U32.size)
    return Record(opcode[0], header, data_at, data_length)


def number(header: Header, name: str) -> int:
    """Return a field that is a number of 4 or 8 bytes.

    Raises
    ------
    DamagedRecordError
        If it is missing or of another length.
    """
    value = header.get(name, b"")
    if len(value) not in {4, 8}:
        raise DamagedRecordError(f"a header has no number '{name}'")
    return int.from_bytes(value, "little")


def time_ns(value: bytes) -> int:
    """Return a time of two numbers, seconds and nanoseconds. [ns]"""
    if len(value) != TIME.size:
        raise DamagedRecordError("a header has no time")
    seconds, nanoseconds = TIME.unpack(value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def chunk_head(record: Record) -> ChunkHead:
    """Return what a chunk's header says; times and a checksum are not in it.

    Raises
    ------
    DamagedRecordError
        If it lacks the size.
    """
    compression = record.header.get("compression", b"").decode("latin-1")
    return ChunkHead(
        0,
        0,
        number(record.header, "size"),
        0,
        "" if compression == "none" else compression,
        record.data_at,
        record.data_length,
    )


class Heads(NamedTuple):
    """What stands before messages, each (n_messages,).

    The columns are copies: arithmetic on numbers that are not aligned takes many times longer.
    """

    connections: NDArray[np.uint32]
    times_ns: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def select(self, mask: NDArray[np.bool_]) -> Heads:
        """Return those of some of the messages."""
        return Heads(self.connections[mask], self.times_ns[mask], self.lengths[mask])


def times_in(records: NDArray[np.void]) -> NDArray[np.int64]:
    """Return the times of message heads, or of an index's entries. [ns]"""
    times_ns: NDArray[np.int64] = records["seconds"].copy().astype(np.int64) * 1_000_000_000
    times_ns += records["nanoseconds"].copy()
    return times_ns


class MessageShape:
    """The header that the messages of one recorder have, in which only two numbers vary.

    Parameters
    ----------
    raw
        One message record; its header is the model.

    Attributes
    ----------
    lead
        Bytes before a message's data. [byte]
    """

    def __init__(self, raw: bytes | memoryview) -> None:
        record = parse_record(raw)
        self.lead = record.data_at
        model = bytes(raw[: self.lead])
        self._at = {}
        for name, size in (("conn", 4), ("time", 8)):
            mark = U32.pack(len(name) + 1 + size) + name.encode() + b"="
            if record.opcode != MESSAGE or model.count(mark) != 1:
                raise DamagedRecordError("a message header lacks its connection or its time")
            self._at[name] = model.index(mark) + len(mark)
        fixed = np.ones(self.lead, np.bool_)
        fixed[self._at["conn"] : self._at["conn"] + 4] = False
        fixed[self._at["time"] : self._at["time"] + 8] = False
        fixed[-4:] = False
        self._model = np.frombuffer(model, np.uint8)
        self._fixed_bits = int.from_bytes(np.where(fixed, 255, 0).astype(np.uint8).tobytes())
        self._model_bits = int.from_bytes(model) & self._fixed_bits
        # Where eight bytes are compared at once: every eighth, and the last eight.
        starts = sorted({*range(0, self.lead - 8, 8), max(0, self.lead - 8)})
        self._parts = [(at, _mask(fixed, at), _mask(fixed, at, self._model)) for at in starts]
        self._head = np.dtype(
            {
                "names": ["conn", "seconds", "nanoseconds", "length"],
                "formats": ["<u4"] * 4,
                "offsets": [
                    self._at["conn"],
                    self._at["time"],
                    self._at["time"] + 4,
                    self.lead - 4,
                ],
                "itemsize": self.lead,
            }
        )

    def heads(self, rows: Bytes) -> Heads:
        """Read the heads at the beginning of rows."""
        fields = np.ndarray(len(rows), self._head, rows, 0, rows.strides[:1])
        lengths = fields["length"].copy().astype(np.int64)
        return Heads(fields["conn"].copy(), times_in(fields), lengths)

    def begins_at(self, buffer: Bytes, offsets: Offsets) -> NDArray[np.bool_]:
        """Tell at which offsets a header begins as such a one does; each must fit in the buffer."""
        words = np.ndarray((len(buffer) - 7,), np.uint64, buffer, 0, (1,))
        return np.asarray(words[offsets] == self._parts[0][2])

    def lengths_at(self, buffer: Bytes, offsets: Offsets) -> NDArray[np.int64]:
        """Read the lengths of the messages whose headers begin at the offsets. [byte]"""
        lengths = np.ndarray((len(buffer) - 3,), np.uint32, buffer, 0, (1,))
        return lengths[offsets + (self.lead - 4)].astype(np.int64)

    def matches(self, raw: bytes | memoryview) -> bool:
        """Tell whether a record begins with such a header."""
        head = bytes(raw[: self.lead])
        same = int.from_bytes(head) & self._fixed_bits == self._model_bits
        return same and len(head) == self.lead

    def begins(self, rows: Bytes) -> NDArray[np.bool_]:
        """Tell which rows begin as such a header does: its length, and that of its first field."""
        words = np.ndarray((len(rows),), np.uint64, rows, 0, rows.strides[:1])
        return np.asarray(words == self._parts[0][2])

    def chain(self, buffer: Bytes) -> MessageChain:
        """Find all messages of this shape that a buffer may hold."""
        room = max(0, len(buffer) - self.lead + 1)
        places = np.flatnonzero(buffer[:room] == self._model[0])
        for at, mask, model in self._parts:
            words = np.ndarray((max(0, len(buffer) - 7),), np.uint64, buffer, 0, (1,))[places + at]
            places = places[(words & mask) == model]
        lengths = np.ndarray((max(0, len(buffer) - 3),), np.uint32, buffer, 0, (1,))
        ends = places + self.lead + lengths[places + (self.lead - 4)].astype(np.int64)
        inside = ends <= len(buffer)
        return MessageChain(places[inside], ends[inside])


class MessageChain:
    """Messages of one shape, found among places that may hold one."""

    def __init__(self, starts: Offsets, ends: Offsets) -> None:
        self._starts = starts
        self._ends = ends
        self._chain = Chain(starts, ends)

    def follow(self, at: int) -> tuple[Offsets, int]:
        """Return the offsets of the messages that follow one another from here, and the end."""
        if not len(self._starts):
            return self._starts, at
        indices, end = self._chain.follow(at)
        return self._starts[indices], end

    def next_after(self, at: int) -> int | None:
        """Return where, after damage, messages go on."""
        later = self._starts[np.searchsorted(self._starts, at) :]
        return int(later[0]) if len(later) else None


def _mask(fixed: NDArray[np.bool_], at: int, values: Bytes | None = None) -> np.uint64:
    part = np.where(fixed[at : at + 8], 255 if values is None else values[at : at + 8], 0)
    padded = np.zeros(8, np.uint8)
    padded[: len(part)] = part
    return np.uint64(int.from_bytes(padded.tobytes(), "little"))
