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
        found = _Found(frozenset(also))
        for batch in framing.batches():
            found.take(batch)
        size = max(blocks.end, blocks.size)
    if not framing.formats:
        raise UnreadableLogError(
            f"{path}: no FMT record ({MAGIC.hex(' ')} {FMT_TYPE:02x}) in {size} bytes: this is no"
            " DataFlash log, or the beginning, which says what its records hold, is lost"
        )
    problems = framing.problems + found.problems()
    tables = {name: _table(name, found.parts.pop(name), problems) for name in sorted(found.parts)}
    return recording(
        path,
        tables,
        form="dataflash",
        size=size,
        layouts=framing.layouts,
        counts=found.counts,
        problems=problems,
    )


_Part = tuple[Layout, Offsets, NDArray[Any]]


@dataclass
class _Found:
    """Records of the wanted types, and how many there are of all."""

    also: frozenset[str]
    parts: dict[str, list[_Part]] = field(default_factory=dict)
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
        gathered = rows(batch.buffer, offsets, layout.dtype)
        self.parts.setdefault(name, []).append((layout, batch.start + offsets, gathered))

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


def _table(name: str, parts: list[_Part], problems: list[Problem]) -> Table:
    """Join the pieces of one name, of one layout or several."""
    layouts = list(dict.fromkeys(layout for layout, _, _ in parts))
    fields = [f for f in layouts[0].fields if all(f in other.fields for other in layouts)]
    missing = sorted({f for layout in layouts for f in layout.fields} - set(fields))
    if missing:
        what = f"{name} is defined in {len(layouts)} ways; left out, as they are not in all: "
        problems.append(Problem(what=what + ", ".join(missing), note=True))
    offsets = np.concatenate([at for _, at, _ in parts])
    columns = {
        f: np.concatenate([physical(layout.character(f), rows_[f]) for layout, _, rows_ in parts])
        for f in fields
    }
    if len(layouts) > 1:
        order = np.argsort(offsets, kind="stable")
        offsets, columns = offsets[order], {f: column[order] for f, column in columns.items()}
    return Table(offsets, columns)
