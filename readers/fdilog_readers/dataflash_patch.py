"""Changing single fields of a DataFlash log, and nothing else of it.

The log's own FMT record says where in a record a field is. Every byte that is not changed or
removed stays as it was: damage, records of unknown kinds, and an incomplete last record included.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UsageError
from fdilog.experiments.injection import Change
from fdilog_readers.dataflash_layout import (
    FIELDS,
    FMT_LENGTH,
    FMT_TYPE,
    MAGIC,
    Layout,
    is_fmt,
    parse_fmt,
)

FMT_HEADER = MAGIC + bytes([FMT_TYPE])
TYPE_AT = 3
"""Byte of an FMT record that holds the type it describes."""


def patch(log: Path, path: Path, changes: Sequence[Change]) -> None:
    """Copy a DataFlash log with other values in some fields and without some records.

    Parameters
    ----------
    log, path
        What is read, and what is written.
    changes
        Streams as the reader of ``log`` gave them, with their offsets, and columns in the units of
        the log.

    Raises
    ------
    UsageError
        If a stream has no offsets, or a field cannot be rewritten in its place.
    """
    data = np.fromfile(log, np.uint8)
    kept = np.ones(len(data), bool)
    for change in changes:
        offsets = change.stream.offsets
        if offsets is None or len(offsets) != len(change.removed):
            raise UsageError(f"{log}: where the records of {change.stream.name} are is not known")
        if not len(offsets):
            continue
        layout = _layout(data, int(offsets[0]), log)
        for name, column in change.columns.items():
            if name not in layout.fields or not _as_logged(layout.character(name)):
                raise UsageError(
                    f"{log}: field {name} of {change.stream.name} cannot be rewritten in its place"
                )
            kind, start = layout.dtype.fields[name][:2]  # type: ignore[index]
            values = np.ascontiguousarray(column, kind).view(np.uint8)
            at = offsets[:, None] + (start + np.arange(kind.itemsize))
            data[at] = values.reshape(len(offsets), kind.itemsize)
        span = np.arange(layout.length)
        kept[offsets[change.removed][:, None] + span] = False
    path.write_bytes(data[kept].tobytes())


def _as_logged(character: str) -> bool:
    """Whether a reader gives the numbers of a field as they stand, without a factor."""
    kind, divisor = FIELDS[character]
    return divisor is None and np.dtype(kind).kind in "iuf" and not np.dtype(kind).shape


def _layout(data: NDArray[np.uint8], offset: int, log: Path) -> Layout:
    """Find the layout of the record at an offset: the last FMT record of its type before it."""
    number = int(data[offset + len(MAGIC)])
    head = data[:offset].tobytes()
    at = head.rfind(FMT_HEADER)
    while at >= 0:
        record = head[at : at + FMT_LENGTH]
        if is_fmt(record) and record[TYPE_AT] == number:
            return parse_fmt(record)
        at = head.rfind(FMT_HEADER, 0, at)
    raise UsageError(f"{log}: no FMT record describes record type {number} at byte {offset}")
