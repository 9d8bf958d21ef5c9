"""What the pictures are drawn from: every channel against its peers, and the intervals for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import Analysis
from fdilog.finding import Evidence
from fdilog.maths.geometry import leave_one_out
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Residual:
    """One channel's reading minus what its peers predict.

    Parameters
    ----------
    channel
        Column of the table.
    peers
        Columns that predict it wherever all of them are valid.
    value : (n_samples,)
        Residual; NaN where nothing predicts the channel. [rad/s]
    """

    channel: int
    peers: tuple[int, ...]
    value: Floats


def residuals(analysis: Analysis) -> list[Residual]:
    """Compare every gyro channel with its peers, sample by sample.

    Channels that are found to have failed, and derived ones, predict nothing as long as the others
    suffice. Channels that nothing predicts are left out.
    """
    table = analysis.table
    failed = {i for i, status in enumerate(analysis.status) if status == "failed"}
    derived = {i for i, channel in enumerate(table.channels) if channel.derived}
    if not table.channels:
        return []
    value = np.full((len(table.channels), len(table.time_s)), np.nan)
    for present, rows in _stretches(table):
        if not present.any():
            continue
        kept = np.flatnonzero(present)
        weight = _weights(table.axes[kept], _among(kept, failed), _among(kept, derived))
        value[np.ix_(kept, rows)] = weight @ table.rate_rad_s[np.ix_(rows, kept)].T
    every = _weights(table.axes, failed, derived)
    found = []
    for i in range(len(table.channels)):
        if i in derived or not np.isfinite(value[i]).any():
            continue
        peers = np.flatnonzero(np.abs(np.nan_to_num(every[i])) > 1e-9)
        found.append(
            Residual(channel=i, peers=tuple(int(j) for j in peers if j != i), value=value[i])
        )
    return found


def _among(kept: NDArray[np.intp], columns: set[int]) -> set[int]:
    return {place for place, column in enumerate(kept) if int(column) in columns}


def mirrored(members: Sequence[int], series: dict[int, Residual]) -> bool:
    """Whether two channels have only one another: one residual is the other's negative."""
    if len(members) != 2:
        return False
    first, second = members
    return series[first].peers == (second,) and series[second].peers == (first,)


def _stretches(table: ChannelTable) -> list[tuple[NDArray[np.bool_], NDArray[np.intp]]]:
    """Group the rows by which channels are valid in them: (valid channels, rows) of each group."""
    if not len(table.time_s):
        return []
    packed = np.packbits(table.valid, axis=1)
    code = packed.astype(np.int64) @ (256 ** np.arange(packed.shape[1]))
    return [
        (table.valid[rows[0]], rows)
        for rows in (np.flatnonzero(code == pattern) for pattern in np.unique(code))
    ]


def _weights(axes: Floats, failed: set[int], derived: set[int]) -> Floats:
    """Rows of leave-one-out, each from the best peers that determine it; NaN if none do."""
    weight = np.full((len(axes), len(axes)), np.nan)
    for removed in (failed | derived, failed, set[int]()):
        missing = np.isnan(weight).any(axis=1)
        if missing.any():
            weight[missing] = leave_one_out(axes, sorted(removed))[missing]
    return weight


@dataclass(frozen=True, kw_only=True, eq=False)
class Intervals:
    """One detector's intervals for one channel's error, over windows of one length.

    Parameters
    ----------
    middle_s, low, high, tolerance : (n_windows,)
        Middle of each window [s], interval of the error and what it is held against. [rad/s]
    """

    detector: str
    length_s: float
    confidence: float
    middle_s: Floats
    low: Floats
    high: Floats
    tolerance: Floats

    @property
    def beyond(self) -> NDArray[np.bool_]:
        """Windows whose interval lies wholly outside the tolerance."""
        outside: NDArray[np.bool_] = (self.low > self.tolerance) | (self.high < -self.tolerance)
        return outside

    @property
    def inside(self) -> NDArray[np.bool_]:
        """Windows whose interval lies wholly inside the tolerance."""
        within: NDArray[np.bool_] = (self.low > -self.tolerance) & (self.high < self.tolerance)
        return within

    @property
    def median_half_width(self) -> float:
        """How sharp the intervals are. [rad/s]"""
        return float(np.median(self.high - self.low) / 2.0)


MOST_WINDOWS = 120
"""More intervals than this beside one another are a smear on paper: longer windows are drawn."""


def leading(evidence: Sequence[Evidence]) -> list[Evidence]:
    """Return the evidence that decides a channel's status: the first detector of windows.

    What a detector says of single samples, or of windows each of its own length, is beside it.
    """
    compared = [item for item in evidence if item.kind == "bias" and item.windows.length_s > 0.0]
    return [
        item for item in compared if len(item.windows) and item.detector == compared[0].detector
    ]


def drawn_evidence(analysis: Analysis, most: int = MOST_WINDOWS) -> Evidence | None:
    """Choose the deciding detector's windows that show most: the shortest of which most decide.

    Of the lengths with at most so many windows, the shortest at which at least half of the bounded
    intervals lie inside or outside the tolerance; where there is none, the longest.
    """
    bounded = [item for item in leading(analysis.evidence) if _bounded(item).any()]
    bounded.sort(key=lambda item: item.windows.length_s)
    for item in bounded:
        if len(item.windows) <= most and _decided_share(item) >= 0.5:
            return item
    return bounded[-1] if bounded else None


def intervals(drawn: Evidence | None, channel: int) -> Intervals | None:
    """Return one channel's intervals of the evidence that is drawn, if any is bounded."""
    if drawn is None:
        return None
    known = _bounded(drawn)[:, channel]
    if not known.any():
        return None
    windows = drawn.windows
    return Intervals(
        detector=drawn.detector,
        length_s=windows.length_s,
        confidence=drawn.confidence,
        middle_s=(windows.start_s[known] + windows.end_s[known]) / 2.0,
        low=drawn.low[known, channel],
        high=drawn.high[known, channel],
        tolerance=drawn.tolerance[known, channel],
    )


def _bounded(evidence: Evidence) -> NDArray[np.bool_]:
    """Windows and channels with a finite interval."""
    known: NDArray[np.bool_] = (
        evidence.tested & np.isfinite(evidence.low) & np.isfinite(evidence.high)
    )
    return known


def _decided_share(evidence: Evidence) -> float:
    low, high, tolerance = evidence.low, evidence.high, evidence.tolerance
    inside = (low > -tolerance) & (high < tolerance)
    outside = (low > tolerance) | (high < -tolerance)
    return float((inside | outside)[_bounded(evidence)].mean())
