"""Chunks of an MCAP file, with what their own indexes say of the wanted channels."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fdilog_readers import chunks
from fdilog_readers.chunks import ChunkHead, DamagedChunkError, decompress
from fdilog_readers.columns import Bytes
from fdilog_readers.file_bytes import read_at
from fdilog_readers.mcap_records import (
    ChunkPlace,
    DamagedRecordError,
    parse_chunk_head,
    parse_message_index,
)


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


def load(file: int, place: ChunkPlace, wanted: frozenset[int]) -> Chunk:
    """Read one chunk with the message indexes of the wanted channels, and check it."""
    try:
        raw = memoryview(
            read_at(file, min(place.end - place.start, chunks.LARGE_BYTES), place.start)
        )
        head = parse_chunk_head(raw)
        if max(head.size, place.length) > chunks.LARGE_BYTES:
            return Chunk(place, head)
        if len(raw) < place.length:
            raise DamagedChunkError("the file ends inside it")  # noqa: TRY301
        data = raw[head.data_at : head.data_at + head.data_length]
        records = decompress(head, data)
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
