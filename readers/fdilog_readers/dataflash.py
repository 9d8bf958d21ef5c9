"""ArduPilot DataFlash logs (.bin): gyros, attitude, outputs, and when the vehicle was armed.

IMU, IMU2, IMU3 (firmware up to 3.6) or one IMU message with an instance field I (since 4.1), and
the raw GYR messages, are gyros; the message's number or instance is the sensor's. Every other type
is listed with its count, and read when it is asked for: its columns then hold the numbers that the
official reader gives, and ``units`` what the log itself says of them (FMTU, UNIT, MULT).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog_readers.columns import Blocks, Offsets, rows
from fdilog_readers.dataflash_framing import Batch, Framing
from fdilog_readers.dataflash_layout import FMT_LENGTH, FMT_TYPE, MAGIC, Layout, is_fmt, physical
from fdilog_readers.dataflash_streams import DEFAULT, GYRO_NAME, INSTANCE, Table, recording

suffixes = (".bin",)
description = "ArduPilot DataFlash"

# A block, and what is computed from it, should stay in the processor's second-level cache.
BLOCK_BYTES = 1 << 20


def sniff(head: bytes) -> bool:
    """Tell a log by its first FMT record, or, with a damaged head, by one that a record follows."""
    fmt = MAGIC + bytes([FMT_TYPE])
    at = head.find(fmt)
    while at >= 0:
        follows = head[at + FMT_LENGTH : at + FMT_LENGTH + len(MAGIC)]
        if is_fmt(head[at : at + FMT_LENGTH]) and (at == 0 or follows == MAGIC):
            return True
        at = head.find(fmt, at + 1)
    return False


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read gyros, attitude, outputs and what tells of the vehicle, and the types in ``also``.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened or holds no FMT record.
    """
    with Blocks(path, BLOCK_BYTES) as blocks:
        framing = Framing(blocks)
        found = _Found(frozenset(also), blocks.size)
        for batch in framing.batches():
            found.take(batch)
        size = max(blocks.end, blocks.size)
    if not framing.formats:
        raise UnreadableLogError(
            f"{path}: no FMT record ({MAGIC.hex(' ')} {FMT_TYPE:02x}) in {size} bytes: this is no"
            " DataFlash log, or the beginning, which says what its records hold, is lost"
        )
    problems = framing.problems + found.problems()
    tables = {
        name: _table(name, found.columns.pop(name), problems) for name in sorted(found.columns)
    }
    return recording(
        path,
        tables,
        form="dataflash",
        size=size,
        layouts=framing.layouts,
        counts=found.counts,
        problems=problems,
        also=also,
    )


@dataclass
class _Found:
    """Records of the wanted types, and how many there are of all."""

    also: frozenset[str]
    file_bytes: int
    columns: dict[str, dict[Layout, _Growing]] = field(default_factory=dict)
    counts: dict[str, int] = field(default_factory=dict)
    flawed: dict[Layout, int] = field(default_factory=dict)

    def take(self, batch: Batch) -> None:
        """Copy the wanted records out of a batch."""
        counts = np.bincount(batch.types, minlength=256)
        for kind in np.flatnonzero(counts).tolist():
            layout, count = batch.layouts[kind], int(counts[kind])
            self.counts[layout.name] = self.counts.get(layout.name, 0) + count
            if layout.flaw:
                self.flawed[layout] = self.flawed.get(layout, 0) + count
            elif layout.name in self.also or DEFAULT.fullmatch(layout.name):
                self._take(batch, layout, batch.offsets[batch.types == kind])

    def _take(self, batch: Batch, layout: Layout, offsets: Offsets) -> None:
        if not GYRO_NAME.fullmatch(layout.name) or layout.character(INSTANCE) not in ("b", "B"):
            self._add(batch, layout, layout.name, offsets)
            return
        place = layout.dtype.fields[INSTANCE][1]  # type: ignore[index]
        instances = batch.buffer[offsets + place]
        for number in np.flatnonzero(np.bincount(instances)).tolist():
            self._add(batch, layout, f"{layout.name}[{number}]", offsets[instances == number])

    def _add(self, batch: Batch, layout: Layout, name: str, offsets: Offsets) -> None:
        ways = self.columns.setdefault(name, {})
        if layout not in ways:
            ways[layout] = _Growing(layout, self.file_bytes)
        ways[layout].add(batch.start + offsets, rows(batch.buffer, offsets, layout.dtype))

    def problems(self) -> list[Problem]:
        """Say which types have a length but no fields that could be read."""
        return [
            Problem(
                what=f"the {count} {layout.name} records cannot be read: {layout.flaw}",
                bytes_lost=count * layout.length,
                note=not DEFAULT.fullmatch(layout.name),
            )
            for layout, count in self.flawed.items()
        ]


class _Growing:
    """Columns of one layout that are filled from the front, so that rows are copied only once.

    There is room for as many records as the rest of the file will hold if it goes on like this;
    room that is not used costs addresses, not memory.
    """

    def __init__(self, layout: Layout, file_bytes: int) -> None:
        self._layout = layout
        self._file_bytes = file_bytes
        self._size = 0
        self._offsets = np.empty(0, np.int64)
        self._columns = {
            f: np.empty((0, *item.shape), item.base.newbyteorder("="))
            for f, item in ((f, layout.dtype[f]) for f in layout.fields)
        }

    def add(self, offsets: Offsets, gathered: NDArray[Any]) -> None:
        """Append records while they are in the processor's cache."""
        start, self._size = self._size, self._size + len(offsets)
        if self._size > len(self._offsets):
            self._make_room(start, int(offsets[-1]) + self._layout.length)
        self._offsets[start : self._size] = offsets
        for f, column in self._columns.items():
            column[start : self._size] = gathered[f]

    def _make_room(self, filled: int, bytes_seen: int) -> None:
        left = max(self._file_bytes - bytes_seen, 0)
        like_this = self._size * left // bytes_seen
        room = self._size + min(max(self._size, like_this * 9 // 8), left // self._layout.length)
        self._offsets = _moved(self._offsets, filled, room)
        self._columns = {f: _moved(column, filled, room) for f, column in self._columns.items()}

    def table(self) -> Table:
        """Return the columns in their units, and give up one's own."""
        fields = list(self._columns)
        columns = {
            f: physical(self._layout.character(f), self._columns.pop(f)[: self._size])
            for f in fields
        }
        return Table(self._offsets[: self._size], columns)


def _moved(column: NDArray[Any], filled: int, room: int) -> NDArray[Any]:
    moved = np.empty((room, *column.shape[1:]), column.dtype)
    moved[:filled] = column[:filled]
    return moved


def _table(name: str, ways: dict[Layout, _Growing], problems: list[Problem]) -> Table:
    """Join the records of one name, which the log may have defined in several ways."""
    tables = [growing.table() for growing in ways.values()]
    if len(tables) == 1:
        return tables[0]
    fields = [f for f in tables[0].columns if all(_alike(f, tables[0], other) for other in tables)]
    missing = sorted({f for table in tables for f in table.columns} - set(fields))
    if missing:
        what = f"{name} is defined in {len(ways)} ways; left out, as they are not alike in all: "
        problems.append(Problem(what=what + ", ".join(missing), note=True))
    offsets = np.concatenate([table.offsets for table in tables])
    order = np.argsort(offsets)
    columns = {f: np.concatenate([table.columns[f] for table in tables])[order] for f in fields}
    return Table(offsets[order], columns)


def _alike(f: str, one: Table, other: Table) -> bool:
    """Tell whether a field is in both tables, as numbers or as text or as arrays in both."""
    if f not in other.columns:
        return False
    a, b = one.columns[f], other.columns[f]
    return a.ndim == b.ndim and (a.dtype.kind == "U") == (b.dtype.kind == "U")
