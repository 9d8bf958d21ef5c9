"""From bytes, offsets and a layout to columns: what every reader here shares.

A log is a sequence of records. *Framing* says where the records of one kind begin (an int64 array
of offsets), *layout* is their schema as a NumPy dtype; ``rows`` and ``columns`` do the rest without
a Python loop over records. ``Blocks`` hands a file out piece by piece, so that a log of 10 GB needs
no more memory than its columns; ``Chain`` finds the records that lie end to end.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError

Bytes = NDArray[np.uint8]
Offsets = NDArray[np.int64]

# A block and what is computed from it should stay in the processor's second-level cache or near it;
# 1 to 4 MiB ran fastest, smaller ones pay for Python and larger ones for memory.
BLOCK_BYTES = 1 << 21

# Two clocks of one device may start apart by what it takes to hand a sample on, not by more.
SAME_CLOCK_NS = 1_000_000_000


def rows(buffer: Bytes, offsets: Offsets, layout: np.dtype[Any]) -> NDArray[Any]:
    """Copy the records that begin at the offsets, whole.

    A stride-1 view with one overlapping item per byte, indexed by the offsets, gathers records that
    are not aligned; gathered as opaque bytes it is several times faster than as a structure.

    Parameters
    ----------
    buffer : (n_bytes,)
        Contiguous bytes.
    offsets : (n_records,)
        Where each record begins in ``buffer``. [byte]
    layout
        The record, header and all; its itemsize is the number of bytes that must be there.

    Returns
    -------
    (n_records,) array of ``layout``; a field of it is a strided view.

    Raises
    ------
    IndexError
        If a record would reach outside the buffer.
    """
    _check_bounds(buffer, offsets, layout)
    return _gather(buffer, offsets, layout, 0)


def columns(
    buffer: Bytes, offsets: Offsets, layout: np.dtype[Any], fields: Iterable[str] | None = None
) -> dict[str, NDArray[Any]]:
    """Copy fields of the records that begin at the offsets, each to a contiguous native column.

    Parameters
    ----------
    buffer : (n_bytes,)
        Contiguous bytes.
    offsets : (n_records,)
        Where each record begins in ``buffer``. [byte]
    layout
        The record; any byte order, any packing.
    fields
        The wanted fields; all of them if None. Others are not copied.

    Raises
    ------
    IndexError
        If a record would reach outside the buffer.
    """
    _check_bounds(buffer, offsets, layout)
    out: dict[str, NDArray[Any]] = {}
    for name in (layout.names or ()) if fields is None else fields:
        field, start = layout.fields[name][:2]  # type: ignore[index]
        column = _gather(buffer, offsets, field, start)
        out[name] = column.astype(column.dtype.newbyteorder("="), copy=False)
    return out


def _gather(buffer: Bytes, offsets: Offsets, item: np.dtype[Any], start: int) -> NDArray[Any]:
    """Copy one item per offset, ``start`` bytes further on."""
    if not len(offsets):
        return np.empty((0, *item.shape), item.base)
    opaque = np.dtype((np.void, item.itemsize))
    places = len(buffer) - start - item.itemsize + 1
    items = np.ndarray((places,), opaque, buffer, start, (1,))[offsets]
    return items.view(item.base).reshape(-1, *item.shape)


def _check_bounds(buffer: Bytes, offsets: Offsets, layout: np.dtype[Any]) -> None:
    if not buffer.flags.c_contiguous or buffer.dtype != np.uint8:
        raise ValueError("the buffer must be contiguous bytes")
    if len(offsets):
        low, high = int(offsets.min()), int(offsets.max()) + layout.itemsize
        if low < 0 or high > len(buffer):
            raise IndexError(f"records reach from byte {low} to {high} of {len(buffer)}")


class Chain:
    """Records that lie end to end, found among places that only look like records.

    Parameters
    ----------
    starts : (n_candidates,)
        Places where a record may begin, increasing. [byte]
    ends : (n_candidates,)
        Where each would end, always after its start. [byte]
    """

    def __init__(self, starts: Offsets, ends: Offsets) -> None:
        self.starts = starts
        self.ends = ends
        # Nearly all candidates are records, so "my end is the next one's start" holds nearly
        # everywhere at once; only where it does not must anyone look.
        breaks: list[int] = np.flatnonzero(ends[:-1] != starts[1:]).tolist()
        self._breaks = [*breaks, len(starts) - 1]

    def follow(self, at: int) -> tuple[NDArray[np.intp], int]:
        """Return the candidates that make an unbroken chain from byte ``at``, and where it ends.

        The chain ends at the first byte at which no candidate begins.
        """
        pieces: list[NDArray[np.intp]] = []
        index = int(np.searchsorted(self.starts, at))
        while index < len(self.starts) and self.starts[index] == at:
            last = self._breaks[bisect.bisect_left(self._breaks, index)]
            pieces.append(np.arange(index, last + 1))
            at = int(self.ends[last])
            index = last + 1 + int(np.searchsorted(self.starts[last + 1 :], at))
        if len(pieces) == 1:
            return pieces[0], at
        return np.concatenate(pieces) if pieces else np.empty(0, np.intp), at


class Blocks:
    """A file, piece by piece, in one buffer that is used again.

    The first ``advance(0)`` gives the file's beginning; each further call says how many bytes of
    the piece are done with, keeps the others, and adds what follows them. A piece is valid until
    the next call. Use it in a ``with`` statement.

    Attributes
    ----------
    start
        Offset in the file of the piece's first byte. [byte]
    at_end
        Whether the piece reaches to the end of what can be read.
    failure
        Why reading stopped before the end of the file (a bad medium), else None.
    """

    def __init__(self, path: Path, block_bytes: int = BLOCK_BYTES) -> None:
        try:
            self._file = path.open("rb", buffering=0)
            self.size = self._file.seek(0, 2)
            self._file.seek(0)
        except OSError as error:
            raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error
        self._buffer = np.empty(max(64, min(block_bytes, self.size + 1)), np.uint8)
        self._filled = 0
        self.start = 0
        self.at_end = False
        self.failure: str | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._file.close()

    @property
    def end(self) -> int:
        """Offset in the file of the byte after the piece. [byte]"""
        return self.start + self._filled

    def advance(self, done: int) -> Bytes:
        """Drop ``done`` bytes from the front of the piece and read on; return the new piece."""
        kept = self._filled - done
        if kept == len(self._buffer):  # something is longer than a whole piece
            self._buffer = np.concatenate([self._buffer, np.empty_like(self._buffer)])
        elif done:
            self._buffer[:kept] = self._buffer[done : self._filled]
        self.start += done
        self._filled = kept
        view = self._buffer.data
        while self._filled < len(self._buffer) and not self.at_end:
            try:
                got = self._file.readinto(view[self._filled :])
            except OSError as error:
                self.failure = (error.strerror or str(error)).lower()
                got = 0
            self._filled += got or 0
            self.at_end = not got
        return self._buffer[: self._filled]


def whole(path: Path) -> Bytes:
    """Read a whole file that is needed at random places; for long logs ``Blocks`` is the way.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened or read.
    """
    try:
        return np.fromfile(path, np.uint8)
    except OSError as error:
        raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error


def choose_time(
    stamp_ns: NDArray[np.int64],
    record_ns: NDArray[np.int64],
    stamp_name: str,
    record_name: str,
) -> tuple[NDArray[np.int64], str]:
    """Choose between the time stamped at the sensor and the time of recording.

    The stamp is nearer to the truth, but only if it tells time at all, and the recorder's time. It
    is left where it stands still in most of the steps in which recording went on, or where most
    stamps are further than a second from the recorder's clock.

    Parameters
    ----------
    stamp_ns : (n_records,)
        Time stamped at the sensor. [ns]
    record_ns : (n_records,)
        Time of recording. [ns]

    Returns
    -------
    The times, and the words for ``Stream.clock``. [ns]
    """
    if not len(stamp_ns):
        return stamp_ns, stamp_name
    moving = np.diff(record_ns) > 0
    standing = np.diff(stamp_ns)[moving] == 0
    if len(stamp_ns) > 1 and standing.size and float(np.mean(standing)) > 0.5:
        return record_ns, f"{record_name} ({stamp_name} stands still)"
    # As floating point: two wild stamps may be further apart than an int64 reaches.
    apart_ns = np.abs(stamp_ns.astype(np.float64) - record_ns.astype(np.float64))
    if float(np.median(apart_ns)) > SAME_CLOCK_NS:
        return record_ns, f"{record_name} ({stamp_name} is another clock)"
    return stamp_ns, stamp_name


def plain_text(raw: bytes | str) -> str:
    """Decode a string that a log may have made up: up to the first NUL, every character visible.

    UTF-8 where it is that, else Latin-1; control characters (a terminal would obey them) become
    escapes.
    """
    if isinstance(raw, bytes):
        try:
            text = raw.partition(b"\0")[0].decode()
        except UnicodeDecodeError:
            text = raw.partition(b"\0")[0].decode("latin-1")
    else:
        text = raw.partition("\0")[0]
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
