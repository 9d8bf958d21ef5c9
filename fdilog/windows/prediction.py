"""What a reading should have been, from its neighbours and from the gyros beside it.

Vibration that slow logging folds down is far from smooth, and the mean of two neighbours says
little of it. But every gyro on the airframe shakes with it, each a little more or less and a little
earlier or later: a linear combination of what they read at three instants, and of the channel's own
two neighbours, tells the reading many times better. Its coefficients are those of the flight.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.neighbours import from_neighbours, near_both
from fdilog.maths.noise import robust_sigma
from fdilog.table import ChannelTable
from fdilog.windows.outliers import MIDDLING_LEVELS
from fdilog.windows.survey import evenly_spaced

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

# The deviation of white noise from the mean of two neighbours, (1 + 1/4 + 1/4)^(1/2).
DEVIATION_GAIN = np.sqrt(1.5)
# What others and neighbours tell of a reading is known for even steps: beside a lost record, the
# coefficients are others. [steps]
EVEN_STEPS = 1.5
# Readings a coefficient: with ten of them, chance fits away a tenth of the variance.
READINGS_A_COEFFICIENT = 10
# Of more readings than these, evenly spaced ones are fitted: a dozen coefficients are known well.
MOST_FITTED = 50_000
# Huber's bend, in sigmas: least squares for normal noise, and a fault of a part of the flight pulls
# with bounded weight (P. J. Huber, Robust Statistics, Wiley 1981, section 7.8).
BEND = 2.0
ROUNDS = 5
# By so many sigmas of what sampling instants differ by, as all tolerances of the suite, a reading
# may be early or late: in a hard turn, a few milliseconds make tens of a deg/s.
TIMING_SIGMAS = 3.0
# The flips of racing quadcopters begin and end within this. Of readings further apart, nobody knows
# when between them the rate changed, nor can a fit tell by how much a gyro's filter delays it: by
# 18.6 ms in its slowest setting (MPU-6000, register map revision 4.2, DLPF_CFG 6).
QUICKEST_S = 0.05
FILTER_S = 0.0186
# The quickest turns of a flight are those that so many readings stay below.
QUICKEST = 0.95


def deviations(table: ChannelTable) -> Floats:
    """Deviation of every reading from the mean of its two neighbours.

    Returns
    -------
    deviation : (n_samples, n_channels)
        0 where a neighbour is missing, or further away than two and a half steps. [rad/s]
    """
    return np.nan_to_num(_deviations(table))


def _deviations(table: ChannelTable) -> Floats:
    deviation = np.full(table.rate_rad_s.shape, np.nan, order="F")
    for channel in range(len(table.channels)):
        rows = np.flatnonzero(table.valid[:, channel])
        readings = table.rate_rad_s[rows, channel]
        rate_hz = table.channels[channel].rate_hz
        deviation[rows, channel] = from_neighbours(table.time_s[rows], readings, rate_hz)
    return deviation


def deviations_as_logged(table: ChannelTable) -> Floats:
    """Deviation of every reading from the mean of its two neighbours when it was logged.

    Interpolation between two readings, as it brings sources onto one time base, takes up to all of
    the noise near half the logging rate away, and more or less of it as stamps drift apart. For
    comparing noise.

    Returns
    -------
    deviation : (n_samples, n_channels)
        NaN where a neighbour is missing. [rad/s]
    """
    logged = table.deviation_rad_s
    if logged is None:
        return _deviations(table)
    deviation = np.full_like(logged, np.nan)
    for channel in range(len(table.channels)):
        rows, near = _neighboured(table, channel)
        deviation[rows[1:-1], channel] = np.where(near, logged[rows[1:-1], channel], np.nan)
    return deviation


def _neighboured(table: ChannelTable, channel: int) -> tuple[Rows, NDArray[np.bool_]]:
    """Rows at which a channel was recorded, and which of the inner ones have both neighbours."""
    rows = np.flatnonzero(table.valid[:, channel])
    near = near_both(table.time_s[rows], table.channels[channel].rate_hz)
    return (rows, near) if near.any() else (rows[:0], near[:0])


def follows(off: Floats, readings: Floats) -> float:
    """Tell what part of the swings of others a channel is usually off by. [1]

    Filters and instants that differ a little make gyros differ the more, the quicker all of them
    turn. It is told by the middlemost of the quickest readings of the flight.

    Parameters
    ----------
    off : (n_readings,)
        [rad/s]
    readings : (n_readings, k)
        What others read then, NaN if nothing. [rad/s]
    """
    at = evenly_spaced(len(readings), MOST_FITTED)
    swings = _swings(readings, at, 1)
    quick = swings > np.quantile(swings, QUICKEST) if len(swings) else swings > 0.0
    return float(np.median(np.abs(off[at[quick]]) / swings[quick])) if quick.any() else 0.0


def off_in_motion(
    readings: Floats, at: Rows, period_s: float, time_sigma_s: float, follows: float
) -> tuple[Floats, Floats]:
    """How far readings may be off because all gyros turn quickly meanwhile, (n,) each. [rad/s]

    Parameters
    ----------
    readings, follows
        As for, and from, `follows`.
    at : (n,)
        Which readings are asked about.

    Returns
    -------
    mistimed
        If they were read early or late, by three sigma of the instants, or filtered otherwise.
    following
        If they follow the others several times worse than usual.

    References
    ----------
    Section 6 of the suite's notes: three sigma of the instants times the rate of change.
    """
    doubt_s = TIMING_SIGMAS * time_sigma_s
    reach = max(1, int(np.ceil(doubt_s / period_s)))
    if period_s > QUICKEST_S:
        share = min(1.0, (doubt_s + FILTER_S) / QUICKEST_S)
    else:
        share = min(1.0, doubt_s / (reach * period_s))
    mistimed = share * _swings(readings, at, reach)
    return mistimed, MIDDLING_LEVELS * follows * _swings(readings, at, 1)


def _swings(readings: Floats, at: Rows, reach: int) -> Floats:
    """How much the one that differs the most reads differently within so many readings, (n,)."""
    around = np.clip(at[:, None] + np.arange(-reach, reach + 1), 0, len(readings) - 1)
    beside = readings[around]
    known = np.isfinite(beside)
    low = np.where(known, beside, np.inf).min(axis=1)
    high = np.where(known, beside, -np.inf).max(axis=1)
    swings: Floats = np.maximum(high - low, 0.0).max(axis=1, initial=0.0)
    return swings


def innovations(
    table: ChannelTable, channel: int, peers: NDArray[np.int64], deviation: Floats
) -> tuple[Floats, Floats]:
    """Tell what a channel reads that neither its neighbours nor its peers tell.

    Parameters
    ----------
    peers : (n_peers,)
        Columns that are asked, at the instant itself and at the two beside it.
    deviation : (n_samples,)
        That of the channel, as `deviations` gives it. [rad/s]

    Returns
    -------
    innovation : (n_samples,)
        Reading less prediction; 0 beside a lost record; the deviation where some peer was not
        recorded, or where there are too few readings to fit. [rad/s]
    weights : (n_peers,)
        What part of each peer's reading at the same instant the prediction holds. [1]
    """
    fit = _Fit.of(table, channel, peers, neighbours=(-1, 1))
    if fit is None:
        return deviation.copy(), np.zeros(len(peers))
    found = deviation.copy()
    found[fit.at], found[fit.uneven] = fit.left, 0.0
    return found, fit.weights


def own_noise(
    table: ChannelTable, channel: int, peers: NDArray[np.int64], deviation: Floats
) -> Floats:
    """Deviation from its neighbours of what a channel reads that its peers do not tell.

    The neighbours take no part in the prediction: an oscillation of the channel would tell them
    what comes next, and calm readings would seem loud beside it.

    Parameters
    ----------
    peers, deviation
        As for `innovations`.

    Returns
    -------
    noise : (n_samples,)
        0 where a neighbour is missing or a record lost; the deviation where some peer was not
        recorded, or where there are too few readings to fit. [rad/s]
    """
    fit = _Fit.of(table, channel, peers, neighbours=())
    if fit is None:
        return deviation.copy()
    found = deviation.copy()
    rate_hz = table.channels[channel].rate_hz
    found[fit.at] = np.nan_to_num(from_neighbours(table.time_s[fit.at], fit.left, rate_hz))
    found[fit.uneven] = 0.0
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """What is left of the readings of a channel when others have told what they can.

    Parameters
    ----------
    at : (n,)
        Samples of the table of which they tell.
    left : (n,)
        Reading less prediction. [rad/s]
    uneven
        Samples beside a lost record.
    weights : (n_peers,)
        What part of each peer's reading at the same instant the prediction holds. [1]
    """

    at: Rows
    left: Floats
    uneven: Rows
    weights: Floats

    @classmethod
    def of(
        cls,
        table: ChannelTable,
        channel: int,
        peers: NDArray[np.int64],
        neighbours: Sequence[int],
    ) -> _Fit | None:
        """Fit what the peers and some neighbours tell; nothing if there are too few readings."""
        rows, near = _neighboured(table, channel)
        if not len(peers) or len(rows) < 3:
            return None
        even = near_both(table.time_s[rows], table.channels[channel].rate_hz, steps=EVEN_STEPS)
        told = near & even
        for shift in range(3):
            told &= table.valid[rows[shift : len(near) + shift]][:, peers].all(axis=1)
        at = 1 + np.flatnonzero(told)
        asked = [(channel, shift) for shift in neighbours]
        asked += [(peer, shift) for peer in peers.tolist() for shift in (-1, 0, 1)]
        if len(at) < READINGS_A_COEFFICIENT * (1 + len(asked)):
            return None
        few = at[:: 1 + len(at) // MOST_FITTED]
        design = np.column_stack(list(_regressors(table, rows, few, asked)))
        weights = _fitted(design, table.rate_rad_s[rows[few], channel])
        left = table.rate_rad_s[rows[at], channel].copy()
        for weight, regressor in zip(weights, _regressors(table, rows, at, asked), strict=True):
            left -= weight * regressor
        return cls(
            at=rows[at],
            left=left,
            uneven=rows[1:-1][near & ~even],
            weights=weights[2 + len(neighbours) :: 3],
        )


def _regressors(
    table: ChannelTable, rows: Rows, at: Rows, asked: Sequence[tuple[int, int]]
) -> Iterator[Floats]:
    """One, and what the channels asked read so many readings later."""
    yield np.ones(len(at))
    for channel, shift in asked:
        yield table.rate_rad_s[rows[at + shift], channel]


def _fitted(design: Floats, target: Floats) -> Floats:
    """Huber's regression, by iteratively reweighted least squares."""
    weight = np.ones(len(target))
    found: Floats = np.zeros(design.shape[1])
    for _ in range(ROUNDS):
        normal = design.T @ (weight[:, None] * design)
        # Two bit-identical peers share a coefficient: the solution of least norm.
        found = np.linalg.pinv(normal, rcond=1e-12) @ (design.T @ (weight * target))
        residual = target - design @ found
        bend = BEND * float(robust_sigma(residual))
        if bend == 0.0:
            break
        weight = bend / np.maximum(np.abs(residual), bend)
    return found
