"""Windows laid where a gyro stands off from the others for a moment, and comes back.

An error of half a second fills no regular window: in a longer one it is a spread, not a mean. So
what each channel is off by is averaged over blocks from a few readings up to a second, and every
block is held against the block before and the block after. Which of them stand out follows from the
flight's own swells, as for single readings; the span that explains most of the readings around is
one more window, for all detectors to look at.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.edges import best_step
from fdilog.finding import Windows
from fdilog.geometry import leave_one_out
from fdilog.outliers import LEVEL, least_levels
from fdilog.table import ChannelTable
from fdilog.usual import usual
from fdilog.windows import spans

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# The spread within fewer readings hardly tells how well their mean is known.
FEWEST_READINGS = 8
# Regular windows of a second and more see what is longer.
LONGEST_S = 1.5
# From one length of blocks to the next; a fault of a length between fills most of either. [1]
LONGER = 1.5
# Blocks of one length begin four times in it.
BEGINS = 4
# What is usual is told by so many blocks on either side, a few of which may hold faults.
BLOCKS_AROUND = 10
# A block that others stand off in, by this part of it on its axis or by all of it on any, is a
# blow or a turn of the vehicle.
CONFIRMED, CONFIRMED_ELSEWHERE = 0.3, 1.0
# Blocks may hold a lost record or two.
LONGEST_WITH_LOSSES = 1.25


def burst_windows(table: ChannelTable, config: Config) -> Windows | None:
    """Lay windows over the moments in which a gyro stands off, or none if there are none."""
    if not table.period_s or FEWEST_READINGS * table.period_s > LONGEST_S:
        return None
    rows = leave_one_out(table.axes, sigma=usual(table).sigma)
    found: set[tuple[int, int]] = set()
    for channel, row in enumerate(rows):
        needed = np.flatnonzero(row != 0.0)
        if np.isfinite(row).all() and not any(table.channels[k].derived for k in needed):
            found.update(_Error.of(table, channel, row).bursts(config))
    if not found:
        return None
    start, stop = np.array(sorted(found)).T
    return spans(table, start, stop)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Error:
    """What one channel is off by from its prediction by the others.

    Parameters
    ----------
    at : (n,) int64
        Samples of the table that hold a reading of all these channels.
    error : (n,)
        [rad/s]
    """

    table: ChannelTable
    channel: int
    at: Rows
    error: Floats

    @classmethod
    def of(cls, table: ChannelTable, channel: int, row: Floats) -> _Error:
        """Hold a channel against the others by a row of weights, (n_channels,)."""
        needed = np.flatnonzero(row != 0.0)
        at = np.flatnonzero(table.valid[:, needed].all(axis=1))
        error = table.rate_rad_s[np.ix_(at, needed)] @ row[needed]
        return cls(table=table, channel=channel, at=at, error=error)

    def bursts(self, config: Config) -> Iterator[tuple[int, int]]:
        """List spans in which it stands off; where some meet, the one that explains the most."""
        sizes = [FEWEST_READINGS]
        while sizes[-1] * LONGER * self.table.period_s <= LONGEST_S:
            sizes.append(round(sizes[-1] * LONGER))
        found: list[tuple[float, int, int]] = []
        for size in sizes:
            per_hour = 3600.0 / (size * self.table.period_s) * len(self.table.channels) * len(sizes)
            for begin in self._standing_out(size, per_hour, config):
                first = begin - size
                around = self.error[first : begin + 2 * size]
                beside = np.concatenate([around[: size // 2], around[-(size // 2) :]])
                step = best_step(around - np.median(beside))
                if step.stop - step.start >= FEWEST_READINGS:
                    span = (int(self.at[first + step.start]), int(self.at[first + step.stop - 1]))
                    found.append((step.gain, span[0], span[1] + 1))
        kept: list[tuple[int, int]] = []
        for _, start, stop in sorted(found, reverse=True):
            if all(stop <= other[0] or start >= other[1] for other in kept):
                kept.append((start, stop))
                yield start, stop

    def _standing_out(self, size: int, per_hour: float, config: Config) -> list[int]:
        """List where blocks of one length begin that stand off by more than chance lets them."""
        limit = np.radians(config.tolerance.impulse_deg_s)
        reach = size + size // 2
        first = np.arange(reach, len(self.error) - size - reach, max(1, size // BEGINS))
        first = first[: len(first) // BEGINS * BEGINS]
        time_s = self.table.time_s[self.at]
        span_s = time_s[first + size + reach - 1] - time_s[first - reach]
        whole = span_s <= LONGEST_WITH_LOSSES * (size + 2 * reach) * self.table.period_s
        off = np.where(whole, np.abs(_off(self.error, first, size)), 0.0)
        if not (off > limit).any():
            return []
        # Of the blocks that share readings, the one that stands off the most.
        groups = off.reshape(-1, BEGINS)
        most = groups.max(axis=1)
        begins = first[np.arange(len(groups)) * BEGINS + groups.argmax(axis=1)]
        around = np.pad(most, BLOCKS_AROUND, mode="symmetric")
        view = np.lib.stride_tricks.sliding_window_view(around, 2 * BLOCKS_AROUND + 1)
        # Where nothing moves, what does is held against the flight.
        level = np.maximum(np.median(view, axis=1), np.median(most))
        if not (level > 0.0).all():
            return []
        level *= np.quantile(most / level, LEVEL)
        peaks = most / level
        far = peaks > least_levels(peaks[peaks > 1.0], per_hour, config)
        return [
            begin
            for begin, peak in zip(begins[far].tolist(), most[far].tolist(), strict=True)
            if peak > limit and not self._confirmed(begin, size, peak)
        ]

    def _confirmed(self, begin: int, size: int, off: float) -> bool:
        """Tell whether gyros of other sources stand off in a block too."""
        reach = size + size // 2
        here = self.at[begin - reach : begin + size + reach]
        along, source = self.table.along(self.channel), self.table.channels[self.channel].source
        for other, described in enumerate(self.table.channels):
            if described.source != source and self.table.valid[here, other].all():
                readings = self.table.rate_rad_s[here, other]
                theirs = abs(float(_off(readings, np.array([reach]), size)[0]))
                if theirs > off * (CONFIRMED if along[other] else CONFIRMED_ELSEWHERE):
                    return True
        return False


def _off(values: Floats, first: Rows, size: int) -> Floats:
    """By how much the means of blocks stand off from those before and after; 0 between the two."""
    total = np.concatenate([[0.0], np.cumsum(values)])

    def mean(begin: Rows) -> Floats:
        return np.asarray((total[begin + size] - total[begin]) / size, np.float64)

    middle, reach = mean(first), size + size // 2
    before, after = middle - mean(first - reach), middle - mean(first + reach)
    least = np.where(np.abs(before) < np.abs(after), before, after)
    return np.asarray(np.where(before * after > 0.0, least, 0.0), np.float64)
