"""Moments in which a gyro stands off from the others and comes back, and windows laid over them.

An error of half a second fills no regular window: in a longer one it is a spread, not a mean. So
what each channel is off by is averaged over blocks from a few readings up to a second, and every
block is held against the block before and the block after. Which of them stand out follows from the
flight's own swells, as for single readings. The span that explains most of the readings around is
one more window, for all detectors to look at; or, of fewer readings than tell a mean, an impulse.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import Windows
from fdilog.maths.geometry import leave_one_out
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape, best_step
from fdilog.windows.outliers import LEVEL, least_levels
from fdilog.windows.prediction import follows, off_in_motion
from fdilog.windows.survey import spans
from fdilog.windows.traces import MANOEUVRE_S
from fdilog.windows.usual import usual

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# The spread within fewer readings hardly tells how well their mean is known.
FEWEST_READINGS = 8
# Blocks for errors of fewer: each fills one of these by two thirds at least. A single reading is
# what its neighbours tell (`fdilog.windows.prediction`).
SHORT_BLOCKS = (2, 3, 5)
# Regular windows of a second and more see what is longer.
LONGEST_S = 1.5
# From one length of blocks to the next; a fault of a length between fills most of either. [1]
LONGER = 1.5
# Blocks of one length begin four times in it.
BEGINS = 4
# What is usual is told by so many blocks on either side, a few of which may hold faults.
BLOCKS_AROUND = 10
# What readings usually stand off by is told by so many before and after.
READINGS_BESIDE = 60
# A block that others stand off in, by this part of it on its axis or by all of it on any, is a
# blow or a turn of the vehicle.
CONFIRMED, CONFIRMED_ELSEWHERE = 0.3, 1.0
# The filters of gyros overshoot where the vehicle begins to turn, by no more than this part of it.
OVERSHOOT = 0.25
# Blocks may hold a lost record or two.
LONGEST_WITH_LOSSES = 1.25


@dataclass(frozen=True, kw_only=True)
class Moment:
    """A span in which one channel stands off.

    Parameters
    ----------
    start, stop
        First sample of the table, one past the last.
    size
        How far it stands off, on average. [rad/s]
    level
        How far one reading in twenty beside it does. [rad/s]
    """

    channel: int
    start: int
    stop: int
    size: float
    level: float


def burst_windows(table: ChannelTable, config: Config) -> Windows | None:
    """Lay windows over the moments in which a gyro stands off, or none if there are none."""
    blocks = [FEWEST_READINGS]
    while table.period_s and blocks[-1] * LONGER * table.period_s <= LONGEST_S:
        blocks.append(round(blocks[-1] * LONGER))
    longest = 3 * blocks[-1]
    found = {
        (moment.start, moment.stop)
        for error in _errors(table, derived=True)
        for moment in error.moments(blocks, (FEWEST_READINGS, longest), config)
    }
    if not found:
        return None
    start, stop = np.array(sorted(found)).T
    return spans(table, start, stop)


def short_moments(table: ChannelTable, config: Config) -> list[Moment]:
    """List the moments of two readings and more, of fewer than a window needs.

    Nothing turns there and back within them: what shows them is off, not the gyros that do not.
    """
    if not table.period_s:
        return []
    most = min(FEWEST_READINGS - 1, int(MANOEUVRE_S / table.period_s))
    within = (min(SHORT_BLOCKS), most)
    errors = _errors(table, derived=False)
    return [one for error in errors for one in error.moments(SHORT_BLOCKS, within, config)]


def _errors(table: ChannelTable, *, derived: bool) -> Iterator[_Error]:
    """Hold every gyro that others can be held against to them, to derived channels as well or not.

    An attitude is too slow and too smooth for errors of a few readings.
    """
    if not table.period_s or FEWEST_READINGS * table.period_s > LONGEST_S:
        return
    rows = leave_one_out(table.axes, sigma=usual(table).sigma)
    for channel, row in enumerate(rows):
        needed = np.flatnonzero(row != 0.0)
        if table.channels[channel].derived or not np.isfinite(row).all():
            continue
        if derived or not any(table.channels[k].derived for k in needed):
            yield _Error.of(table, channel, row)


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

    def moments(
        self, blocks: Sequence[int], readings: tuple[int, int], config: Config
    ) -> list[Moment]:
        """List the moments of so many readings; where some meet, the one that explains the most."""
        found: list[Shape] = []
        for size in blocks:
            block_s = size * self.table.period_s
            per_hour = 3600.0 / block_s * len(self.table.channels) * len(blocks)
            for begin in self._standing_out(size, per_hour, config):
                shape = self._shape(begin, size)
                if readings[0] <= shape.stop - shape.start <= readings[1]:
                    found.append(shape)
        kept: list[Shape] = []
        for one in sorted(found, key=lambda shape: (shape.gain, shape.start), reverse=True):
            if all(one.stop <= other.start or one.start >= other.stop for other in kept):
                kept.append(one)
        return [self._moment(shape) for shape in kept]

    def _shape(self, begin: int, size: int) -> Shape:
        """Find the span that explains the most of a block and of what is beside it."""
        beside = max(size, FEWEST_READINGS)
        first = max(0, begin - beside)
        around = self.error[first : begin + size + beside]
        outer = np.concatenate([around[: beside // 2], around[-(beside // 2) :]])
        step = best_step(around - np.median(outer))
        return replace(step, start=first + step.start, stop=first + step.stop)

    def _moment(self, shape: Shape) -> Moment:
        before = self.error[max(0, shape.start - READINGS_BESIDE) : shape.start]
        beside = np.concatenate([before, self.error[shape.stop : shape.stop + READINGS_BESIDE]])
        return Moment(
            channel=self.channel,
            start=int(self.at[shape.start]),
            stop=int(self.at[shape.stop - 1]) + 1,
            size=shape.size,
            level=float(np.quantile(np.abs(beside - np.median(beside)), LEVEL)),
        )

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
        view = np.lib.stride_tricks.sliding_window_view(around, BLOCKS_AROUND)
        middling = np.median(view, axis=1)
        # Where nothing moves, what does is held against the flight; where noise ends, against it.
        beside = np.maximum(middling[: len(most)], middling[BLOCKS_AROUND + 1 :])
        level = np.maximum(beside, np.median(most))
        if not (level > 0.0).all():
            return []
        level *= np.quantile(most / level, LEVEL)
        peaks = most / level
        far = peaks > least_levels(peaks[peaks > 1.0], per_hour, config)
        return [
            begin
            for begin, peak in zip(begins[far].tolist(), most[far].tolist(), strict=True)
            if peak > self._in_motion(begin, size, limit, config)
            and not self._confirmed(begin, size, peak)
        ]

    @cached_property
    def _told(self) -> tuple[Floats, float]:
        """What the others tell that it reads, (n, 1) [rad/s], and how it usually follows that."""
        told = (self.table.rate_rad_s[self.at, self.channel] - self.error)[:, None]
        return told, follows(self.error - np.median(self.error), told)

    def _in_motion(self, begin: int, size: int, limit: float, config: Config) -> float:
        """Say how far a block may stand off because all turn quickly in or beside it. [rad/s]"""
        told, usually = self._told
        if size < FEWEST_READINGS:
            # Where others turn by as much meanwhile, it may be early or late, and overshoot.
            around = told[max(0, begin - FEWEST_READINGS) : begin + size + FEWEST_READINGS]
            turned = float(np.ptp(around))
            limit = max(limit, (1.0 + OVERSHOOT) * turned)
        mistimed, following = off_in_motion(
            told,
            np.arange(begin - 1, begin + size + 1),
            self.table.period_s,
            config.noise.time_sigma_s,
            usually,
        )
        return max(float(np.hypot(limit, mistimed.max())), float(following.max()))

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
