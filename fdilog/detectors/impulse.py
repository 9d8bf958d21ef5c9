"""Readings far off from what was to be expected, which no other gyro confirms: one, or a few.

A channel accuses itself here. What was to be expected follows from its neighbours and from the
other gyros of its axis (`fdilog.windows.prediction`). A shock of the airframe is felt along every
axis and by every source, accelerometers among them; a character lost on a serial line by one
channel alone. A few readings in
a row stand off from those before and after (`fdilog.windows.bursts`), while the others go on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import Evidence
from fdilog.maths.student import student_quantile
from fdilog.registry import Stage
from fdilog.table import ChannelTable
from fdilog.windows.bursts import Moment, short_moments
from fdilog.windows.outliers import LEVEL, MIDDLING_LEVELS, least_levels
from fdilog.windows.prediction import TIMING_SIGMAS, deviations, follows, innovations, off_in_motion
from fdilog.windows.survey import Survey, spans
from fdilog.windows.traces import MANOEUVRE_S

Floats = NDArray[np.float64]

# The level of the neighbourhood is that which 95 % of the readings within 2 s stay below: an
# impulse touches three of them, so that two impulses a neighbourhood do not hide each other, if it
# holds 120 readings. It is as short as that because vibration swells and dies within seconds.
NEIGHBOURHOOD_S = 2.0
FEWEST_AROUND = 120
# Many impulses are no level. So the level of a reading is a few middling ones at most: of the ten
# before it or the ten after, whichever shake more, but of the flight at least. An impulse among ten
# touches three and does not move their middle.
BESIDE = 10
# The level of normal readings, in sigmas; where tails are heavy it is more. It is so many of their
# middling moduli.
NORMAL_LEVEL = 1.96
LEVEL_OF_MIDDLING = 2.9
SECONDS_PER_HOUR = 3600.0
# A peak counts as confirmed by another channel of the axis that is off by this part of it too, the
# peak itself left out of what is expected there, or deviates from its neighbours by as much and
# more than vibration makes it once in a hundred readings; and by any channel of another source
# that stands out so far above its own level as vibration makes it once in a thousand.
CONFIRMED = 0.3
CONFIRMING_LEVELS, CONFIRMING_LEVELS_ON_AXIS = 3.0, 1.5
# Around an impulse the channel is where the others are: the means over two readings before and
# after differ by less than this part of it. At a step, where a bias begins or ends, by all of it.
RETURNED = 0.5
RETURNING_READINGS = 2
# Without a second gyro that was read together with it, within as much, only the other axes of the
# source can confirm a shock, and some shocks turn the airframe about one axis alone: landings of
# recorded flights reach 58 deg/s, six times the tolerance.
ALONE_FACTOR = 6.0
# Nor does a turn that two readings span look like anything but an impulse: alone, a gyro must be
# read at least so many times while the quickest manoeuvre lasts.
READINGS_A_MANOEUVRE = 4


@dataclass(frozen=True, kw_only=True)
class ImpulseDetector:
    """Impulses of one reading or a few, each channel judged by itself."""

    description: ClassVar[str] = "one reading or a few far off, which nothing else confirms"
    stage: ClassVar[Stage] = "alone"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give one window for every impulse."""
        table, config = survey.table, survey.config
        limit = float(np.radians(config.tolerance.impulse_deg_s))
        deviation = deviations(table)
        axes = {tuple(_group(table, channel)) for channel in range(len(table.channels))}
        found = [
            impulse
            for channels in sorted(axes)
            for axis in (_Axis.of(table, deviation, np.array(channels)),)
            for place in range(len(channels))
            for impulse in _impulses(table, axis, place, config)
            if not _is_shock(survey, impulse)
        ]
        rest = _without(table, found) if found else table
        confidence = config.windows.confidence
        levels = float(student_quantile(np.array([np.inf]), confidence)[0]) / NORMAL_LEVEL
        short = short_moments(rest, config)
        found += [one for one in short if abs(one.size) > levels * one.level]
        if not found:
            return []
        return [_evidence(table, found, limit, levels, confidence)]


def _is_shock(survey: Survey, impulse: Moment) -> bool:
    """Tell whether the accelerometer of its own device confirms an impulse.

    Gyros of other devices, read some milliseconds apart through other filters, may show nothing of
    a blow. A character lost on a line is lost from one number.
    """
    if survey.shocks is None:
        return False
    source = survey.table.channels[impulse.channel].source
    return survey.shocks.felt(source, float(survey.table.time_s[impulse.start]))


def _group(table: ChannelTable, channel: int) -> list[int]:
    """List a channel and those along its axis that belong to other sources."""
    source = table.channels[channel].source
    along = np.flatnonzero(table.along(channel)).tolist()
    return sorted([channel, *(k for k in along if table.channels[k].source != source)])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Axis:
    """What the gyros of an axis show, one column each.

    Parameters
    ----------
    channels : (k,)
        Columns of the table.
    deviation : (n_samples, n_channels)
        From the mean of two neighbours, of all channels. [rad/s]
    off, level : (n_samples, k)
        Deviation from what was to be expected, and the level of its modulus. [rad/s]
    shaking : (n_samples, k)
        Level of the modulus of the deviation from the mean of two neighbours. [rad/s]
    weights : (k, k)
        What part of the reading in the second goes into what is expected of the first. [1]
    """

    channels: NDArray[np.int64]
    deviation: Floats
    off: Floats
    level: Floats
    shaking: Floats
    weights: Floats

    @classmethod
    def of(cls, table: ChannelTable, deviation: Floats, channels: NDArray[np.int64]) -> _Axis:
        """Predict each channel from the others."""
        k = len(channels)
        off, weights = np.zeros((len(deviation), k)), np.zeros((k, k))
        level, shaking = np.zeros_like(off), np.zeros_like(off)
        for place, channel in enumerate(channels.tolist()):
            others = np.delete(np.arange(k), place)
            off[:, place], weights[place, others] = innovations(
                table, channel, channels[others], deviation[:, channel]
            )
            level[:, place] = _levels(table, channel, off[:, place])
            shaking[:, place] = _levels(table, channel, deviation[:, channel])
        return cls(
            channels=channels,
            deviation=deviation,
            off=off,
            level=level,
            shaking=shaking,
            weights=weights,
        )

    def without(self, place: int, samples: NDArray[np.int64]) -> Floats:
        """Say what the others are off by if one is off at some samples, (n, k). [rad/s]"""
        peak = self.off[samples, place]
        left: Floats = self.off[samples] + peak[:, None] * self.weights[:, place]
        left[:, place] = self.deviation[samples, self.channels[place]] - peak
        return left

    def strangeness(self, place: int, samples: NDArray[np.int64]) -> Floats:
        """Say how strange the readings are if one is off at some samples, (n,). [1]"""
        usual = self.level[samples]
        usual[:, place] = self.shaking[samples, place]
        left = self.without(place, samples)
        strange: Floats = ((left / np.where(usual > 0.0, usual, np.inf)) ** 2).sum(axis=1)
        return strange


def _impulses(table: ChannelTable, axis: _Axis, place: int, config: Config) -> list[Moment]:
    """List the samples of one channel that stand out alone."""
    channel = int(axis.channels[place])
    alone = _alone(table, axis, place, config)
    described = table.channels[channel]
    too_slow = described.rate_hz * MANOEUVRE_S < READINGS_A_MANOEUVRE
    off, level = axis.off[:, place], axis.level[:, place]
    size = np.abs(off)
    limit = np.where(alone, ALONE_FACTOR, 1.0) * np.radians(config.tolerance.impulse_deg_s)
    asked = table.valid[:, channel] & ~(alone & too_slow)
    if not (asked & (size > limit)).any():
        return []
    peaks = np.flatnonzero(asked & (size > level))
    peaks = peaks[~_confirmed(table, axis, place, peaks, alone[peaks])]
    readings_per_hour = SECONDS_PER_HOUR / table.period_s * len(table.channels)
    least = least_levels(size[peaks] / level[peaks], readings_per_hour, config) * level[peaks]
    at = peaks[size[peaks] > np.maximum(limit[peaks], least)]
    rows = np.flatnonzero(table.valid[:, channel])
    here = np.searchsorted(rows, at)
    # Both neighbours are there: the deviation of the first and the last reading is zero.
    highest = size[at] >= np.maximum(size[rows[here - 1]], size[rows[here + 1]])
    apart = _apart(table, axis, place, rows)
    returned = _returned(apart, here) <= RETURNED * size[at]
    returned &= alone[at] | _stands_out(apart, here)
    beside = table.rate_rad_s[np.ix_(rows, np.delete(axis.channels, place))]
    mistimed, following = off_in_motion(
        beside,
        here,
        1.0 / described.rate_hz,
        config.noise.time_sigma_s,
        follows(off[rows], beside),
    )
    tolerance = np.maximum(np.hypot(limit[at], mistimed), following)
    at = at[highest & returned & (size[at] > tolerance)]
    # An impulse stands in what is expected of the others too, and who is off is the likeliest.
    mine = axis.strangeness(place, at)
    for other in range(len(axis.channels)):
        if other != place:
            mine = np.where(axis.strangeness(other, at) < mine, np.inf, mine)
    return [
        Moment(
            channel=channel,
            start=k,
            stop=k + 1,
            size=float(off[k]),
            level=float(level[k]),
        )
        for k in at[np.isfinite(mine)].tolist()
    ]


def _without(table: ChannelTable, found: list[Moment]) -> ChannelTable:
    """Leave out the readings that are impulses already."""
    rates, valid = table.rate_rad_s.copy(), table.valid.copy()
    for one in found:
        rates[one.start, one.channel] = np.nan
        valid[one.start, one.channel] = False
    return replace(table, rate_rad_s=rates, valid=valid)


def _alone(table: ChannelTable, axis: _Axis, place: int, config: Config) -> NDArray[np.bool_]:
    """Tell at which samples no other gyro of the axis was read at that instant, (n_samples,)."""
    apart_s = np.array([table.channels[channel].apart_s for channel in axis.channels])
    together = apart_s <= TIMING_SIGMAS * config.noise.time_sigma_s
    others = np.delete(axis.channels, place)[np.delete(together, place)]
    return np.asarray(~(table.valid[:, others].any(axis=1) & together[place]), bool)


def _confirmed(
    table: ChannelTable,
    axis: _Axis,
    place: int,
    peaks: NDArray[np.int64],
    alone: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Tell which peaks of a channel, some of them read alone, another channel confirms."""
    size = np.abs(axis.off[peaks, place])
    left = np.abs(np.delete(axis.without(place, peaks), place, axis=1))
    confirmed = np.asarray((left > CONFIRMED * size[:, None]).any(axis=1), bool)
    channel = int(axis.channels[place])
    # Where a peer was not read, its neighbours alone tell what was expected; others may read it.
    plain = axis.off[peaks, place] == axis.deviation[peaks, channel]
    beside_it = table.rate_rad_s[np.ix_(peaks, np.delete(axis.channels, place))]
    apart = np.abs(beside_it - table.rate_rad_s[peaks, channel][:, None])
    confirmed |= plain & (apart <= CONFIRMED * size[:, None]).any(axis=1)
    source = table.channels[channel].source
    for other, described in enumerate(table.channels):
        shown = np.abs(axis.deviation[:, other])
        rows = np.flatnonzero(table.valid[:, other])
        if other == channel or not len(rows):
            continue
        here = np.searchsorted(rows, peaks)
        beside = rows[np.clip(here[:, None] + np.array([-1, 0, 1]), 0, len(rows) - 1)]
        most = shown[beside].max(axis=1)
        if described.source != source:
            level = _levels(table, other, shown)[beside[:, 1]]
            confirmed |= most > CONFIRMING_LEVELS * level
            if other in axis.channels:
                beyond = most > CONFIRMING_LEVELS_ON_AXIS * level
                confirmed |= beyond & (most > CONFIRMED * size)
        else:
            confirmed |= alone & (most > CONFIRMED * size)
    return confirmed


def _apart(table: ChannelTable, axis: _Axis, place: int, rows: NDArray[np.int64]) -> Floats:
    """Tell what a channel reads more than its peers at some samples, (n_readings,). [rad/s]"""
    apart: Floats = table.rate_rad_s[rows, axis.channels[place]].copy()
    beside = table.rate_rad_s[np.ix_(rows, np.delete(axis.channels, place))]
    known = np.isfinite(beside)
    apart -= np.where(known, beside, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return apart


def _returned(apart: Floats, at: NDArray[np.int64]) -> Floats:
    """By how much a channel is off from its peers after some readings more than before. [rad/s]

    Parameters
    ----------
    apart, at : (n_readings,), (n,)
        What it reads more than they do, and which of these readings are asked about.
    """
    total = np.concatenate([[0.0], np.cumsum(apart)])
    first = np.maximum(at - RETURNING_READINGS, 0)
    last = np.minimum(at + 1 + RETURNING_READINGS, len(apart))
    before = (total[at] - total[first]) / np.maximum(at - first, 1)
    after = (total[last] - total[at + 1]) / np.maximum(last - at - 1, 1)
    change: Floats = np.abs(after - before)
    return change


def _stands_out(apart: Floats, at: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which readings are further off from the peers than those before and after, (n,).

    Where a gyro begins to swing, its first reading is not what the calm ones before let expect, and
    yet one of many.
    """
    if len(apart) < 2 * (BESIDE + 2):
        return np.ones(len(at), bool)
    before, after = _beside(apart, at)
    middle = np.median(np.concatenate([before, after], axis=1), axis=1)
    swing = np.maximum(
        *(np.median(np.abs(side - middle[:, None]), axis=1) for side in (before, after))
    )
    return np.asarray(np.abs(apart[at] - middle) > LEVEL_OF_MIDDLING * swing, bool)


def _beside(values: Floats, at: NDArray[np.int64]) -> tuple[Floats, Floats]:
    """List the readings before and after some, their neighbours apart, (n, `BESIDE`) each."""
    before, after = (
        values[np.clip(first, 0, len(values) - BESIDE)[:, None] + np.arange(BESIDE)]
        for first in (at - 1 - BESIDE, at + 2)
    )
    return before, after


def _levels(table: ChannelTable, channel: int, values: Floats) -> Floats:
    """Level that `LEVEL` of the readings about each stay below, a third of them at a time."""
    rows = np.flatnonzero(table.valid[:, channel])
    size = np.abs(values[rows])
    third = max(FEWEST_AROUND, round(NEIGHBOURHOOD_S * table.channels[channel].rate_hz)) // 3
    level = np.zeros(-(-len(size) // third))
    whole = max(0, len(size) // third - 2)
    if whole:
        around = np.lib.stride_tricks.sliding_window_view(size, 3 * third)[::third]
        level[1 : 1 + whole] = np.quantile(around[:whole], LEVEL, axis=1)
    for number in {0, *range(1 + whole, len(level))} if len(level) else ():
        first = number * third
        level[number] = np.quantile(size[max(0, first - third) : first + 2 * third], LEVEL)
    levels = np.zeros(len(values))
    level = np.repeat(level, third)[: len(size)]
    if len(size):
        usual = np.median(size)
        far = np.flatnonzero(size > MIDDLING_LEVELS * usual)
        middling = np.maximum(usual, _middling(size, far))
        level[far] = np.minimum(level[far], MIDDLING_LEVELS * middling)
    levels[rows] = level
    return levels


def _middling(size: Floats, at: NDArray[np.int64]) -> Floats:
    """Find what is middling beside readings that stand out, their neighbours apart, (n,).

    Zero where there are too few.
    """
    if len(size) < 2 * (BESIDE + 2):
        return np.zeros(len(at))
    middling: Floats = np.maximum(*(np.median(side, axis=1) for side in _beside(size, at)))
    return middling


def _evidence(
    table: ChannelTable, found: list[Moment], limit: float, levels: float, confidence: float
) -> Evidence:
    shape = (len(found), len(table.channels))
    accused = np.zeros(shape, np.int8)
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    for row, one in enumerate(found):
        accused[row, one.channel] = 1
        low[row, one.channel] = one.size - levels * one.level
        high[row, one.channel] = one.size + levels * one.level
    start = np.array([one.start for one in found])
    stop = np.array([one.stop for one in found])
    return Evidence(
        detector="impulse",
        kind="impulse",
        windows=spans(table, start, stop),
        tested=accused > 0,
        low=low,
        high=high,
        tolerance=np.full(shape, limit),
        accused=accused,
        confidence=confidence,
    )
