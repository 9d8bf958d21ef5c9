"""A stretch of a ULog in memory, and every place in it where a record can be believed to begin."""

from __future__ import annotations

import bisect

import numpy as np

from fdilog_readers.columns import Bytes, Chain
from fdilog_readers.ulog_definitions import ID_BYTES, Definitions, is_plausible, may_begin
from fdilog_readers.ulog_layout import HEADER_BYTES, MOST_BYTES

DATA, FLAGS = ord("D"), ord("B")
OTHERS = b"FIMPQALCSORB"
# A record, and enough of what follows it to believe it.
LOOK_AHEAD = HEADER_BYTES + MOST_BYTES + HEADER_BYTES + ID_BYTES
# So many records that nothing describes may follow one another before one that is believed.
MOST_UNDESCRIBED = 30
FILL = (0x00, 0xFF)
FEWEST_FILL = 16


class Piece:
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
