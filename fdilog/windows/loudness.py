"""How loud the noise of a channel is, how much of it the others show, and what of it is usual.

The noise is seen in the deviation of every reading from the mean of its neighbours, in which the
motion of the body hardly shows. Vibration shows in it, and in every gyro; a channel's own noise is
what is left when the readings of the others are taken out (`fdilog.windows.prediction`). Swings
that last for many readings show little in it and more in that of means of some readings from the
means beside them, at a slower pace.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.maths.noise import NORMAL_CONSISTENCY
from fdilog.table import ChannelTable
from fdilog.windows.prediction import DEVIATION_GAIN, deviations_as_logged, own_noise

Floats = NDArray[np.float64]

# Below this many readings a ratio of variances means little: at 25, its 99.9 % interval already
# spans a factor of four.
FEWEST_SAMPLES = 50
# A reading further off than this counts as if it were no further, so that the edges of a step and a
# few impulses are not taken for noise. [sigmas, those of the median modulus]
CAP = 3.0
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
    return deviation / DEVIATION_GAIN, np.array(own).T / DEVIATION_GAIN


def _quantile(values: Floats, share: float) -> float:
    """Return what `numpy.quantile` does, several times as fast where the values are few."""
    place = (len(values) - 1) * share
    below = int(place)
    above = min(below + 1, len(values) - 1)
    ordered = np.partition(values, (below, above))
    return float(ordered[below] + (place - below) * (ordered[above] - ordered[below]))


def noise_peers(table: ChannelTable, channel: int) -> NDArray[np.int64]:
    """Channels whose noise is comparable: those along the same axis, else all others."""
    axes = table.axes
    along = table.along(channel)
    if along.any():
        return np.flatnonzero(along)
    skewed = len(np.unique(np.round(np.abs(axes), 3), axis=0)) == len(axes) > 3
    others = np.arange(len(axes))
    return others[others != channel] if skewed else others[:0]


def capped_sigma(size: Floats, least: float | Floats = 0.0) -> Floats:
    """Sigma of readings along the last axis, given their moduli, those beyond `CAP` capped.

    Parameters
    ----------
    least
        What sigma is taken for at least to tell what is far off: at rest most readings of a coarse
        gyro repeat, and their median is zero. Broadcast against the moduli.
    """
    usual = np.maximum(NORMAL_CONSISTENCY * np.median(size, axis=-1, keepdims=True), least)
    repeating = ~(usual > 0.0)[..., 0]
    if repeating.any():
        # No step is known: those that do not repeat tell it.
        told = np.where(size[repeating] > 0.0, size[repeating], np.nan)
        told[np.isnan(told).all(axis=-1)] = 0.0
        usual[repeating] = NORMAL_CONSISTENCY * np.nanmedian(told, axis=-1, keepdims=True)
    cap = CAP * usual
    sigma: Floats = np.sqrt((np.minimum(size, cap) ** 2).mean(axis=-1))
    return sigma


def shown_rows(deviation: Floats, columns: Sequence[int]) -> NDArray[np.int64]:
    """Return the samples at which the noise of some channels shows, that of all of them."""
    return np.flatnonzero(np.isfinite(deviation[:, columns]).all(axis=1))


def rounding_noise(table: ChannelTable) -> Floats:
    """Noise that the quantisation of each channel makes, (n_channels,). [rad/s]"""
    return ROUNDING * np.array([channel.step_rad_s for channel in table.channels])


@dataclass(frozen=True, kw_only=True, eq=False)
class UsualNoise:
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
    def of(cls, deviation: Floats, own: Floats, rounding: Floats) -> UsualNoise:
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
        return of_comparable(self.shaking, values, common, USUAL)


def of_comparable(shaking: Floats, values: Floats, common: Floats, share: float) -> Floats:
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
    each = np.array([_quantile(values[a:b], share) if b > a else np.nan for a, b in pairs.tolist()])
    usual[known] = each[which]
    return usual


@lru_cache(maxsize=MOST_CHANNELS)
def usual_noise(table: ChannelTable, channel: int) -> UsualNoise:
    """Tell what is usual of a channel, which is the same for windows of every length."""
    columns = [channel, *noise_peers(table, channel)]
    deviation, own = shown_noise(table)
    rows = shown_rows(deviation, columns)
    rounding = rounding_noise(table)[columns]
    return UsualNoise.of(deviation[rows][:, columns], own[rows, channel], rounding)


def loudness_notes(table: ChannelTable, config: Config) -> dict[str, str]:
    """Say of each source that is usually much louder, or quieter, than the reference source.

    It is mounted harder or softer, filtered otherwise, or worse. Which of these, and whether that
    is a failure, is not told by gyros that are compared with one another.

    Parameters
    ----------
    table
        Of gyros.

    Returns
    -------
    notes
        By source. None of the reference source, which is the first.
    """
    deviation, _ = shown_noise(table)
    sources = list(dict.fromkeys(channel.source for channel in table.channels))
    of = {s: [k for k, one in enumerate(table.channels) if one.source == s] for s in sources}
    reference = of[sources[0]] if sources else []
    notes = {}
    for source in sources[1:]:
        axes = (table.axes[reference], table.axes[of[source]])
        if len(reference) != 3 or axes[0].shape != axes[1].shape or not np.allclose(*axes):
            continue
        columns = [*reference, *of[source]]
        rows = shown_rows(deviation, columns)
        n = len(rows) // FEWEST_SAMPLES
        pieces = np.abs(deviation[rows[: n * FEWEST_SAMPLES]][:, columns])
        sigma = capped_sigma(np.moveaxis(pieces.reshape(n, FEWEST_SAMPLES, 6), 1, 2))
        loud = (sigma > 0.0).all(axis=1) & (sigma > np.radians(config.tolerance.bias_deg_s)).any(
            axis=1
        )
        if not loud.any():
            continue
        ratio = np.sort(np.median(sigma[loud, 3:] / sigma[loud, :3], axis=0))
        if max(ratio[1], 1.0 / ratio[1]) > config.tolerance.noise_factor:
            notes[source] = (
                f"{ratio[0]:.2g} to {ratio[2]:.2g} times as noisy as {sources[0]} in vibration, "
                "by its mount, its filter or its make: which, the gyros cannot tell"
            )
    return notes
