"""Pieces of a ROS 1 bag: chunks with their message indexes, and messages that stand in none."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdilog_readers import chunks
from fdilog_readers.chunks import ChunkHead, DamagedChunkError, decompress, decompress_part
from fdilog_readers.columns import Bytes
from fdilog_readers.file_bytes import FileBytes, read_at
from fdilog_readers.rosbag1_records import (
    CHUNK,
    COUNT_ENTRY,
    INDEX,
    INDEX_ENTRY,
    DamagedRecordError,
    Record,
    chunk_head,
    number,
    parse_record,
    time_ns,
)


@dataclass(frozen=True)
class Place:
    """A chunk that the bag's index knows.

    Parameters
    ----------
    start, end
        From the chunk record to behind its message indexes. [byte]
    counts
        Connection to the number of its messages.
    seconds
        Time from its first message to its last. [s]
    """

    start: int
    end: int
    counts: dict[int, int]
    seconds: float


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a bag, read.

    Parameters
    ----------
    start, length
        Where it lies in the file. [byte]
    head
        What stands before a chunk's data; None for messages that stand in no chunk.
    records : (n_bytes,) or None
        Its records; None if they are to be taken in windows, or are lost.
    failure
        What is wrong with it; what ``records`` there are may be used.
    index_damage
        Where in the file its message indexes are not what they should be, or -1. [byte]
    """

    start: int
    length: int
    place: Place | None = None
    head: ChunkHead | None = None
    records: Bytes | None = None
    indexes: dict[int, NDArray[np.void]] = field(default_factory=dict)
    failure: str = ""
    index_damage: int = -1

    @property
    def has_false_index(self) -> bool:
        """Whether its indexes name a place twice, or one that is not there."""
        for entries in self.indexes.values():
            offsets = np.sort(entries["offset"].copy())
            beyond = self.head is not None and bool((offsets >= self.head.size).any())
            if beyond or (offsets[1:] == offsets[:-1]).any():
                return True
        return False

    @property
    def plain_at(self) -> int:
        """Where in the file its records stand as they are, or -1. [byte]"""
        plain = self.head is not None and not self.head.compression
        return self.start + self.head.data_at if self.head and plain else -1


def chunk_place(record: Record, content: bytes, end: int) -> Place:
    """Read a Chunk Info record.

    Raises
    ------
    DamagedRecordError
        If it is not whole.
    """
    counts = dict(COUNT_ENTRY.iter_unpack(content[: len(content) // 8 * 8]))
    if len(counts) != number(record.header, "count"):
        raise DamagedRecordError("a chunk is not described in full")
    first = time_ns(record.header.get("start_time", b""))
    last = time_ns(record.header.get("end_time", b""))
    start = number(record.header, "chunk_pos")
    return Place(start, end, counts, max(0, last - first) / 1e9)


def load(data: FileBytes, start: int, end: int, place: Place | None) -> Piece:
    """Read one chunk, and the message indexes behind it.

    Parameters
    ----------
    end
        Where what belongs to it ends. [byte]
    """
    length = end - start
    try:
        raw = memoryview(read_at(data.file, min(length, chunks.LARGE_BYTES + (1 << 20)), start))
        record = parse_record(raw)
        head = chunk_head(record)
        if record.opcode != CHUNK:
            raise DamagedRecordError("no chunk stands there")  # noqa: TRY301
        if max(head.size, head.data_length) > chunks.LARGE_BYTES:
            return Piece(start, length, place, head)
    except DamagedRecordError as error:
        return Piece(start, length, place, failure=str(error))
    except OSError as error:
        return Piece(start, length, place, failure=(error.strerror or str(error)).lower())
    content = raw[record.data_at : record.end] if head.data_length else raw[record.data_at :]
    if record.end > len(raw) or not head.data_length:
        part = np.frombuffer(decompress_part(head.compression, content), np.uint8)
        return Piece(start, length, place, head, part, failure="the file ends inside it")
    try:
        records = np.frombuffer(decompress(head, content), np.uint8)
    except DamagedChunkError as error:
        # Without compression there is nothing to go wrong but a length; bzip2 checks every block.
        # What lz4 gives before it stumbles may be wrong already.
        usable = head.compression in {"", "bz2"}
        part = np.frombuffer(decompress_part(head.compression, content), np.uint8)
        return Piece(start, length, place, head, part if usable else None, failure=str(error))
    indexes, damage = _indexes(raw, record.end, place) if place else ({}, -1)
    damage = damage if damage < 0 else start + damage
    return Piece(start, length, place, head, records, indexes, index_damage=damage)


def _indexes(raw: memoryview, at: int, place: Place) -> tuple[dict[int, NDArray[np.void]], int]:
    """Read the message indexes, and say where they cannot be believed; -1 if they can. [byte]"""
    found: dict[int, NDArray[np.void]] = {}
    while at < len(raw):
        try:
            record = parse_record(raw, at)
            connection = number(record.header, "conn")
        except DamagedRecordError:
            return {}, at
        if record.opcode != INDEX:
            return {}, -1
        content = raw[record.data_at : record.end]
        if record.end > len(raw) or len(content) % INDEX_ENTRY.itemsize:
            return {}, at
        entries = np.frombuffer(bytes(content), INDEX_ENTRY)
        if len(entries) != place.counts.get(connection):
            return {}, at
        found[connection] = entries
        at = record.end
    return found, -1 if found.keys() == place.counts.keys() else at
