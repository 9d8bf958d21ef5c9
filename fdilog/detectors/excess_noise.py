"""A channel that is noisier than others on its axis, or than it was before.

Motion hardly shows in what is compared (`fdilog.windows.loudness`), so that even of two gyros on an
axis the noisy one is told. It is compared at several paces, since slow swings are noise, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.maths.student import student_quantile
from fdilog.registry import Stage
from fdilog.table import ChannelTable
from fdilog.windows.isolation import family_wise_confidence
from fdilog.windows.loudness import (
    FEWEST_SAMPLES,
    USUAL,
    UsualNoise,
    capped_sigma,
    noise_peers,
    of_comparable,
    paces,
    rounding_noise,
    shown_noise,
    shown_rows,
    usual_noise,
)
from fdilog.windows.prediction import DEVIATION_GAIN, own_noise
from fdilog.windows.survey import Survey

Floats = NDArray[np.float64]

# n times the variance of the logarithm of a sigma from so capped squares of normal readings.
CAPPED_VARIANCE = 0.52
# Readings gathered at a time, to bound the memory.
BLOCK_READINGS = 1_000_000
# Deviations of neighbouring readings share readings; white ones have 35/18 times the variance of
# their mean square that independent ones have (autocorrelations -2/3 and 1/6, squared, twice).
SHARED_READINGS = 35.0 / 18.0
# A device that is mounted harder, or filtered less, is louder on two axes at least, within a factor
# of two: of simulated ones the loudest is up to 1.5 times as loud as the next, of a gyro in a log
# that fell to vibration 1.9 to 2.9 times. What the middle one of its axes shows is the device's.
ALIKE = 2.0


@dataclass(frozen=True, kw_only=True)
class NoiseDetector:
    """Ratio of a channel's noise to that of the others on its axis, with an interval."""

    description: ClassVar[str] = "noise far above that of the other gyros on the axis"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Accuse the channel whose noise ratio is beyond ``tolerance.noise_factor`` for sure.

        Two gyros of different make differ in noise by more than that at rest, where both are
        quiet, so the noise must matter too: it must be larger than the tolerance for a bias. In
        vibration, which is common to all, no ratio to the others shows even large noise of one
        channel. So its own noise is also compared with what it usually is while all shake as much
        as now; then what it reads must have become noisier, relative to that, for sure.

        Of a device that is louder than the others on several axes by about as much only what has
        become noisier is accused: it is mounted harder, or filtered less.
        """
        windows = survey.windows
        size = int(np.median(windows.stop - windows.start)) if len(windows) else 0
        if size < FEWEST_SAMPLES:
            return []
        low, high, accused = _said(survey)
        for every, paced in paces(survey.table)[1:]:
            slower = spans_of_means(survey, paced, every)
            if slower is None:
                continue
            its_low, its_high, its_accused = _said(slower)
            only = (its_accused > 0) & ~(accused > 0).any(axis=1, keepdims=True)
            low, high = np.where(only, its_low, low), np.where(only, its_high, high)
            accused = np.where(only, its_accused, accused)
        return [
            Evidence(
                detector="noise",
                kind="noise",
                windows=windows,
                tested=np.isfinite(low),
                low=low,
                high=high,
                tolerance=np.full(low.shape, survey.config.tolerance.noise_factor),
                accused=accused,
                confidence=survey.config.windows.confidence,
            )
        ]


def spans_of_means(survey: Survey, paced: ChannelTable, every: int) -> Survey | None:
    """Look at the means that lie within each window, or nothing if they are too few."""
    windows = survey.windows
    start, stop = -(-windows.start // every), windows.stop // every
    if int(np.median(stop - start)) < FEWEST_SAMPLES:
        return None
    return replace(survey, table=paced, windows=replace(windows, start=start, stop=stop))


def _said(survey: Survey) -> tuple[Floats, Floats, NDArray[np.int8]]:
    """Compare the noise of every channel in every window.

    Returns
    -------
    low, high : (n_windows, n_channels)
        Interval of the ratio. [1]
    accused : (n_windows, n_channels)
        As in `fdilog.finding.Evidence`.
    """
    table, config, windows = survey.table, survey.config, survey.windows
    shape = (len(windows), len(table.channels))
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    accused = np.zeros(shape, np.int8)
    least = np.radians(config.tolerance.bias_deg_s)
    deviation, own = shown_noise(table)
    rounding = rounding_noise(table)

    @cache
    def told(axis: tuple[int, ...]) -> NDArray[np.int64]:
        return shown_rows(deviation, axis)

    @cache
    def sigmas(axis: tuple[int, ...], k: int) -> tuple[Floats, Floats]:
        return _window_sigmas(deviation[told(axis), k], survey, told(axis), rounding[k])

    compared = [k for k in range(shape[1]) if len(noise_peers(table, k))]
    axes = {k: tuple(sorted([k, *noise_peers(table, k).tolist()])) for k in compared}
    ratio = np.full(shape, np.nan)
    for channel in compared:
        others = [sigmas(axes[channel], k)[1] for k in axes[channel] if k != channel]
        with np.errstate(invalid="ignore", divide="ignore"):
            theirs = np.sqrt(np.mean(np.square(others), axis=0))
            ratio[:, channel] = sigmas(axes[channel], channel)[0] / theirs
    device = _of_their_device(table, ratio)
    for channel in compared:
        axis = axes[channel]
        peers, rows = noise_peers(table, channel), told(axis)
        mine, _ = sigmas(axis, channel)
        others = [sigmas(axis, k)[1] for k in peers.tolist()]
        alone, _ = _window_sigmas(own[rows, channel], survey, rows, rounding[channel])
        counts = _window_counts(survey, rows)
        logged = _ratio(survey, counts, ratio[:, channel])
        found = logged.beyond & (mine > least) & (logged.low > ALIKE * device[:, channel])
        usual = usual_noise(table, channel)
        common, loudest = usual.common(np.column_stack([mine, *others]))
        with np.errstate(invalid="ignore", divide="ignore"):
            growth = alone / usual.of_those(usual.own, common)
            relative = mine / common / usual.of_those(usual.relative, common)
        grown, louder = _ratio(survey, counts, growth), _ratio(survey, counts, relative)
        by_itself = grown.beyond & louder.more & loudest & (alone > least) & ~found
        if by_itself.any() and len(peers) > 1:
            by_itself &= ~_others_have_changed(survey, channel, rows)
        shown = logged if found.any() else grown
        found |= by_itself
        for peer in peers.tolist() if found.any() else ():
            quieter, risen = _changed(survey, channel, peer)
            found &= ~quieter
            if len(peers) == 1:
                # Who changed is not known: one may be noisy, or the other read too little.
                accused[found & ~risen, peer] = channel + 1
        low[:, channel] = np.where(by_itself, grown.low, shown.low)
        high[:, channel] = np.where(by_itself, grown.high, shown.high)
        accused[found, channel] = channel + 1
    return low, high, accused


def _others_have_changed(
    survey: Survey, channel: int, rows: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Tell in which windows a channel's peers no longer tell of one another as they usually do.

    One of them that is late, or turned, does not tell either what vibration the channel feels,
    which then looks as if it were the channel's own.

    Parameters
    ----------
    rows
        Samples at which the noise of the channel and its peers shows.
    """
    table = survey.table
    deviation, _ = shown_noise(table)
    rounding = rounding_noise(table)
    counts = _window_counts(survey, rows)
    peers = noise_peers(table, channel)
    changed = np.zeros(len(survey.windows), bool)
    for peer in peers:
        others = peers[peers != peer]
        shown = deviation[:, peer] * DEVIATION_GAIN
        own = own_noise(table, peer, others, shown)[rows] / DEVIATION_GAIN
        columns = [peer, *others]
        usual = UsualNoise.of(deviation[rows][:, columns], own, rounding[columns])
        sigmas = [_window_sigmas(deviation[rows, k], survey, rows, rounding[k]) for k in columns]
        common, _ = usual.common(np.column_stack([sigmas[0][0], *(one[1] for one in sigmas[1:])]))
        alone, _ = _window_sigmas(own, survey, rows, rounding[peer])
        with np.errstate(invalid="ignore", divide="ignore"):
            growth = alone / usual.of_those(usual.own, common)
        changed |= _ratio(survey, counts, growth).more
    return changed


def _of_their_device(table: ChannelTable, ratio: Floats) -> Floats:
    """Tell how much louder than the others the device of each channel is, (n_windows, n_channels).

    That of the middle one of its three axes, or zero where it has no three that are compared. [1]

    Parameters
    ----------
    ratio : (n_windows, n_channels)
        How much noisier each is than those that it is compared with. [1]
    """
    device = np.zeros(ratio.shape)
    for source in {channel.source for channel in table.channels}:
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        if len(columns) == 3:
            middle = np.median(ratio[:, columns], axis=1, keepdims=True)
            device[:, columns] = np.where(np.isfinite(middle), middle, 0.0)
    return device


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseRatio:
    """How much noisier than something else a channel is in every window.

    Parameters
    ----------
    low, high : (n_windows,)
        Interval of the ratio; NaN where there are too few readings. [1]
    more : (n_windows,) bool
        Whether it is more than one at the family-wise confidence, and more than healthy gyros have.
    beyond : (n_windows,) bool
        Whether the interval is beyond the tolerance, and more than healthy gyros have at the
        family-wise confidence; two conditions, as for a bias.
    """

    low: Floats
    high: Floats
    more: NDArray[np.bool_]
    beyond: NDArray[np.bool_]


def _ratio(survey: Survey, n: NDArray[np.int64], ratio: Floats) -> NoiseRatio:
    """Tell what ratios of noise over windows say; the interval is that of the logarithm."""
    config = survey.config
    known = (n >= FEWEST_SAMPLES) & (ratio > 0) & np.isfinite(ratio)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_ratio = np.where(known, np.log(ratio), np.nan)
        doubt = np.sqrt(2.0 * CAPPED_VARIANCE * SHARED_READINGS / n)
    strict = family_wise_confidence(config, survey.windows.length_s, len(survey.table.channels))
    dof = np.maximum(n / SHARED_READINGS, 1.0)
    half = student_quantile(dof, config.windows.confidence) * doubt
    least = log_ratio - student_quantile(dof, strict) * doubt
    tolerance = np.log(config.tolerance.noise_factor)
    # Healthy gyros have a third of the tolerance: it is three sigma, as for biases.
    healthy = tolerance / 3.0
    return NoiseRatio(
        low=np.exp(log_ratio - half),
        high=np.exp(log_ratio + half),
        more=known & (least > 0.0) & (log_ratio > healthy),
        beyond=known & (least > healthy) & (log_ratio - half > tolerance),
    )


def _window_counts(survey: Survey, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the given samples in every window."""
    return np.searchsorted(rows, survey.windows.stop) - np.searchsorted(rows, survey.windows.start)


def _window_sigmas(
    values: Floats,
    survey: Survey,
    rows: NDArray[np.int64],
    least: float,
) -> tuple[Floats, Floats]:
    """Sigma in every window of values given at some samples, about zero, what is far off capped.

    What is far off is told by the median of the window, and again by those of its pieces: of a
    window that holds both rest and flight the median may be that of either, and noise in a part of
    a window is no noise of the window. The smaller answer is returned, and the larger.
    """
    first = np.searchsorted(rows, survey.windows.start)
    counts = _window_counts(survey, rows)
    smaller, larger = np.full(len(counts), np.nan), np.full(len(counts), np.nan)
    size = np.abs(values)
    for count in np.unique(counts[counts >= FEWEST_SAMPLES]):
        here = np.flatnonzero(counts == count)
        view = np.lib.stride_tricks.sliding_window_view(size, count)
        pieces = int(count) // FEWEST_SAMPLES
        told = int(count) // pieces * pieces
        for block in np.array_split(here, 1 + len(here) * int(count) // BLOCK_READINGS):
            readings = view[first[block]]
            even = readings[:, :told].reshape(len(block), pieces, -1)
            by_piece = np.sqrt((capped_sigma(even, least) ** 2).mean(axis=1))
            whole = capped_sigma(readings, least)
            smaller[block] = np.minimum(by_piece, whole)
            larger[block] = np.maximum(by_piece, whole)
    return smaller, larger


def _changed(
    survey: Survey, channel: int, peer: int
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell in which windows a channel shows more than a peer because that one, or itself, changed.

    A peer that shows less no longer tells what the channel feels of the vibration either, which
    looks as if it were the channel's own. What the airframe shakes is told by all others. By that
    measure, and while it shakes about as much, a gyro has changed that went up or down from what
    it usually shows by most of what the two differ by now, and by more than the other.

    Returns
    -------
    quieter, risen : (n_windows,) bool
        Whether the peer came down; whether the channel went up.
    """
    table = survey.table
    deviation, _ = shown_noise(table)
    others = np.delete(np.arange(len(table.channels)), [channel, peer])
    if not len(others):
        return np.zeros(len(survey.windows), bool), np.ones(len(survey.windows), bool)
    shown = deviation[:, [channel, peer, *others]]
    rows = np.flatnonzero(np.isfinite(shown).all(axis=1))
    shaken = np.sqrt((shown[rows, 2:] ** 2).mean(axis=1))
    readings = np.column_stack([shown[rows, :2], shaken])
    n = len(rows) // FEWEST_SAMPLES
    pieces = np.abs(readings[: n * FEWEST_SAMPLES]).reshape(n, FEWEST_SAMPLES, 3)
    sigma = capped_sigma(np.moveaxis(pieces, 1, 2))
    rounding = rounding_noise(table)[[channel, peer]]
    mine, theirs, shaking = (
        _window_sigmas(column, survey, rows, least)[0]
        for column, least in zip(readings.T, (*rounding, 0.0), strict=True)
    )
    sigma = sigma[(sigma > 0.0).all(axis=1)]
    sigma = sigma[np.argsort(sigma[:, 2])]
    quietly, loudly = (
        of_comparable(np.log2(sigma[:, 2]), np.log(sigma[:, k] / sigma[:, 2]), shaking, share)
        for k, share in ((0, USUAL), (1, 1.0 - USUAL))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.log(mine / shaking) - quietly
        down = loudly - np.log(theirs / shaking)
        most = np.log(mine / theirs) / 2.0
        return np.asarray(down > np.maximum(up, most), bool), np.asarray(up > most, bool)
