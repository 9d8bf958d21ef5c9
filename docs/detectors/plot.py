# ruff: noqa: INP001  beside a script, not in a package
"""A plot as SVG: lines, bands and spans over time; nothing but text is needed to write one."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape

import numpy as np
from numpy.typing import NDArray

from fdilog_reports.figures import envelope

Floats = NDArray[np.float64]

WIDE, HIGH = 720, 220
LEFT, RIGHT, TOP, BOTTOM = 56, 14, 30, 24
BINS = 320
ACCUSED, OTHER, ONE, ANOTHER = "#cf222e", "#8c959f", "#0969da", "#8250df"
INK, GRID, FAULT = "#24292f", "#e6e8eb", "#fff1c9"


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A statistic over time; where `high` is given, an interval from `value` to it."""

    time_s: Floats
    value: Floats
    word: str = ""
    colour: str = OTHER
    high: Floats | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Panel:
    """One plot.

    Parameters
    ----------
    faults
        Spans in which the sample log has its fault, shaded. [s]
    levels
        What the statistic is held against, dashed, with a word.
    marks
        Spans that the detector accuses, as bars at the bottom. [s]
    logarithmic
        Whether the ordinate is.
    """

    title: str
    unit: str
    lines: list[Line]
    faults: list[tuple[float, float]]
    levels: list[tuple[float, str]] = field(default_factory=list)
    marks: list[tuple[float, float]] = field(default_factory=list)
    logarithmic: bool = False
    least: float | None = None
    most: float | None = None


def svg(panels: list[Panel]) -> str:
    """Draw panels one below the other."""
    height = HIGH * len(panels)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDE} {height}" width="{WIDE}"',
        f' height="{height}" font-family="sans-serif" font-size="11" fill="{INK}">',
        f'<rect width="{WIDE}" height="{height}" fill="#ffffff"/>',
    ]
    for number, panel in enumerate(panels):
        parts.append(f'<g transform="translate(0,{number * HIGH})">')
        parts += _panel(panel, timed=number == len(panels) - 1)
        parts.append("</g>")
    return "\n".join([*parts, "</svg>"]) + "\n"


class _Scales:
    """Where times and values go."""

    def __init__(self, panel: Panel) -> None:
        self.logarithmic = panel.logarithmic
        times = np.concatenate([line.time_s for line in panel.lines])
        self.first, self.last = float(times.min()), float(times.max())
        values = [np.asarray(v) for v, _ in panel.levels]
        for line in panel.lines:
            values += [line.value] if line.high is None else [line.value, line.high]
        known = np.concatenate([np.atleast_1d(v) for v in values])
        known = self.shown(known[np.isfinite(known)])
        known = known[np.isfinite(known)]
        low = float(known.min()) if panel.least is None else float(self.shown(panel.least))
        high = float(known.max()) if panel.most is None else float(self.shown(panel.most))
        margin = 0.06 * ((high - low) or 1.0)
        self.low = low - margin if panel.least is None else low
        self.high = high + margin if panel.most is None else high

    def shown(self, value: Floats | float) -> Floats:
        """Value, or its logarithm."""
        v = np.asarray(value, float)
        if not self.logarithmic:
            return v
        return np.log10(np.where(v > 0, v, np.nan))

    def x(self, time_s: Floats | float) -> Floats:
        """Abscissa."""
        share = (np.asarray(time_s, float) - self.first) / (self.last - self.first)
        return LEFT + np.clip(share, 0.0, 1.0) * (WIDE - LEFT - RIGHT)

    def y(self, value: Floats | float) -> Floats:
        """Ordinate; what lies beyond the plot is held at its edge."""
        share = (self.shown(value) - self.low) / (self.high - self.low)
        return HIGH - BOTTOM - np.clip(share, -0.01, 1.01) * (HIGH - TOP - BOTTOM)

    def ticks(self) -> list[tuple[float, str]]:
        """Round values."""
        if self.logarithmic:
            powers = range(math.ceil(self.low), math.floor(self.high) + 1)
            step = max(1, -(-len(powers) // 5))
            return [(10.0**p, f"{10.0**p:g}") for p in powers[::step]]
        return [(v, f"{v:g}".replace("-", "−")) for v in _round(self.low, self.high, 5)]


def _round(low: float, high: float, most: int) -> list[float]:
    steps = (f * 10.0**p for p in range(-6, 9) for f in (1, 2, 5))
    step = next(s for s in steps if (high - low) / s <= most)
    ticks = range(math.ceil(low / step), math.floor(high / step) + 1)
    return [round(k * step, 9) for k in ticks]


def _panel(panel: Panel, *, timed: bool) -> list[str]:
    scales = _Scales(panel)
    floor, right = HIGH - BOTTOM, WIDE - RIGHT
    parts = [
        f'<text x="{LEFT}" y="14" font-weight="bold">{escape(panel.title)}</text>',
        f'<text x="{LEFT - 6}" y="{TOP - 4}" text-anchor="end">{escape(panel.unit)}</text>',
    ]
    for start, end in panel.faults:
        x, wide = float(scales.x(start)), float(scales.x(end) - scales.x(start))
        parts.append(
            f'<rect x="{x:.1f}" y="{TOP}" width="{max(wide, 2.0):.1f}" height="{floor - TOP}"'
            f' fill="{FAULT}"/>'
        )
    for value, word in scales.ticks():
        y = float(scales.y(value))
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{right}" stroke="{GRID}"/>'
            f'<text x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{word}</text>'
        )
    parts += [
        f'<text x="{float(scales.x(t)):.1f}" y="{HIGH - 8}" text-anchor="middle">{t:g} s</text>'
        for t in (_round(scales.first, scales.last, 8) if timed else ())
    ]
    parts += [text for line in panel.lines for text in _line(line, scales)]
    for value, word in panel.levels:
        y = float(scales.y(value))
        parts.append(
            f'<path d="M{LEFT} {y:.1f}H{right}" stroke="{INK}" stroke-dasharray="5 4"/>'
            f'<text x="{right - 2}" y="{y - 3:.1f}" text-anchor="end">{escape(word)}</text>'
        )
    for start, end in panel.marks:
        x, wide = float(scales.x(start)), float(scales.x(end) - scales.x(start))
        parts.append(
            f'<rect x="{x:.1f}" y="{floor - 5}" width="{max(wide, 2.0):.1f}" height="5"'
            f' fill="{ACCUSED}"/>'
        )
    parts.append(f'<path d="M{LEFT} {TOP}V{floor}H{right}" fill="none" stroke="{INK}"/>')
    return [*parts, *_legend(panel)]


def _line(line: Line, scales: _Scales) -> list[str]:
    if line.high is not None:
        known = np.isfinite(line.value) & np.isfinite(line.high)
        parts = np.split(np.arange(len(known)), np.flatnonzero(np.diff(known)) + 1)
        return [
            f'<path d="{_outline(scales, line.time_s[at], line.value[at], line.high[at])}"'
            f' fill="{line.colour}" fill-opacity="0.35" stroke="{line.colour}"/>'
            for at in parts
            if known[at[0]]
        ]
    time_s, value = line.time_s, line.value
    if len(time_s) > 2 * BINS:
        edges = np.linspace(scales.first, scales.last, BINS + 1)
        low, high = envelope(time_s, value, edges)
        time_s, value = (
            np.repeat((edges[:-1] + edges[1:]) / 2, 2),
            np.column_stack([low, high]).ravel(),
        )
    known = np.isfinite(scales.shown(value))
    parts = np.split(np.arange(len(known)), np.flatnonzero(np.diff(known)) + 1)
    drawn = [_points(scales, time_s[at], value[at]) for at in parts if len(at) and known[at[0]]]
    return [f'<path d="M{"M".join(drawn)}" fill="none" stroke="{line.colour}"/>'] if drawn else []


def _points(scales: _Scales, time_s: Floats, value: Floats) -> str:
    x, y = scales.x(time_s), scales.y(value)
    return "L".join(f"{a:.1f} {b:.1f}" for a, b in zip(x, y, strict=True))


def _outline(scales: _Scales, time_s: Floats, low: Floats, high: Floats) -> str:
    return f"M{_points(scales, time_s, high)}L{_points(scales, time_s[::-1], low[::-1])}Z"


def _legend(panel: Panel) -> list[str]:
    words = [(line.word, line.colour) for line in panel.lines if line.word]
    if panel.marks:
        words.append(("accused", ACCUSED))
    parts, x = [], WIDE - RIGHT
    for word, colour in reversed(words):
        x -= 14 + round(6.2 * len(word))
        parts.append(
            f'<rect x="{x}" y="20" width="8" height="4" fill="{colour}"/>'
            f'<text x="{x + 11}" y="25">{escape(word)}</text>'
        )
    return parts
