"""The picture on a finding's card: its interval beside the tolerance, on one line of numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fdilog.config import Tolerance
from fdilog.finding import Finding
from fdilog_reports.words import DEG_PER_RAD, figure

ROOM = 0.06
"""Share of the width that stays free at either end."""

APART = 6.0
"""Numbers that are nearer to one another, in percent of the width, would be printed over each
other."""


@dataclass(frozen=True, kw_only=True)
class SizeBar:
    """Positions in percent of the width; an open end reaches the border.

    ``tolerated`` and ``interval`` are left end and width, ``marks`` are numbers to print.
    """

    tolerated: tuple[str, str]
    interval: tuple[str, str]
    estimate: str
    marks: tuple[tuple[str, str], ...]
    unit: str


def size_bar(finding: Finding, tolerance: Tolerance, *, flipped: bool = False) -> SizeBar | None:
    """Place a finding's size, if it has one in the unit of the tolerance it is held against.

    ``flipped`` draws its negative, where that is what the words beside it give.
    """
    size = finding.size
    if size is None or not math.isfinite(size.estimate):
        return None
    scale, unit, low, high = _tolerated(finding.kind, tolerance)
    if not unit:
        return None
    scale = -scale if flipped else scale
    ends = sorted(scale * end for end in (size.low, size.high))
    known = [end for end in (*ends, scale * size.estimate, low, high) if math.isfinite(end)]
    least, most = min(known), max(known)
    room = ROOM * (most - least) or 1.0
    left, width = least - room, most - least + 2.0 * room

    def at(value: float) -> float:
        return min(max(100.0 * (value - left) / width, 0.0), 100.0)

    def bar(start: float, end: float) -> tuple[str, str]:
        return f"{at(start):.1f}", f"{max(at(end) - at(start), 0.6):.1f}"

    return SizeBar(
        tolerated=bar(low, high),
        interval=bar(*ends),
        estimate=f"{at(scale * size.estimate):.1f}",
        marks=(
            ((f"{at((low + high) / 2.0):.1f}", f"{_printed(low)} to {_printed(high)}"),)
            if at(high) - at(low) < APART
            else ((f"{at(low):.1f}", _printed(low)), (f"{at(high):.1f}", _printed(high)))
        ),
        unit=unit,
    )


def _printed(value: float) -> str:
    return figure(value).replace("-", "\u2212")


def _tolerated(kind: str, tolerance: Tolerance) -> tuple[float, str, float, float]:
    """Return the factor from SI, the unit, and the ends of what is tolerated in that unit."""
    if kind in {"bias", "impulse"}:
        limit = tolerance.bias_deg_s if kind == "bias" else tolerance.impulse_deg_s
        return DEG_PER_RAD, "deg/s", -limit, limit
    if kind == "scale":
        limit = 100.0 * tolerance.scale
        return 100.0, "% of the rate", 100.0 - limit, 100.0 + limit
    if kind == "noise":
        return 1.0, "times", 1.0, tolerance.noise_factor
    if kind == "dropout":
        return 1.0, "s", 0.0, tolerance.dropout_s
    return 1.0, "", 0.0, 0.0
