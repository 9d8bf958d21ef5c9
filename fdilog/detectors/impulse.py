"""Single readings far off from their neighbours, which no other gyro confirms.

A channel accuses itself here. A shock of the airframe is felt along every axis and by every
source, a character lost on a serial line by one channel alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.registry import Stage
from fdilog.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.windows import Survey, spans

Floats = NDArray[np.float64]

# The level of the neighbourhood is that which 97 % of the readings within 5 s stay below: an
# impulse touches three of them, so that two impulses a neighbourhood do not hide each other.
NEIGHBOURHOOD_S = 5.0
LEVEL = 0.97
# How far above that level an impulse stands. Vibration has heavy tails; landings, take-offs and
# turns reach 5 times the level on recorded flights, but there every source confirms them.
TIMES_LEVEL = 5.0
# A deviation counts as confirmed by another channel that shows this part of it at that instant.
CONFIRMED = 0.3
# Both neighbours of an impulse are back where the rate was: they differ by less than this part of
# it. At a step, where a bias begins or ends, they differ by twice the deviation.
RETURNED = 0.5
# Without a second gyro on the axis only the other axes of the source can confirm a shock, and some
# shocks turn the airframe about one axis alone; so three times the tolerance is asked.
ALONE_FACTOR = 3.0
# The deviation of white noise from the mean of two neighbours, (1 + 1/4 + 1/4)^(1/2).
DEVIATION_GAIN = np.sqrt(1.5)


@dataclass(frozen=True, kw_only=True)
class ImpulseDetector:
    """Impulses of single samples, each channel judged by itself."""

    description: ClassVar[str] = "single readings far off, confirmed by no other gyro"
    stage: ClassVar[Stage] = "alone"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give one window of one sample for every impulse."""
        table, config = survey.table, survey.config
        limit = float(np.radians(config.tolerance.impulse_deg_s))
        deviation = deviations(table)
        found: list[tuple[int, int, float]] = []
        for channel in range(len(table.channels)):
            found += [
                (sample, channel, level)
                for sample, level in _impulses(table, deviation, channel, limit)
            ]
        if not found:
            return []
        return [_evidence(table, deviation, found, limit, config.windows.confidence)]


def deviations(table: ChannelTable) -> Floats:
    """Deviation of every reading from the mean of its two neighbours.

    Returns
    -------
    deviation : (n_samples, n_channels)
        0 where a neighbour is missing, or further away than two and a half steps. [rad/s]
    """
    deviation = np.zeros(table.rate_rad_s.shape)
    for channel, described in enumerate(table.channels):
        rows = np.flatnonzero(table.valid[:, channel])
        if len(rows) < 3 or not described.rate_hz:
            continue
        values, time_s = table.rate_rad_s[rows, channel], table.time_s[rows]
        step_s = np.diff(time_s)
        near = np.maximum(step_s[1:], step_s[:-1]) < 2.5 / described.rate_hz
        middle = values[1:-1] - (values[:-2] + values[2:]) / 2.0
        deviation[rows[1:-1], channel] = np.where(near, middle, 0.0)
    return deviation


def _impulses(
    table: ChannelTable, deviation: Floats, channel: int, limit: float
) -> list[tuple[int, float]]:
    """List the samples of one channel that stand out alone, each with the level around it."""
    rows = np.flatnonzero(table.valid[:, channel])
    size = np.abs(deviation[rows, channel])
    high = np.flatnonzero(size > limit)
    if not len(high):
        return []
    along = table.along(channel)
    of_source = np.array([c.source == table.channels[channel].source for c in table.channels])
    others = along & ~of_source
    factor = 1.0 if others.any() else ALONE_FACTOR
    others = others if others.any() else of_source
    others[channel] = False
    peak = size[high] >= np.maximum(size[high - 1], size[np.minimum(high + 1, len(size) - 1)])
    # Both neighbours are there: the deviation of the first and the last reading is zero.
    at = high[peak & (size[high] >= factor * limit)]
    readings = table.rate_rad_s[rows, channel]
    at = at[np.abs(readings[at + 1] - readings[at - 1]) <= RETURNED * size[at]]
    level = _levels(size, at, max(3, round(NEIGHBOURHOOD_S * table.channels[channel].rate_hz)))
    stands_out = size[at] > TIMES_LEVEL * level
    found = []
    for sample, around in zip(at[stands_out].tolist(), level[stands_out].tolist(), strict=True):
        here = slice(rows[sample - 1], rows[sample + 1] + 1)
        if np.abs(deviation[here][:, others]).max(initial=0.0) < CONFIRMED * size[sample]:
            found.append((int(rows[sample]), around))
    return found


def _levels(size: Floats, at: NDArray[np.int64], half: int) -> Floats:
    """Level that `LEVEL` of the readings about some samples stay below, one a stretch of them."""
    levels = np.zeros(len(at))
    stretch = at // half
    for number in np.unique(stretch).tolist():
        around = size[max(0, (number - 1) * half) : (number + 2) * half]
        levels[stretch == number] = np.quantile(around, LEVEL)
    return levels


def _evidence(
    table: ChannelTable,
    deviation: Floats,
    found: list[tuple[int, int, float]],
    limit: float,
    confidence: float,
) -> Evidence:
    shape = (len(found), len(table.channels))
    accused = np.zeros(shape, np.int8)
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    # The level is the 97 % point of a normal deviation, or beyond it where tails are heavy.
    sigmas = float(student_quantile(np.array([np.inf]), confidence)[0]) / 2.17
    for row, (sample, channel, level) in enumerate(found):
        accused[row, channel] = 1
        low[row, channel] = deviation[sample, channel] - sigmas * level
        high[row, channel] = deviation[sample, channel] + sigmas * level
    samples = np.array([sample for sample, _, _ in found])
    return Evidence(
        detector="impulse",
        kind="impulse",
        windows=spans(table, samples, samples + 1),
        tested=accused > 0,
        low=low,
        high=high,
        tolerance=np.full(shape, limit),
        accused=accused,
        confidence=confidence,
    )
