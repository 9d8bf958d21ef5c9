"""Does a sensor get worse from flight to flight? A test that asks only for the flights' order.

References
----------
H. B. Mann, Nonparametric tests against trend, Econometrica 13 (1945), 245-259.
M. G. Kendall, Rank Correlation Methods, 4th ed. 1975: distribution of S, variance with ties.
P. K. Sen, Regression coefficients based on Kendall's tau, JASA 63 (1968), 1379-1389.
S. Holm, A simple sequentially rejective multiple test procedure, Scand. J. Stat. 6 (1979), 65-70.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SIGNIFICANCE = 0.01
"""Chance of one false alarm in a whole campaign, after Holm's correction."""
CONFIDENCE = 0.95
FEWEST = 5
"""Flights; of fewer no order at all is rarer than one in sixty."""
EXACT_UP_TO = 60
"""Flights up to which the distribution of S is counted out; beyond, it is normal to four digits."""
MOST_PAIRED = 1500
"""Flights whose pairs are compared, a million pairs; of a longer series every k-th is."""


@dataclass(frozen=True, kw_only=True)
class Trend:
    """How a series moves.

    Parameters
    ----------
    slope, low, high
        Theil-Sen slope and its interval, in the unit of the series per unit of ``x``.
    p_value
        Of the Mann-Kendall test against no trend at all, two-sided.
    p_adjusted
        The same, for one series among all that were tested.
    """

    flights: int
    tau: float
    slope: float
    low: float
    high: float
    p_value: float
    p_adjusted: float = 1.0

    @property
    def drifts(self) -> bool:
        """Whether chance is no explanation."""
        return self.p_adjusted < SIGNIFICANCE


def trend(x: Floats, y: Floats) -> Trend | None:
    """Test a series for a trend; None where it has too few flights, or all at one time.

    Parameters
    ----------
    x : (n,)
        When each flight was, or its number; increasing.
    y : (n,)
        What was measured. [any unit]
    """
    n = len(y)
    if n < FEWEST:
        return None
    step = -(-n // MOST_PAIRED)
    x, y = x[::step], y[::step]
    later, earlier = np.tril_indices(len(y), -1)
    dy, dx = y[later] - y[earlier], x[later] - x[earlier]
    s = int(np.sign(dy).sum())
    variance = _variance(y)
    ties = len(np.unique(y)) < len(y)
    p_value = 1.0
    if variance > 0.0:
        exact = len(y) <= EXACT_UP_TO and not ties
        p_value = _exact_p(len(y), s) if exact else _normal_p(s, variance)
    if not bool((dx > 0).any()):
        return None
    slopes = np.sort(dy[dx > 0] / dx[dx > 0])
    half = NormalDist().inv_cdf(0.5 + CONFIDENCE / 2.0) * math.sqrt(variance)
    last = len(slopes) - 1
    below = min(max(math.floor((len(slopes) - half) / 2.0), 0), last)
    above = min(max(math.ceil((len(slopes) + half) / 2.0), 0), last)
    return Trend(
        flights=n,
        tau=s / len(dy),
        slope=float(np.median(slopes)),
        low=float(slopes[below]),
        high=float(slopes[above]),
        p_value=p_value,
    )


def _variance(y: Floats) -> float:
    """Variance of S where every order is as likely as the next. [Kendall75]"""
    n = len(y)
    _, tied = np.unique(y, return_counts=True)
    of_ties = float((tied * (tied - 1) * (2 * tied + 5)).sum())
    return (n * (n - 1) * (2 * n + 5) - of_ties) / 18.0


def _normal_p(s: int, variance: float) -> float:
    z = max(abs(s) - 1, 0) / math.sqrt(variance)  # continuity: S moves in steps of two
    return math.erfc(z / math.sqrt(2.0))


def _exact_p(n: int, s: int) -> float:
    """Share of all n! orders whose S is as far from zero; inversions follow Mahonian numbers."""
    share = np.ones(1)
    for k in range(2, n + 1):
        share = np.convolve(share, np.full(k, 1.0 / k))
    pairs = n * (n - 1) // 2
    inversions = (pairs - abs(s)) // 2
    return min(1.0, 2.0 * float(share[: inversions + 1].sum()))


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values so that one false alarm among all of them is as rare as each says."""
    order = np.argsort(p_values)
    adjusted = [1.0] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        adjusted[index] = largest
    return adjusted
