"""From a ROS message type to the few steps in which its messages are walked through."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Literal

import numpy as np

from fdilog_readers.message_schema import NUMBERS, SEQUENCE, Field, Schema, UnknownTypeError

Order = Literal["<", ">"]

# A fixed array of structures longer than this is no place to look for a sensor.
MAX_UNROLLED = 4096


@dataclass
class Block:
    """Bytes at fixed places, after the cursor has been aligned."""

    align: int
    size: int = 0
    leaves: list[tuple[str, str, int]] = field(default_factory=list)
    _records: dict[Order, np.dtype[Any]] = field(default_factory=dict, init=False, repr=False)

    def record(self, order: Order) -> np.dtype[Any]:
        """Return the block as a structure of its wanted leaves."""
        if order not in self._records:
            names, numbers, offsets = zip(*self.leaves, strict=True) if self.leaves else ((),) * 3
            formats = [number_type(number, order) for number in numbers]
            self._records[order] = np.dtype(
                {"names": names, "formats": formats, "offsets": offsets, "itemsize": self.size}
            )
        return self._records[order]


@dataclass
class Run:
    """A length, and so many elements of one fixed size; a string is a run of bytes."""

    size: int
    align: int
    leaf: str = ""
    number: str = ""


@dataclass
class Loop:
    """A length, and so many elements whose own size varies."""

    steps: list[Step]
    leaf: str = ""


@dataclass
class Count:
    """A length that is the same in every message; the elements follow as steps of their own."""

    length: int


Step = Block | Run | Loop | Count


class Compiler:
    """Compiles one type for one rule of alignment.

    Parameters
    ----------
    wanted
        The leaves that are to be read; everything else is only stepped over.
    max_align
        How far numbers are aligned at most; 1 for no alignment at all. [byte]
    """

    def __init__(self, schema: Schema, wanted: Collection[str], max_align: int) -> None:
        self.schema = schema
        self.wanted = wanted
        self.max_align = max_align
        self.steps: list[Step] = []
        self.block = Block(max_align)

    def compile(self, name: str) -> list[Step]:
        """Return the steps from a message's beginning to its end.

        Raises
        ------
        UnknownTypeError
            If it holds something whose size nobody can tell.
        """
        self._type(name, "", ())
        self._close(1)
        return self.steps

    def _close(self, align: int) -> None:
        """End the block of fixed places; of what follows only this alignment is known."""
        if self.block.size:
            self.steps.append(self.block)
        self.block = Block(align)

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
                self._run(Run(size, min(size, self.max_align), leaf, NUMBERS[item.type]))
            else:
                self._number(item.type, path, item.length)
        elif item.length == SEQUENCE:
            size, align = self._even(item.type)
            leaf = f"#{path}" if f"#{path}" in self.wanted else ""
            run = Run(size, align, leaf) if size else Loop(self._element(item.type, above), leaf)
            self._run(run)
        elif item.length is not None:
            if item.length > MAX_UNROLLED:
                raise UnknownTypeError(f"{path} is an array of {item.length} structures")
            if item.counted:
                self._run(Count(item.length))
            for k in range(item.length):
                self._field(Field(item.name, item.type), f"{path}[{k}]", above)
        elif item.type == "string":
            self._run(Run(1, 1))
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

    def _run(self, step: Run | Loop | Count) -> None:
        self._close(1)
        self.steps.append(step)

    def _element(self, name: str, above: tuple[str, ...]) -> list[Step]:
        inner = Compiler(self.schema, (), self.max_align)
        inner.block = Block(1)
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


def without_costly_tail(steps: list[Step]) -> list[Step]:
    """Leave out what follows the last wanted leaf if only a walk could tell how long it is."""
    wanted = [k for k, s in enumerate(steps) if getattr(s, "leaves", ()) or getattr(s, "leaf", "")]
    end = wanted[-1] + 1 if wanted else 0
    return steps[:end] if any(isinstance(s, Loop) for s in steps[end:]) else steps


@cache
def number_type(number: str, order: Order) -> np.dtype[Any]:
    """Return a number's type with a byte order."""
    return np.dtype(number).newbyteorder(order)
