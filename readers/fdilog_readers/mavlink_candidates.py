"""Every place in a stretch of bytes that could be a MAVLink packet, and whether it is a whole one.

All places are tried at once: a byte that may begin a packet, a length that fits the message it
names, a checksum that is right.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import Bytes, Offsets, rows
from fdilog_readers.mavlink_dialect import (
    CHECKSUM_BYTES,
    HEADER_V1,
    HEADER_V2,
    LONGEST_PACKET,
    SIGNATURE_BYTES,
    SIGNED,
    UNKNOWN_ID,
    V1,
    V2,
    Dialect,
    checksums,
)

# Packets whose lengths differ by less are gathered and checked together.
LENGTH_CLASS_BYTES = 32


class Piece(NamedTuple):
    """A stretch of a file in memory.

    Parameters
    ----------
    bytes : (size + LONGEST_PACKET or more,)
        The stretch, and bytes after it that may be read but mean nothing.
    start
        Offset in the file of its first byte. [byte]
    size
        Bytes that mean something.
    last
        Whether the file ends with it.
    """

    bytes: Bytes
    start: int
    size: int
    last: bool

    @property
    def limit(self) -> int:
        """Where the bytes end that packets may have."""
        return self.size if self.last else len(self.bytes)

    @classmethod
    def of(cls, stretch: Bytes, start: int, *, last: bool) -> Piece:
        """Make a piece of a stretch; all but the file's last keep their end to be read ahead."""
        if last:
            padded = np.concatenate([stretch, np.zeros(LONGEST_PACKET, np.uint8)])
            return cls(padded, start, len(stretch), last)
        return cls(stretch, start, len(stretch) - LONGEST_PACKET, last)

    def items(self, kind: str) -> NDArray[Any]:
        """View the bytes as items of a type, one item beginning at every byte."""
        item = np.dtype(kind)
        return np.ndarray((len(self.bytes) - item.itemsize,), item, self.bytes, 0, (1,))


class Found(NamedTuple):
    """Packets, or what could be packets, in order: bytes of the piece, and what headers say.

    Parameters
    ----------
    start, payload, end : (n,)
        First byte, first byte of the payload, and first byte after each.
    length : (n,)
        Of the payload. [byte]
    row, sender : (n,)
        Message, as a row of the dialect; and system times 256 plus component.
    """

    start: Offsets
    payload: Offsets
    end: Offsets
    length: Offsets
    row: NDArray[np.int16]
    sender: NDArray[np.uint16]

    def and_also(self, others: Found) -> Found:
        """Merge others into these, in order."""
        if not len(others.start):
            return self
        start = np.concatenate([self.start, others.start])
        order = np.argsort(start, kind="stable")
        return Found(
            start[order],
            np.concatenate([self.payload, others.payload])[order],
            np.concatenate([self.end, others.end])[order],
            np.concatenate([self.length, others.length])[order],
            np.concatenate([self.row, others.row])[order],
            np.concatenate([self.sender, others.sender])[order],
        )

    def chosen(self, mask: NDArray[np.bool_]) -> Found:
        """Keep some of them."""
        if mask.all():
            return self
        return Found(
            self.start[mask],
            self.payload[mask],
            self.end[mask],
            self.length[mask],
            self.row[mask],
            self.sender[mask],
        )


def find_packets(piece: Piece, first: int, known: Dialect, longest: Offsets) -> Found:
    """Find all whole packets that begin from byte ``first`` of the piece on.

    Parameters
    ----------
    longest : (n_messages + 1,)
        The longest payload that is believed of MAVLink 2, by row of the dialect. [byte]
    """
    magic = (piece.bytes[: piece.size] - np.uint8(V2)) < V1 - V2 + 1  # either, in one comparison
    magic[:first] = False
    start = np.flatnonzero(magic)
    head = piece.items("<u8")[start]
    two = (head & (0xFF | (0xFF & ~SIGNED) << 16)) == V2
    one = (head & 0xFF) == V1
    found = _version_2(piece, start[two], head[two], known, longest)
    found = found.and_also(_version_1(piece, start[one], head[one], known))
    return found.chosen(_apart(found.start, found.end))


def _version_2(
    piece: Piece, start: Offsets, head: NDArray[np.uint64], known: Dialect, longest: Offsets
) -> Found:
    """Find whole packets of MAVLink 2; ``head`` holds the first eight bytes of each candidate."""
    ids = head >> 56 | piece.items("<u2")[start + 8].astype(np.uint64) << 8
    row = known.row[np.minimum(ids, UNKNOWN_ID).astype(np.intp)]
    length = (head >> 8 & 0xFF).astype(np.int64)
    payload = start + HEADER_V2
    end = payload + length + CHECKSUM_BYTES
    end += SIGNATURE_BYTES * (head >> 16 & SIGNED).astype(np.int64)
    sender = (head >> 40).astype(np.uint16).byteswap()
    found = Found(start, payload, end, length, row, sender)
    found = found.chosen((length <= longest[row]) & (end <= piece.limit))
    return found.chosen(_are_whole(piece, found, known))


def _version_1(piece: Piece, start: Offsets, head: NDArray[np.uint64], known: Dialect) -> Found:
    """Find whole packets of MAVLink 1; ``head`` holds the first eight bytes of each candidate."""
    row = known.row[(head >> 40 & 0xFF).astype(np.intp)]
    length = (head >> 8 & 0xFF).astype(np.int64)
    # MAVLink 1 does not shorten a payload; some senders add what only MAVLink 2 has.
    fits = (length == known.base[row]) | (length == known.size[row])
    payload = start + HEADER_V1
    end = payload + length + CHECKSUM_BYTES
    sender = (head >> 24).astype(np.uint16).byteswap()
    found = Found(start, payload, end, length, row, sender).chosen(fits & (end <= piece.limit))
    return found.chosen(_are_whole(piece, found, known))


def _are_whole(piece: Piece, found: Found, known: Dialect) -> NDArray[np.bool_]:
    """Whether each candidate ends in the checksum of its bytes."""
    after_magic = found.start + 1
    covered = found.payload + found.length - after_magic
    order = np.argsort((LONGEST_PACKET - covered).astype(np.uint16), kind="stable")
    covered, after_magic, row = covered[order], after_magic[order], found.row[order]
    edges = np.flatnonzero(np.diff(covered // LENGTH_CLASS_BYTES)) + 1
    bounds = [0, *edges.tolist(), len(order)]
    right = np.empty(len(order), bool)
    for low, high in pairwise(bounds if len(order) else []):
        some = slice(low, high)
        width = np.dtype((np.uint8, int(covered[low])))
        gathered = rows(piece.bytes, after_magic[some], width)
        logged = piece.items("<u2")[after_magic[some] + covered[some]]
        right[order[some]] = checksums(gathered, covered[some], known.extra[row[some]]) == logged
    return right


def _apart(start: Offsets, end: Offsets) -> NDArray[np.bool_]:
    """Leave out what begins inside a packet before it: a packet may carry another."""
    apart = np.ones(len(start), bool)
    for k in np.flatnonzero(start[1:] < np.maximum.accumulate(end)[:-1]) + 1:
        before = k - 1
        while not apart[before]:
            before -= 1
        apart[k] = start[k] >= end[before]
    return apart
