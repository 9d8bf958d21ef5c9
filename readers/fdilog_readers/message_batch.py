"""Messages of one topic, many at once: what framing hands to a layout."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import Bytes, Offsets, rows

# Rows may be this much longer in all than what they hold, beside twice as long.
BATCH_WASTE_BYTES = 1 << 16
ROW_STEP_BYTES = 32

Columns = dict[str, NDArray[Any]]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Batch:
    """Messages side by side in rows of one width.

    Parameters
    ----------
    rows : (n_messages, width) uint8
        A record a row, contiguous; what lies beyond a message's length is anything.
    lead
        Bytes of framing in each row before the message begins. [byte]
    lengths : (n_messages,) int64
        Length of each message. [byte]
    """

    rows: Bytes
    lead: int
    lengths: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.rows)

    def at(self, offset: int, number: np.dtype[Any]) -> NDArray[Any]:
        """View the number at one place of every message; the place must lie within the rows."""
        return np.ndarray(
            (len(self.rows),),
            number,
            self.rows,
            self.lead + offset,
            (self.rows.shape[1],),
        )

    def is_like(self, other: Batch) -> bool:
        """Whether the rows of both may stand in one batch."""
        return self.lead == other.lead and self.rows.shape[1] == other.rows.shape[1]

    def select(self, mask: Mask) -> Batch:
        """Return some of the messages."""
        return Batch(self.rows[mask], self.lead, self.lengths[mask])


class Layout(Protocol):
    """How messages of one type lie in their bytes.

    Attributes
    ----------
    batch_bytes
        How much should come together before it is read: enough that a step costs what its bytes
        cost, little enough to be in the processor's cache still. [byte]
    """

    batch_bytes: int

    def columns(self, batch: Batch) -> tuple[Columns, Mask]:
        """Read the wanted leaves of all messages.

        Returns
        -------
        columns : each (n_messages,)
            Dotted path of the leaf to its values, in the type the log has them in.
        fits : (n_messages,)
            Whether the message is one of this type; where not, its values mean nothing.
        """


def side_by_side(
    buffer: Bytes, starts: Offsets, lead: int, lengths: NDArray[np.int64]
) -> Iterator[tuple[slice, Batch]]:
    """Copy records of a buffer to rows of one width, in as few batches as that is no waste.

    Parameters
    ----------
    buffer : (n_bytes,)
        The records, at any places.
    starts : (n_records,)
        Where each record begins. [byte]
    lead
        Bytes of framing before each message. [byte]
    lengths : (n_records,)
        Length of each message; every record must end within the buffer. [byte]

    Yields
    ------
    Which of the records, and these.
    """
    todo = [slice(0, len(starts))] if len(starts) else []
    while todo:
        part = todo.pop()
        count = part.stop - part.start
        # A round number, so that records of nearly one length have rows of one width.
        longest = max(1, lead + int(lengths[part].max()))
        width = -(-longest // ROW_STEP_BYTES) * ROW_STEP_BYTES
        needed = lead * count + int(lengths[part].sum())
        if count > 1 and count * width > 2 * needed + BATCH_WASTE_BYTES:
            middle = (part.start + part.stop) // 2
            todo += [slice(middle, part.stop), slice(part.start, middle)]
            continue
        yield part, Batch(_padded_rows(buffer, starts[part], width), lead, lengths[part])


def _padded_rows(buffer: Bytes, starts: Offsets, width: int) -> Bytes:
    opaque = np.dtype((np.void, width))
    inside = starts <= len(buffer) - width
    if inside.all():
        return rows(buffer, starts, opaque).view(np.uint8).reshape(-1, width)
    copied = np.zeros((len(starts), width), np.uint8)
    copied[inside] = rows(buffer, starts[inside], opaque).view(np.uint8).reshape(-1, width)
    first = int(starts[~inside].min())
    tail = np.concatenate([buffer[first:], np.zeros(width, np.uint8)])
    late = rows(tail, starts[~inside] - first, opaque)
    copied[~inside] = late.view(np.uint8).reshape(-1, width)
    return copied
