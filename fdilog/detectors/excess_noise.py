"""A channel that is noisier than others on its axis, or than it was before.

The noise is seen in the deviation of every reading from the mean of its neighbours, in which the
motion of the body hardly shows; so even with two gyros on an axis the noisy one is told. Vibration
shows in it, and in every gyro; a channel's own noise is what is left when the readings of the
others are taken out (`fdilog.windows.prediction`). Swings that last for many readings show little
in it and more in that of means of some readings from the means beside them; so those are looked at
too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.maths.student import student_quantile
from fdilog.registry import Stage
from fdilog.table import ChannelTable
from fdilog.windows.isolation import family_wise_confidence
from fdilog.windows.prediction import DEVIATION_GAIN, deviations_as_logged, own_noise
from fdilog.windows.survey import Survey

Floats = NDArray[np.float64]

# Below this many readings a ratio of variances means little: at 25, its 99.9 % interval already
# spans a factor of four.
FEWEST_SAMPLES = 50
# A reading further off than this counts as if it were no further, so that the edges of a step and a
# few impulses are not taken for noise. [sigmas, those of the median modulus]
CAP = 3.0
# n times the variance of the logarithm of a sigma from so capped squares of normal readings.
CAPPED_VARIANCE = 0.52
# One over the normal quantile at 3/4: from a median modulus to a sigma.
NORMAL_MEDIAN = 1.4826
# Readings gathered at a time, to bound the memory.
BLOCK_READINGS = 1_000_000
# What is usual is kept for so many channels, to be asked again for windows of other lengths; and
# what is shown for as many paces as the fastest logs have.
MOST_CHANNELS = 48
MOST_PACES = 4
# Each pace takes means over so many rows of the one before. Deviations from neighbours show a half
# or more of what swings from a sixth to a half of the pace; the next one is to show what is slower.
ROWS_A_MEAN = 4
# Swings below two a second show in means over half seconds: the fastest for disagreements, the
# slowest here.
SLOWEST_HZ = 4.0
# A mean holds so much of the readings that its time promises, and spans so little more than that.
MEAN_HOLDS, MEAN_SPANS = 0.9, 1.25
# The standard deviation of rounding to steps of one.
ROUNDING = 12.0**-0.5
# What is usual is what the quietest quarter of a flight stays below: a fault may last for most of
# it. The pieces compared are those in which all gyros shake as much, within a factor of
# two: propellers and the ground make more of a difference than faults do.
USUAL = 0.25
COMPARABLE_OCTAVES = 1.0
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
        quiet, so the noise must matter too: it must be larger than the tolerance for a bias. In
        vibration, which is common to all, no ratio to the others shows even large noise of one
        channel. So its own noise is also compared with what it usually is while all shake as much
        as now; then what it reads must have become noisier, relative to that, for sure.
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


@lru_cache(maxsize=1)
def paces(table: ChannelTable) -> tuple[tuple[int, ChannelTable], ...]:
    """Return the table, and those of means over ever more of its rows, with their numbers."""
    found = [(1, table)]
    every = ROWS_A_MEAN
    while (
        table.period_s and every * table.period_s * SLOWEST_HZ <= 1.0 and every < len(table.time_s)
    ):
        found.append((every, _means(table, every)))
        every *= ROWS_A_MEAN
    return tuple(found)


def _means(table: ChannelTable, every: int) -> ChannelTable:
    """Average a table over so many rows at a time; what a mean lacks too much of is not valid."""
    n = len(table.time_s) // every
    whole = slice(0, n * every)
    time_s = table.time_s[whole].reshape(n, every)
    rates = np.where(table.valid[whole], table.rate_rad_s[whole], 0.0).reshape(n, every, -1)
    count = table.valid[whole].reshape(rates.shape).sum(axis=1)
    length_s = every * table.period_s
    promised = np.array([min(every, channel.rate_hz * length_s) for channel in table.channels])
    valid = (count > 0) & (count >= MEAN_HOLDS * promised)
    valid &= (np.ptp(time_s, axis=1) <= MEAN_SPANS * length_s)[:, None]
    channels = tuple(
        replace(
            channel,
            rate_hz=min(channel.rate_hz, 1.0 / length_s),
            step_rad_s=channel.step_rad_s / float(np.sqrt(max(held, 1.0))),
        )
        for channel, held in zip(table.channels, promised.tolist(), strict=True)
    )
    return ChannelTable(
        time_s=time_s.mean(axis=1),
        rate_rad_s=np.where(valid, rates.sum(axis=1) / np.maximum(count, 1), np.nan),
        valid=valid,
        channels=channels,
        period_s=length_s,
    )


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
    rounding = _rounding(table)

    @cache
    def told(axis: tuple[int, ...]) -> NDArray[np.int64]:
        return _told(deviation, axis)

    @cache
    def sigmas(axis: tuple[int, ...], k: int) -> tuple[Floats, Floats]:
        return _window_sigmas(deviation[told(axis), k], survey, told(axis), rounding[k])

    for channel in range(shape[1]):
        peers = noise_peers(table, channel)
        if not len(peers):
            continue
        axis = tuple(sorted([channel, *peers.tolist()]))
        rows = told(axis)
        mine, _ = sigmas(axis, channel)
        others = [sigmas(axis, k)[1] for k in peers.tolist()]
        theirs = np.sqrt(np.mean(np.square(others), axis=0))
        alone, _ = _window_sigmas(own[rows, channel], survey, rows, rounding[channel])
        counts = _window_counts(survey, rows)
        logged = _ratio(survey, counts, mine, theirs)
        found = logged.beyond & (mine > least)
        usual = _usual(table, channel)
        common, loudest = usual.common(np.column_stack([mine, *others]))
        grown = _ratio(survey, counts, alone, usual.of_those(usual.own, common))
        with np.errstate(invalid="ignore", divide="ignore"):
            relative = mine / common
        louder = _ratio(survey, counts, relative, usual.of_those(usual.relative, common))
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
    rounding = _rounding(table)
    counts = _window_counts(survey, rows)
    peers = noise_peers(table, channel)
    changed = np.zeros(len(survey.windows), bool)
    for peer in peers:
        others = peers[peers != peer]
        shown = deviation[:, peer] * DEVIATION_GAIN
        own = own_noise(table, peer, others, shown)[rows] / DEVIATION_GAIN
        columns = [peer, *others]
        usual = _Usual.of(deviation[rows][:, columns], own, rounding[columns])
        sigmas = [_window_sigmas(deviation[rows, k], survey, rows, rounding[k]) for k in columns]
        common, _ = usual.common(np.column_stack([sigmas[0][0], *(one[1] for one in sigmas[1:])]))
        alone, _ = _window_sigmas(own, survey, rows, rounding[peer])
        changed |= _ratio(survey, counts, alone, usual.of_those(usual.own, common)).more
    return changed


def _told(deviation: Floats, columns: Sequence[int]) -> NDArray[np.int64]:
    """Return the samples at which the noise of some channels shows, that of all of them."""
    return np.flatnonzero(np.isfinite(deviation[:, columns]).all(axis=1))


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


def _ratio(survey: Survey, n: NDArray[np.int64], mine: Floats, theirs: Floats) -> NoiseRatio:
    """Compare noise over windows; the interval is that of the logarithm of their ratio."""
    config = survey.config
    known = (n >= FEWEST_SAMPLES) & (mine > 0) & (theirs > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        log_ratio = np.where(known, np.log(mine / theirs), np.nan)
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


@lru_cache(maxsize=MOST_PACES)
def shown_noise(table: ChannelTable) -> tuple[Floats, Floats]:
    """Noise that every channel shows, and what of it the others do not, as white sigmas. [rad/s]

    Returns
    -------
    deviation, own : (n_samples, n_channels)
    """
    deviation = deviations_as_logged(table)
    own = [
        own_noise(table, channel, noise_peers(table, channel), deviation[:, channel])
        for channel in range(len(table.channels))
    ]
    return deviation / DEVIATION_GAIN, np.column_stack(own) / DEVIATION_GAIN


def _window_counts(survey: Survey, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Count the given samples in every window."""
    return np.searchsorted(rows, survey.windows.stop) - np.searchsorted(rows, survey.windows.start)


def _rounding(table: ChannelTable) -> Floats:
    """Noise that the quantisation of each channel makes, (n_channels,). [rad/s]"""
    return ROUNDING * np.array([channel.step_rad_s for channel in table.channels])


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


def capped_sigma(size: Floats, least: float | Floats = 0.0) -> Floats:
    """Sigma of readings along the last axis, given their moduli, those beyond `CAP` capped.

    Parameters
    ----------
    least
        What sigma is taken for at least to tell what is far off: at rest most readings of a coarse
        gyro repeat, and their median is zero. Broadcast against the moduli.
    """
    usual = np.maximum(NORMAL_MEDIAN * np.median(size, axis=-1, keepdims=True), least)
    repeating = ~(usual > 0.0)[..., 0]
    if repeating.any():
        # No step is known: those that do not repeat tell it.
        told = np.where(size[repeating] > 0.0, size[repeating], np.nan)
        told[np.isnan(told).all(axis=-1)] = 0.0
        usual[repeating] = NORMAL_MEDIAN * np.nanmedian(told, axis=-1, keepdims=True)
    cap = CAP * usual
    sigma: Floats = np.sqrt((np.minimum(size, cap) ** 2).mean(axis=-1))
    return sigma


@dataclass(frozen=True, kw_only=True, eq=False)
class _Usual:
    """What a channel usually shows, by how much all gyros of the axis shake.

    It is taken from pieces of `FEWEST_SAMPLES` readings whatever the windows, so that a fault for
    most of a flight leaves some that are whole.

    Parameters
    ----------
    share : (k,)
        Logarithm of what each gyro usually feels of the vibration, the channel first.
    shaking : (n,)
        Logarithm of the vibration in the pieces, base two, rising.
    own, relative : (n,)
        The channel's own noise in them [rad/s], and what it shows over that vibration [1].
    """

    share: Floats
    shaking: Floats
    own: Floats
    relative: Floats

    @classmethod
    def of(cls, deviation: Floats, own: Floats, rounding: Floats) -> _Usual:
        """Take it from the deviations of a channel and its peers, (n, k), and its own noise."""
        n = len(own) // FEWEST_SAMPLES
        pieces = np.abs(np.column_stack([deviation, own])[: n * FEWEST_SAMPLES])
        pieces = pieces.reshape(n, FEWEST_SAMPLES, pieces.shape[1])
        least = np.append(rounding, rounding[:1])[:, None]
        sigma = capped_sigma(np.moveaxis(pieces, 1, 2), least)
        sigma = sigma[(sigma > 0.0).all(axis=1)]
        loudness = np.log(sigma[:, :-1])
        apart = loudness - np.median(loudness, axis=1, keepdims=True)
        share = np.quantile(apart, USUAL, axis=0) if len(apart) else np.zeros(deviation.shape[1])
        common = (loudness - share).min(axis=1)
        order = np.argsort(common)
        return cls(
            share=share,
            shaking=common[order] / np.log(2.0),
            own=sigma[order, -1],
            relative=(sigma[:, 0] / np.exp(common))[order],
        )

    def common(self, noise: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Tell the vibration that all gyros feel, which a noisy one of them does not raise.

        Parameters
        ----------
        noise : (n, k)
            Of the gyros of the axis in windows, the channel first. [rad/s]

        Returns
        -------
        common : (n,)
            That vibration. [rad/s]
        loudest : (n,) bool
            Whether the channel is further above it, for its share, than any other.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            loudness = np.log(noise) - self.share
            common: Floats = np.exp(loudness.min(axis=1))
        loudest = (loudness[:, :1] >= loudness[:, 1:]).all(axis=1)
        return common, np.asarray(loudest, bool)

    def of_those(self, values: Floats, common: Floats) -> Floats:
        """Take what values of the pieces usually are while the vibration is about the same."""
        return _of_comparable(self.shaking, values, common, USUAL)


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
    rounding = _rounding(table)[[channel, peer]]
    mine, theirs, shaking = (
        _window_sigmas(column, survey, rows, least)[0]
        for column, least in zip(readings.T, (*rounding, 0.0), strict=True)
    )
    sigma = sigma[(sigma > 0.0).all(axis=1)]
    sigma = sigma[np.argsort(sigma[:, 2])]
    quietly, loudly = (
        _of_comparable(np.log2(sigma[:, 2]), np.log(sigma[:, k] / sigma[:, 2]), shaking, share)
        for k, share in ((0, USUAL), (1, 1.0 - USUAL))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        up = np.log(mine / shaking) - quietly
        down = loudly - np.log(theirs / shaking)
        most = np.log(mine / theirs) / 2.0
        return np.asarray(down > np.maximum(up, most), bool), np.asarray(up > most, bool)


def _of_comparable(shaking: Floats, values: Floats, common: Floats, share: float) -> Floats:
    """Take a quantile of values of pieces in which the vibration is about that of each window.

    Parameters
    ----------
    shaking, values : (n,)
        Logarithm of the vibration in the pieces, base two, rising, and the values there.
    common : (n_windows,)
        The vibration in the windows. [rad/s]
    share
        Which quantile. [1]

    Returns
    -------
    usual : (n_windows,)
        NaN where there is no such piece. [as values]
    """
    usual = np.full(len(common), np.nan)
    known = np.flatnonzero(common > 0.0)
    if not len(known) or not len(shaking):
        return usual
    now = np.log2(common[known])
    first = np.searchsorted(shaking, now - COMPARABLE_OCTAVES)
    last = np.searchsorted(shaking, now + COMPARABLE_OCTAVES)
    pairs, which = np.unique(np.column_stack([first, last]), axis=0, return_inverse=True)
    each = np.array(
        [np.quantile(values[a:b], share) if b > a else np.nan for a, b in pairs.tolist()]
    )
    usual[known] = each[which]
    return usual


def noise_peers(table: ChannelTable, channel: int) -> NDArray[np.int64]:
    """Channels whose noise is comparable: those along the same axis, else all others."""
    axes = table.axes
    along = table.along(channel)
    if along.any():
        return np.flatnonzero(along)
    skewed = len(np.unique(np.round(np.abs(axes), 3), axis=0)) == len(axes) > 3
    others = np.arange(len(axes))
    return others[others != channel] if skewed else others[:0]


@lru_cache(maxsize=MOST_CHANNELS)
def _usual(table: ChannelTable, channel: int) -> _Usual:
    """Tell what is usual of a channel, which is the same for windows of every length."""
    columns = [channel, *noise_peers(table, channel)]
    deviation, own = shown_noise(table)
    rows = _told(deviation, columns)
    rounding = _rounding(table)[columns]
    return _Usual.of(deviation[rows][:, columns], own[rows, channel], rounding)
