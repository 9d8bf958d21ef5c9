"""One flight's bias and noise of each gyro channel, each with an interval: a point of a trend.

A channel is compared with what the other channels say of its axis, ``r_i = (L z)_i``. With three
aligned sources that is its difference from the mean of the two others: a sensor on its way out
shows in its own series at full size, and at half of it, reversed, in theirs. With two sources
their series mirror one another, and nothing tells which of them moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import Analysis
from fdilog.maths.geometry import leave_one_out
from fdilog.maths.noise import robust_sigma, windowed_mean
from fdilog.maths.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.windows.calibration import STRETCH_S, calibrate

Floats = NDArray[np.float64]

CONFIDENCE = 0.95
"""Of the bars in a trend: what a reader of charts takes them for."""
UNUSABLE = frozenset(["dead", "stuck", "saturated", "dropout", "impulse"])
"""Kinds of finding whose readings are no measurement at all; the others are what is measured."""
NOISE_BLOCK_S = 10.0
FEWEST_BLOCKS = 3
FEWEST_PER_BLOCK = 10
"""A block with fewer differences says little of its noise."""


@dataclass(frozen=True, kw_only=True)
class Measure:
    """Bias (mean error) or noise (standard deviation) of a channel in one flight. [rad/s]"""

    channel: str
    quantity: str
    estimate: float
    low: float
    high: float


def measure(analysis: Analysis) -> tuple[Measure, ...]:
    """Measure every gyro channel that can be compared with others in a flight."""
    table = _usable(analysis)
    if table is None:
        return ()
    sound, _ = calibrate(table, analysis.config)
    rows = leave_one_out(table.axes)
    compared = [i for i in range(len(rows)) if np.isfinite(rows[i]).all()]
    means = _stretch_means(sound)
    measures = []
    if len(means):
        answer = windowed_mean(means[None])
        for i in compared:
            estimate = float(rows[i] @ answer.mean[0])
            half = float(answer.half_width(rows[i], CONFIDENCE)[0])
            if math.isfinite(estimate) and math.isfinite(half):
                measures.append(_measure(table.names[i], "bias", estimate, half))
    for i in compared:
        noise = _noise(sound, rows[i])
        if noise is not None:
            centre, half = noise
            measures.append(
                Measure(
                    channel=table.names[i],
                    quantity="noise",
                    estimate=math.exp(centre),
                    low=math.exp(centre - half),
                    high=math.exp(centre + half),
                )
            )
    return tuple(measures)


def _measure(channel: str, quantity: str, estimate: float, half: float) -> Measure:
    return Measure(
        channel=channel,
        quantity=quantity,
        estimate=estimate,
        low=estimate - half,
        high=estimate + half,
    )


def _usable(analysis: Analysis) -> ChannelTable | None:
    """Return the gyros' readings where they measure, without channels that mostly do not."""
    table = analysis.table
    valid = table.valid.copy()
    for finding in analysis.findings:
        if finding.kind in UNUSABLE:
            inside = (table.time_s >= finding.start_s) & (table.time_s <= finding.end_s)
            accused = np.array([name in finding.suspects for name in table.names])
            valid[np.ix_(inside, accused)] = False
    keep = np.array([not channel.derived for channel in table.channels], bool)
    if len(valid):
        keep &= valid.mean(axis=0) >= 0.5
    if keep.sum() < 2:
        return None
    return ChannelTable(
        time_s=table.time_s,
        rate_rad_s=np.where(valid, table.rate_rad_s, np.nan)[:, keep],
        valid=valid[:, keep],
        channels=tuple(channel for channel, kept in zip(table.channels, keep, strict=True) if kept),
        period_s=table.period_s,
    )


def _stretch_means(table: ChannelTable) -> Floats:
    """Mean readings over whole stretches of a second, (n_stretches, n_channels). [rad/s]"""
    complete = table.valid.all(axis=1)
    if not complete.any():
        return np.empty((0, len(table.channels)))
    stretch = np.floor(table.time_s[complete] / STRETCH_S).astype(np.int64)
    start = np.flatnonzero(np.diff(stretch, prepend=stretch[0] - 1))
    count = np.diff(np.append(start, len(stretch)))
    means: Floats = np.add.reduceat(table.rate_rad_s[complete], start, axis=0) / count[:, None]
    usual = np.median(count)
    kept: Floats = means[count >= 0.5 * usual]
    return kept


def _noise(table: ChannelTable, row: Floats) -> tuple[float, float] | None:
    """Logarithm of the standard deviation of what one channel adds, and its half-width.

    Each block of ten seconds gives one robust sigma of the steps of ``r / |L_i|``; their spread
    within the flight gives the interval.
    """
    used = row != 0.0
    complete = table.valid[:, used].all(axis=1)
    residual = table.rate_rad_s[np.ix_(complete, used)] @ row[used] / np.linalg.norm(row)
    time_s = table.time_s[complete]
    adjacent = np.diff(time_s) < 1.5 * table.period_s
    steps = np.diff(residual)[adjacent] / math.sqrt(2.0)
    block = np.floor(time_s[1:][adjacent] / NOISE_BLOCK_S).astype(np.int64)
    start = np.flatnonzero(np.diff(block, prepend=-1)) if len(block) else block
    logs = []
    for steps_of_one in np.split(steps, start[1:]):
        if len(steps_of_one) >= FEWEST_PER_BLOCK:
            sigma = float(robust_sigma(steps_of_one))
            if sigma > 0.0:
                logs.append(math.log(sigma))
    if len(logs) < FEWEST_BLOCKS:
        return None
    spread = float(np.std(logs, ddof=1)) / math.sqrt(len(logs))
    quantile = float(student_quantile(np.array([len(logs) - 1.0]), CONFIDENCE)[0])
    return float(np.mean(logs)), quantile * spread
