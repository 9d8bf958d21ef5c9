"""Framing of MAVLink: all whole packets of a file, and an account of every byte between them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem
from fdilog_readers.columns import Blocks, Bytes, Offsets, rows
from fdilog_readers.losses import Losses
from fdilog_readers.mavlink_candidates import Found, Piece, find_packets
from fdilog_readers.mavlink_dialect import (
    CHECKSUM_BYTES,
    HEADER_V1,
    HEADER_V2,
    SIGNATURE_BYTES,
    SIGNED,
    V1,
    V2,
    checksum,
    dialect,
)

STAMP_BYTES = 8
# A block and what is computed from it fit the processor's second-level cache.
BLOCK_BYTES = 1 << 20
NO_STAMP = -1
# Stamps beyond 146 years overflow what nanoseconds of 64 bits and their differences can hold.
LATEST_US = 2**62 // 1000
MAGICS = (V1, V2)


@dataclass(frozen=True, eq=False)
class Packets:
    """Packets of one message, in file order.

    Parameters
    ----------
    offset : (n,)
        Byte of each packet's magic.
    sender : (n,)
        System times 256 plus component.
    stamp_us : (n,)
        The receive stamp before the packet, or `NO_STAMP`. [us]
    payload : (n, size)
        The payload, filled up with the zeros that the sender left out.
    """

    offset: Offsets
    sender: NDArray[np.uint16]
    stamp_us: Offsets
    payload: Bytes


@dataclass(frozen=True, eq=False)
class PacketLog:
    """What framing found in a file.

    Parameters
    ----------
    stamped
        Whether each packet has the receive stamp of a tlog before it.
    counts
        Packets by sender (system times 256 plus component) and message id.
    wanted
        The packets of the messages asked for, by id.
    """

    bytes: int
    stamped: bool
    counts: dict[tuple[int, int], int]
    wanted: dict[int, Packets]
    problems: list[Problem]


def read_packets(path: Path, wanted: Collection[int]) -> PacketLog:
    """Find every packet of a file and keep those of the wanted message ids.

    Raises
    ------
    UnreadableLogError
        If there is no packet in it.
    """
    framing = _Framing(wanted)
    with Blocks(path, BLOCK_BYTES) as blocks:
        stretch = blocks.advance(0)
        framing.take(Piece.of(stretch, 0, last=blocks.at_end))
        while not blocks.at_end:
            # The stamp of a packet that comes next must stay in reach.
            stretch = blocks.advance(max(framing.position - STAMP_BYTES - blocks.start, 0))
            framing.take(Piece.of(stretch, blocks.start, last=blocks.at_end))
        if not framing.counts:
            why = "no whole MAVLink packet in it" if blocks.size else "the file is empty"
            raise UnreadableLogError(f"{path}: {why} ({blocks.size} bytes)")
        return framing.finish(blocks)


class _Header(NamedTuple):
    """The header of one packet that was not among the whole ones."""

    end: int
    header: int
    row: int
    message: int
    sender: int


class _Framing:
    """What framing carries from one piece of the file to the next."""

    def __init__(self, wanted: Collection[int]) -> None:
        self.known = dialect()
        self.position = 0  # what lies before it is accounted for, or part of the open loss
        self.loss: int | None = None  # where a loss began that has not ended yet
        self.stamped: bool | None = None
        self.counts: Counter[tuple[int, int]] = Counter()
        self.unknown: Counter[tuple[int, int]] = Counter()
        self.losses: list[tuple[int, int, str]] = []
        self.notes: list[Problem] = []
        self.wanted = {self.known.row_of(message): message for message in wanted}
        self.wanted.pop(0, None)
        self.parts: dict[int, list[Packets]] = {row: [] for row in self.wanted}
        # A newer sender may have added fields to a message.
        self.longest = self.known.size.copy()
        self.longest[list(self.wanted)] = 255

    @property
    def before(self) -> int:
        """Bytes that belong to a packet before its magic."""
        return STAMP_BYTES if self.stamped else 0

    def take(self, piece: Piece) -> None:
        """Find the packets of one piece, and account for every byte between them."""
        first = self.position - piece.start
        found = find_packets(piece, first, self.known, self.longest)
        gap = found.start - np.concatenate([[first], found.end])[:-1]
        if self.stamped is None and len(gap):
            self.stamped = bool((gap >= STAMP_BYTES).sum() >= (gap < STAMP_BYTES).sum())
        for k in np.flatnonzero(gap != self.before):
            self._gap(piece, int(found.start[k] - gap[k]), int(found.start[k]))
        self._count(found)
        self._keep(piece, found, gap)
        at = int(found.end[-1]) if len(gap) else first
        if piece.last:
            self._finish_piece(piece, at)
        else:
            self._leave_piece(piece, at)

    def _gap(self, piece: Piece, at: int, start: int) -> None:
        """Account for the bytes from ``at`` to the stamp of the packet at ``start``."""
        until = start - self.before if start - self.before >= at else start
        if self.loss is None:
            at = self._walk(piece, at, until)
            if at == until:
                return
            self.loss = piece.start + at
        self._lose(self.loss, piece.start + until, "bytes that belong to no packet")
        self.loss = None

    def _leave_piece(self, piece: Piece, at: int) -> None:
        """Account for what follows the last packet, and leave the rest to the next piece."""
        if self.loss is None:
            at = self._walk(piece, at)
            if at + self.before < piece.size:
                self.loss = piece.start + at
        self.position = piece.start + (at if self.loss is None else piece.size)

    def _finish_piece(self, piece: Piece, at: int) -> None:
        """Account for what follows the file's last packet."""
        self.position = piece.start + piece.size
        if self.loss is None:
            at = self._walk(piece, at, piece.size)
            if at == piece.size:
                return
            header = self._header(piece, at + self.before)
            cut = at + self.before + HEADER_V2 > piece.size
            if cut or (header is not None and header.end > piece.size):
                what = "the last packet is incomplete: recording stopped there"
                lost = piece.size - at
                self.notes.append(
                    Problem(what=what, offset=piece.start + at, bytes_lost=lost, note=True)
                )
                return
            self.loss = piece.start + at
        self._lose(self.loss, self.position, "bytes that belong to no packet")

    def _walk(self, piece: Piece, at: int, until: int | None = None) -> int:
        """Go from packet to packet by their lengths, over those that are unknown or not whole.

        Returns where that fails, or ``until``; or, without it, the first byte that belongs to the
        next piece.
        """
        end = piece.size if until is None else until
        while at + self.before < end:
            header = self._header(piece, at + self.before)
            if header is None or (until is not None and header.end > until):
                break
            following = header.end + self.before
            goes_on = header.end == until or following >= piece.size
            if not goes_on and piece.bytes[following] not in MAGICS:
                break
            if header.row == 0:
                self.unknown[header.sender, header.message] += 1
            elif self._is_whole(piece, at + self.before, header):
                self.counts[header.sender, header.message] += 1
            else:
                self._lose(
                    piece.start + at, piece.start + header.end, "a packet with a wrong checksum"
                )
            at = header.end
        return at

    def _header(self, piece: Piece, start: int) -> _Header | None:
        """Read one header; the packet may reach beyond the piece."""
        head = piece.bytes[start : min(start + HEADER_V2, piece.bytes.size)].tobytes()
        if len(head) < HEADER_V2:
            return None
        if head[0] == V1:
            end = start + HEADER_V1 + head[1] + CHECKSUM_BYTES
            row = self.known.row_of(head[5])
            return _Header(end, HEADER_V1, row, head[5], int.from_bytes(head[3:5], "big"))
        if head[0] != V2 or head[2] > SIGNED:
            return None
        end = start + HEADER_V2 + head[1] + CHECKSUM_BYTES + SIGNATURE_BYTES * head[2]
        message = int.from_bytes(head[7:10], "little")
        row = self.known.row_of(message)
        return _Header(end, HEADER_V2, row, message, int.from_bytes(head[5:7], "big"))

    def _is_whole(self, piece: Piece, start: int, header: _Header) -> bool:
        """Whether a packet of a known message, longer than that should be, has its checksum."""
        end = start + header.header + int(piece.bytes[start + 1])
        covered, logged = piece.bytes[start + 1 : end], piece.bytes[end : end + CHECKSUM_BYTES]
        right = checksum(covered.tobytes(), int(self.known.extra[header.row]))
        return right == int.from_bytes(logged.tobytes(), "little")

    def _lose(self, start: int, end: int, what: str) -> None:
        """Note bytes that hold no whole packet; neighbours of one kind are one loss."""
        if self.losses and self.losses[-1][1] == start and self.losses[-1][2] == what:
            start = self.losses.pop()[0]
        self.losses.append((start, end, what))

    def _count(self, found: Found) -> None:
        """Count packets by sender and message."""
        senders = np.flatnonzero(np.bincount(found.sender, minlength=1))
        number = np.zeros(1 << 16, np.int64)
        number[senders] = np.arange(len(senders))
        n_rows = len(self.known.ids)
        cells = np.bincount(number[found.sender] * n_rows + found.row)
        for cell in np.flatnonzero(cells).tolist():
            sender, message = int(senders[cell // n_rows]), int(self.known.ids[cell % n_rows])
            self.counts[sender, message] += int(cells[cell])

    def _keep(self, piece: Piece, found: Found, gap: Offsets) -> None:
        """Put the wanted packets aside."""
        for row, parts in self.parts.items():
            mine = np.flatnonzero(found.row == row)
            if not len(mine):
                continue
            start, length = found.start[mine], found.length[mine]
            stamp_us = np.full(len(mine), NO_STAMP)
            if self.stamped:
                has = np.flatnonzero(gap[mine] >= STAMP_BYTES)
                stamp = piece.items(">u8")[start[has] - STAMP_BYTES]
                stamp_us[has] = np.where(stamp < LATEST_US, stamp, NO_STAMP).astype(np.int64)
            size = int(self.known.size[row])
            payload = rows(piece.bytes, found.payload[mine], np.dtype((np.uint8, size)))
            for k in range(int(length.min()), size):
                payload[:, k] *= length > k  # what follows is not the payload's
            parts.append(Packets(piece.start + start, found.sender[mine], stamp_us, payload))

    def finish(self, blocks: Blocks) -> PacketLog:
        """Put together what all pieces gave."""
        wanted = {
            self.wanted[row]: Packets(
                *(
                    np.concatenate([getattr(part, name) for part in parts])
                    for name in ("offset", "sender", "stamp_us", "payload")
                )
            )
            for row, parts in self.parts.items()
            if parts
        }
        return PacketLog(
            bytes=blocks.size,
            stamped=bool(self.stamped),
            counts=dict(self.counts + self.unknown),
            wanted=wanted,
            problems=[*self._problems(blocks)],
        )

    def _problems(self, blocks: Blocks) -> Iterator[Problem]:
        """Say what was lost, and what could not be checked."""
        losses = Losses()
        for loss in self.losses:
            losses.add(*loss)
        if blocks.failure is not None:
            what = f"the file could not be read beyond this byte: {blocks.failure}"
            losses.add(blocks.end, max(blocks.end, blocks.size), what)
        yield from losses.problems()
        yield from self.notes
        if self.unknown:
            ids = ", ".join(map(str, sorted({message for _, message in self.unknown})))
            what = f"{self.unknown.total()} packets of messages that are not known (id {ids})"
            yield Problem(what=f"{what}: their checksums could not be checked", note=True)
