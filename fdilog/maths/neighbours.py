"""How far readings lie from the middle of the two beside each: what shows no slow motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# Neighbours are no further apart than this: one lost record is bridged. [steps]
STEPS_APART = 2.5


def from_neighbours(time_s: Floats, readings: Floats, rate_hz: float, apart: int = 1) -> Floats:
    """Deviation of the readings of one source from the mean of the two beside each.

    Parameters
    ----------
    readings : (n,) or (n, n_axes)
        [rad/s]
    apart
        How many readings further the two are.

    Returns
    -------
    deviation : as readings
        NaN where a neighbour is missing, or further away than two and a half steps. [rad/s]
    """
    deviation = np.full_like(readings, np.nan)
    if len(readings) <= 2 * apart:
        return deviation
    near = near_both(time_s, rate_hz, apart)
    inner = slice(apart, -apart)
    middle = readings[inner] - (readings[: -2 * apart] + readings[2 * apart :]) / 2.0
    deviation[inner][near] = middle[near]
    return deviation


def near_both(
    time_s: Floats, rate_hz: float, apart: int = 1, steps: float = STEPS_APART
) -> NDArray[np.bool_]:
    """Tell which of the inner ones of some instants have both neighbours, within so many steps."""
    step_s = time_s[apart:] - time_s[:-apart]
    longest_s = np.maximum(step_s[apart:], step_s[:-apart])
    return np.asarray(longest_s * rate_hz < apart - 1 + steps, bool)
