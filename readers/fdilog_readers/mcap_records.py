"""The records of an MCAP file: what each opcode holds, and how records lie end to end.

Layouts follow the format's specification, version 0 (mcap.dev/spec).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.chunks import ChunkHead
from fdilog_readers.columns import Bytes, Chain, Offsets

MAGIC = b"\x89MCAP0\r\n"

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX = range(9, 14)
SUMMARY_OFFSET, DATA_END = 14, 15
PRIVATE = 0x80

RECORD = struct.Struct("<BQ")
CHUNK_FIELDS = struct.Struct("<QQQI")
CHUNK_INDEX_FIELDS = struct.Struct("<QQQQI")
INDEX_OFFSET = struct.Struct("<HQ")
INDEX_HEAD = struct.Struct("<BQHI")
FOOTER_FIELDS = struct.Struct("<QQI")

# opcode, length, channel, sequence, log time, publish time; the data follows.
MESSAGE_HEAD = np.dtype(
    {
        "names": ["opcode", "length", "channel", "log_time"],
        "formats": ["u1", "<u8", "<u2", "<i8"],
        "offsets": [0, 1, 9, 15],
        "itemsize": 31,
    }
)
MESSAGE_FIELDS_BYTES = 22
INDEX_ENTRY = np.dtype([("log_time", "<i8"), ("offset", "<u8")])


class DamagedRecordError(Exception):
    """A record's own lengths contradict each other."""


@dataclass(frozen=True)
class SchemaRecord:
    """Definition of a message type."""

    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class ChannelRecord:
    """A topic, and how its messages are written."""

    id: int
    schema: int
    topic: str
    encoding: str


@dataclass(frozen=True)
class ChunkPlace:
    """A chunk's place in the file, from its index in the summary.

    Parameters
    ----------
    start, length
        The whole chunk record. [byte]
    index_length
        The message indexes right behind it. [byte]
    indexes
        Channel to the offset in the file of its message index.
    seconds
        Time from its first message to its last, where that is known. [s]
    """

    start: int
    length: int
    index_length: int = 0
    indexes: dict[int, int] = field(default_factory=dict)
    seconds: float | None = None

    @property
    def end(self) -> int:
        """Offset of the byte after the chunk and its indexes. [byte]"""
        return self.start + self.length + self.index_length

    def counts(self) -> dict[int, int]:
        """Return how many messages each channel has, from the lengths of their indexes."""
        counts = {}
        end = self.end
        for channel, at in sorted(self.indexes.items(), key=itemgetter(1), reverse=True):
            counts[channel] = (end - at - RECORD.size - 6) // INDEX_ENTRY.itemsize
            end = at
        return counts


class Fields:
    """Reads fields one after another from a record's content."""

    def __init__(self, content: bytes | memoryview) -> None:
        self._content = content
        self._at = 0

    @property
    def left(self) -> int:
        """Bytes not read yet. [byte]"""
        return len(self._content) - self._at

    def take(self, count: int) -> bytes:
        """Return the next bytes.

        Raises
        ------
        DamagedRecordError
            If the record has fewer.
        """
        if count > self.left:
            raise DamagedRecordError(f"a field of {count} bytes in a record with {self.left} left")
        self._at += count
        return bytes(self._content[self._at - count : self._at])

    def u16(self) -> int:
        """Return the next two bytes as a number."""
        return int.from_bytes(self.take(2), "little")

    def u32(self) -> int:
        """Return the next four bytes as a number."""
        return int.from_bytes(self.take(4), "little")

    def u64(self) -> int:
        """Return the next eight bytes as a number."""
        return int.from_bytes(self.take(8), "little")

    def text(self) -> str:
        """Return the next string."""
        return self.take(self.u32()).decode(errors="replace")


def parse_schema(content: bytes | memoryview) -> tuple[int, SchemaRecord]:
    """Read a Schema record: its number, and what it defines."""
    fields = Fields(content)
    number = fields.u16()
    return number, SchemaRecord(fields.text(), fields.text(), fields.take(fields.u32()))


def parse_channel(content: bytes | memoryview) -> ChannelRecord:
    """Read a Channel record."""
    fields = Fields(content)
    return ChannelRecord(fields.u16(), fields.u16(), fields.text(), fields.text())


def parse_chunk_index(content: bytes | memoryview) -> ChunkPlace:
    """Read a Chunk Index record; a long log has tens of thousands of them."""
    try:
        start_ns, end_ns, start, length, size = CHUNK_INDEX_FIELDS.unpack_from(content)
        at = CHUNK_INDEX_FIELDS.size
        indexes = dict(INDEX_OFFSET.iter_unpack(content[at : at + size]))
        (index_length,) = struct.unpack_from("<Q", content, at + size)
    except struct.error as error:
        raise DamagedRecordError("a chunk index is cut") from error
    seconds = (end_ns - start_ns) / 1e9 if end_ns >= start_ns else None
    return ChunkPlace(start, length, index_length, indexes, seconds)


def parse_statistics(content: bytes | memoryview) -> dict[int, int]:
    """Read how many messages each channel has from a Statistics record."""
    fields = Fields(content)
    fields.take(42)
    inner = Fields(fields.take(fields.u32()))
    counts = {}
    while inner.left:
        channel = inner.u16()
        counts[channel] = inner.u64()
    return counts


def parse_chunk_head(record: bytes | memoryview) -> ChunkHead:
    """Read what stands before a chunk's data; the record may be cut after it.

    Raises
    ------
    DamagedRecordError
        If this is no chunk, or its lengths contradict each other.
    """
    fields = Fields(record[: RECORD.size + CHUNK_FIELDS.size + 4 + 64 + 8])
    opcode = fields.take(1)[0]
    length = fields.u64()
    start_ns, end_ns, size, crc = CHUNK_FIELDS.unpack(fields.take(CHUNK_FIELDS.size))
    compression_length = fields.u32()
    if opcode != CHUNK or compression_length > 64:
        raise DamagedRecordError("no chunk begins here")
    compression = fields.take(compression_length).decode("latin-1")
    data_length = fields.u64()
    data_at = RECORD.size + CHUNK_FIELDS.size + 4 + compression_length + 8
    if data_at + data_length != RECORD.size + length:
        raise DamagedRecordError("the chunk's length contradicts that of its records")
    return ChunkHead(start_ns, end_ns, size, crc, compression, data_at, data_length)


def parse_message_index(record: bytes | memoryview) -> tuple[int, NDArray[np.void]]:
    """Read a Message Index record, opcode and all: channel, and its entries.

    Raises
    ------
    DamagedRecordError
        If this is none, or its lengths contradict each other.
    """
    fields = Fields(record)
    if fields.take(1)[0] != MESSAGE_INDEX:
        raise DamagedRecordError("no message index begins here")
    length, channel, entries_length = fields.u64(), fields.u16(), fields.u32()
    if length != 6 + entries_length or entries_length % INDEX_ENTRY.itemsize:
        raise DamagedRecordError("the message index's length contradicts that of its entries")
    if entries_length > fields.left:
        raise DamagedRecordError("the message index is cut")
    at = RECORD.size + 6
    # A copy lies at an aligned address, which all that is done with it is faster for.
    return channel, np.frombuffer(bytes(record[at : at + entries_length]), INDEX_ENTRY)


class MessageChain:
    """The message records of a buffer that may begin anywhere among others.

    Parameters
    ----------
    buffer : (n_bytes,)
        Records end to end, at least from some place on.
    """

    def __init__(self, buffer: Bytes) -> None:
        places = np.flatnonzero(
            buffer[: max(0, len(buffer) - MESSAGE_HEAD.itemsize + 1)] == MESSAGE
        )
        lengths = np.ndarray((max(0, len(buffer) - 8),), "<u8", buffer, 1, (1,))[places]
        room = (len(buffer) - RECORD.size - places).astype(np.uint64)
        real = (lengths >= MESSAGE_FIELDS_BYTES) & (lengths <= room)
        self._starts: Offsets = places[real]
        self._ends: Offsets = self._starts + RECORD.size + lengths[real].astype(np.int64)
        self._chain = Chain(self._starts, self._ends)

    def follow(self, at: int) -> tuple[Offsets, int]:
        """Return the offsets of the messages that follow one another from here, and the end."""
        if not len(self._starts):
            return self._starts, at
        indices, end = self._chain.follow(at)
        return self._starts[indices], end
