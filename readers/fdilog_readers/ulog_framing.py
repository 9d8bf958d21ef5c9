"""Where the records of a ULog are, and which of its bytes are none.

A record is its length, its type, and its body; there is no checksum. Data records give themselves
away by more than that: the length must be that of the topic to which their message id subscribes.
All places where that holds are found at once, and the chain of those that lie end to end is
followed; the few records of other types, and damage, are looked at one by one. A data record counts
if a record begins where it ends: where damage begins inside it, nothing believable follows.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem
from fdilog_readers.columns import Blocks, Bytes, Offsets
from fdilog_readers.losses import Losses
from fdilog_readers.ulog_definitions import ID_BYTES, Definitions, is_plausible
from fdilog_readers.ulog_layout import FILE_HEADER_BYTES, HEADER_BYTES, MAGIC
from fdilog_readers.ulog_piece import (
    DATA,
    FEWEST_FILL,
    FILL,
    FLAGS,
    LOOK_AHEAD,
    OTHERS,
    Piece,
)

NO_RECORD = "bytes that belong to no record"


@dataclass
class Batch:
    """Data records in file order; the buffer is valid until the next batch.

    Parameters
    ----------
    start
        Offset in the file of the buffer's first byte. [byte]
    offsets : (n_records,)
        Of the records, in the buffer. [byte]
    ids : (n_records,)
        Message id of each record.
    """

    buffer: Bytes
    start: int
    offsets: Offsets
    ids: NDArray[np.intp]


@dataclass
class _Lost:
    """A stretch of bytes that is no record, whose end is still looked for.

    Parameters
    ----------
    record_bytes
        Length of the record that its first bytes announce, or 0 where they announce none. [byte]
    fill, fill_start
        The last byte seen, and where the run of such bytes begins that ends with it.
    """

    start: int
    what: str
    record_bytes: int = 0
    fill: int = -1
    fill_start: int = 0

    def watch(self, buffer: Bytes, base: int) -> None:
        """Keep track of the run of one byte value that the file may end with."""
        first = max(self.start - base, 0)
        if first >= len(buffer):
            return
        last = int(buffer[-1])
        others = np.flatnonzero(buffer[first:] != last)
        if len(others):
            self.fill_start = base + first + int(others[-1]) + 1
        elif last != self.fill:
            self.fill_start = base + first
        self.fill = last


class Framing:
    """One pass over a log.

    Attributes
    ----------
    known
        What the records other than data have said; complete once the batches are through.
    """

    def __init__(self, blocks: Blocks) -> None:
        self.known = Definitions()
        self._blocks = blocks
        self._losses = Losses()
        self._notes: list[Problem] = []
        self._lost: _Lost | None = None
        self._appended: list[int] = []
        self._begun = False

    @property
    def problems(self) -> list[Problem]:
        """What was lost, then what is worth knowing; complete once the batches are through."""
        return [*self._losses.problems(), *self._notes]

    def batches(self) -> Iterator[Batch]:
        """Walk through the file, once."""
        done = 0
        while True:
            buffer = self._blocks.advance(done)
            border = next((o - self._blocks.start for o in self._appended), None)
            if border is not None and border <= len(buffer):
                done = yield from self._block(buffer[:border], at_end=True)
                if done == border:
                    self._close(self._blocks.start + border)
                    self._appended.pop(0)
            else:
                done = yield from self._block(buffer, at_end=self._blocks.at_end)
                if self._blocks.at_end and done == len(buffer):
                    break
        self._close(self._blocks.end)
        if self._blocks.failure is not None:
            what = f"the file could not be read beyond this byte: {self._blocks.failure}"
            self._losses.add(self._blocks.end, max(self._blocks.end, self._blocks.size), what)

    def _block(self, buffer: Bytes, *, at_end: bool) -> Generator[Batch, None, int]:
        """Walk through one block; return how many of its bytes are done with."""
        piece = Piece(buffer, self.known, at_end=at_end)
        base, at = self._blocks.start, 0
        if not self._begun:
            at, self._begun = self._begin(piece), True
        offsets: list[Offsets] = []
        ids: list[NDArray[np.intp]] = []
        going = True
        while going:
            if self._lost is not None:
                restart = piece.restart(self._lost.start - base)
                if restart is None:
                    self._lost.watch(buffer, base)
                    at = len(buffer) if at_end else max(at, len(buffer) - LOOK_AHEAD)
                    break
                self._losses.add(max(self._lost.start, 0), base + restart, self._lost.what)
                self._lost, at = None, restart
            if buffer[at + HEADER_BYTES - 1 : at + HEADER_BYTES].tolist() == [DATA]:
                piece.link()
            records, end = piece.chain.follow(at)
            at, going, sure = self._step(piece, end)
            if not sure and len(records) and not piece.ends_surely(at):
                at, records = int(piece.chain.starts[records[-1]]), records[:-1]
                if self._lost is not None:
                    self._lost = self._damaged(piece, at)
            offsets.append(piece.chain.starts[records])
            ids.append(piece.ids[records])
        if offsets:
            yield Batch(buffer, base, np.concatenate(offsets), np.concatenate(ids))
        return at

    def _begin(self, piece: Piece) -> int:
        """Find the file's header; without one, records are looked for from the first byte on."""
        at = piece.buffer.tobytes().find(MAGIC)
        if at < 0:
            self._lost = _Lost(-1, "no file header, and bytes that belong to no record")
            return 0
        if at > 0:
            self._losses.add(0, at, "bytes before the file header")
        return min(at + FILE_HEADER_BYTES, len(piece.buffer))

    def _step(self, piece: Piece, at: int) -> tuple[int, bool, bool]:
        """Deal with what is no data record of a known topic, and set ``_lost`` if it is nothing.

        Returns where to go on, whether to go on in this piece, and whether a record ended before
        it for sure.
        """
        base, size = self._blocks.start, len(piece.buffer)
        if not piece.at_end and size - at < LOOK_AHEAD:
            return at, False, False
        if size - at < HEADER_BYTES + ID_BYTES:
            if size > at:
                self._cut_short(base + at, size - at)
            return size, False, True
        kind, end, message_id = piece.header(at)
        described = kind == DATA and self.known.most[message_id] > 0
        if end > size and piece.begins(at):
            self._lost = _Lost(base + at, NO_RECORD, end - at)  # unless something follows it: cut
            return at, True, True
        if end <= size and described and piece.begins(end) and not piece.holds_data(at, end):
            self._losses.add(
                base + at, base + end, "a data record longer or shorter than its topic"
            )
            return end, True, True
        if end <= size and not described and piece.begins(at):
            return self._take(piece, at)
        self._lost = _Lost(base + at, NO_RECORD)
        return at, True, False

    def _take(self, piece: Piece, at: int) -> tuple[int, bool, bool]:
        """Take a record that is believed."""
        kind, end, message_id = piece.header(at)
        if kind == DATA:
            self.known.learn(message_id, end - at - HEADER_BYTES)
            return at, True, True
        offset, body = self._blocks.start + at, piece.body(at, end)
        readable = kind in OTHERS and is_plausible(chr(kind), body)
        if not readable and (kind in OTHERS or self.known.fits(message_id, len(body))):
            what = f"a record of type {chr(kind)} that cannot be read"
            self._losses.add(offset, self._blocks.start + end, what)
            return end, True, True
        self.known.take(chr(kind), offset, body)
        if kind == FLAGS and self.known.appended:
            inside = range(self._blocks.start + end + 1, self._blocks.size)
            self._appended = [place for place in self.known.appended if place in inside]
            return end, not self._appended, True
        return end, True, True

    def _damaged(self, piece: Piece, at: int) -> _Lost:
        """Make a loss that begins with a data record whose end nothing confirms."""
        _, end, message_id = piece.header(at)
        name = self.known.topics[message_id].name or "data"
        what = f"a damaged or cut record, {name}, and what follows it"
        return _Lost(self._blocks.start + at, what, end - at)

    def _cut_short(self, offset: int, length: int) -> None:
        what = "the last record is incomplete: recording stopped there"
        if self._appended:
            what = "a record is incomplete: other data was appended there"
        self._notes.append(Problem(what=what, offset=offset, bytes_lost=length, note=True))

    def _close(self, end: int) -> None:
        """Say what the bytes are that were lost up to where records end."""
        lost, self._lost = self._lost, None
        if lost is None:
            return
        start, run = max(lost.start, 0), end - lost.fill_start
        padded = lost.fill in FILL and (run >= FEWEST_FILL or lost.fill_start == start)
        body_end = lost.fill_start if padded else end
        if lost.record_bytes > body_end - start:
            self._cut_short(start, body_end - start)
        elif body_end > start:
            self._losses.add(start, body_end, lost.what)
        if padded:
            what = f"padding after the last record: {run} bytes 0x{lost.fill:02X}"
            self._notes.append(Problem(what=what, offset=body_end, bytes_lost=run, note=True))
