"""Bytes of a file at any place, without a position that moves."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fdilog.errors import UnreadableLogError

SMALL_BYTES = 1 << 16

_position = threading.Lock()


def read_at(file: int, count: int, offset: int) -> bytes:
    """Read from a place in an open file; several threads may do so at once."""
    if hasattr(os, "pread"):
        return os.pread(file, count, offset)
    with _position:  # Windows has one position in a file, for all
        os.lseek(file, offset, os.SEEK_SET)
        return os.read(file, count)


@contextmanager
def opened(path: Path) -> Iterator[FileBytes]:
    """Open a file for reading at any place.

    Raises
    ------
    UnreadableLogError
        If it cannot be opened, or not be read.
    """
    try:
        file = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        try:
            yield FileBytes(file, os.fstat(file).st_size)
        finally:
            os.close(file)
    except OSError as error:
        raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error


class FileBytes:
    """Bytes of a file at any place, small reads served from one window."""

    def __init__(self, file: int, size: int) -> None:
        self.file = file
        self.size = size
        self._window = b""
        self._start = 0

    def at(self, offset: int, count: int) -> bytes:
        """Return bytes, fewer only at the end of the file."""
        inner = offset - self._start
        if inner < 0 or inner + count > len(self._window):
            if count > SMALL_BYTES:
                return read_at(self.file, count, offset)
            self._window, self._start = read_at(self.file, SMALL_BYTES, offset), offset
            inner = 0
        return self._window[inner : inner + count]
