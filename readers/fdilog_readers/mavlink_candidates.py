"""Every place in a stretch of bytes that could be a MAVLink packet, and whether it is a whole one.

All places are tried at once: a byte that may begin a packet, a length that fits the message it
names, a checksum that is right.
"""

from __future__ import annotations

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
LENGTH_CLASS_BYTES = 16


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


class Candidates(NamedTuple):
    """Where packets could be, in order: bytes of the piece, and what their headers say."""

    start: Offsets
    header: Offsets
    length: Offsets
    end: Offsets
    row: NDArray[np.int16]
    sender: NDArray[np.uint16]

    def and_also(self, others: Candidates) -> Candidates:
        """Merge others into these, in order."""
        columns = [np.concatenate([mine, other]) for mine, other in zip(self, others, strict=True)]
        order = np.argsort(columns[0], kind="stable")
        return Candidates(*(column[order] for column in columns))

    def chosen(self, index: NDArray[Any]) -> Candidates:
        """Keep some of them, by a mask or by their numbers."""
        if index.dtype == bool and index.all():
            return self
        return Candidates(*(column[index] for column in self))


def candidates(piece: Piece, first: int, known: Dialect, longest: Offsets) -> Candidates:
    """Find all that could be a known packet, beginning from byte ``first`` of the piece on.

    Parameters
    ----------
    longest : (n_messages + 1,)
        The longest payload that is believed, by row of the dialect. [byte]
    """
    magic = (piece.bytes[: piece.size] - np.uint8(V2)) < V1 - V2 + 1  # either, in one comparison
    magic[:first] = False
    start = np.flatnonzero(magic)
    head = piece.items("<u8")[start]
    two = np.flatnonzero((head & (0xFF | (0xFF & ~SIGNED) << 16)) == V2)
    one = np.flatnonzero((head & 0xFF) == V1)
    id_two = head[two] >> 56 | piece.items("<u2")[start[two] + 8].astype(np.uint64) << 8
    id_one = head[one] >> 40 & 0xFF
    row_two = known.row[np.minimum(id_two, UNKNOWN_ID).astype(np.intp)]
    row_one = known.row[id_one.astype(np.intp)]
    length_two, length_one = (head[two] >> 8 & 0xFF, head[one] >> 8 & 0xFF)
    # MAVLink 1 does not shorten a payload; some senders add what only MAVLink 2 has.
    fits_one = (length_one == known.base[row_one]) | (length_one == known.size[row_one])
    fits_two = length_two <= longest[row_two]
    found = _read(start[two][fits_two], head[two][fits_two], row_two[fits_two], HEADER_V2)
    if fits_one.any():
        version_1 = _read(start[one][fits_one], head[one][fits_one], row_one[fits_one], HEADER_V1)
        found = found.and_also(version_1)
    return found.chosen(found.end <= piece.size) if piece.last else found


def _read(
    start: Offsets, head: NDArray[np.uint64], row: NDArray[np.int16], header: int
) -> Candidates:
    """Read headers of one version; ``head`` holds the first eight bytes of each packet."""
    length = (head >> 8 & 0xFF).astype(np.int64)
    end = start + (header + CHECKSUM_BYTES) + length
    if header == HEADER_V2:
        end += SIGNATURE_BYTES * (head >> 16 & SIGNED).astype(np.int64)
    # System and component are bytes 5 and 6, or 3 and 4.
    sender = (head >> (40 if header == HEADER_V2 else 24)).astype(np.uint16).byteswap()
    return Candidates(start, np.full(len(start), header), length, end, row, sender)


def whole(piece: Piece, found: Candidates, known: Dialect) -> NDArray[np.bool_]:
    """Whether each candidate ends in the checksum of its bytes."""
    covered = found.header - 1 + found.length
    order = np.argsort((LONGEST_PACKET - covered).astype(np.uint16), kind="stable")
    covered = covered[order]
    edges = np.flatnonzero(np.diff(covered // LENGTH_CLASS_BYTES)) + 1
    right = np.empty(len(order), bool)
    for some, lengths in zip(np.split(order, edges), np.split(covered, edges), strict=True):
        if not len(some):
            continue
        width = np.dtype((np.uint8, int(lengths[0])))
        after_magic = found.start[some] + 1
        gathered = rows(piece.bytes, after_magic, width)
        logged = piece.items("<u2")[after_magic + lengths]
        right[some] = checksums(gathered, lengths, known.extra[found.row[some]]) == logged
    return right
