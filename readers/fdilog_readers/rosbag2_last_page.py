"""The last page of an SQLite file that is cut: its whole rows are kept, the others taken out.

SQLite fills the missing end of that page with zeros and calls them readings. A page holds its rows
from its end backwards, so that a cut takes the earliest of them first.

References
----------
[SQLite] Database File Format, section 1.6, "B-tree Pages".
"""

from __future__ import annotations

import os
import struct
from pathlib import Path

TABLE_LEAF = 0x0D
HEAD_BYTES = 8
LONGEST_NUMBER = 9


def mend(path: Path, page_bytes: int, reserved_bytes: int) -> None:
    """Make the last, incomplete page of a file whole, without the rows that the cut touched.

    A page that holds no rows, or not even where they are, is taken off.

    Parameters
    ----------
    path
        A copy: it is changed.
    """
    with path.open("r+b") as file:
        size = file.seek(0, 2)
        begin = size - size % page_bytes
        file.seek(begin)
        page = file.read()
        head = _without_cut_rows(page, page_bytes - reserved_bytes)
        if head:
            file.seek(begin)
            file.write(head)
    os.truncate(path, begin + page_bytes if head else begin)


def _without_cut_rows(page: bytes, usable: int) -> bytes:
    """Return the head of a page with the places of its whole rows only; empty if it has none."""
    if len(page) < HEAD_BYTES or page[0] != TABLE_LEAF:
        return b""
    (count,) = struct.unpack_from(">H", page, 3)
    if HEAD_BYTES + 2 * count > len(page):
        return b""
    starts = struct.unpack_from(f">{count}H", page, HEAD_BYTES)
    whole = [start for start in starts if _end_of_row(page, start, usable) <= len(page)]
    places = struct.pack(f">{len(whole)}H", *whole)
    return page[:3] + struct.pack(">H", len(whole)) + page[5:HEAD_BYTES] + places


def _end_of_row(page: bytes, start: int, usable: int) -> int:
    """Return where the part of a row ends that lies in its page, beyond the page if it is cut."""
    length, at = _number(page, start)
    _, at = _number(page, at)
    most, least = usable - 35, (usable - 12) * 32 // 255 - 23
    if length <= most:
        return at + length
    here = least + (length - least) % (usable - 4)
    return at + (here if here <= most else least) + 4


def _number(page: bytes, at: int) -> tuple[int, int]:
    """Read a number of one to nine bytes; return where it ends, beyond the page if it does."""
    value = 0
    for k in range(LONGEST_NUMBER):
        if at >= len(page):
            return 0, len(page) + 1
        byte = page[at]
        at += 1
        if k == LONGEST_NUMBER - 1:
            return value << 8 | byte, at
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            break
    return value, at
