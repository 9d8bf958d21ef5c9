"""How well a window knows its mean: intervals that stay true when the noise is coloured.

The mean of n samples of stationary noise has the variance ``S(0) / n`` with S(0) the spectral
density at frequency zero, the long-run variance. White noise has S(0) equal to the variance of a
sample; vibration aliased by slow logging, drifts and filters do not. S(0) itself cannot be seen
in the window, since the mean takes frequency zero away; its neighbours can. The estimate:

1. Project the window on the cosines ``sqrt(2/n) cos(pi j (t + 1/2) / n)``, j = 1..J: uncorrelated
   looks at the spectrum next to zero [Lazarus18]. J is n - 1 or `MAX_COSINES`.
2. Compare with a fixed family of spectral shapes (`_shapes`): flat, low-pass of every corner and
   strength, rising. Given a shape, ``Q = sum Y_j^2 / S_j`` over S(0) is chi-square with J degrees
   of freedom, and the likelihood of the shape is ``prod S_j^-1/2 Q^-J/2`` (scale integrated out).
3. Average log S(0) over the shapes by their posterior weights. The flat one has the prior weight
   `WHITE_PRIOR`, the others share the rest evenly. The mean and variance of log S(0) are matched
   by a scaled inverse chi-square, whose degrees of freedom say how well S(0) is known (the idea of
   [Satterthwaite46], for logarithms). Tests by weighted averages over kinds of autocorrelation are
   due to [Muller14].

Several series are first turned into components that are uncorrelated with one another over the
whole band and next to frequency zero (simultaneous diagonalisation), so that the covariance of any
linear combination follows, and linear maps of the series map the answer: a parity basis may be
turned at will. The components share one shape unless the data speak for separate ones by more than
Schwarz's penalty [Schwarz78] for the turn that was fitted.

References
----------
[Lazarus18] E. Lazarus, D. J. Lewis, J. H. Stock, M. W. Watson, "HAR inference: recommendations for
    practice", Journal of Business & Economic Statistics 36(4), 2018, 541-559.
[Muller14] U. K. Mueller, "HAC corrections for strongly autocorrelated time series", Journal of
    Business & Economic Statistics 32(3), 2014, 311-322.
[Satterthwaite46] F. E. Satterthwaite, "An approximate distribution of estimates of variance
    components", Biometrics Bulletin 2(6), 1946, 110-114.
[Schwarz78] G. Schwarz, "Estimating the dimension of a model", Annals of Statistics 6(2), 1978,
    461-464.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]

MIN_SAMPLES = 3
"""Below three samples nothing is known of the noise: one sample has no spread, two have one
difference, from which neither a drift nor a vibration can be told from white noise."""

MAX_COSINES = 128
"""Cosines looked at: 128 degrees of freedom are as good as infinitely many (the 99.9 % quantile is
2.5 % above the normal one), and everything faster than 64 periods a window is left out of it."""

WHITE_PRIOR = 2.0 / 3.0
"""Prior weight of the flat shape, two to one. Counted: at even odds the 95 % interval of 25 white
samples covers 97.3 %, wider than it need be; the price is that the 99.9 % interval of 125 samples
of autoregressive (0.9) plus white noise misses 0.32 % instead of 0.21 %."""

MIN_CORRELATION_TIMES = 1.5
"""Lowest corner of the low-pass shapes: correlation times a window holds. In less, nothing tells
the mean from a slow wander, and no interval covers."""

MIN_FLOORED_TIMES = 6.0
"""Below so many correlation times, a low-pass shape is taken without white noise beside it: with
it, its few large cosines look like white noise, and white windows would pay for the doubt."""

FLOOR_RATIOS = (10.0, 30.0, 100.0, 1e4)
"""Density of the low-pass part at zero over that of the white part; 1e4 is no white part at all."""

RISE_RATIOS = (10.0, 100.0, 1e4)
"""How far the rising shapes rise: vibration above the band that matters to the mean."""

MIN_FLAT_COSINES = 8
"""Cosines below the lowest edge of the rising shapes."""

SHAPE_GRID = 256
"""Samples at which shapes are computed: they depend on window over correlation time alone."""

LOW_BAND = 0.2
"""Half-power point, over J, of the low-pass weight that picks the components' axes."""

LONG = 16_384
"""Samples of a window whose cosines, 16 MB of them, are not kept but made by a transform."""

ROUNDING = 1e-12
"""Cosines below this part of the mean are rounding: far above 1e-16, far below any gyro's noise."""

RANK_TOLERANCE = 1e-10
"""Relative variance below which a component is rounding, not noise."""

TABLE_KNOTS = 4000
"""Knots of the tables between which functions of the degrees of freedom are interpolated."""

DOF_RANGE = (0.05, 1e4)
"""Range of those tables; the shapes keep the degrees of freedom within it."""

BLOCK_BYTES = 2_000_000
"""Bytes of samples taken at a time, which bounds the memory and stays in the processor's cache."""


@dataclass(frozen=True)
class WindowedMean:
    """Means of windows and how well they are known.

    Attributes
    ----------
    mean : (n_windows, q)
        Mean of each series. [unit of the samples]
    covariance : (n_windows, q, q)
        Covariance of the mean, S(0)/n; infinite diagonal where nothing is known. [unit squared]
    dof : (n_windows,)
        Degrees of freedom of the covariance, those of its least known component; 0 where nothing is
        known.
    parts : (n_windows, q, q)
        Standard deviations of the mean, a column for each uncorrelated component. [unit]
    part_dof : (n_windows, q)
        Degrees of freedom of each component.
    """

    mean: Floats
    covariance: Floats
    dof: Floats
    parts: Floats
    part_dof: Floats

    def at(self, windows: NDArray[np.int64] | NDArray[np.bool_]) -> WindowedMean:
        """Return some of the windows."""
        return WindowedMean(
            mean=self.mean[windows],
            covariance=self.covariance[windows],
            dof=self.dof[windows],
            parts=self.parts[windows],
            part_dof=self.part_dof[windows],
        )

    def quantile(self, combinations: ArrayLike, confidence: float) -> Floats:
        """How many standard deviations the Student intervals of ``c' mean`` reach.

        A component that has few degrees of freedom widens them by as much as it is a part of the
        variance: half-widths of the components add up as independent errors do.

        Parameters
        ----------
        combinations : (k, q)
            Coefficients c of linear combinations of the series; (n_windows, k, q) if they differ.
        confidence
            Probability that the interval covers, such as 0.999.

        Returns
        -------
        quantile : (n_windows, k)
            Infinite where nothing is known. [1]
        """
        variance = np.square(np.asarray(combinations, np.float64) @ self.parts)
        each = student_quantile(self.part_dof, confidence)
        total = variance.sum(axis=2)
        with np.errstate(invalid="ignore", divide="ignore"):
            squared = (variance @ np.square(each)[:, :, None])[:, :, 0] / total
        # What does not move at all is known as well as the least known component.
        squared = np.where(total > 0.0, squared, np.square(each.max(axis=1))[:, None])
        return np.where((self.dof > 0)[:, None], np.sqrt(squared), np.inf)

    def half_width(self, combination: ArrayLike, confidence: float) -> Floats:
        """Half-width of the Student interval of ``c' mean``; infinite where nothing is known.

        Parameters
        ----------
        combination : (q,) or (n_windows, q)
            Coefficients c of a linear combination of the series.
        confidence
            Probability that the interval covers, such as 0.999.

        Returns
        -------
        half_width : (n_windows,)
            ``t sqrt(c' cov c)``. [unit of the samples]
        """
        c = np.broadcast_to(np.asarray(combination, dtype=np.float64), self.mean.shape)
        known = self.dof > 0
        covariance = np.where(known[:, None, None], self.covariance, 0.0)
        variance = np.einsum("wi,wij,wj->w", c, covariance, c)
        half = self.quantile(c[:, None, :], confidence)[:, 0]
        half[known] *= np.sqrt(np.maximum(variance[known], 0.0))
        return half


def windowed_mean(samples: ArrayLike) -> WindowedMean:
    """Mean of every window with a covariance that allows for autocorrelation.

    Parameters
    ----------
    samples : (n_windows, n_samples, q)
        Windows of q simultaneous series; a strided view will do, it is copied block by block.
        [any unit]

    Returns
    -------
    WindowedMean
        A window of fewer than `MIN_SAMPLES` samples, or one that holds a value that is not finite,
        has no degrees of freedom.

    Raises
    ------
    ValueError
        If the samples do not have three axes.
    """
    x = np.asarray(samples, dtype=np.float64)
    if x.ndim != 3:
        raise ValueError(f"windows must be (n_windows, n_samples, q), not {x.shape}")
    n_windows, n, q = x.shape
    mean = np.full((n_windows, q), np.nan)
    covariance = np.zeros((n_windows, q, q))
    parts, part_dof = np.zeros((n_windows, q, q)), np.zeros((n_windows, q))
    step = max(1, BLOCK_BYTES // max(1, 8 * q * max(n, SHAPE_GRID)))
    for start in range(0, n_windows if n and q else 0, step):
        block = slice(start, start + step)
        mean[block], covariance[block], parts[block], part_dof[block] = _block(x[block])
    dof = part_dof.min(axis=1, initial=np.inf) if q else np.zeros(n_windows)
    covariance[dof == 0] = np.where(np.eye(q, dtype=bool), np.inf, 0.0)
    return WindowedMean(mean, covariance, dof, parts, part_dof)


def _block(x: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Mean, covariance, its parts and their degrees of freedom of a block of windows."""
    n_windows, n, q = x.shape
    by_sample = np.ascontiguousarray(np.moveaxis(x, 1, 0)).reshape(n, n_windows * q)
    with np.errstate(invalid="ignore"):  # a value that is not finite spoils its own window only
        mean: Floats = (np.full(n, 1.0 / n) @ by_sample).reshape(n_windows, q)
        finite = np.isfinite(mean.sum(axis=1))
        if n < MIN_SAMPLES:
            nothing = np.zeros((n_windows, q, q))
            return mean, nothing, nothing, np.zeros((n_windows, q))
        count = min(n - 1, MAX_COSINES)
        # The cosines of long windows would fill the memory.
        look = _cosines(n, count) @ by_sample if n < LONG else _by_fourier(by_sample, count)
        looks = np.moveaxis(look.reshape(-1, n_windows, q), 0, 2)
    # A series that does not move leaves rounding alone in its cosines.
    moves = np.abs(looks).max(axis=2) > ROUNDING * np.abs(mean)
    looks = np.where((moves & finite[:, None])[:, :, None], looks, 0.0)
    long_run, parts, dof = _long_run(looks, n)
    return mean, long_run / n, parts / np.sqrt(n), np.where(finite[:, None], dof, 0.0)


def _long_run(looks: Floats, n: int) -> tuple[Floats, Floats, Floats]:
    """Long-run covariance (w, q, q) from the cosines (w, q, J).

    With the standard deviations of its components (w, q, q) and their degrees of freedom (w, q).
    """
    to_components, back = _components(looks)
    z = to_components @ looks
    j = z.shape[2]
    inverse, log_det, prior = _shapes(min(n, SHAPE_GRID), j)
    power = np.square(z)
    alive: NDArray[np.bool_] = power.sum(axis=2) > 0.5 * j
    # One product for Q of every component under every shape; a component that is dead says nothing.
    log_s0 = power @ inverse.T
    log_s0 /= j
    log_s0[~alive] = 1.0
    np.log(log_s0, out=log_s0)
    tells = alive & (2 * alive.sum(axis=1, keepdims=True) <= j)  # else the prior stands
    log_like = np.where(tells[:, :, None], -0.5 * (log_det + j * log_s0), 0.0)
    weight = _posterior(log_like, alive, prior, j)

    shift, spread = _log_chi_square(np.asarray(float(j)))
    log_mean = np.einsum("wqs,wqs->wq", weight, log_s0)
    log_s0 -= log_mean[:, :, None]
    log_var = np.einsum("wqs,wqs,wqs->wq", weight, log_s0, log_s0) + spread
    dof, own_shift = _inverse_chi_square(log_var)
    scale = np.exp(log_mean - shift + own_shift)

    # Every component whitened and recoloured by its own weights: their products are a Gram matrix,
    # so the covariance is positive semidefinite whatever the weights.
    recoloured = z * np.sqrt(weight @ inverse)
    power = np.square(recoloured).sum(axis=2)
    recoloured *= np.sqrt(scale / np.where(alive, power, 1.0))[:, :, None]
    recoloured[~alive] = 0.0
    recoloured = back @ recoloured
    covariance = recoloured @ np.swapaxes(recoloured, 1, 2)
    parts = back * np.sqrt(np.where(alive, scale, 0.0))[:, None, :]
    return covariance, parts, np.where(alive, dof, float(j))


def _components(looks: Floats) -> tuple[Floats, Floats]:
    """Return maps to and from components uncorrelated over the band and next to zero frequency."""
    q, j = looks.shape[1:]
    rms = np.sqrt(np.square(looks).mean(axis=2))
    live = rms > 0
    unit = np.where(live, 1.0 / np.where(live, rms, 1.0), 0.0)
    if q == 1:
        return unit[:, :, None], rms[:, :, None]
    scaled = looks * unit[:, :, None]
    # The ridge lets dependent series through: what it alone holds up has no power once whitened.
    factor = np.linalg.cholesky(scaled @ np.swapaxes(scaled, 1, 2) / j + RANK_TOLERANCE * np.eye(q))
    whiten = np.linalg.inv(factor)
    white = whiten @ scaled
    low = 1.0 / (1.0 + np.square(np.arange(1, j + 1) / (LOW_BAND * j)))
    turn = np.linalg.eigh((white * low) @ np.swapaxes(white, 1, 2))[1]
    to_components = (np.swapaxes(turn, 1, 2) @ whiten) * unit[:, None, :]
    return to_components, np.asarray(rms[:, :, None] * (factor @ turn))


def _posterior(log_like: Floats, alive: NDArray[np.bool_], prior: Floats, n_cosines: int) -> Floats:
    """Posterior weight (w, q, shapes) of every shape for every component."""
    own_peak = log_like.max(axis=2, keepdims=True)
    own = np.exp(log_like - own_peak) * prior
    own_sum = own.sum(axis=2, keepdims=True)
    own /= own_sum
    if log_like.shape[1] == 1:
        return np.asarray(own)
    total = log_like.sum(axis=1, keepdims=True)
    peak = total.max(axis=2, keepdims=True)
    common = np.exp(total - peak) * prior
    common_sum = common.sum(axis=2, keepdims=True)
    common /= common_sum
    count = alive.sum(axis=1)
    penalty = 0.25 * count * (count - 1) * np.log(n_cosines)
    log_odds = (peak + np.log(common_sum))[:, 0, 0] + penalty
    log_odds -= (own_peak + np.log(own_sum))[:, :, 0].sum(axis=1)
    share = 1.0 / (1.0 + np.exp(-np.clip(log_odds, -500.0, 500.0)))[:, None, None]
    weight: Floats = share * common + (1.0 - share) * own
    return weight


@lru_cache(maxsize=16)
def _cosines(n: int, count: int) -> Floats:
    """Orthonormal cosines j = 1..count (count, n), each with zero sum."""
    j = np.arange(1, count + 1)[:, None]
    cosines: Floats = np.sqrt(2.0 / n) * np.cos(np.pi * j * (np.arange(n) + 0.5) / n)
    return cosines


def _by_fourier(samples: Floats, count: int) -> Floats:
    """Return what the cosines make of columns of samples (n, k), by a Fourier transform."""
    n = len(samples)
    mirrored = np.concatenate([samples, samples[::-1]])
    turn = np.exp(-0.5j * np.pi * np.arange(1, count + 1) / n)[:, None]
    return np.asarray((np.fft.rfft(mirrored, axis=0)[1 : count + 1] * turn).real * np.sqrt(0.5 / n))


@lru_cache(maxsize=64)
def _shapes(m: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Reciprocal shapes ``1/S_j`` relative to the variance of the mean, log-determinants, priors.

    The low-pass shapes are first-order autoregressions plus white noise, computed exactly (leakage
    and the finite window included) from their covariance matrix on m samples.
    """
    looks = np.vstack([np.full(m, m**-0.5), _cosines(m, count)])
    lag = np.abs(np.arange(m)[:, None] - np.arange(m))
    shapes = [np.ones(count)]
    corner = MIN_CORRELATION_TIMES
    while corner <= min(m, 2 * count):
        rho = np.exp(-corner / m)
        low_pass = (
            np.sum((looks @ (rho ** np.arange(m))[lag]) * looks, axis=1) * (1.0 - rho) / (1.0 + rho)
        )
        for ratio in FLOOR_RATIOS if corner >= MIN_FLOORED_TIMES - 1e-9 else FLOOR_RATIOS[-1:]:
            spectrum = ratio * low_pass + 1.0
            shapes.append(spectrum[1:] / spectrum[0])
        corner *= np.sqrt(2.0)
    edge = MIN_FLAT_COSINES
    while edge < count:
        shapes.extend(np.where(np.arange(count) < edge, 1.0, ratio) for ratio in RISE_RATIOS)
        edge *= 2
    spectra = np.array(shapes)
    prior = np.full(len(shapes), (1.0 - WHITE_PRIOR) / max(1, len(shapes) - 1))
    prior[0] = WHITE_PRIOR if len(shapes) > 1 else 1.0
    return 1.0 / spectra, np.log(spectra).sum(axis=1), prior


def _log_chi_square(dof: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of log(chi2 / dof): digamma(dof/2) - log(dof/2) and trigamma(dof/2)."""
    x = 0.5 * dof
    steps = [x + k for k in range(6)]
    y = x + 6.0
    inv2 = 1.0 / np.square(y)
    digamma = np.log(y) - 0.5 / y - inv2 * (1 / 12 - inv2 * (1 / 120 - inv2 / 252))
    trigamma = 1.0 / y + inv2 * (0.5 + (1 / 6 - inv2 * (1 / 30 - inv2 / 42)) / y)
    for s in steps:
        digamma = digamma - 1.0 / s
        trigamma = trigamma + 1.0 / np.square(s)
    return digamma - np.log(x), trigamma


@lru_cache(maxsize=1)
def _chi_square_table() -> tuple[Floats, Floats, Floats]:
    """Tabulate the log variance of log chi-square (rising), its log dof and its mean log."""
    dof = np.geomspace(DOF_RANGE[1], DOF_RANGE[0], TABLE_KNOTS)
    shift, spread = _log_chi_square(dof)
    return np.log(spread), np.log(dof), shift


def _inverse_chi_square(log_var: Floats) -> tuple[Floats, Floats]:
    """Degrees of freedom whose log chi-square has the given variance, and its mean log."""
    spreads, log_dofs, shifts = _chi_square_table()
    log_spread = np.log(log_var)
    dof: Floats = np.exp(np.interp(log_spread, spreads, log_dofs))
    return dof, np.interp(log_spread, spreads, shifts)


def moving_mean(values: Floats, width: int) -> Floats:
    """Mean of so many values about each of some, (n,); beyond the ends values are zero.

    Of running sums, since a convolution takes as many products as the width.
    """
    total = np.concatenate([[0.0], np.cumsum(values)])
    first = np.arange(len(values)) - width // 2
    stop = np.clip(first + width, 0, len(values))
    return np.asarray(total[stop] - total[np.maximum(first, 0)], np.float64) / width


def robust_sigma(x: ArrayLike, axis: int | None = 0) -> Floats:
    """Measure the spread of the bulk: 1.4826 times the median absolute deviation, NaN left out.

    Parameters
    ----------
    x : any shape
        Samples; NaN counts as missing. [any unit]
    axis
        Axis of the samples, or None for all.

    Returns
    -------
    sigma
        NaN where there is no sample at all. [unit of x]
    """
    values = np.asarray(x, dtype=np.float64)
    values = np.where(np.isfinite(values), values, np.nan)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "All-NaN slice", RuntimeWarning)  # the answer is NaN
        warnings.filterwarnings("ignore", "Mean of empty slice", RuntimeWarning)
        centre = np.nanmedian(values, axis=axis, keepdims=True)
        spread = np.nanmedian(np.abs(values - centre), axis=axis)
    return np.asarray(NORMAL_CONSISTENCY * spread, dtype=np.float64)


NORMAL_CONSISTENCY = 1.482602218505602
"""1 / Phi^-1(3/4): makes the median absolute deviation estimate a normal sigma."""


def quantisation_step(x: ArrayLike) -> float:
    """Resolution of a channel: the step whose multiples are all the differences of its values.

    Parameters
    ----------
    x : (n_samples,)
        Readings of one channel; what is not finite is left out. [any unit]

    Returns
    -------
    step
        The largest such step, which is the smallest difference or a simple fraction of it; 0 if
        the values fit none, or are too few (`MIN_LEVELS`) to tell. [unit of x]

    Notes
    -----
    Values may have been through single precision (most logs), so each is known to
    `SINGLE_ROUNDING` of its size only; a step must stand well above that to be seen.
    """
    readings = np.asarray(x, dtype=np.float64)
    values = np.unique(readings[:: 1 + len(readings) // MOST_READINGS])
    values = values[np.isfinite(values)]
    rounding = SINGLE_ROUNDING * np.abs(values)
    if len(values):
        # Levels that rounding alone could separate are one level.
        first = np.append(True, np.diff(values) > rounding[1:] + rounding[:-1])
        values, rounding = values[first], rounding[first]
    if len(values) < MIN_LEVELS:
        return 0.0
    gaps = np.diff(values)
    for divisor in range(1, MAX_DIVISOR + 1):
        step = _refined_step(values, float(gaps.min()) / divisor)
        origin = int(np.argmin(np.abs(values)))
        turns = (values - values[origin]) / step
        misfit = np.abs(turns - np.round(turns)) * step
        allowed = 2.0 * (rounding + rounding[origin])
        told = allowed < CLEAR_OF_ROUNDING * step
        if told.sum() < MIN_LEVELS:
            return 0.0
        if np.mean(misfit[told] <= allowed[told] + 1e-3 * step) >= FITTING_SHARE:
            return step
    return 0.0


def _refined_step(values: Floats, guess: float) -> float:
    """Least-squares step from a first guess, over ever longer spans about the smallest value."""
    offset = values - values[np.argmin(np.abs(values))]
    step, reach = guess, 8.0 * guess
    while True:
        near = np.abs(offset) <= reach
        turns = np.round(offset[near] / step)
        if turns.any():
            step = float(turns @ offset[near] / (turns @ turns))
        if near.all():
            return step
        reach = max(4.0 * reach, float(np.abs(offset[~near]).min()))


MOST_READINGS = 20_000
"""Of more readings than these, evenly spaced ones are looked at: the levels are the same."""

MIN_LEVELS = 6
"""Fewer distinct values than this fit some step by chance."""

MAX_DIVISOR = 6
"""The step may be missing between the values seen; fractions of the smallest gap are tried."""

SINGLE_ROUNDING = 2.0**-23
"""Two roundings to single precision: as recorded, and after a change of unit."""

CLEAR_OF_ROUNDING = 0.1
"""Values whose rounding exceeds this part of a step do not tell."""

FITTING_SHARE = 0.99
"""Share of the levels that must fit: a damaged record or two may hold anything."""
