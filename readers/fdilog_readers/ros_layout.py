"""Where the numbers are in a serialised ROS message: CDR of ROS 2, and the packed form of ROS 1.

A message type compiles to a few steps: blocks of fixed size, and lists whose length stands before
them. All messages of a batch take each step together; as long as their lists have the same length,
which is nearly always, the cursor is one number and a column is one strided copy.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.message_batch import Batch, Columns, Mask
from fdilog_readers.message_schema import NUMBERS, SEQUENCE, Field, Schema, UnknownTypeError

Cursor = int | NDArray[np.int64]
Order = Literal["<", ">"]

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

# A fixed array of structures longer than this is no place to look for a sensor.
MAX_UNROLLED = 4096
MAX_LIST_COLUMNS = 64
MAX_LOOPS = 4096


@dataclass
class _Block:
    """Bytes at fixed places, after the cursor has been aligned."""

    align: int
    size: int = 0
    leaves: list[tuple[str, str, int]] = field(default_factory=list)
    _records: dict[Order, np.dtype[Any]] = field(default_factory=dict, init=False, repr=False)

    def record(self, order: Order) -> np.dtype[Any]:
        """Return the block as a structure of its wanted leaves."""
        if order not in self._records:
            names, numbers, offsets = zip(*self.leaves, strict=True) if self.leaves else ((),) * 3
            formats = [_number_type(number, order) for number in numbers]
            self._records[order] = np.dtype(
                {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size}
            )
        return self._records[order]


@dataclass
class _Run:
    """A length, and so many elements of one fixed size; a string is a run of bytes."""

    size: int
    align: int
    leaf: str = ""
    number: str = ""


@dataclass
class _Loop:
    """A length, and so many elements whose own size varies."""

    steps: list[_Step]
    leaf: str = ""


@dataclass
class _Count:
    """A length that is the same in every message; the elements follow as steps of their own."""

    length: int


_Step = _Block | _Run | _Loop | _Count


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
        self._compiled: dict[int, tuple[list[_Step], bool]] = {}
        self._steps(1 if packed else 8)

    def _steps(self, max_align: int) -> tuple[list[_Step], bool]:
        """Return the steps, and whether they lead to the message's end."""
        if max_align not in self._compiled:
            steps = _Compiler(self._schema, self._wanted, max_align).compile(self._name)
            short = _without_costly_tail(steps)
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


class _Compiler:
    def __init__(self, schema: Schema, wanted: Collection[str], max_align: int) -> None:
        self.schema = schema
        self.wanted = wanted
        self.max_align = max_align
        self.steps: list[_Step] = []
        self.block = _Block(max_align)

    def compile(self, name: str) -> list[_Step]:
        self._type(name, "", ())
        self._close(1)
        return self.steps

    def _close(self, align: int) -> None:
        """End the block of fixed places; of what follows only this alignment is known."""
        if self.block.size:
            self.steps.append(self.block)
        self.block = _Block(align)

    def _type(self, name: str, path: str, above: tuple[str, ...]) -> None:
        if name in above:
            raise UnknownTypeError(f"{name} holds itself")
        fields = self.schema[name]
        if not fields and self.max_align > 1:
            self._number("uint8", "", 1)  # CDR has no empty structures
        for item in fields:
            self._field(item, f"{path}{item.name}", (*above, name))

    def _field(self, item: Field, path: str, above: tuple[str, ...]) -> None:
        if item.type in NUMBERS:
            if item.length == SEQUENCE:
                leaf = path if path in self.wanted else ""
                size = np.dtype(NUMBERS[item.type]).itemsize
                self._run(_Run(size, min(size, self.max_align), leaf, NUMBERS[item.type]))
            else:
                self._number(item.type, path, item.length)
        elif item.length == SEQUENCE:
            size, align = self._even(item.type)
            leaf = f"#{path}" if f"#{path}" in self.wanted else ""
            run = _Run(size, align, leaf) if size else _Loop(self._element(item.type, above), leaf)
            self._run(run)
        elif item.length is not None:
            if item.length > MAX_UNROLLED:
                raise UnknownTypeError(f"{path} is an array of {item.length} structures")
            if item.counted:
                self._run(_Count(item.length))
            for k in range(item.length):
                self._field(Field(item.name, item.type), f"{path}[{k}]", above)
        elif item.type == "string":
            self._run(_Run(1, 1))
        elif item.type in self.schema:
            self._type(item.type, f"{path}.", above)
        else:
            raise UnknownTypeError(f"{path} is of the type {item.type}")

    def _number(self, kind: str, path: str, length: int | None) -> None:
        size = np.dtype(NUMBERS[kind]).itemsize
        align = min(size, self.max_align)
        if align > self.block.align:
            self._close(align)
        if length == 0:
            return
        start = -(-self.block.size // align) * align
        if length is None:
            if path in self.wanted:
                self.block.leaves.append((path, NUMBERS[kind], start))
        else:
            for k in range(length) if path in self.wanted else ():
                self.block.leaves.append((f"{path}[{k}]", NUMBERS[kind], start + k * size))
        self.block.size = start + size * (1 if length is None else length)

    def _run(self, step: _Run | _Loop | _Count) -> None:
        self._close(1)
        self.steps.append(step)

    def _element(self, name: str, above: tuple[str, ...]) -> list[_Step]:
        inner = _Compiler(self.schema, (), self.max_align)
        inner.block = _Block(1)
        inner._field(Field("", name), "", above)
        inner._close(1)
        return inner.steps

    def _even(self, name: str) -> tuple[int, int]:
        """Return size and alignment of a type made of numbers of one size, else zeros.

        Only then do the elements of a list lie at equal distances wherever it begins.
        """
        sizes: list[int] = []
        if not self._collect_sizes(name, sizes, ()):
            return 0, 0
        aligns = {min(size, self.max_align) for size in sizes}
        return (sum(sizes), aligns.pop()) if len(aligns) == 1 else (0, 0)

    def _collect_sizes(self, name: str, sizes: list[int], above: tuple[str, ...]) -> bool:
        if name not in self.schema or name in above or not self.schema[name]:
            return False
        for item in self.schema[name]:
            count = 1 if item.length is None else item.length
            if count == SEQUENCE or len(sizes) + count > MAX_UNROLLED:
                return False
            if item.type in NUMBERS:
                sizes += [np.dtype(NUMBERS[item.type]).itemsize] * count
            else:
                for _ in range(count):
                    if not self._collect_sizes(item.type, sizes, (*above, name)):
                        return False
        return True


def _without_costly_tail(steps: list[_Step]) -> list[_Step]:
    """Leave out what follows the last wanted leaf if only a walk could tell how long it is."""
    wanted = [k for k, s in enumerate(steps) if getattr(s, "leaves", ()) or getattr(s, "leaf", "")]
    end = wanted[-1] + 1 if wanted else 0
    return steps[:end] if any(isinstance(s, _Loop) for s in steps[end:]) else steps


@cache
def _number_type(number: str, order: Order) -> np.dtype[Any]:
    return np.dtype(number).newbyteorder(order)


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

    def take(self, steps: list[_Step]) -> None:
        for step in steps:
            if isinstance(step, _Block):
                self._align(step.align)
                self._require(step.size)
                self._block(step)
                self.at = self.at + step.size
            elif isinstance(step, _Run):
                self._run(step)
            elif isinstance(step, _Loop):
                self._loop(step)
            else:
                self.fits &= self._count(1) == step.length

    def _block(self, step: _Block) -> None:
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
        kind = _number_type(number, self.order)
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

    def _run(self, step: _Run) -> None:
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

    def _list(self, step: _Run, count: Cursor) -> None:
        """Copy the elements of a list; those that a message lacks are not-a-number."""
        longest = int(np.max(count)) if len(self.batch) else 0
        for k in range(min(longest, MAX_LIST_COLUMNS)):
            values = self._read(step.number, k * step.size)
            if not isinstance(count, int):
                values = np.where(count > k, values.astype(np.float64), np.nan)
            self.columns[f"{step.leaf}[{k}]"] = values

    def _loop(self, step: _Loop) -> None:
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
