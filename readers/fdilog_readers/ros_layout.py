"""Where the numbers are in a serialised ROS message: CDR of ROS 2, and the packed form of ROS 1.

A message type compiles to a few steps: blocks of fixed size, and lists whose length stands before
them. All messages of a batch take each step together; as long as their lists have the same length,
which is nearly always, the cursor is one number and a column is one strided copy.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.message_batch import Batch, Columns, Mask
from fdilog_readers.message_schema import Schema
from fdilog_readers.ros_steps import (
    Block,
    Compiler,
    Loop,
    Order,
    Run,
    Step,
    number_type,
    without_costly_tail,
)

Cursor = int | NDArray[np.int64]

# Second byte of the four before a CDR message (DDS-XTypes 1.3, table 59): byte order, and how far
# numbers are aligned. What is not here (parameter lists, delimited types) ROS does not write.
ENCAPSULATIONS: dict[int, tuple[Order, int]] = {
    0: (">", 8),
    1: ("<", 8),
    6: (">", 4),
    7: ("<", 4),
}
CDR_HEAD = 4

# ROS 2 can compress every message by itself. It then begins with this, which CDR cannot.
ZSTD_MAGIC = 0xFD2FB528
# So much may come of one message, and of the messages of one batch together.
MESSAGE_BYTES = 16 << 20
BATCH_BYTES = 64 << 20

MAX_LIST_COLUMNS = 64
MAX_LOOPS = 4096


class RosLayout:
    """Reads some leaves of one message type.

    Parameters
    ----------
    wanted
        Dotted paths: ``imu.angular_velocity.x``, ``data[2]``; the path of a list of numbers alone
        means every element, and ``#imus`` the length of a list of structures.
    packed
        ROS 1 serialisation: no alignment, no encapsulation.
    """

    batch_bytes = 1 << 18

    def __init__(self, schema: Schema, name: str, wanted: Collection[str], *, packed: bool) -> None:
        self._schema = schema
        self._name = name
        self._wanted = {leaf.rpartition("[")[0] if leaf.endswith("]") else leaf for leaf in wanted}
        self._packed = packed
        self._compiled: dict[int, tuple[list[Step], bool]] = {}
        self._steps(1 if packed else 8)

    def _steps(self, max_align: int) -> tuple[list[Step], bool]:
        """Return the steps, and whether they lead to the message's end."""
        if max_align not in self._compiled:
            steps = Compiler(self._schema, self._wanted, max_align).compile(self._name)
            short = without_costly_tail(steps)
            self._compiled[max_align] = (short, len(short) == len(steps))
        return self._compiled[max_align]

    def _walk(self, batch: Batch, head: int, order: Order, max_align: int) -> tuple[Columns, Mask]:
        steps, to_the_end = self._steps(max_align)
        walk = _Walk(batch, head, order, max_align)
        walk.take(steps)
        # A message in CDR may be padded to a multiple of four.
        return walk.finish((0 if self._packed else 3) if to_the_end else None)

    def columns(self, batch: Batch) -> tuple[Columns, Mask]:
        """Read the wanted leaves of all messages; see ``Layout``."""
        if self._packed:
            return self._walk(batch, 0, "<", 1)
        if len(batch) and batch.rows.shape[1] > batch.lead + CDR_HEAD:
            packed = batch.at(0, np.dtype("<u4")) == ZSTD_MAGIC
            if packed.any():
                return self._encapsulated(_decompressed(batch, packed))
        return self._encapsulated(batch)

    def _encapsulated(self, batch: Batch) -> tuple[Columns, Mask]:
        if batch.rows.shape[1] < batch.lead + CDR_HEAD:
            return {}, np.zeros(len(batch), np.bool_)
        kinds = batch.at(1, np.dtype(np.uint8))
        present = np.unique(kinds).tolist()
        if len(present) == 1:
            return self._one_encapsulation(batch, present[0])
        columns: Columns = {}
        fits = np.zeros(len(batch), np.bool_)
        for kind in present:
            here = kinds == kind
            part, part_fits = self._one_encapsulation(batch.select(here), kind)
            fits[here] = part_fits
            for leaf, values in part.items():
                whole = columns.setdefault(leaf, np.zeros(len(batch), values.dtype))
                columns[leaf] = whole.astype(np.result_type(whole, values), copy=False)
                columns[leaf][here] = values
        return columns, fits

    def _one_encapsulation(self, batch: Batch, kind: int) -> tuple[Columns, Mask]:
        if kind not in ENCAPSULATIONS:
            return {}, np.zeros(len(batch), np.bool_)
        return self._walk(batch, CDR_HEAD, *ENCAPSULATIONS[kind])


class _Walk:
    """All messages of a batch, walked through together."""

    def __init__(self, batch: Batch, head: int, order: Order, max_align: int) -> None:
        self.batch = batch
        self.head = head
        self.order = order
        self.max_align = max_align
        self.room = batch.lengths - head
        self.at: Cursor = 0
        self.fits: Mask = self.room >= 0
        self.columns: Columns = {}
        self._row_starts: NDArray[np.int64] | None = None

    def take(self, steps: list[Step]) -> None:
        for step in steps:
            if isinstance(step, Block):
                self._align(step.align)
                self._require(step.size)
                self._block(step)
                self.at = self.at + step.size
            elif isinstance(step, Run):
                self._run(step)
            elif isinstance(step, Loop):
                self._loop(step)
            else:
                self.fits &= self._count(1) == step.length

    def _block(self, step: Block) -> None:
        rows = self.batch.rows
        if not isinstance(self.at, int) or (
            self.batch.lead + self.head + self.at + step.size > rows.shape[1]
        ):
            for leaf, number, offset in step.leaves:
                self.columns[leaf] = self._read(number, offset)
            return
        records = self.batch.at(self.head + self.at, step.record(self.order))
        for leaf, number, _ in step.leaves:
            # Copied first, as it is: conversion of what is not aligned takes many times longer.
            self.columns[leaf] = records[leaf].copy().astype(number, copy=False)

    def finish(self, padding: int | None) -> tuple[Columns, Mask]:
        """Check that the messages end where their type does, up to some padding."""
        self._require(0)
        if padding is not None:
            self.fits &= self.at + padding >= self.room
        return self.columns, self.fits

    def _align(self, size: int) -> None:
        if size > 1:
            self.at = (self.at + (size - 1)) & -size

    def _require(self, size: int) -> None:
        self.fits &= self.at + size <= self.room

    def _read(self, number: str, offset: int) -> NDArray[Any]:
        """Copy the number that lies at this distance from every message's cursor."""
        kind = number_type(number, self.order)
        rows = self.batch.rows
        if isinstance(self.at, int):
            place = self.head + self.at + offset
            if self.batch.lead + place + kind.itemsize > rows.shape[1]:
                return np.zeros(len(rows), number)  # no message is that long: none of them fits
            return self.batch.at(place, kind).copy().astype(number, copy=False)
        if self._row_starts is None:
            first = self.batch.lead + self.head
            self._row_starts = np.arange(len(rows), dtype=np.int64) * rows.shape[1] + first
        last = rows.size - kind.itemsize
        if last < 0:
            return np.zeros(len(rows), number)
        places = np.clip(self._row_starts + (self.at + offset), 0, last)
        everywhere = np.ndarray((last + 1,), np.dtype((np.void, kind.itemsize)), rows, 0, (1,))
        values: NDArray[Any] = everywhere[places].view(kind).astype(number, copy=False)
        return values

    def _count(self, smallest: int) -> Cursor:
        """Read the length of a list, of elements of this size at least."""
        if self.max_align > 1:
            self._align(4)
        self._require(4)
        counts = self._read("uint32", 0).astype(np.int64)
        self.at = self.at + 4
        self.fits &= self.at + counts * smallest <= self.room
        if not self.fits.all():
            counts[~self.fits] = 0
        first = int(counts[0]) if len(counts) else 0
        return first if (counts == first).all() else counts

    def _run(self, step: Run) -> None:
        count = self._count(step.size)
        if isinstance(count, int):
            if count:
                self._align(step.align)
        elif step.align > 1:
            before = self.at
            self._align(step.align)
            self.at = np.where(count > 0, self.at, before)
        if step.leaf:
            self._note(step.leaf, count) if not step.number else self._list(step, count)
        self.at = self.at + count * step.size

    def _note(self, leaf: str, count: Cursor) -> None:
        self.columns[leaf] = np.broadcast_to(np.asarray(count, np.int64), len(self.batch))

    def _list(self, step: Run, count: Cursor) -> None:
        """Copy the elements of a list; those that a message lacks are not-a-number."""
        longest = int(np.max(count)) if len(self.batch) else 0
        for k in range(min(longest, MAX_LIST_COLUMNS)):
            values = self._read(step.number, k * step.size)
            if not isinstance(count, int):
                values = np.where(count > k, values.astype(np.float64), np.nan)
            self.columns[f"{step.leaf}[{k}]"] = values

    def _loop(self, step: Loop) -> None:
        count = self._count(1)
        if step.leaf:
            self._note(step.leaf, count)
        self.fits &= count <= MAX_LOOPS
        for k in range(min(int(np.max(count)), MAX_LOOPS)):
            here = (count > k) & self.fits
            if not here.any():
                return
            before, fitted = self.at, self.fits.copy()
            self.take(step.steps)
            if not isinstance(count, int):
                self.at = np.where(count > k, self.at, before)
                self.fits = np.where(count > k, self.fits, fitted)


def _decompressed(batch: Batch, packed: Mask) -> Batch:
    """Decompress messages one by one; what does not decompress, or to too much, becomes empty."""
    import zstandard

    tool = zstandard.ZstdDecompressor()
    messages: list[bytes] = []
    room = BATCH_BYTES
    for row, length, is_packed in zip(batch.rows, batch.lengths.tolist(), packed, strict=True):
        raw = row[batch.lead : batch.lead + length].tobytes()
        if is_packed:
            try:
                promised = zstandard.get_frame_parameters(raw).content_size
                raw = tool.decompress(raw) if promised <= min(MESSAGE_BYTES, room) else b""
            except zstandard.ZstdError:
                raw = b""
            room -= len(raw)
        messages.append(raw)
    lengths = np.array([len(message) for message in messages], np.int64)
    # One long message would make every row as long: it cannot be a sensor's.
    width = min(int(lengths.max()), max(BATCH_BYTES // len(messages), CDR_HEAD))
    text = b"".join(message[:width].ljust(width, b"\0") for message in messages)
    rows = np.frombuffer(text, np.uint8).reshape(len(messages), width)
    return Batch(rows, 0, np.where(lengths <= width, lengths, 0))
