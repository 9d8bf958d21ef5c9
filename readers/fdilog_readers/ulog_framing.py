"""Where the records of a ULog are, and which of its bytes are none.

A record is its length, its type, and its body; there is no checksum. Data records give themselves
away by more than that: the length must be that of the topic to which their message id subscribes.
All places where that holds are found at once, and the chain of those that lie end to end is
followed; the few records of other types, and damage, are looked at one by one. A data record counts
if a record begins where it ends: where damage begins inside it, nothing believable follows.
"""

from __future__ import annotations

import bisect
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem
from fdilog_readers.columns import Blocks, Bytes, Chain, Offsets
from fdilog_readers.losses import Losses
from fdilog_readers.ulog_definitions import ID_BYTES, Definitions, is_plausible, may_begin
from fdilog_readers.ulog_layout import FILE_HEADER_BYTES, HEADER_BYTES, MAGIC, MOST_BYTES

DATA, FLAGS = ord("D"), ord("B")
OTHERS = b"FIMPQALCSORB"
# A record, and enough of what follows it to believe it.
LOOK_AHEAD = HEADER_BYTES + MOST_BYTES + HEADER_BYTES + ID_BYTES
# So many records that nothing describes may follow one another before one that is believed.
MOST_UNDESCRIBED = 30
NO_RECORD = "bytes that belong to no record"
FILL = (0x00, 0xFF)
FEWEST_FILL = 16


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


class _Piece:
    """A block, with every place in it that could be a data record.

    Parameters
    ----------
    at_end
        Whether records end with it, because the file does or because data was appended there.
    """

    def __init__(self, buffer: Bytes, known: Definitions, *, at_end: bool) -> None:
        self.buffer = buffer
        self.known = known
        self.at_end = at_end
        self._words = np.ndarray((max(len(buffer) - 1, 0),), "<u2", buffer, 0, (1,))
        self._places = np.flatnonzero(
            buffer[HEADER_BYTES - 1 : max(len(buffer) - ID_BYTES, 0)] == DATA
        )
        self._sizes = self._words[self._places]
        self._ids = self._words[self._places + HEADER_BYTES].astype(np.intp)
        self._others: list[int] | None = None
        self._revision = -1
        self.link()

    def link(self) -> None:
        """Find the data records among the places, where more topics are known than before."""
        known = self.known
        if known.revision == self._revision:
            return
        self._revision = known.revision
        fits = self._sizes >= known.least[self._ids]
        fits &= self._sizes <= known.most[self._ids]
        starts, sizes, self.ids = self._places[fits], self._sizes[fits], self._ids[fits]
        ends = starts + HEADER_BYTES + sizes
        whole = int(np.searchsorted(starts, len(self.buffer) - LOOK_AHEAD))
        if (ends[whole:] > len(self.buffer)).any():
            inside = ends <= len(self.buffer)
            starts, ends, self.ids = starts[inside], ends[inside], self.ids[inside]
        self.chain = Chain(starts, ends)

    def header(self, at: int) -> tuple[int, int, int]:
        """Type, end, and message id of the record that begins at a place."""
        head = self.buffer[at : at + HEADER_BYTES + ID_BYTES].tobytes()
        size, message_id = int.from_bytes(head[:2], "little"), int.from_bytes(head[3:], "little")
        return head[2], at + HEADER_BYTES + size, message_id

    def body(self, at: int, end: int) -> bytes:
        """Body of a record."""
        return self.buffer[at + HEADER_BYTES : end].tobytes()

    def begins(self, at: int, undescribed: int = MOST_UNDESCRIBED) -> bool:
        """Tell whether a record can be believed to begin at a place, or the log to end there.

        Parameters
        ----------
        undescribed
            How many records may follow one another of which nothing but their length is known.
        """
        left = len(self.buffer) - at
        if left < HEADER_BYTES + ID_BYTES:
            return self.at_end
        kind, end, message_id = self.header(at)
        size = end - at - HEADER_BYTES
        if kind == DATA and self.known.most[message_id]:
            return self.known.fits(message_id, size)
        if end > len(self.buffer):
            return self.at_end and may_begin(chr(kind), size, self.body(at, end))
        if self.holds_data(at, end) or (kind == FLAGS and self.known.counts):
            return False  # flags stand at the beginning or nowhere
        if kind in OTHERS and is_plausible(chr(kind), self.body(at, end)):
            return True
        named = size > 0 and chr(kind).isalpha() and kind < 128
        return named and undescribed > 0 and self.begins(end, undescribed - 1)

    def holds_data(self, start: int, end: int) -> bool:
        """Tell whether a data record begins inside a stretch: then that is no record itself."""
        first, last = np.searchsorted(self.chain.starts, [start + 1, end])
        return bool(last > first)

    def restart(self, after: int) -> int | None:
        """Return the first place behind ``after`` where a record begins that can be believed."""
        # Near the end of a block a longer record might be found first once its end is there.
        limit = len(self.buffer) - (0 if self.at_end else LOOK_AHEAD)
        self.link()
        starts, ends = self.chain.starts, self.chain.ends
        data = None
        for index in range(int(np.searchsorted(starts, after, "right")), len(starts)):
            if starts[index] >= limit:
                break
            if self.begins(int(ends[index])):
                limit = data = int(starts[index])
                break
        if self._others is None:
            self._others = self._find_others()
        for at in self._others[bisect.bisect_right(self._others, after) :]:
            if at >= limit:
                break
            if self.begins(at, 0) and self.begins(self.header(at)[1]):
                return at
        return data

    def _find_others(self) -> list[int]:
        """List the places that look like whole records of other types, one after them included."""
        known = np.zeros(256, bool)
        known[list(OTHERS)] = True
        places = np.flatnonzero(known[self.buffer[HEADER_BYTES - 1 : -1]])
        ends = places + HEADER_BYTES + self._words[places]
        whole = ends <= len(self.buffer)
        places, ends = places[whole], ends[whole]
        known[DATA] = True
        following = np.minimum(ends + HEADER_BYTES - 1, len(self.buffer) - 1)
        near_end = ends + HEADER_BYTES > len(self.buffer)
        found: list[int] = places[near_end | known[self.buffer[following]]].tolist()
        return found

    def ends_surely(self, at: int) -> bool:
        """Tell whether fill bytes at a place say that the record before them ended there."""
        fill = self.buffer[at : at + FEWEST_FILL]
        if len(fill) < FEWEST_FILL or fill[0] not in FILL or (fill != fill[0]).any():
            return False
        return bool(self.buffer[at - 1] != fill[0])


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
        piece = _Piece(buffer, self.known, at_end=at_end)
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

    def _begin(self, piece: _Piece) -> int:
        """Find the file's header; without one, records are looked for from the first byte on."""
        at = piece.buffer.tobytes().find(MAGIC)
        if at < 0:
            self._lost = _Lost(-1, "no file header, and bytes that belong to no record")
            return 0
        if at > 0:
            self._losses.add(0, at, "bytes before the file header")
        return min(at + FILE_HEADER_BYTES, len(piece.buffer))

    def _step(self, piece: _Piece, at: int) -> tuple[int, bool, bool]:
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

    def _take(self, piece: _Piece, at: int) -> tuple[int, bool, bool]:
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

    def _damaged(self, piece: _Piece, at: int) -> _Lost:
        """Make a loss that begins with a data record whose end nothing confirms."""
        _, end, message_id = piece.header(at)
        name = self.known.topics[message_id].name or "data"
        what = f"a {name} record that is damaged or cut, and what follows it"
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
