"""Where in an SQLite file a row lies, or should: SQLite itself never says where damage is.

Layouts follow sqlite.org/fileformat2.html: a table is a tree of pages, whose inner pages name the
page of every range of row numbers.
"""

from __future__ import annotations

from pathlib import Path

from fdilog_readers.file_bytes import FileBytes, opened

INNER, LEAF = 5, 13
INNER_HEAD_BYTES = 12
# A tree of pages of 512 bytes is as deep as this only with more rows than there can be.
DEEPEST = 40


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
    return value << 8 | raw[min(at + 8, len(raw) - 1)]
