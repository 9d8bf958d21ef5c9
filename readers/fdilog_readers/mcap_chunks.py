"""Chunks of an MCAP file: read, decompressed, and checked before anything in them is believed."""

from __future__ import annotations

import io
import os
import threading
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import Bytes
from fdilog_readers.mcap_records import (
    ChunkHead,
    ChunkPlace,
    DamagedRecordError,
    parse_chunk_head,
    parse_message_index,
)

# Chunks are a few megabytes in practice; one larger than this is taken in windows, so that neither
# an odd recorder nor a made-up size decides how much memory is used.
LARGE_BYTES = 32 << 20
WINDOW_BYTES = 8 << 20

_UNKNOWN_SIZE = (1 << 64) - 1


class DamagedChunkError(Exception):
    """A chunk's records cannot be had or cannot be believed; the text says why."""


@dataclass(frozen=True, eq=False)
class Chunk:
    """A chunk that has been read.

    Parameters
    ----------
    records : (n_bytes,) or None
        The uncompressed records; None if the chunk is too large to have whole.
    indexes
        Channel to the entries of its message index.
    failure
        Why there are no records.
    """

    place: ChunkPlace
    head: ChunkHead | None = None
    records: Bytes | None = None
    indexes: dict[int, NDArray[np.void]] = field(default_factory=dict)
    failure: str = ""

    @property
    def is_large(self) -> bool:
        """Whether its records must be taken in windows."""
        return self.records is None and not self.failure


def checksum(data: Any, before: int = 0) -> int:
    """Return the CRC-32 of the data that continues what ``before`` is the CRC-32 of."""
    return _crc32()(data, before)


def _crc32() -> Callable[[Any, int], int]:
    try:  # comes with pymavlink, and is an order of magnitude faster than zlib's
        from fastcrc.crc32 import iso_hdlc
    except ImportError:
        return zlib.crc32
    return cast("Callable[[Any, int], int]", iso_hdlc)


_position = threading.Lock()


def read_at(file: int, count: int, offset: int) -> bytes:
    """Read from a place in an open file; several threads may do so at once."""
    if hasattr(os, "pread"):
        return os.pread(file, count, offset)
    with _position:  # Windows has one position in a file, for all
        os.lseek(file, offset, os.SEEK_SET)
        return os.read(file, count)


def reserve_heap() -> None:
    """Let the C library keep freed megabytes instead of handing them back page by page.

    Once a block this large has been freed, glibc serves smaller ones from its heap; decompressing
    into pages that are already mapped is several times faster. Elsewhere this does nothing.
    """
    np.empty(16 << 20, np.uint8)


def load(file: int, place: ChunkPlace, wanted: frozenset[int]) -> Chunk:
    """Read one chunk with the message indexes of the wanted channels, and check it."""
    try:
        raw = memoryview(read_at(file, min(place.end - place.start, LARGE_BYTES), place.start))
        head = parse_chunk_head(raw)
        if max(head.size, place.length) > LARGE_BYTES:
            return Chunk(place, head)
        if len(raw) < place.length:
            raise DamagedChunkError("the file ends inside it")  # noqa: TRY301
        data = raw[head.data_at : head.data_at + head.data_length]
        records = _decompress(head, data)
        if head.crc and checksum(records) != head.crc:
            raise DamagedChunkError("its checksum is wrong")  # noqa: TRY301
    except (DamagedChunkError, DamagedRecordError) as error:
        return Chunk(place, failure=str(error))
    except OSError as error:
        return Chunk(place, failure=(error.strerror or str(error)).lower())
    buffer = np.frombuffer(records, np.uint8)
    return Chunk(place, head, buffer, _indexes(raw, place, wanted))


def _indexes(
    raw: memoryview, place: ChunkPlace, wanted: frozenset[int]
) -> dict[int, NDArray[np.void]]:
    """Read the message indexes; none at all if one of them is not what the summary says."""
    found = {}
    for channel in wanted.intersection(place.indexes):
        try:
            at = place.indexes[channel] - place.start
            if at < place.length:
                return {}
            number, entries = parse_message_index(raw[at:])
        except DamagedRecordError:
            return {}
        if number != channel:
            return {}
        found[channel] = entries
    return found


def _decompress(head: ChunkHead, data: memoryview) -> bytes | memoryview:
    records: bytes | memoryview
    try:
        if head.compression == "":
            records = data
        elif head.compression == "zstd":
            records = _zstd(data, head.size)
        elif head.compression == "lz4":
            records = _lz4(data, head.size)
        else:
            raise DamagedChunkError(f"its compression {head.compression!r} is not known")
    except (RuntimeError, ValueError, EOFError, MemoryError) as error:
        raise DamagedChunkError(f"it does not decompress ({error})") from error
    if len(records) != head.size:
        raise DamagedChunkError(f"it holds {len(records)} bytes instead of {head.size}")
    return records


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


def windows(file: int, chunk: Chunk) -> Iterator[Bytes]:
    """Yield a large chunk's records in order, in pieces of at most ``WINDOW_BYTES``.

    Raises
    ------
    DamagedChunkError
        At any piece; then what was yielded before is not to be believed either.
    """
    head = chunk.head
    assert head is not None  # noqa: S101  a large chunk has one
    span = io.BufferedReader(
        _Span(file, chunk.place.start + head.data_at, head.data_length), 1 << 20
    )
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
