"""What healthy sources differ by in proportion to the rate: misalignment and scale.

Two triads on one board are never quite parallel and never quite of one scale. Left in, a turn of
70 deg/s shows a misalignment of one degree as an error of 1.2 deg/s. The log itself tells it: over
most of a flight the parity vector follows ``p = c + B w``. The part in proportion to the rate is
taken out where it is within what healthy gyros have, and it is always reported; the constant part
is never taken out, for a bias is what is looked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.maths.geometry import blocks, parity_matrix
from fdilog.maths.noise import robust_sigma
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

# Means over a second: long against vibration and sampling offsets, short against manoeuvres.
STRETCH_S = 1.0
# Fewer stretches than this do not tell four unknowns from a fault.
FEWEST_STRETCHES = 20
# Of its usual part of the samples a channel must be there for so much.
PRESENT = 0.9
# Tukey's constant: 95 % efficient for normal noise, no influence of what is far off.
TUKEY = 4.685
ROUNDS = 20
# Relative to the trace of a matrix: above its rounding, below anything that readings tell.
ROUNDING = 1e-13
# Of an error of a hundred times what healthy gyros are off by, a misalignment of half a degree
# makes one on another axis. From so much on the middlemost source tells the rate. [rad/s]
FAR = float(np.radians(10.0))


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """How a source differs from the reference source.

    Parameters
    ----------
    rotation_deg
        Small rotation that turns the reference's axes into this source's. [deg]
    scale
        Its scale factors relative to the reference's, along x, y, z. [1]
    bias_rad_s
        Constant difference, which is not taken out. [rad/s]
    note
        What was done about it.
    """

    source: str
    rotation_deg: tuple[float, float, float]
    scale: tuple[float, float, float]
    bias_rad_s: tuple[float, float, float]
    note: str | None = None


def calibrate(
    table: ChannelTable, config: Config, steps: Floats | None = None
) -> tuple[ChannelTable, tuple[Calibration, ...]]:
    """Take out what is in proportion to the rate, block by block, and say what it was.

    The regression is Tukey's, on means over one second, so that faults and manoeuvres of a part of
    the flight do not decide it, each weighed by how noisy that second was; a normal prior of
    ``noise.scale_sigma`` on every coefficient keeps a flight with little rotation from inventing
    any.

    Parameters
    ----------
    steps : (N, n)
        Faults that are known already, from which nothing is to be learnt. [rad/s]
    """
    n_channels = len(table.channels)
    error_per_rate = np.zeros((n_channels, 3))
    constant = np.full(n_channels, np.nan)
    vague = np.zeros(3, bool)
    learnt = table if steps is None else replace(table, rate_rad_s=table.rate_rad_s - steps)
    means, rates = _stretch_means(learnt)
    for block in blocks(table.axes):
        columns = list(block)
        known = np.isfinite(means[:, columns]).all(axis=1) & np.isfinite(rates).all(axis=1)
        if known.sum() < FEWEST_STRETCHES:
            continue
        parity = parity_matrix(table.axes[columns])
        fitted, told = _robust_fit(
            means[known][:, columns] @ parity.T,
            rates[known],
            _loudness(learnt, columns, parity)[known],
            config.noise.scale_sigma,
        )
        vague |= ~told
        error_per_rate[columns] = parity.T @ fitted[:, 1:]
        constant[columns] = parity.T @ fitted[:, 0]
    taken_out = _within_tolerance(table, error_per_rate, config)
    described = _described(table, error_per_rate, constant, taken_out)
    if vague.any():
        axes = ", ".join(axis for axis, is_vague in zip("xyz", vague, strict=True) if is_vague)
        words = f"turns too little, for its noise, about {axes} to tell misalignment and scale"
        described = with_notes(described, {one.source: words for one in described})
    return _corrected(table, taken_out), described


def _stretch_means(table: ChannelTable) -> tuple[Floats, Floats]:
    """Mean readings over stretches of one second, (n, n_channels), and mean body rates, (n, 3)."""
    start = _starts(table)
    filled = np.where(table.valid, table.rate_rad_s, 0.0)
    count = np.add.reduceat(table.valid.astype(float), start, axis=0)
    length = np.diff(np.append(start, len(filled)))[:, None]
    share = count / length
    # A slower source is there at some of the samples only, and so is one whose stamps jitter.
    usual = np.array([np.median(own[own > 0.0]) if own.any() else 0.0 for own in share.T])
    full = (share > 0.0) & (share >= PRESENT * usual)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.where(full, np.add.reduceat(filled, start, axis=0) / count, np.nan)
    rates, told = _least_squares(means, np.isfinite(means), table.axes)
    return means, np.where(told[:, None], rates, np.nan)


def _loudness(table: ChannelTable, columns: list[int], parity: Floats) -> Floats:
    """How many times their usual variance the parity vectors have in every stretch, (n, q).

    One at least. It is that of each from the mean of the two beside it, in which no motion shows.
    """
    start = _starts(table)
    rows = np.flatnonzero(table.valid[:, columns].all(axis=1))
    if len(rows) < 3:
        return np.ones((len(start), len(parity)))
    vectors = table.rate_rad_s[:, columns][rows] @ parity.T
    apart = np.square(vectors[1:-1] - (vectors[:-2] + vectors[2:]) / 2.0)
    sums = np.concatenate([np.zeros((1, len(parity))), np.cumsum(apart, axis=0)])
    edges = np.searchsorted(rows[1:-1], np.append(start, len(table.time_s)))
    count = np.diff(edges)[:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        variance = np.diff(sums[edges], axis=0) / count
    usual = np.nanmedian(variance, axis=0) if count.any() else np.zeros(len(parity))
    known = (count > 0) & (usual > 0.0)
    return np.maximum(np.where(known, variance / np.where(usual > 0.0, usual, 1.0), 1.0), 1.0)


def _starts(table: ChannelTable) -> NDArray[np.int64]:
    """Return the first sample of every stretch of a second."""
    which = np.floor(table.time_s / STRETCH_S).astype(np.int64)
    return np.flatnonzero(np.concatenate([[True], np.diff(which) > 0])) if len(which) else which


def _least_squares(
    readings: Floats, valid: NDArray[np.bool_], axes: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Body rates by least squares from the channels recorded, (n, 3), and whether they tell all."""
    rates = np.zeros((len(readings), 3))
    told = np.zeros(len(readings), bool)
    whole = valid.all(axis=1)
    for pattern in [np.ones(len(axes), bool), *np.unique(valid[~whole], axis=0)]:
        rows = np.flatnonzero(whole if pattern.all() else (valid == pattern).all(axis=1))
        here = readings[rows] if pattern.all() else readings[rows][:, pattern]
        rates[rows] = here @ np.linalg.pinv(axes[pattern]).T
        told[rows] = pattern.any() and np.linalg.matrix_rank(axes[pattern]) == 3
    return rates, told


def _robust_fit(
    parity: Floats, rates: Floats, loudness: Floats, sigma: float
) -> tuple[Floats, NDArray[np.bool_]]:
    """Robust regression of parity vectors on body rates, with a prior on the slopes.

    Parameters
    ----------
    parity : (n, q)
        Parity vectors p. [rad/s]
    rates : (n, 3)
        Body rates w. [rad/s]
    loudness : (n, q)
        How many times their usual variance they have, one at least. [1]
    sigma
        Standard deviation of a slope expected beforehand. [1]

    Returns
    -------
    coefficients : (q, 4)
        Constant c [rad/s] and slopes B [1].
    told : (3,) bool
        Whether the slopes on each body rate are told by the readings rather than by the prior: they
        alone would know them to less than its standard deviation.

    References
    ----------
    P. J. Huber, Robust Statistics, Wiley 1981, sections 4.8 and 7.8 (Tukey's biweight, by
    iteratively reweighted least squares from the median on).
    """
    design = np.column_stack([np.ones(len(rates)), rates])
    found = np.zeros((parity.shape[1], 4))
    told = np.ones(3, bool)
    for k, target in enumerate(parity.T):
        level = np.array([float(np.median(target)), 0.0, 0.0, 0.0])
        for _ in range(ROUNDS):
            residual = target - design @ level
            noise = max(float(robust_sigma(residual)), 1e-12)
            # What a healthy slope could explain at that rate is no outlier.
            loud = noise * np.sqrt(loudness[:, k])
            spread = np.hypot(loud, sigma * np.linalg.norm(rates, axis=1))
            weight = np.maximum(1.0 - (residual / (TUKEY * spread)) ** 2, 0.0) ** 2
            weight /= loudness[:, k]
            ridge = np.diag([1e-12, *[(noise / max(sigma, 1e-9)) ** 2] * 3])
            normal = design.T @ (weight[:, None] * design) + ridge
            # Rates that never change cannot be told from the constant.
            normal += ROUNDING * np.trace(normal) * np.eye(len(normal))
            before, level = level, np.linalg.solve(normal, design.T @ (weight * target))
            if np.allclose(before, level, rtol=1e-6, atol=1e-12):
                break
        found[k] = level
        information = np.linalg.pinv(design.T @ (weight[:, None] * design))
        told &= noise * np.sqrt(np.diag(information)[1:]) < sigma
        # A rate that is always the same tells nothing, and its inverse is no infinity here.
        told &= np.ptp(rates, axis=0) > 0.0
    return found, told


def _within_tolerance(table: ChannelTable, error_per_rate: Floats, config: Config) -> Floats:
    """Keep the blocks in which no channel's proportional error is beyond the scale tolerance."""
    kept = np.zeros_like(error_per_rate)
    for block in blocks(table.axes):
        columns = list(block)
        largest = np.linalg.norm(error_per_rate[columns], axis=1).max()
        if largest <= config.tolerance.scale:
            kept[columns] = error_per_rate[columns]
    return kept


def _corrected(table: ChannelTable, error_per_rate: Floats) -> ChannelTable:
    """Subtract ``M w`` with w the least-squares rate of the channels recorded at each instant.

    Where one of them is far off, w is that of the middlemost source: times a misalignment, the
    error would come up on the other axes.
    """
    if not error_per_rate.any():
        return table
    rates, _ = _least_squares(table.rate_rad_s, table.valid, table.axes)
    apart = np.where(table.valid, np.abs(table.rate_rad_s - rates @ table.axes.T), 0.0)
    far = np.flatnonzero((apart > FAR).any(axis=1))
    rates[far] = _middlemost(table, far, rates[far])
    rate = table.rate_rad_s - rates @ error_per_rate.T
    return replace(table, rate_rad_s=rate)


def _middlemost(table: ChannelTable, rows: NDArray[np.int64], otherwise: Floats) -> Floats:
    """Median of what the sources say of the body rate, (n, 3).

    Of two, what is less, for a gyro that is far off hardly ever reads too little.
    """
    told = []
    for source in dict.fromkeys(channel.source for channel in table.channels):
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        axes = table.axes[columns]
        if np.linalg.matrix_rank(axes) == 3:
            told.append(table.rate_rad_s[rows][:, columns] @ np.linalg.pinv(axes).T)
    rates = otherwise.copy()
    if len(told) >= 2:
        opinions = np.array(told)
        sources = np.isfinite(opinions).all(axis=2).sum(axis=0)
        rates[sources > 2] = np.nanmedian(opinions[:, sources > 2], axis=0)
        two = opinions[:, sources == 2]
        least = np.nanargmin(np.abs(two), axis=0)
        rates[sources == 2] = np.take_along_axis(two, least[None], axis=0)[0]
    return rates


def _described(
    table: ChannelTable, error_per_rate: Floats, constant: Floats, taken_out: Floats
) -> tuple[Calibration, ...]:
    """Say what every other triad of the reference's axes differs by from the reference."""
    sources = list(dict.fromkeys(channel.source for channel in table.channels))
    triads = {
        source: [k for k, channel in enumerate(table.channels) if channel.source == source]
        for source in sources
    }
    reference = triads[sources[0]]
    found = []
    for source in sources[1:]:
        columns = triads[source]
        if len(columns) != 3 or len(reference) != 3 or not np.isfinite(constant[columns]).all():
            continue
        # In the body frame: what the source reads along each axis, less what the reference reads.
        frame = table.axes[columns].T @ error_per_rate[columns]
        frame -= table.axes[reference].T @ error_per_rate[reference]
        bias = table.axes[columns].T @ constant[columns]
        bias -= table.axes[reference].T @ constant[reference]
        # z = S R' w, so z - w = (S - I) w - rotation x w to first order.
        turn = np.degrees(
            [
                (frame[1, 2] - frame[2, 1]) / 2,
                (frame[2, 0] - frame[0, 2]) / 2,
                (frame[0, 1] - frame[1, 0]) / 2,
            ]
        )
        left = bool((error_per_rate[columns] != taken_out[columns]).any())
        found.append(
            Calibration(
                source=source,
                rotation_deg=_three(turn),
                scale=_three(1.0 + np.diag(frame)),
                bias_rad_s=_three(bias),
                note="beyond the scale tolerance: left in" if left else None,
            )
        )
    return tuple(found)


def with_notes(
    calibration: Sequence[Calibration], notes: Mapping[str, str]
) -> tuple[Calibration, ...]:
    """Add to the notes of some sources."""
    return tuple(
        replace(one, note="; ".join(filter(None, (one.note, notes.get(one.source)))) or None)
        for one in calibration
    )


def _three(values: Floats) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
