"""A channel that is noisier than others on its axis, or than it was before.

The noise is seen in the deviation of every reading from the mean of its neighbours, in which the
motion of the body hardly shows; so even with two gyros on an axis the noisy one is told.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.isolation import family_wise_confidence
from fdilog.prediction import DEVIATION_GAIN, deviations
from fdilog.registry import Stage
from fdilog.student import student_quantile
from fdilog.windows import Survey

Floats = NDArray[np.float64]

# Below this many readings a ratio of variances means little: at 25, its 99.9 % interval already
# spans a factor of four.
FEWEST_SAMPLES = 50
# Relative variance of n times a robust sigma from the median modulus of normal readings.
MEDIAN_VARIANCE = 1.36
# One over the normal quantile at 3/4: from a median modulus to a sigma.
NORMAL_MEDIAN = 1.4826
# Readings gathered at a time, to bound the memory.
BLOCK_READINGS = 1_000_000
# What is usual is what the quietest quarter of the windows stays below: a fault may last for most
# of a flight.
USUAL = 0.25
# Deviations of neighbouring readings share readings; white ones have 35/18 times the variance of
# their mean square that independent ones have (autocorrelations -2/3 and 1/6, squared, twice).
SHARED_READINGS = 35.0 / 18.0


@dataclass(frozen=True, kw_only=True)
class NoiseDetector:
    """Ratio of a channel's noise to that of the others on its axis, with an interval."""

    description: ClassVar[str] = "noise far above that of the other gyros on the axis"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Accuse the channel whose noise ratio is beyond ``tolerance.noise_factor`` for sure.

        Two gyros of different make differ in noise by more than that at rest, where both are
        quiet, so the noise must matter too. As it is logged, vibration included, it matters if it
        is larger than the tolerance for a bias. Against what three gyros of an axis agree on, where
        common vibration cancels, it matters if both the noise and the ratio are as many times
        larger than in the quietest quarter of the flight.
        """
        table, config, windows = survey.table, survey.config, survey.windows
        size = int(np.median(windows.stop - windows.start)) if len(windows) else 0
        if size < FEWEST_SAMPLES:
            return []
        shape = (len(windows), len(table.channels))
        low, high = np.full(shape, np.nan), np.full(shape, np.nan)
        accused = np.zeros(shape, np.int8)
        factor = config.tolerance.noise_factor
        deviation = deviations(table) / DEVIATION_GAIN
        for channel in range(shape[1]):
            peers = _peers(survey, channel)
            if not len(peers):
                continue
            recorded = np.asarray(table.valid[:, [channel, *peers]].all(axis=1), bool)
            rows = np.flatnonzero(recorded)
            mine, theirs = deviation[rows, channel], deviation[rows][:, peers]
            spread = partial(_window_sigmas, survey=survey, rows=rows)
            squares = [spread(column) ** 2 for column in theirs.T]
            logged = _ratio(survey, rows, spread(mine) ** 2, np.mean(squares, axis=0))
            found = logged.surely & (logged.noise > np.radians(config.tolerance.bias_deg_s))
            shown = logged
            if len(peers) > 1:
                # Against the mean of the others, and against what they disagree by themselves.
                apart = [spread(one - two) ** 2 / 2.0 for one, two in pairwise(theirs.T)]
                disagreement = np.mean(apart, axis=0)
                own = spread(mine - theirs.mean(axis=1)) ** 2 - disagreement / len(peers)
                agreed = _ratio(survey, rows, own, disagreement)
                grown = agreed.surely & (agreed.noise > factor * _usual(agreed.noise))
                grown &= agreed.ratio > factor * _usual(agreed.ratio)
                shown = logged if found.any() else agreed
                found |= grown
            low[:, channel], high[:, channel] = shown.low, shown.high
            accused[:, channel] = np.where(found, channel + 1, 0)
        return [
            Evidence(
                detector="noise",
                kind="noise",
                windows=windows,
                tested=np.isfinite(low),
                low=low,
                high=high,
                tolerance=np.full(shape, factor),
                accused=accused,
                confidence=config.windows.confidence,
            )
        ]


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseRatio:
    """Noise of a channel and its ratio to that of others in every window.

    Parameters
    ----------
    noise, ratio, low, high : (n_windows,)
        Noise [rad/s], ratio and its interval [1]; NaN where there are too few readings.
    surely : (n_windows,) bool
        Whether the ratio is beyond the tolerance at the family-wise confidence.
    """

    noise: Floats
    ratio: Floats
    low: Floats
    high: Floats
    surely: NDArray[np.bool_]


def _ratio(survey: Survey, rows: NDArray[np.int64], mine: Floats, theirs: Floats) -> NoiseRatio:
    """Compare noise powers over windows; the interval is that of the logarithm of their ratio."""
    config = survey.config
    n = _window_counts(survey, rows)
    known = (n >= FEWEST_SAMPLES) & (mine > 0) & (theirs > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_ratio = np.where(known, 0.5 * np.log(mine / theirs), np.nan)
        doubt = np.sqrt(2.0 * MEDIAN_VARIANCE * SHARED_READINGS / n)
    strict = family_wise_confidence(config, survey.windows.length_s, len(survey.table.channels))
    dof = np.maximum(n / SHARED_READINGS, 1.0)
    half = student_quantile(dof, config.windows.confidence) * doubt
    least = log_ratio - student_quantile(dof, strict) * doubt
    return NoiseRatio(
        noise=np.where(known, np.sqrt(np.maximum(mine, 0.0)), np.nan),
        ratio=np.exp(log_ratio),
        low=np.exp(log_ratio - half),
        high=np.exp(log_ratio + half),
        surely=known & (least > np.log(config.tolerance.noise_factor)),
    )


def _window_counts(survey: Survey, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the given samples in every window."""
    return np.searchsorted(rows, survey.windows.stop) - np.searchsorted(rows, survey.windows.start)


def _window_sigmas(values: Floats, survey: Survey, rows: NDArray[np.int64]) -> Floats:
    """Robust sigma in every window of values given at some samples, about zero.

    A median, so that the edges of a step and a few impulses are not taken for noise.
    """
    first = np.searchsorted(rows, survey.windows.start)
    counts = _window_counts(survey, rows)
    sigmas = np.full(len(counts), np.nan)
    size = np.abs(values)
    for count in np.unique(counts[counts >= FEWEST_SAMPLES]):
        here = np.flatnonzero(counts == count)
        view = np.lib.stride_tricks.sliding_window_view(size, count)
        for block in np.array_split(here, 1 + len(here) * int(count) // BLOCK_READINGS):
            sigmas[block] = NORMAL_MEDIAN * np.median(view[first[block]], axis=1)
    return sigmas


def _usual(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.quantile(known, USUAL)) if len(known) else np.inf


def _peers(survey: Survey, channel: int) -> NDArray[np.int64]:
    """Channels whose noise is comparable: those along the same axis, else all others."""
    axes = survey.table.axes
    along = survey.table.along(channel)
    if along.any():
        return np.flatnonzero(along)
    skewed = len(np.unique(np.round(np.abs(axes), 3), axis=0)) == len(axes) > 3
    others = np.arange(len(axes))
    return others[others != channel] if skewed else others[:0]
