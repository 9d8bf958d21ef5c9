"""The three exhaustive searches: leave one channel out, then see how well the others agree.

With channel i left out, every other channel j is compared with its prediction from the rest:
``d_ij = z_j - h_j' pinv(H_-ij) z_-ij``. If i has failed, all d_ij are small.

References
----------
[Triads] "Improving the efficiency of search for a failed sensor in redundant angular-rate meters",
    searches 1 to 3; the fourth is in `fdilog.detectors.difference`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import ballot, named_channel, voted_evidence
from fdilog.finding import Evidence
from fdilog.maths.geometry import Floats, checked_axes, checked_readings, leave_one_out
from fdilog.registry import Stage
from fdilog.windows.survey import Survey


def pair_rows(axes: ArrayLike) -> Floats:
    """Rows of all the differences d_ij, computed once for a unit.

    Returns
    -------
    rows : (n_channels, n_channels, n_channels)
        ``d_ij = rows[i, j] @ z``; not-a-number for j = i and where H_-ij does not span h_j. [1]
    """
    directions = checked_axes(axes)
    rows = np.stack([leave_one_out(directions, removed=(i,)) for i in range(len(directions))])
    own = np.arange(len(directions))
    rows[own, own] = np.nan
    return rows


def _pair_search(
    readings: ArrayLike, axes: ArrayLike, power: int, weights: Floats | None = None
) -> tuple[Floats, NDArray[np.intp]]:
    """Weighted mean of |d_ij|^power over j, and the channel i where it is smallest."""
    samples, directions = checked_readings(readings, axes)
    statistic = np.full(samples.shape, np.nan)
    for i, rows in enumerate(pair_rows(directions)):
        compared = np.flatnonzero(~np.isnan(rows[:, 0]))
        if len(compared):
            size = np.abs(samples @ rows[compared].T) ** power
            weight = np.ones(len(compared)) if weights is None else weights[i, compared]
            statistic[:, i] = size @ weight / len(compared)
    return statistic, named_channel(statistic, largest=False)


def mean_modulus(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, NDArray[np.intp]]:
    """Search 1 of [Triads]: the channel without which the mean modulus of d_ij is smallest.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    statistic : (n_samples, n_channels)
        Mean over j of ``|d_ij|``; over the j that can be compared, where some cannot. [the rate]
    candidate : (n_samples,)
        Channel with the smallest, -1 where none was compared.
    """
    return _pair_search(readings, axes, power=1)


def mean_square(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, NDArray[np.intp]]:
    """Search 2 of [Triads]: the channel without which the mean square of d_ij is smallest.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    statistic : (n_samples, n_channels)
        Mean over j of ``d_ij^2``. [square of the rate]
    candidate : (n_samples,)
        Channel with the smallest, -1 where none was compared.
    """
    return _pair_search(readings, axes, power=2)


def mean_square_rate_deviation(
    readings: ArrayLike, axes: ArrayLike
) -> tuple[Floats, NDArray[np.intp]]:
    """Search 3 of [Triads]: the channel without which leaving out another moves the rate least.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    statistic : (n_samples, n_channels)
        Mean over j and the three body axes of ``(W_-i - W_-ij)^2``, W the least-squares body rate
        without the channels named. [square of the rate]
    candidate : (n_samples,)
        Channel with the smallest, -1 where none was compared.

    Notes
    -----
    ``W_-i - W_-ij = (H_-i' H_-i)^-1 h_j d_ij`` (the deletion formula of regression), so this is
    search 2 with each d_ij weighted by how strongly channel j steers the body rate.
    """
    directions = checked_axes(axes)
    weights = np.empty((len(directions), len(directions)))
    for i in range(len(directions)):
        rest = np.delete(directions, i, axis=0)
        steered = directions @ np.linalg.pinv(rest.T @ rest)
        weights[i] = (steered**2).mean(axis=1)
    return _pair_search(readings, axes, power=2, weights=weights)


@dataclass(frozen=True, kw_only=True)
class MeanModulusDetector:
    """Search 1 as a vote; three or more parallel gyros are searched like any other block."""

    description: ClassVar[str] = "mean modulus of differences without a gyro [Triads, search 1]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel without which the others agree best, where some disagree."""
        naming = ballot(lambda z, h: mean_modulus(z, h)[0], largest=False)
        return [voted_evidence("mean-modulus", survey, naming)]


@dataclass(frozen=True, kw_only=True)
class MeanSquareDetector:
    """Search 2 as a vote; three or more parallel gyros are searched like any other block."""

    description: ClassVar[str] = "mean square of differences without a gyro [Triads, search 2]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel without which the others agree best, where some disagree."""
        naming = ballot(lambda z, h: mean_square(z, h)[0], largest=False)
        return [voted_evidence("mean-square", survey, naming)]


@dataclass(frozen=True, kw_only=True)
class RateDeviationDetector:
    """Search 3 as a vote; parallel gyros move the rate along their own axis only."""

    description: ClassVar[str] = "shift of the body rate without a gyro [Triads, search 3]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel without which leaving out another moves the rate least."""
        naming = ballot(lambda z, h: mean_square_rate_deviation(z, h)[0], largest=False)
        return [voted_evidence("rate-deviation", survey, naming)]
