"""Compressed parts of a log: decompressed, checked, and never larger in memory than they may be."""

from __future__ import annotations

import bz2
import io
import threading
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, TypeVar, cast

import numpy as np

from fdilog_readers.columns import Bytes
from fdilog_readers.file_bytes import read_at

# Chunks are a few megabytes in practice; one larger than this is taken in windows, so that neither
# an odd recorder nor a made-up size decides how much memory is used.
LARGE_BYTES = 32 << 20
WINDOW_BYTES = 8 << 20
PART_BYTES = 1 << 14

CHUNKS_AHEAD = 3
THREADS = 2

_UNKNOWN_SIZE = (1 << 64) - 1

T = TypeVar("T")


class DamagedChunkError(Exception):
    """A chunk's records cannot be had or cannot be believed; the text says why."""


@dataclass(frozen=True)
class ChunkHead:
    """What stands before a chunk's data.

    Parameters
    ----------
    data_at, data_length
        The compressed records, from the beginning of the chunk record. [byte]
    crc
        Of the uncompressed records; 0 where the writer made none.
    """

    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data_at: int
    data_length: int


def ahead(calls: Iterable[Callable[[], T]]) -> Iterator[T]:
    """Make calls in threads, a few ahead of their use, and yield what they return in order."""
    with ThreadPoolExecutor(THREADS) as pool:
        waiting: deque[Future[T]] = deque()
        for call in calls:
            waiting.append(pool.submit(call))
            if len(waiting) > CHUNKS_AHEAD:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def checksum(data: Any, before: int = 0) -> int:
    """Return the CRC-32 of the data that continues what ``before`` is the CRC-32 of."""
    return _crc32()(data, before)


def _crc32() -> Callable[[Any, int], int]:
    try:  # comes with pymavlink, and is an order of magnitude faster than zlib's
        from fastcrc.crc32 import iso_hdlc
    except ImportError:
        return zlib.crc32
    return cast("Callable[[Any, int], int]", iso_hdlc)


def reserve_heap() -> None:
    """Let the C library keep freed megabytes instead of handing them back page by page.

    Once a block this large has been freed, glibc serves smaller ones from its heap; decompressing
    into pages that are already mapped is several times faster. Elsewhere this does nothing.
    """
    np.empty(16 << 20, np.uint8)


def decompress(head: ChunkHead, data: memoryview) -> bytes | memoryview:
    """Decompress a chunk and check it against its size and its checksum.

    Raises
    ------
    DamagedChunkError
        If it is not what it should be.
    """
    records: bytes | memoryview
    try:
        if head.compression == "":
            records = data
        elif head.compression == "zstd":
            records = _zstd(data, head.size)
        elif head.compression == "lz4":
            records = _lz4(data, head.size)
        elif head.compression == "bz2":
            records = bz2.BZ2Decompressor().decompress(data, max_length=head.size + 1)
        else:
            raise DamagedChunkError(f"its compression {head.compression!r} is not known")
    except (RuntimeError, ValueError, EOFError, OSError, MemoryError) as error:
        raise DamagedChunkError(f"it does not decompress ({error})") from error
    if len(records) != head.size:
        raise DamagedChunkError(f"it holds {len(records)} bytes instead of {head.size}")
    if head.crc and checksum(records) != head.crc:
        raise DamagedChunkError("its checksum is wrong")
    return records


def decompress_part(compression: str, data: memoryview) -> bytes | memoryview:
    """Decompress as much as there is of a chunk that is cut; nothing of an unknown compression."""
    if compression == "":
        return data
    pieces: list[bytes] = []
    length = 0
    try:
        tool: Any = None
        if compression == "bz2":
            tool = bz2.BZ2Decompressor()
        elif compression == "lz4":
            import lz4.frame

            tool = lz4.frame.LZ4FrameDecompressor()
        for at in range(0, len(data), PART_BYTES) if tool else ():
            pieces.append(tool.decompress(bytes(data[at : at + PART_BYTES]), LARGE_BYTES - length))
            length += len(pieces[-1])
            if tool.eof or length >= LARGE_BYTES:
                break
    except (RuntimeError, ValueError, EOFError, OSError):
        pass
    return b"".join(pieces)


_of_thread = threading.local()


def _zstd(data: memoryview, size: int) -> bytes:
    import zstandard

    try:
        promised = zstandard.get_frame_parameters(data).content_size
        if promised not in {size, _UNKNOWN_SIZE, 0}:
            raise DamagedChunkError(f"it promises {promised} bytes instead of {size}")
        tool = getattr(_of_thread, "zstd", None)
        if tool is None:  # a context serves one thread at a time, and costs more than a chunk
            tool = _of_thread.zstd = zstandard.ZstdDecompressor()
        return cast("bytes", tool.decompress(data, max_output_size=size))
    except zstandard.ZstdError as error:
        raise DamagedChunkError(f"it does not decompress ({error})") from error


def _lz4(data: memoryview, size: int) -> bytes:
    import lz4.frame

    # One byte more than promised: what does not stop there is longer than it should be.
    context = lz4.frame.create_decompression_context()
    records, _, ended = lz4.frame.decompress_chunk(context, data, max_length=size + 1)
    if not ended and len(records) == size:
        raise DamagedChunkError("its lz4 frame has no end")
    return cast("bytes", records)


class _Span(io.RawIOBase):
    """A part of a file, as a file."""

    def __init__(self, file: int, start: int, length: int) -> None:
        self._file = file
        self._at = start
        self._end = start + length

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        view = memoryview(buffer)
        data = read_at(self._file, min(len(view), self._end - self._at), self._at)
        view[: len(data)] = data
        self._at += len(data)
        return len(data)


def windows(file: int, start: int, head: ChunkHead) -> Iterator[Bytes]:
    """Yield the records of the chunk that begins at a place, in pieces of ``WINDOW_BYTES`` at most.

    Raises
    ------
    DamagedChunkError
        At any piece; then what was yielded before is not to be believed either.
    """
    span = io.BufferedReader(_Span(file, start + head.data_at, head.data_length), 1 << 20)
    crc, length = 0, 0
    try:
        source = _opened(span, head.compression)
        while length < head.size:
            # Longer pieces than decompressors like to give at once.
            piece = b"".join(_read(source, min(WINDOW_BYTES, head.size - length)))
            if not piece:
                break
            crc = checksum(piece, crc)
            length += len(piece)
            yield np.frombuffer(piece, np.uint8)
        longer = len(source.read(1)) > 0
    except (RuntimeError, ValueError, EOFError, OSError, MemoryError) as error:
        raise DamagedChunkError(f"it does not decompress ({error})") from error
    if length != head.size or longer:
        raise DamagedChunkError(f"it does not hold the {head.size} bytes that it promises")
    if head.crc and crc != head.crc:
        raise DamagedChunkError("its checksum is wrong")


def _read(source: Any, count: int) -> Iterator[bytes]:
    while count > 0 and (piece := source.read(count)):
        count -= len(piece)
        yield piece


def _opened(span: Any, compression: str) -> Any:
    if compression == "zstd":
        import zstandard

        # ZstdError is a plain Exception; as a ValueError it is known to whoever reads.
        return _Zstd(zstandard.ZstdDecompressor().stream_reader(span), zstandard.ZstdError)
    if compression == "lz4":
        import lz4.frame

        return lz4.frame.LZ4FrameFile(span, mode="rb")
    if compression == "bz2":
        return bz2.BZ2File(span)
    if compression == "":
        return span
    raise DamagedChunkError(f"its compression {compression!r} is not known")


class _Zstd:
    def __init__(self, stream: Any, error: type[Exception]) -> None:
        self._stream = stream
        self._error = error

    def read(self, count: int) -> bytes:
        try:
            return cast("bytes", self._stream.read(count))
        except self._error as error:
            raise ValueError(str(error)) from error
