"""Where in an SQLite file a row lies, or should, and the rows on pages that nothing leads to.

SQLite itself never says where damage is, and what an inner page led to is gone for it.

Layouts follow sqlite.org/fileformat2.html: a table is a tree of pages, whose inner pages name the
page of every range of row numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.file_bytes import FileBytes, opened

INNER, LEAF = 5, 13
INNER_HEAD_BYTES, LEAF_HEAD_BYTES = 12, 8
SCAN_BYTES = 8 << 20
# Bytes of an integer by the number that tells its kind; 8 and 9 are zero and one themselves.
INTEGER_BYTES = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
# A tree of pages of 512 bytes is as deep as this only with more rows than there can be.
DEEPEST = 40
MOST_ROWS = (1 << 63) - 1

Row = tuple[int, int, int, bytes]


def place_of_row(path: Path, page_bytes: int, root: int, row: int) -> int:
    """Return where the page of a row begins: that of the leaf, or of a page above it that is none.

    Parameters
    ----------
    root
        Number of the table's first page; pages count from one.
    """
    with opened(path) as data:
        page = root
        for _ in range(DEEPEST):
            start = (page - 1) * page_bytes
            below = _child(data, start, page_bytes, row)
            if not 0 < below <= data.size // page_bytes:
                return start
            page = below
    return start


def _child(data: FileBytes, start: int, page_bytes: int, row: int) -> int:
    """Return the page below the one that begins here which would hold a row; 0 if there is none."""
    raw = data.at(start, page_bytes)
    if len(raw) < page_bytes or raw[0] != INNER:
        return 0
    n_cells = int.from_bytes(raw[3:5])
    for k in range(n_cells):
        at = int.from_bytes(raw[INNER_HEAD_BYTES + 2 * k :][:2])
        if not INNER_HEAD_BYTES <= at <= page_bytes - 5:
            return 0
        if _varint(raw, at + 4) >= row:
            return int.from_bytes(raw[at : at + 4])
    return int.from_bytes(raw[8:12])


def _varint(raw: bytes, at: int) -> int:
    """Read a number of one to nine bytes, the high ones first."""
    value = 0
    for byte in raw[at : at + 8]:
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value
    return value << 8 | (raw[at + 8] if at + 8 < len(raw) else 0)


@dataclass(frozen=True, eq=False)
class Leaves:
    """The leaf pages of a file, found by what they are and not by what leads to them.

    A page counts only if each of its rows fills what its head says: of one in which damage begins
    nothing is taken.

    Parameters
    ----------
    numbers : (n_pages,)
        Of the pages that may be leaves of a table.
    """

    path: Path
    page_bytes: int
    usable_bytes: int
    numbers: NDArray[np.int64]

    @classmethod
    def of(cls, path: Path, page_bytes: int) -> Leaves:
        """Look at the first byte of every page."""
        with opened(path) as data:
            reserved = data.at(0, 21)[20:]
            found = []
            step = max(1, SCAN_BYTES // page_bytes) * page_bytes
            for start in range(0, data.size - page_bytes + 1, step):
                firsts = np.frombuffer(data.at(start, step), np.uint8)[::page_bytes]
                found.append(np.flatnonzero(firsts == LEAF) + start // page_bytes)
        numbers = np.concatenate([np.empty(0, np.int64), *found])
        return cls(path, page_bytes, page_bytes - sum(reserved), numbers)

    def rows(self, after: int, most: int) -> Iterator[list[Row]]:
        """Yield the rows of four columns with these numbers, a page at a time in their order."""
        first, last = self._ranges
        here = np.flatnonzero((first <= most) & (last > after))
        with opened(self.path) as data:
            for number in self.numbers[here[np.argsort(first[here])]].tolist():
                rows = self._rows_of(data, data.at(number * self.page_bytes, self.page_bytes))
                if kept := [row for row in rows if after < row[0] <= most]:
                    yield kept

    @cached_property
    def _ranges(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Numbers of the first and the last row of each page, as far as it is one."""
        ends = np.empty((2, len(self.numbers)), np.int64)
        with opened(self.path) as data:
            for k, number in enumerate(self.numbers.tolist()):
                page = data.at(number * self.page_bytes, self.page_bytes)
                for end, cell in enumerate((0, _n_cells(page) - 1)):
                    row = _varint(page, _after_varint(page, _cell(page, cell)))
                    ends[end, k] = min(row, MOST_ROWS)
        return ends[0], ends[1]

    def _rows_of(self, data: FileBytes, page: bytes) -> list[Row]:
        rows = [self._row(data, page, _cell(page, k)) for k in range(_n_cells(page))]
        good = [row for row in rows if row is not None]
        return good if len(good) == len(rows) else []

    def _row(self, data: FileBytes, page: bytes, at: int) -> Row | None:
        """Read a row of (number, integer, integer, blob); None if it is anything else."""
        size = _varint(page, at)
        at = _after_varint(page, at)
        number = _varint(page, at)
        at = _after_varint(page, at)
        whole = self._payload(data, page, at, size)
        if whole is None:
            return None
        head_bytes = _varint(whole, 0)
        kinds = []
        place = _after_varint(whole, 0)
        while place < min(head_bytes, len(whole)):
            kinds.append(_varint(whole, place))
            place = _after_varint(whole, place)
        if len(kinds) != 4 or kinds[0] != 0 or kinds[3] < 12 or kinds[3] % 2:
            return None
        widths = [INTEGER_BYTES.get(kind, -1) for kind in kinds[1:3]]
        if min(widths) < 0 or head_bytes + sum(widths) + (kinds[3] - 12) // 2 != size:
            return None
        edge = head_bytes + widths[0]
        topic = int.from_bytes(whole[head_bytes:edge], signed=True) if widths[0] else kinds[1] - 8
        stamp = int.from_bytes(whole[edge : edge + widths[1]], signed=True)
        return number, topic, stamp, whole[edge + widths[1] :]

    def _payload(self, data: FileBytes, page: bytes, at: int, size: int) -> bytes | None:
        """Put together what a cell holds, and what follows it on pages of its own."""
        usable = self.usable_bytes
        local = size
        if size > usable - 35:
            least = (usable - 12) * 32 // 255 - 23
            local = least + (size - least) % (usable - 4)
            local = local if local <= usable - 35 else least
        parts = [page[at : at + local]]
        following = int.from_bytes(page[at + local : at + local + 4])
        left = size - local
        while left > 0:
            if not 0 < following <= data.size // self.page_bytes or left > data.size:
                return None
            more = data.at((following - 1) * self.page_bytes, self.page_bytes)
            parts.append(more[4 : 4 + min(left, usable - 4)])
            following = int.from_bytes(more[:4])
            left -= usable - 4
        whole = b"".join(parts)
        return whole if len(whole) == size else None


def _n_cells(page: bytes) -> int:
    return int.from_bytes(page[3:5])


def _cell(page: bytes, k: int) -> int:
    """Return where a cell of a leaf begins."""
    return int.from_bytes(page[LEAF_HEAD_BYTES + 2 * k :][:2]) if k >= 0 else len(page)


def _after_varint(raw: bytes, at: int) -> int:
    for place in range(at, min(at + 8, len(raw))):
        if raw[place] < 0x80:
            return place + 1
    return at + 9
