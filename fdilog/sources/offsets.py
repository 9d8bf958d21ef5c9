"""By how much one source's stamps run late against another's, from the rates themselves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.noise import NORMAL_CONSISTENCY
from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]

# Offsets are sought up to this; beyond it two clocks have nothing in common. [s]
LARGEST_OFFSET_S = 0.5
# The flight is cut into this many pieces; their spread says how sure the offset is.
PIECES = 12
FEWEST_PIECES = 4
# A piece counts if the two sources agree this well at the best lag: at rest, noise decides it.
LEAST_CORRELATION = 0.7
# Turned as they best fit, two triads correlate by the sum of the singular values of their moments.
# That is what counts if it is so much more than as they are: then one is mounted otherwise.
ALIGNED = 0.9
# Longer holes are cut short. [s]
LONGEST_HOLE_S = 10.0
# Motion of a vehicle holds nothing that a hundred samples a second do not show.
FINEST_STEP_S = 0.01
# Means over this time, twice, leave the motion of the vehicle. Vibration must go: aliased by the
# logging rate, its phase says nothing of the offset, and half a millisecond can look like twenty.
SMOOTH_S = 0.25


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """By how much a source's stamps run late against the reference source. [s]"""

    source: str
    offset_s: float
    low: float
    high: float


def estimate_offset(
    source: str,
    reference: tuple[Floats, Floats],
    other: tuple[Floats, Floats],
    confidence: float,
) -> ClockOffset | None:
    """Estimate a constant offset by correlating two triads that point the same way.

    Parameters
    ----------
    reference, other
        Stamps of each, (n,) and increasing [s], and its readings, (n, 3). [rad/s]

    Returns
    -------
    ClockOffset or None
        The median over pieces of the flight, with a Student interval from their robust spread;
        None where too few pieces hold enough motion.
    """
    (reference_s, reference_rate), (time_s, rate) = reference, other
    period = float(np.median(np.diff(reference_s))) if len(reference_s) > 2 else 0.0
    # A hole of hours tells no more than one of seconds.
    steps = np.diff(reference_s, prepend=reference_s[0])
    cut_s = np.cumsum(np.maximum(steps - LONGEST_HOLE_S, 0.0))
    time_s, reference_s = time_s - np.interp(time_s, reference_s, cut_s), reference_s - cut_s
    step = max(period, FINEST_STEP_S) if period > 0 else 0.0
    start, end = max(reference_s[0], time_s[0]), min(reference_s[-1], time_s[-1])
    lags = round(LARGEST_OFFSET_S / step) if step > 0 else 0
    if lags < 2 or (end - start) / step < PIECES * 8 * lags / 4:
        return None
    grid = np.arange(start, end, step)
    one = _prepared(grid, reference_s, reference_rate, step)
    two = _prepared(grid, time_s, rate, step)
    found = [
        lag
        for piece in np.array_split(np.arange(len(grid)), PIECES)
        if (lag := _best_lag(one[piece], two[piece], lags)) is not None
    ]
    if len(found) < FEWEST_PIECES:
        return None
    offsets = np.array(found) * step
    middle = float(np.median(offsets))
    spread = NORMAL_CONSISTENCY * float(np.median(np.abs(offsets - middle)))
    quantile = float(student_quantile(np.array([len(found) - 1.0]), confidence)[0])
    # The median of n normal values has the variance pi / 2n; no piece is better than a hundredth
    # of a step.
    half = quantile * float(np.sqrt(np.pi / 2.0 / len(found))) * max(spread, 0.01 * step)
    return ClockOffset(source=source, offset_s=middle, low=middle - half, high=middle + half)


def _prepared(grid: Floats, time_s: Floats, rate: Floats, step: float) -> Floats:
    """Put rates on a grid, smooth them, and take differences, in which offsets show best."""
    width = max(1, round(SMOOTH_S / step))
    kernel = np.ones(width) / width
    columns = []
    for column in rate.T:
        known = np.isfinite(column)
        if known.sum() < 2:
            return np.zeros((len(grid), 3))
        even = np.interp(grid, time_s[known], column[known])
        smooth = np.convolve(np.convolve(even, kernel, mode="same"), kernel, mode="same")
        columns.append(np.gradient(smooth))
    return np.column_stack(columns)


def _best_lag(one: Floats, other: Floats, lags: int) -> float | None:
    """Lag in steps at which the other correlates best, by a parabola through the peak."""
    inner = one[lags : len(one) - lags]
    if len(inner) < 2 * lags:
        return None
    moments = np.array(
        [inner.T @ other[lags + k : len(other) - lags + k] for k in range(-lags, lags + 1)]
    )
    products = np.einsum("kii->k", moments)
    turned = np.linalg.svd(moments, compute_uv=False).sum(axis=1)
    if products.max() < ALIGNED * turned.max():
        products = turned
    power = np.sqrt(float((inner**2).sum()) * float((other[lags : len(other) - lags] ** 2).sum()))
    best = int(products.argmax())
    if power <= 0 or products[best] < LEAST_CORRELATION * power or not 0 < best < 2 * lags:
        return None
    left, middle, right = products[best - 1 : best + 2]
    curvature = left - 2.0 * middle + right
    return best - lags + (0.5 * float((left - right) / curvature) if curvature < 0 else 0.0)
