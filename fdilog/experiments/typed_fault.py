"""Faults as people type them: in deg/s, deg/s per second, as a factor, or without a size."""

from __future__ import annotations

import math
from typing import get_args

from fdilog.errors import UsageError, nearest
from fdilog.experiments.faults import KINDS, MAY_HAVE_NO_SIZE, SIZE_UNITS, Fault, FaultKind

SHAPE = "kind:channel:start:end[:size[:count]]"
"""How a fault is written in one word; an empty end is that of the flight."""

TYPED_UNITS = {"rad/s": "deg/s", "rad/s^2": "deg/s per second", "1": "factor", "rad": "deg"}
"""Unit in which people give a size, for each unit of `SIZE_UNITS`."""


def typed_fault(
    kind: str,
    channel: str,
    start_s: float,
    end_s: float = math.inf,
    *,
    size: float | None = None,
    count: int = 1,
) -> Fault:
    """Make a fault of the numbers that a person typed.

    Parameters
    ----------
    size
        In the kind's unit of `TYPED_UNITS`.

    Raises
    ------
    UsageError
        If the kind is unknown, or the numbers make no sense for it; the text names the unit typed.
    """
    if kind not in KINDS:
        raise UsageError(f"no fault of kind '{kind}'{nearest(kind, list(KINDS))}")
    known: FaultKind = next(one for one in get_args(FaultKind) if one == kind)
    unit = SIZE_UNITS.get(kind)
    needed = unit is not None and (size is not None or kind not in MAY_HAVE_NO_SIZE)
    if needed and (size is None or not math.isfinite(size)):
        raise UsageError(f"{kind} of {channel}: needs a size [{TYPED_UNITS[unit or '']}]")
    in_degrees = size is not None and (unit or "").startswith("rad")
    return Fault(
        kind=known,
        channel=channel,
        start_s=start_s,
        end_s=end_s,
        size=math.radians(size) if in_degrees and size is not None else size,
        count=count,
    )


def parsed_fault(text: str) -> Fault:
    """Make a fault of one word in the form of `SHAPE`.

    Raises
    ------
    UsageError
        If the word has another form, or as for `typed_fault`.
    """
    kind, *rest = text.split(":")
    if not 3 <= len(rest) <= 5:
        raise UsageError(f"fault '{text}': must be {SHAPE}")
    channel, start, end, *size_and_count = rest
    size, count = [*size_and_count, "", ""][:2]
    return typed_fault(
        kind,
        channel,
        _number(text, "start", start or "0"),
        _number(text, "end", end) if end else math.inf,
        size=_number(text, "size", size) if size else None,
        count=_count(text, count) if count else 1,
    )


def _number(text: str, what: str, word: str) -> float:
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if math.isnan(number):
        raise UsageError(f"fault '{text}': {what} '{word}' is no number; must be {SHAPE}")
    return number


def _count(text: str, word: str) -> int:
    if not word.isdecimal():
        raise UsageError(f"fault '{text}': count '{word}' is no whole number; must be {SHAPE}")
    return int(word)
