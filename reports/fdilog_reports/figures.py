"""Where the lines and the bars of the two pictures go; the templates only put them there.

Widths run from 0 to `WIDE` and heights from 0 to `HIGH` whatever the size on screen, positions of
words are percentages: the pictures stretch to any width while words and strokes keep their size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import Analysis
from fdilog_reports.words import figure, flight_time

Floats = NDArray[np.float64]

WIDE, HIGH = 1000, 100
BINS = 500
"""Columns of a decimated line, two points in each: as many as there are dots on a screen."""
KNEE = 2.0
"""Multiple of the tolerance up to which rates are drawn to a linear scale."""
LEAST_WIDTH = 3.0
"""Narrowest shading of a finding, of `WIDE`: an impulse must not vanish."""


@dataclass(frozen=True, kw_only=True)
class Tick:
    """A word beside an axis, at a percentage of its length."""

    at: str
    label: str


@dataclass(frozen=True, kw_only=True)
class Span:
    """A stretch of time, from ``left`` over ``width`` of `WIDE`, of one state."""

    state: str
    left: str
    width: str
    title: str
    anchor: str = ""


@dataclass(frozen=True, kw_only=True)
class TimeAxis:
    """Flight time from left to right."""

    start_s: float
    end_s: float

    @classmethod
    def of(cls, analysis: Analysis) -> TimeAxis:
        """Span the table; a table of one sample or none gets a second, to have a width at all."""
        time_s = analysis.table.time_s
        start = float(time_s[0]) if len(time_s) else 0.0
        end = float(time_s[-1]) if len(time_s) else 0.0
        return cls(start_s=start, end_s=end if end > start else start + 1.0)

    def x(self, time_s: Floats | float) -> Floats:
        """Place times between 0 and `WIDE`; what lies outside goes to the nearer end."""
        share = (np.asarray(time_s, float) - self.start_s) / (self.end_s - self.start_s)
        return np.clip(share, 0.0, 1.0) * WIDE

    def ticks(self) -> tuple[Tick, ...]:
        """Round times, at most seven."""
        span = self.end_s - self.start_s
        steps = (factor * 10.0**power for power in range(-6, 9) for factor in (1, 2, 5))
        step = next((step for step in steps if span / step <= 6.0), span)
        first, last = math.ceil(self.start_s / step), math.floor(self.end_s / step)
        places = max(0, -math.floor(math.log10(step)))
        return tuple(
            Tick(at=f"{float(self.x(k * step)) * 100 / WIDE:.2f}", label=f"{k * step:.{places}f}")
            for k in range(first, last + 1)
        )

    def edges(self, analysis: Analysis, most: int) -> Floats:
        """Borders of bins wide enough to hold a sample of the slowest channel each."""
        table = analysis.table
        slowest = max((1.0 / c.rate_hz for c in table.channels if c.rate_hz > 0), default=0.0)
        step = 1.5 * max(table.period_s, slowest)
        fitting = (self.end_s - self.start_s) / step if step > 0 else 1.0
        bins = int(min(most, max(1.0, fitting)))
        return np.linspace(self.start_s, self.end_s, bins + 1)


@dataclass(frozen=True, kw_only=True)
class RateAxis:
    """Rates from bottom to top: linear up to twice the tolerance, logarithmic beyond.

    So the tolerance and what lies about it can be read beside a peak a thousand times as large.

    Parameters
    ----------
    tolerance, top
        What a failure is held against, and the largest rate to be drawn. [deg/s]
    """

    tolerance: float
    top: float

    @property
    def _knee(self) -> float:
        return KNEE * self.tolerance

    def y(self, rate: Floats | float) -> Floats:
        """Place rates [deg/s] between 0 (the largest) and `HIGH`."""
        size = np.abs(np.asarray(rate, float))
        if self.top <= KNEE * self._knee:
            share = size / self.top
        else:
            far = np.log(np.maximum(size, self._knee) / self._knee)
            share = 0.5 * np.minimum(size / self._knee, 1.0)
            share += 0.5 * far / math.log(self.top / self._knee)
        placed: Floats = HIGH / 2.0 * (1.0 - np.copysign(share, rate))
        return placed

    def round_rates(self) -> list[tuple[float, str]]:
        """Zero, the tolerance and round multiples of it, thinned so that words keep apart."""
        least = 12.0  # percent of the height that a line of small print takes
        rates, last = [0.0], HIGH / 2.0
        for multiple in (1.0, KNEE, *(10.0**power for power in range(1, 12))):
            at = float(self.y(self.tolerance * multiple))
            if at < 4.0:
                break
            if last - at >= least:
                rates.append(self.tolerance * multiple)
                last = at
        both = [*(-rate for rate in reversed(rates[1:])), *rates]
        return [(rate, figure(rate).replace("-", "\u2212")) for rate in both]

    def ticks(self) -> tuple[Tick, ...]:
        """Place the round rates."""
        return tuple(
            Tick(at=f"{float(self.y(rate)):.1f}", label=label) for rate, label in self.round_rates()
        )


def finding_spans(analysis: Analysis, axis: TimeAxis, channels: set[str]) -> tuple[Span, ...]:
    """Stretches in which findings name one of the channels, each with its finding's anchor."""
    spans = []
    for number, finding in enumerate(analysis.findings, start=1):
        if not channels.intersection(finding.suspects):
            continue
        left, right = (float(axis.x(time)) for time in (finding.start_s, finding.end_s))
        width = max(right - left, LEAST_WIDTH)
        spans.append(
            Span(
                state="failed" if finding.isolated else "suspect",
                left=f"{min(left, WIDE - width):.1f}",
                width=f"{width:.1f}",
                title=f"Finding {number}: {finding.kind} "
                f"{flight_time(finding.start_s, finding.end_s)}",
                anchor=f"finding-{number}",
            )
        )
    return tuple(spans)


def envelope(time_s: Floats, value: Floats, edges: Floats) -> Floats:
    """Reduce a line to its least and its greatest value per bin, so that no peak is lost.

    Parameters
    ----------
    time_s : (n_samples,)
        Increasing times. [s]
    value : (n_samples,)
        Values; NaN counts as missing. [any unit]
    edges : (n_bins + 1,)
        Borders of the bins; the last sample may lie on the last one. [s]

    Returns
    -------
    envelope : (2, n_bins)
        Least and greatest value; NaN where a bin holds none. [unit of value]
    """
    start = np.searchsorted(time_s, edges[:-1])
    stop = np.append(start[1:], len(time_s))
    line = np.full((2, len(start)), np.nan)
    filled = stop > start
    if not filled.any():
        return line
    missing = np.isnan(value)
    for row, reduce, neutral in ((0, np.minimum, np.inf), (1, np.maximum, -np.inf)):
        padded = np.where(missing, neutral, value)
        line[row, filled] = reduce.reduceat(padded, start[filled])
    line[~np.isfinite(line)] = np.nan
    return line


def outline(x: Floats, y: Floats) -> str:
    """Outline of an envelope, one closed path for each stretch without a gap."""
    known = np.isfinite(y[0])
    breaks = np.flatnonzero(np.diff(known)) + 1
    paths = []
    for stretch in np.split(np.arange(len(x)), breaks):
        if not known[stretch[0]]:
            continue
        there = [f"{a:.0f} {b:.1f}" for a, b in zip(x[stretch], y[1][stretch], strict=True)]
        back = [f"{a:.0f} {b:.1f}" for a, b in zip(x[stretch], y[0][stretch], strict=True)]
        paths.append("M" + "L".join([*there, *reversed(back)]) + "Z")
    return "".join(paths)
