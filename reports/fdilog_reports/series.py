"""Lines small enough for a page: no peak is lost, and what lies about a finding is kept whole."""

from __future__ import annotations

import base64
import gzip
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

LEVEL = 9
"""Of gzip: a report is written once and sent often."""
FINEST_S = 1e-5
"""Times are kept to this; the fastest gyros are logged every 125 microseconds."""
LARGEST = 1e38
"""Larger values are no rates; they are drawn as this, which a browser's floats can hold."""
# The 12 bits kept of a float's 24 are a part in 4096, finer than a line on any screen.
_KEPT = np.uint32(0xFFFF_F000)
_HALF = np.uint32(0x0000_0800)


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """A decimated line.

    Parameters
    ----------
    time_s : (n,)
        Increasing times; the middle of what each point stands for. [s]
    low, high : (n,)
        Least and greatest value there; NaN where the line is broken. [any unit]
    """

    time_s: Floats
    low: Floats
    high: Floats


def decimate(
    time_s: Floats, low: Floats, high: Floats, most: int, places_s: Sequence[float] = ()
) -> Line:
    """Reduce a line, or a band between two, to about ``most`` points without losing a peak.

    Parameters
    ----------
    time_s : (n_samples,)
        Increasing times. [s]
    low, high : (n_samples,)
        Lower and upper edge, the same for a line; what is not finite counts as missing. [any unit]
    most
        Points to keep; a short line keeps all of its samples.
    places_s
        Times about which every sample is kept, as far as half of ``most`` goes. [s]
    """
    known = np.flatnonzero(np.isfinite(low) & np.isfinite(high))
    if not len(known):
        nothing = np.zeros(0)
        return Line(time_s=nothing, low=nothing, high=nothing)
    time_s, low, high = time_s[known], low[known], high[known]
    breaks = _breaks(time_s, max(1, most // 4))
    start = np.union1d(_starts(time_s, most, places_s), breaks)
    stop = np.append(start[1:], len(time_s))
    middle = (time_s[start] + time_s[stop - 1]) / 2.0
    least = np.minimum.reduceat(low, start)
    greatest = np.maximum.reduceat(high, start)
    at = np.searchsorted(start, breaks)
    return Line(
        time_s=np.insert(middle, at, (time_s[breaks - 1] + time_s[breaks]) / 2.0),
        low=np.insert(least, at, np.nan),
        high=np.insert(greatest, at, np.nan),
    )


def _starts(time_s: Floats, most: int, places_s: Sequence[float]) -> NDArray[np.int64]:
    """Choose the first samples of the points: half spread evenly, the others near the places."""
    n = len(time_s)
    if n <= most:
        return np.arange(n)
    even = most // 2 if places_s else most
    parts = [np.linspace(0, n, even, endpoint=False).astype(np.int64)]
    reach = (most - even) // (2 * max(1, len(places_s)))
    for place_s in places_s:
        at = int(np.searchsorted(time_s, place_s))
        parts.append(np.arange(max(0, at - reach), min(n, at + reach)))
    return np.unique(np.concatenate(parts))


def _breaks(time_s: Floats, most: int) -> NDArray[np.int64]:
    """Find samples before which nothing was recorded for long; of too many, the longest gaps."""
    step = np.diff(time_s)
    if not len(step):
        return np.zeros(0, np.int64)
    gaps = np.flatnonzero(step > 5.0 * np.median(step))
    if len(gaps) > most:
        gaps = np.sort(gaps[np.argsort(step[gaps])[-most:]])
    return gaps + 1


@dataclass(kw_only=True)
class Pack:
    """Arrays in one compressed block of text; equal arrays are kept once.

    Bytes of equal weight stand together, which is what makes numbers compress.

    Parameters
    ----------
    start_s, span_s
        Time that times are counted from, and how far they may be from it. [s]
    """

    start_s: float
    span_s: float
    lengths: list[tuple[str, int]] = field(default_factory=list)
    _blocks: dict[bytes, int] = field(default_factory=dict)

    @property
    def step_s(self) -> float:
        """What times are rounded to. [s]"""
        return max(FINEST_S, self.span_s / 2.0**31)

    def times(self, time_s: Floats) -> int:
        """Add increasing times and return their number in the pack."""
        ticks = np.round((time_s - self.start_s) / self.step_s)
        return self._add("time", np.diff(ticks, prepend=0.0).astype(np.uint32))

    def values(self, value: Floats) -> int:
        """Add values, rounded to a part in 4096, and return their number in the pack."""
        single = np.clip(value, -LARGEST, LARGEST).astype(np.float32)
        rounded = (single.view(np.uint32) + _HALF) & _KEPT
        return self._add("value", np.where(np.isnan(single), single.view(np.uint32), rounded))

    def _add(self, kind: str, array: NDArray[np.uint32]) -> int:
        planes = array.astype("<u4").view(np.uint8).reshape(-1, 4).T
        block = kind.encode() + planes.tobytes()
        if block not in self._blocks:
            self._blocks[block] = len(self.lengths)
            self.lengths.append((kind, len(array)))
        return self._blocks[block]

    def text(self) -> str:
        """Return all arrays, one after the other, as gzip in base64."""
        kinds = (kind for kind, _ in self.lengths)
        return compressed(
            b"".join(block[len(kind) :] for block, kind in zip(self._blocks, kinds, strict=True))
        )


def compressed(content: bytes) -> str:
    """Return gzip in base64; the same content gives the same text."""
    return base64.b64encode(gzip.compress(content, LEVEL, mtime=0)).decode()
