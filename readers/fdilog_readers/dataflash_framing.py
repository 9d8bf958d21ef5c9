"""Where the records of a DataFlash log are, and which of its bytes are none.

The format has no checksum and no length in a record; only that each record ends where the next one
begins. So a record counts if it is reached from the one before it and if its end is confirmed: by
the next header (whole or with one byte of it spoiled), by the end of the file, or by the start of a
run of fill bytes that is not also its own last byte. Where damage begins inside a record nothing of
this holds, and the record is lost together with what follows, up to the next place from which the
chain goes on.
"""

from __future__ import annotations

import bisect
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem
from fdilog_readers.columns import Blocks, Bytes, Chain, Offsets
from fdilog_readers.dataflash_layout import (
    FMT,
    FMT_LENGTH,
    FMT_TYPE,
    HEADER,
    MAGIC,
    BadFormatError,
    Layout,
    is_fmt,
    parse_fmt,
)
from fdilog_readers.losses import Losses

MAGIC_0, MAGIC_1 = 0xA3, 0x95
# A length is one byte, and the header after it is looked at as well.
LOOK_AHEAD = 255 + FMT_LENGTH
# Erased flash reads FF, which a log of a flash chip keeps in its last page; a file system that was
# cut off leaves zeros. Neither was ever written as a record.
FILL = (0x00, 0xFF)
FEWEST_FILL = 16


@dataclass
class Batch:
    """Records under one set of layouts; the buffer is valid until the next batch.

    Parameters
    ----------
    start
        Offset in the file of the buffer's first byte. [byte]
    offsets : (n_records,)
        Of the records, in the buffer. [byte]
    types : (n_records,)
        Of the records.
    layouts
        Of all types known here.
    """

    buffer: Bytes
    start: int
    offsets: Offsets
    types: NDArray[np.uint8]
    layouts: dict[int, Layout]


class _Piece:
    """A block with every place in it that looks like the header of a record."""

    def __init__(self, buffer: Bytes, lengths: NDArray[np.int64], at_end: bool) -> None:
        self.buffer = buffer
        self.at_end = at_end
        places = np.flatnonzero(buffer[:-2] == MAGIC_0)
        self._places = places[buffer[places + 1] == MAGIC_1]
        self._place_types = buffer[self._places + 2]
        self.link(lengths)

    def link(self, lengths: NDArray[np.int64]) -> None:
        """Find the end of every candidate; to be done again when a length changes."""
        ends = self._places + lengths[self._place_types]
        whole = (ends > self._places) & (ends <= len(self.buffer))
        self.chain = Chain(self._places[whole], ends[whole])
        self.types = self._place_types[whole]
        self._restarts: list[int] | None = None

    def header(self, at: int) -> int | None:
        """Return the type number of the header at a place, or None where there is none."""
        head = self.buffer[at : at + HEADER].tolist()
        return head[2] if head[:2] == [MAGIC_0, MAGIC_1] and len(head) == HEADER else None

    def restart(self, after: int) -> int | None:
        """Return the first place behind ``after`` where a record begins that can be believed."""
        if self._restarts is None:
            self._restarts = self.chain.starts[self._believable()].tolist()
        index = bisect.bisect_right(self._restarts, after)
        return self._restarts[index] if index < len(self._restarts) else None

    def _believable(self) -> NDArray[np.bool_]:
        """Tell which candidates are followed by a header, end the file, or must be FMT."""
        buffer, ends = self.buffer, self.chain.ends
        inside = ends + HEADER <= len(buffer)
        next_ = np.where(inside, ends, 0)
        followed: NDArray[np.bool_] = (
            inside & (buffer[next_] == MAGIC_0) & (buffer[next_ + 1] == MAGIC_1)
        )
        if self.at_end:
            followed |= ends == len(buffer)
        for index in np.flatnonzero((self.types == FMT_TYPE) & ~followed):
            start = int(self.chain.starts[index])
            followed[index] = is_fmt(buffer[start : start + FMT_LENGTH].tobytes())
        return followed

    def ends_surely(self, at: int) -> bool:
        """Tell whether the bytes at ``at`` say that the record before them ended there."""
        following = self.buffer[at : at + FEWEST_FILL]
        if following[0] == MAGIC_0 or (len(following) > 1 and following[1] == MAGIC_1):
            return True
        fill = following[0] in FILL and bool((following == following[0]).all())
        return fill and bool(self.buffer[at - 1] != following[0])


@dataclass
class _Lost:
    """A stretch of bytes that is no record, whose end is still looked for.

    Parameters
    ----------
    record_bytes
        Length of the record that its first bytes announce, or 0 where they announce none. [byte]
    """

    start: int
    what: str
    record_bytes: int = 0
    fill: int = -1
    fill_start: int = 0

    def watch(self, buffer: Bytes, base: int) -> None:
        """Keep track of the run of one byte value with which the file may end."""
        seen = buffer[max(self.start - base, 0) :]
        if not len(seen):
            return
        others = np.flatnonzero(seen != seen[-1])
        if len(others):
            self.fill_start = base + len(buffer) - len(seen) + int(others[-1]) + 1
        elif int(seen[-1]) != self.fill:
            self.fill_start = max(self.start, base)
        self.fill = int(seen[-1])


class Framing:
    """One pass over a log.

    Attributes
    ----------
    layouts
        Of every type, as last defined.
    formats
        How many FMT records were believed.
    """

    def __init__(self, blocks: Blocks) -> None:
        self.layouts: dict[int, Layout] = {FMT_TYPE: FMT}
        self.formats = 0
        self._blocks = blocks
        self._losses = Losses()
        self._notes: list[Problem] = []
        self._lost: _Lost | None = None

    @property
    def problems(self) -> list[Problem]:
        """What was lost, then what is worth knowing; complete once the batches are through."""
        return [*self._losses.problems(), *self._notes]

    def batches(self) -> Iterator[Batch]:
        """Walk through the file, once."""
        done = 0
        while not self._blocks.at_end:
            buffer = self._blocks.advance(done)
            done = yield from self._block(_Piece(buffer, self._lengths(), self._blocks.at_end))
        self._close()

    def _lengths(self) -> NDArray[np.int64]:
        lengths = np.zeros(256, np.int64)
        for layout in self.layouts.values():
            lengths[layout.type] = layout.length
        return lengths

    def _block(self, piece: _Piece) -> Generator[Batch, None, int]:
        """Walk through one block; return how many of its bytes are done with."""
        at, base = 0, self._blocks.start
        found: list[NDArray[np.intp]] = []
        while True:
            if self._lost is not None:
                restart = piece.restart(self._lost.start - base)
                if restart is None:
                    self._lost.watch(piece.buffer, base)
                    size = len(piece.buffer)
                    at = size if piece.at_end else max(at, size - LOOK_AHEAD)
                    break
                self._losses.add(self._lost.start, base + restart, self._lost.what)
                self._lost, at = None, restart
            records, at = piece.chain.follow(at)
            records, layouts = self._define(piece, records)
            if layouts is not None:
                yield self._batch(piece, [*found, records])
                at, found = int(piece.chain.ends[records[-1]]), []
                self.layouts = layouts
                piece.link(self._lengths())
                continue
            records, at = self._stop(piece, records, at)
            found.append(records)
            if self._lost is None:
                break
        yield self._batch(piece, found)
        return at

    def _batch(self, piece: _Piece, found: list[NDArray[np.intp]]) -> Batch:
        records = np.concatenate(found) if found else np.empty(0, np.intp)
        return Batch(
            buffer=piece.buffer,
            start=self._blocks.start,
            offsets=piece.chain.starts[records],
            types=piece.types[records],
            layouts=self.layouts,
        )

    def _define(
        self, piece: _Piece, records: NDArray[np.intp]
    ) -> tuple[NDArray[np.intp], dict[int, Layout] | None]:
        """Read FMT records up to where they change what follows; return the records so far.

        The layouts are None where nothing changes.
        """
        formats = np.flatnonzero(piece.types[records] == FMT_TYPE).tolist()
        layouts = dict(self.layouts) if formats else self.layouts
        changed = False
        for number, index in enumerate(formats):
            start = int(piece.chain.starts[records[index]])
            try:
                layout = self._format(piece, start)
            except BadFormatError as error:
                offset = self._blocks.start + start
                self._losses.add(offset, offset + FMT_LENGTH, f"an FMT record is bad: {error}")
            else:
                self.formats += 1
                changed = changed or layouts.get(layout.type) != layout
                layouts[layout.type] = layout
            if changed and formats[number + 1 : number + 2] != [index + 1]:
                return records[: index + 1], layouts
        return records, None

    def _format(self, piece: _Piece, start: int) -> Layout:
        record = piece.buffer[start : start + FMT_LENGTH].tobytes()
        if not is_fmt(record) and piece.header(start + FMT_LENGTH) is None:
            raise BadFormatError("its text is none, and no record follows it")
        return parse_fmt(record)

    def _stop(
        self, piece: _Piece, records: NDArray[np.intp], at: int
    ) -> tuple[NDArray[np.intp], int]:
        """See why no whole record of a known type begins at ``at``; set ``_lost`` if it should."""
        left, last = len(piece.buffer) - at, int(records[-1]) if len(records) else None
        if last is not None and piece.types[last] == FMT_TYPE:
            last = None  # it has been looked at and needs nobody to confirm it
        if not piece.at_end and left < FEWEST_FILL:
            if last is None:
                return records, at
            return records[:-1], int(piece.chain.starts[last])  # again with what follows it
        kind = piece.header(at)
        offset = self._blocks.start + at
        if kind is not None and kind in self.layouts:  # and its end is not in this block
            if piece.at_end:
                self._cut_short(offset, left, self.layouts[kind].name)
                at = len(piece.buffer)
        elif piece.at_end and piece.buffer[at:].tobytes() == MAGIC[:left]:
            if left:
                self._cut_short(offset, left, "a")
            at = len(piece.buffer)
        elif last is None or piece.ends_surely(at):
            what = "bytes that belong to no record"
            if kind is not None:
                what = f"a record of type {kind}, which no FMT record describes"
            self._lost = _Lost(offset, what)
        else:
            records, at = records[:-1], int(piece.chain.starts[last])
            layout = self.layouts[int(piece.types[last])]
            what = f"a damaged or cut record, {layout.name}, and what follows it"
            self._lost = _Lost(self._blocks.start + at, what, layout.length)
        return records, at

    def _cut_short(self, offset: int, length: int, name: str) -> None:
        what = f"the last record, {name}, is incomplete: recording stopped there"
        self._notes.append(Problem(what=what, offset=offset, bytes_lost=length, note=True))

    def _close(self) -> None:
        """Say what the bytes after the last record are."""
        end, lost = self._blocks.end, self._lost
        if lost is not None:
            run = end - lost.fill_start
            padded = lost.fill in FILL and (run >= FEWEST_FILL or lost.fill_start == lost.start)
            body = lost.fill_start if padded else end
            if padded and lost.record_bytes > body - lost.start:
                self._cut_short(lost.start, body - lost.start, "before the padding")
            elif body > lost.start:
                self._losses.add(lost.start, body, lost.what)
            if padded:
                what = f"padding after the last record: {run} bytes 0x{lost.fill:02X}"
                self._notes.append(Problem(what=what, offset=body, bytes_lost=run, note=True))
        if self._blocks.failure is not None:
            what = f"the file could not be read beyond this byte: {self._blocks.failure}"
            self._losses.add(end, max(end, self._blocks.size), what)
