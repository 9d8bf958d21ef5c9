"""Quantiles of Student's distribution, for a whole array of degrees of freedom at once.

Written here because it is all that an analysis would need of a library of a hundred megabytes, and
because that library takes longer to import than most logs take to analyse.
"""

from __future__ import annotations

import math
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

# Beyond this many degrees of freedom the asymptotic series is exact to ten digits.
SERIES_FROM_DOF = 1000.0
# Newton steps in log t; a handful suffice but where the tail of few degrees of freedom is far out.
MOST_STEPS = 100
LONGEST_STEP = 2.0
FRACTION_TERMS = 400
# Quantiles are interpolated from a table, one a confidence: log t over log dof by cubics through
# four knots, within a hundred-thousandth everywhere.
LOG_DOF_RANGE = (math.log(0.4), math.log(1e6))
KNOTS = 400


def student_quantile(dof: ArrayLike, confidence: float) -> Floats:
    """Two-sided Student quantile: the interval half-width in standard errors.

    Parameters
    ----------
    dof : any shape
        Degrees of freedom, not necessarily whole; 0 gives infinity.
    confidence
        Probability that the interval covers, in [0, 1).

    Raises
    ------
    ValueError
        If the confidence is not in [0, 1).
    """
    if not 0.0 <= confidence < 1.0:
        raise ValueError(f"confidence must be in [0, 1), not {confidence}")
    values = np.asarray(dof, dtype=np.float64)
    result = np.full(values.shape, np.inf)
    known = values > 0
    if confidence == 0.0:
        return np.where(known, 0.0, np.inf)
    log_dof = np.log(np.clip(values[known], math.exp(LOG_DOF_RANGE[0]), math.exp(LOG_DOF_RANGE[1])))
    at = (log_dof - LOG_DOF_RANGE[0]) / (LOG_DOF_RANGE[1] - LOG_DOF_RANGE[0]) * (KNOTS - 1)
    result[known] = np.exp(_cubic(_table(confidence), at))
    return result


@lru_cache(maxsize=64)
def _table(confidence: float) -> Floats:
    return np.log(_quantile(np.exp(np.linspace(*LOG_DOF_RANGE, KNOTS)), confidence))


def _cubic(table: Floats, at: Floats) -> Floats:
    """Lagrange's cubic through the four knots about each place, counted in knots."""
    first = np.clip(np.floor(at).astype(np.int64) - 1, 0, len(table) - 4)
    u = at - first
    weights = (
        -(u - 1) * (u - 2) * (u - 3) / 6,
        u * (u - 2) * (u - 3) / 2,
        -u * (u - 1) * (u - 3) / 2,
        u * (u - 1) * (u - 2) / 6,
    )
    found = np.zeros_like(at)
    for k, weight in enumerate(weights):
        found += weight * table[first + k]
    return found


def _quantile(dof: Floats, confidence: float) -> Floats:
    # The tail is passed on as it is: at 1 - 1e-12 the confidence itself has few digits left.
    tail = 1.0 - confidence
    found = np.empty_like(dof)
    many = dof >= SERIES_FROM_DOF
    found[many] = _by_series(dof[many], tail)
    found[~many] = _by_newton(dof[~many], tail)
    return found


def _by_series(dof: Floats, tail: float) -> Floats:
    """Asymptotic series of the quantile in 1 / dof, about the normal one.

    References
    ----------
    M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 1964, 26.7.5.
    """
    z = -NormalDist().inv_cdf(tail / 2.0)
    terms = (
        z,
        (z**3 + z) / 4.0,
        (5.0 * z**5 + 16.0 * z**3 + 3.0 * z) / 96.0,
        (3.0 * z**7 + 19.0 * z**5 + 17.0 * z**3 - 15.0 * z) / 384.0,
    )
    series = np.zeros_like(dof)
    for k, term in enumerate(terms):
        series += term / dof**k
    return series


def _by_newton(dof: Floats, tail: float) -> Floats:
    """Solve log tail(log t) = log tail by Newton steps of bounded length: both are smooth."""
    log_t = np.full_like(dof, np.log(-NormalDist().inv_cdf(tail / 2.0) + 0.1))
    log_peak: Floats = _log_gamma(dof / 2 + 0.5) - _log_gamma(dof / 2) - 0.5 * np.log(dof * np.pi)
    for _ in range(MOST_STEPS):
        t = np.exp(log_t)
        reached = two_sided_tail(t, dof)
        log_density = log_peak - (dof + 1.0) / 2.0 * np.log1p(t * t / dof)
        slope = -2.0 * np.exp(log_density + log_t - np.log(reached))
        step: Floats = (np.log(reached) - np.log(tail)) / slope
        log_t = log_t - np.clip(step, -LONGEST_STEP, LONGEST_STEP)
        if np.abs(step).max(initial=0.0) < 1e-13:
            break
    quantile: Floats = np.exp(log_t)
    return quantile


def two_sided_tail(t: Floats, dof: Floats) -> Floats:
    """Probability of a Student variable beyond +-t: the incomplete beta ratio I_x(dof/2, 1/2).

    Parameters
    ----------
    t, dof : (n,)
        Positive.

    References
    ----------
    Abramowitz and Stegun 26.7.1 with 26.5.8, the continued fraction, by Lentz's method.
    """
    a, b = dof / 2.0, 0.5
    # 1 - x is computed as such: x itself rounds to one for small t.
    x, rest = 1.0 / (1.0 + t * t / dof), 1.0 / (1.0 + dof / (t * t))
    swapped = x > (a + 1.0) / (a + b + 2.0)
    first, second = np.where(swapped, b, a), np.where(swapped, a, b)
    argument, other = np.where(swapped, rest, x), np.where(swapped, x, rest)
    log_beta = _log_gamma(a) + math.lgamma(b) - _log_gamma(a + b)
    with np.errstate(divide="ignore"):
        log_front = first * np.log(argument) + second * np.log(other) - log_beta - np.log(first)
    ratio = np.exp(log_front) * _continued_fraction(first, second, argument)
    tail: Floats = np.where(swapped, 1.0 - ratio, ratio)
    return tail


def _log_gamma(values: Floats) -> Floats:
    return np.array([math.lgamma(value) for value in values])


def _continued_fraction(a: Floats, b: Floats, x: Floats) -> Floats:
    tiny = 1e-300
    c = np.ones_like(x)
    d = 1.0 - (a + b) * x / (a + 1.0)
    d = 1.0 / np.where(np.abs(d) < tiny, tiny, d)
    value = d.copy()
    for m in range(1, FRACTION_TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1.0) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1.0))
        for term in (even, odd):
            d = 1.0 + term * d
            c = 1.0 + term / c
            d = 1.0 / np.where(np.abs(d) < tiny, tiny, d)
            c = np.where(np.abs(c) < tiny, tiny, c)
            value = value * d * c
        if np.abs(d * c - 1.0).max(initial=0.0) < 1e-14:
            break
    return value
