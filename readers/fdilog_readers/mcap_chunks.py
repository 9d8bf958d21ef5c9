"""Chunks of an MCAP file, with what their own indexes say of the wanted channels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog_readers import chunks
from fdilog_readers.chunks import ChunkHead, DamagedChunkError, decompress
from fdilog_readers.columns import Bytes, Offsets, rows
from fdilog_readers.file_bytes import read_at
from fdilog_readers.mcap_records import (
    INDEX_ENTRY,
    INDEX_HEAD,
    MESSAGE,
    MESSAGE_FIELDS_BYTES,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD,
    ChunkPlace,
    DamagedRecordError,
    parse_chunk_head,
    parse_message_index,
)
from fdilog_readers.message_batch import Batch, side_by_side

Timed = tuple[NDArray[np.int64], Batch]

# What a disk or a card loses, it loses in blocks of this size at least.
DAMAGE_BYTES = 4096


@dataclass(frozen=True, eq=False)
class Chunk:
    """A chunk that has been read.

    Parameters
    ----------
    records : (n_bytes,) or None
        The uncompressed records; None if the chunk is too large to have whole.
    batches
        Channels of a topic to their messages, as the chunk's own index names them; None where
        there is no index, or it does not hold true.
    failure
        Why there are no records.
    index_damage
        Where in the file the indexes behind it are not what they should be, or -1. [byte]
    """

    place: ChunkPlace
    head: ChunkHead | None = None
    records: Bytes | None = None
    batches: dict[tuple[int, ...], list[Timed]] | None = None
    failure: str = ""
    index_damage: int = -1


def load(file: int, place: ChunkPlace, topics: tuple[tuple[int, ...], ...]) -> Chunk:
    """Read one chunk, check it, and copy the messages of the topics by the chunk's own index.

    Parameters
    ----------
    topics
        The channels of each topic; none at all if the index is not to be used.
    """
    try:
        raw = memoryview(
            read_at(file, min(place.end - place.start, chunks.LARGE_BYTES), place.start)
        )
        head = parse_chunk_head(raw)
        if max(head.size, place.length) > chunks.LARGE_BYTES:
            return Chunk(place, head)
        if len(raw) < place.length:
            raise DamagedChunkError("the file ends inside it")  # noqa: TRY301
        data = raw[head.data_at : head.data_at + head.data_length]
        records = np.frombuffer(decompress(head, data), np.uint8)
    except (DamagedChunkError, DamagedRecordError) as error:
        return Chunk(place, failure=str(error))
    except OSError as error:
        return Chunk(place, failure=(error.strerror or str(error)).lower())
    batches = None
    damage = _index_damage(raw, place, head)
    # Without a checksum only a walk through all records shows whether they still lie end to end.
    if damage < 0 and topics and head.crc:
        batches = _indexed(records, raw, place, topics)
        damage = place.start + place.length if batches is None else damage
    return Chunk(place, head, records, batches, index_damage=damage)


def _indexed(
    records: Bytes, raw: memoryview, place: ChunkPlace, topics: tuple[tuple[int, ...], ...]
) -> dict[tuple[int, ...], list[Timed]] | None:
    """Copy what the index names; nothing if any of it is not what it says."""
    found = {}
    for channels in topics:
        here = tuple(channel for channel in channels if channel in place.indexes)
        entries = _entries(raw, place, here)
        batches = None if entries is None else _at_entries(records, entries, here)
        if batches is None:
            return None
        found[channels] = batches
    return found


def _index_damage(raw: memoryview, place: ChunkPlace, head: ChunkHead) -> int:
    """Return where the message indexes are not what the summary says, or -1. [byte]

    They have no checksum. Those of the wanted channels prove themselves by what they name; of the
    others the heads are looked at, and the times of what is longer than a block of a disk: damage
    comes in blocks, and less than one leaves no room between two heads.
    """
    for channel, offset in place.indexes.items():
        at = offset - place.start
        if not place.length <= at <= len(raw) - INDEX_HEAD.size:
            return offset
        opcode, length, number, size = INDEX_HEAD.unpack_from(raw, at)
        end = at + INDEX_HEAD.size + size
        if (opcode, number, length) != (MESSAGE_INDEX, channel, 6 + size) or end > len(raw):
            return offset
        if size >= DAMAGE_BYTES:
            entries = np.frombuffer(raw[at + INDEX_HEAD.size : end], INDEX_ENTRY)
            times_ns = entries["log_time"].copy()
            if times_ns.min() < head.start_ns or times_ns.max() > head.end_ns:
                return offset
    return -1


def _entries(
    raw: memoryview, place: ChunkPlace, channels: tuple[int, ...]
) -> NDArray[np.void] | None:
    """Read the message indexes of some channels; None if they are not what the summary says."""
    found = [np.empty(0, INDEX_ENTRY)]
    for channel in channels:
        at = place.indexes[channel] - place.start
        try:
            number, entries = parse_message_index(raw[at:] if at >= place.length else raw[:0])
        except DamagedRecordError:
            return None
        if number != channel:
            return None
        found.append(entries)
    return found[1] if len(found) == 2 else np.concatenate(found)


class Heads(NamedTuple):
    """What stands before messages, each (n_messages,).

    The columns are copies: arithmetic on numbers that are not aligned takes many times longer.
    """

    channels: NDArray[np.uint16]
    log_time_ns: NDArray[np.int64]
    lengths: NDArray[np.int64]

    def select(self, mask: NDArray[np.bool_]) -> Heads:
        """Return those of some of the messages."""
        return Heads(self.channels[mask], self.log_time_ns[mask], self.lengths[mask])


def message_heads(records: Bytes, offsets: Offsets) -> Heads | None:
    """Read the heads of the messages at these offsets; None unless there are such."""
    if not len(offsets):
        return None
    low, high = int(offsets.min()), int(offsets.max())
    if low < 0 or high > len(records) - MESSAGE_HEAD.itemsize:
        return None
    opaque = np.dtype((np.void, MESSAGE_HEAD.itemsize))
    heads = rows(records, offsets, opaque).view(MESSAGE_HEAD)
    lengths: NDArray[np.int64] = heads["length"].copy().view(np.int64) - MESSAGE_FIELDS_BYTES
    longest = len(records) - MESSAGE_HEAD.itemsize - offsets
    good = (heads["opcode"] == MESSAGE) & (lengths >= 0) & (lengths <= longest)
    if not good.all():
        return None
    return Heads(heads["channel"].copy(), heads["log_time"].copy(), lengths)


def batches_at(records: Bytes, offsets: Offsets, heads: Heads) -> Iterator[Timed]:
    """Copy the messages at these offsets, with the times at which they were recorded. [ns]"""
    for part, batch in side_by_side(records, offsets, MESSAGE_HEAD.itemsize, heads.lengths):
        yield heads.log_time_ns[part], batch


def _at_entries(
    records: Bytes, entries: NDArray[np.void], channels: tuple[int, ...]
) -> list[Timed] | None:
    """Copy the messages that an index names, in file order; None if it names anything else."""
    offsets: Offsets = entries["offset"].astype(np.int64)
    if not (offsets[1:] > offsets[:-1]).all():
        order = np.argsort(offsets)
        entries, offsets = entries[order], offsets[order]
        if not (offsets[1:] > offsets[:-1]).all():
            return None
    times_ns: NDArray[np.int64] = entries["log_time"].copy()
    batch = _of_one_length(records, offsets)
    if batch is not None:
        heads = np.ndarray(len(batch), MESSAGE_HEAD, batch.rows, 0, batch.rows.strides[:1])
        same_times = (heads["log_time"].copy() == times_ns).all()
        if int(heads["channel"][0]) in channels and same_times:
            return [(times_ns, batch)]
    whole = message_heads(records, offsets)
    if whole is None:
        return None if len(offsets) else []
    if np.isin(whole.channels, channels).all() and (whole.log_time_ns == times_ns).all():
        return list(batches_at(records, offsets, whole))
    return None


def _of_one_length(records: Bytes, offsets: Offsets) -> Batch | None:
    """Copy messages that all have the first one's length and channel, as nearly always; or None."""
    if not len(offsets) or not 0 <= offsets[0] <= len(records) - MESSAGE_HEAD.itemsize:
        return None
    first = int(offsets[0])
    opcode, length = RECORD.unpack_from(records.data, first)
    for other in (offsets[len(offsets) // 2], offsets[-1]):  # lengths that vary, vary everywhere
        if other > len(records) - RECORD.size or (
            RECORD.unpack_from(records.data, int(other)) != (opcode, length)
        ):
            return None
    width = -(-(RECORD.size + length) // 8) * 8
    if opcode != MESSAGE or length < MESSAGE_FIELDS_BYTES or offsets[-1] > len(records) - width:
        return None
    found = rows(records, offsets, np.dtype((np.void, width))).view(np.uint8).reshape(-1, width)
    # Opcode, length and channel are the first eleven bytes: two numbers of eight that overlap.
    for at in (0, 3):
        column = np.ndarray(len(found), np.uint64, found, at, (width,)).copy()
        if not (column == column[0]).all():
            return None
    lengths = np.full(len(found), length - MESSAGE_FIELDS_BYTES, np.int64)
    return Batch(found, MESSAGE_HEAD.itemsize, lengths)
