"""The scale error of every channel in windows over which the rate varies enough to show it.

A channel with a scale error k reads ``e = b + k u`` more than the others tell, with u its predicted
reading. So the slope of e over u is sought, over means of half a second, in which motion is left
and vibration is not. What else follows the motion takes part in the fit, as large as healthy gyros
have it: the misalignment, in proportion to the rates about the other axes, and the time between two
sources' readings, in proportion to the rate of change.

References
----------
[Triads] the error model ``e_i = k_i (H w)_i + b_i``, over a window in place of a single sample.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import Evidence
from fdilog.maths.geometry import leave_one_out
from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.windows.isolation import LEAST_ODDS, family_wise_confidence, numbered_suspects
from fdilog.windows.survey import Moments, Survey, spans
from fdilog.windows.traces import MANOEUVRE_S

Floats = NDArray[np.float64]

# Two unknowns and the noise about them take this many means at least; it is five seconds.
FEWEST_SEGMENTS = 10
# Readings in the shortest segment: fewer leave the vibration in and, logged slowly, what sources
# differ by because they were not read at the same instant.
SEGMENT_SAMPLES = 5
# A slope that rests on fewer means than this, weighed by the square of the rate, is one event.
FEWEST_TELLING = 2.0
# What rounding may leave of a sum of squares, and the least that can be divided by. [1]
ROUNDING, TINY = 1e-12, 1e-200


@dataclass(frozen=True, kw_only=True, eq=False)
class Slopes:
    """Slope of what one channel is off by over its predicted reading, in every window.

    Parameters
    ----------
    slope, sigma : (n,)
        Scale error and its standard deviation, infinite where nothing is known. [1]
    dof : (n,)
        Degrees of freedom of the latter.
    effect : (n,)
        Root mean square of what it makes the channel read wrong. [rad/s]
    moving : (n,) bool
        Whether the rate varies so much that noise, which stands in the prediction too, makes no
        more of a slope than healthy scale errors do.
    """

    slope: Floats
    sigma: Floats
    dof: Floats
    effect: Floats
    moving: NDArray[np.bool_]

    def half_width(self, confidence: float) -> Floats:
        """Half-width of the Student interval."""
        known = self.dof > 0.0
        quantile = student_quantile(np.where(known, self.dof, 1.0), confidence)
        half: Floats = np.where(known, quantile * np.where(known, self.sigma, 0.0), np.inf)
        return half

    def outside(self, config: Config, family: float) -> NDArray[np.bool_]:
        """Tell where the scale error is surely beyond tolerance; two conditions, as for a bias.

        It must also make more of a difference than healthy biases, which may wander meanwhile.
        """
        size = np.abs(self.slope)
        found = self.moving & (
            size - self.half_width(config.windows.confidence) > config.tolerance.scale
        )
        surely = size - self.half_width(family) > config.noise.scale_sigma
        matters = self.effect > np.radians(config.noise.bias_sigma_deg_s)
        return np.asarray(found & surely & matters, bool)


def slopes(error: Floats, predicted: Floats, beside: Floats, config: Config) -> Slopes:
    """Fit the slope of errors over predicted readings in many windows.

    Parameters
    ----------
    error, predicted : (n, s)
        Means over the segments of n windows. [rad/s]
    beside : (n, s, m)
        What else follows the motion, each less its mean, in units of what healthy gyros have of it.
        [rad/s]
    """
    s = error.shape[1]
    e = error - error.mean(axis=1, keepdims=True)
    u = predicted - predicted.mean(axis=1, keepdims=True)
    # A first look at the noise, motion taken out: it says how much the prior knows beside it.
    rough = (e * u).sum(axis=1) / np.maximum((u**2).sum(axis=1), TINY)
    noise = ((e - rough[:, None] * u) ** 2).sum(axis=1) / max(s - 2, 1)
    m = beside.shape[2]
    normal = np.swapaxes(beside, 1, 2) @ beside + noise[:, None, None] * np.eye(m)
    normal += (ROUNDING * np.trace(normal, axis1=1, axis2=2) + TINY)[:, None, None] * np.eye(m)
    both = np.stack([e, u], axis=2)
    fitted = beside @ np.linalg.solve(normal, np.swapaxes(beside, 1, 2) @ both)
    e_left, u_left = np.moveaxis(both - fitted, 2, 0)
    power = (u * u_left).sum(axis=1)
    seen = power > np.maximum(ROUNDING * (u**2).sum(axis=1), TINY)
    safe = np.where(seen, power, 1.0)
    slope = np.where(seen, (u * e_left).sum(axis=1) / safe, 0.0)
    left = e_left - slope[:, None] * u_left
    variance = (left**2).sum(axis=1) / max(s - 2, 1)
    looks = windowed_mean((u_left * left)[:, :, None])
    known = seen & (looks.dof > 0)
    long_run = np.where(known, looks.covariance[:, 0, 0], 0.0) * s**2
    sigma = np.sqrt(np.maximum(long_run / safe, variance) / safe)
    return Slopes(
        slope=slope,
        sigma=np.where(known, sigma, np.inf),
        dof=np.where(known, looks.dof * (s - 2) / (s - 1), 0.0),
        effect=np.abs(slope) * np.sqrt(power / s),
        moving=known
        & (variance < config.noise.scale_sigma * power / s)
        & (power**2 > FEWEST_TELLING * ((u * u_left) ** 2).sum(axis=1)),
    )


def scale_evidence(survey: Survey) -> Evidence:
    """Say of every gyro by how much its scale is off in each window, and who is accused of that."""
    table, config = survey.table, survey.config
    shape = (len(survey.windows), len(table.channels))
    evidence = Evidence(
        detector="parity",
        kind="scale",
        windows=survey.windows,
        tested=np.zeros(shape, bool),
        low=np.full(shape, -np.inf),
        high=np.full(shape, np.inf),
        tolerance=np.full(shape, config.tolerance.scale),
        accused=np.zeros(shape, np.int8),
        confidence=config.windows.confidence,
    )
    for moments in survey.moments:
        if any(table.channels[k].derived for k in moments.channels):
            continue
        means = _segments(moments, survey)
        if means is not None:
            _answer(moments, means, survey, evidence)
    return evidence


@dataclass(frozen=True, kw_only=True, eq=False)
class _Segments:
    """Means over the segments of windows: readings (n, s, k), body rates (n, s, 3), and length."""

    readings: Floats
    body: Floats
    segment_s: float


def _segments(moments: Moments, survey: Survey) -> _Segments | None:
    table, columns = survey.table, list(moments.channels)
    together, start, size = survey.together(moments)
    segments = min(size // SEGMENT_SAMPLES, int(size * table.period_s / MANOEUVRE_S))
    if segments < FEWEST_SEGMENTS:
        return None
    rates = np.where(table.valid, table.rate_rad_s, 0.0)[together]
    values = np.column_stack([rates[:, columns], rates @ np.linalg.pinv(table.axes).T])
    total = np.zeros((len(values) + 1, values.shape[1]))
    np.cumsum(values, axis=0, out=total[1:])
    edges = np.linspace(0, size, segments + 1).astype(np.int64)
    means = np.diff(total[start[:, None] + edges], axis=1) / np.diff(edges)[None, :, None]
    k = len(columns)
    return _Segments(
        readings=means[:, :, :k],
        body=means[:, :, k:],
        segment_s=size / segments * table.period_s,
    )


def _answer(moments: Moments, means: _Segments, survey: Survey, evidence: Evidence) -> None:
    """Fill in what the windows of one block of channels say."""
    config = survey.config
    channels = np.array(moments.channels)
    axes = survey.table.axes[channels]
    k = len(channels)
    family = family_wise_confidence(config, survey.windows.length_s, k)
    rows = np.arange(len(moments.windows))
    nobody = list(_all_slopes(means, axes, (), rows, config))
    outside, shown, moving = np.zeros((3, len(rows), k), bool)
    for channel, found in nobody:
        outside[:, channel] = found.outside(config, family)
        half = found.half_width(config.windows.confidence)
        # A rate that hardly moves shows it by chance in one of a thousand windows of noise.
        shown[:, channel] = np.abs(found.slope) > np.where(
            found.moving, half, found.half_width(family)
        )
        moving[:, channel] = found.moving
        place = (moments.windows, channels[channel])
        evidence.tested[place] = found.moving
        evidence.low[place] = np.where(found.moving, 1.0 + found.slope - half, -np.inf)
        evidence.high[place] = np.where(found.moving, 1.0 + found.slope + half, np.inf)
    open_windows = np.flatnonzero(outside.any(axis=1))
    if not len(open_windows):
        return
    stands = np.ones((len(open_windows), k), bool)
    misfit = np.zeros((len(open_windows), k))
    for removed in range(k):
        for channel, found in _all_slopes(means, axes, (removed,), open_windows, config):
            if channel != removed:
                # Where the others do not move against each other's noise, they do not agree.
                stands[:, removed] &= found.moving & ~found.outside(config, family)
                variance = np.where(found.dof > 0, found.sigma, np.inf) ** 2
                strange = found.slope**2 / (variance + config.noise.scale_sigma**2)
                misfit[:, removed] = np.maximum(misfit[:, removed], strange)
    least = np.where(stands, misfit, np.inf).min(axis=1, keepdims=True)
    stands &= misfit <= least + 2.0 * np.log(LEAST_ODDS)
    # Where no single scale error explains it, or where the others agree without a channel that does
    # not read off in proportion to its rate, it is no scale error: that is for the biases. Of two
    # gyros that check each other, the rates that one of them tells must show it.
    told = (stands & moving[open_windows]).any(axis=1)
    told &= (shown[open_windows] | ~stands).all(axis=1)
    hypotheses = [(channel,) for channel in range(k)]
    evidence.accused[np.ix_(moments.windows[open_windows[told]], channels)] = numbered_suspects(
        stands[told], hypotheses, k
    )


def _all_slopes(
    means: _Segments,
    axes: Floats,
    removed: Sequence[int],
    rows: NDArray[np.int64],
    config: Config,
) -> Iterator[tuple[int, Slopes]]:
    """Fit every channel against its prediction from those that are not removed."""
    readings, body = means.readings[rows], means.body[rows]
    for channel, row in enumerate(leave_one_out(axes, list(removed))):
        if not bool(np.isfinite(row).all()):
            continue
        error = readings @ row
        predicted = readings[:, :, channel] - error
        axis = axes[channel]
        across = body - (body @ axis)[:, :, None] * axis
        late = np.gradient(predicted, means.segment_s, axis=1)
        beside = np.concatenate(
            [config.noise.scale_sigma * across, config.noise.time_sigma_s * late[:, :, None]],
            axis=2,
        )
        beside -= beside.mean(axis=1, keepdims=True)
        yield channel, slopes(error, predicted, beside, config)


def scale_over(
    table: ChannelTable, channel: int, span: tuple[int, int], config: Config
) -> Slopes | None:
    """Fit the scale error of a channel over one span, or nothing if that is too short."""
    windows = spans(table, np.array([span[0]]), np.array([span[1]]))
    survey = Survey(table=table, windows=windows, config=config)
    moments = survey.moments_of(frozenset({channel}))
    means = None if moments is None else _segments(moments, survey)
    if moments is None or means is None:
        return None
    axes = table.axes[list(moments.channels)]
    place = moments.channels.index(channel)
    return dict(_all_slopes(means, axes, (), np.arange(1), config)).get(place)
