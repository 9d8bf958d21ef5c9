"""Sequential innovations under cyclic permutation: the failed channel is the one that comes last.

References
----------
[Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
    Mechanics 51(6), 2015, 112-118: Kalman filter with cyclic permutation, Table 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import ballot, named_channel, voted_evidence
from fdilog.finding import Evidence
from fdilog.maths.geometry import (
    RANK_TOLERANCE,
    Floats,
    checked_axes,
    checked_readings,
    residual_projector,
)
from fdilog.registry import Stage
from fdilog.windows.survey import Survey


def innovation_rows(axes: ArrayLike) -> Floats:
    """Rows that turn readings into normalised innovations, for every cyclic shift of the channels.

    The filter for a constant body rate is recursive least squares, and its gains do not depend on
    the readings, so it is run once on coefficients: ``x = X z``.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    rows : (n_shifts, n_channels - 3, n_channels)
        ``rows[r, s] @ z = v / sqrt(S)`` for unit noise, after the last channel has been put first
        r times; not-a-number for a shift whose first three channels do not span space. [1]

    References
    ----------
    [Larin15]: start x = H_3^-1 z_3, P = (H_3' H_3)^-1 s^2; then innovation v and its variance S.
    """
    directions = checked_axes(axes)
    n = len(directions)
    rows = np.full((n, max(n - 3, 0), n), np.nan)
    for shift in range(n):
        order = np.roll(np.arange(n), shift)
        start = directions[order[:3]]
        if len(start) < 3 or np.linalg.svd(start, compute_uv=False)[-1] < RANK_TOLERANCE:
            continue
        state = np.zeros((3, n))
        state[:, order[:3]] = np.linalg.inv(start)
        covariance = np.linalg.inv(start.T @ start)
        for step, channel in enumerate(order[3:]):
            axis = directions[channel]
            innovation = -axis @ state
            innovation[channel] += 1.0
            variance = axis @ covariance @ axis + 1.0
            gain = covariance @ axis / variance
            state += np.outer(gain, innovation)
            covariance -= np.outer(gain, axis @ covariance)
            rows[shift, step] = innovation / np.sqrt(variance)
    return rows


def kalman_search(
    readings: ArrayLike, axes: ArrayLike, sigma: float
) -> tuple[Floats, Floats, NDArray[np.intp]]:
    """Ratio of the last innovation to the one before, for every cyclic shift.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z of five channels or more. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    sigma
        Standard deviation s of the noise; it cancels in the ratio. [the rate]

    Returns
    -------
    k : (n_samples, n_shifts, n_channels - 3)
        Squared normalised innovations ``k_s = v^2 / S``, chi-square with one degree of freedom
        each if all channels are healthy. [1]
    ratio : (n_samples, n_shifts)
        ``beta_r``, the last k_s over the one before it, after shift r. [1]
    candidate : (n_samples,)
        Channel ``n - r*`` with r* the shift of the largest ratio, counted from 0 here; -1 where
        there is none.

    Raises
    ------
    ValueError
        With fewer than five channels, where there is no innovation before the last.

    References
    ----------
    [Larin15] beta_r and the rule i = n - r* (channels counted from 1), Table 1.
    """
    samples, directions = checked_readings(readings, axes)
    n = len(directions)
    if n < 5:
        raise ValueError(f"the permuted filter needs five channels or more, not {n}")
    k: Floats = np.einsum("rsj,tj->trs", innovation_rows(directions) / sigma, samples) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio: Floats = k[:, :, -1] / k[:, :, -2]
    shift = named_channel(ratio, largest=True)
    return k, ratio, np.where(shift < 0, -1, n - 1 - shift)


def total_chi_square(k: Floats) -> Floats:
    """Sum of the squared innovations of one pass: has any channel failed at all?

    Parameters
    ----------
    k : (n_samples, n_shifts, n_channels - 3)
        Squared normalised innovations of `kalman_search`. [1]

    Returns
    -------
    total : (n_samples,)
        Chi-square with n - 3 degrees of freedom if all are healthy. It is |p|^2 / s^2, the same
        after any shift, so the first shift that could be started gives it. [1]
    """
    startable = np.flatnonzero(~np.isnan(k).all(axis=(0, 2)))
    if not len(startable):
        return np.full(len(k), np.nan)
    total: Floats = k[:, startable[0]].sum(axis=1)
    return total


def last_innovation_ratio(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Ratio of the last two innovations with each channel last, without running the filter.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H, of any rank. [1]

    Returns
    -------
    ratio : (n_samples, n_channels)
        beta of the cyclic order that ends with the channel; not-a-number where nothing checks it.
        [1]

    Notes
    -----
    An innovation depends on which channels came before, not on their order, and after all others
    ``v^2 / S = (G z)_i^2 / G_ii``. So neither a start that spans space nor three unknowns are
    needed: parallel gyros have one. Where the others do not check the channel before the last, the
    nearest before it that they check stands in.

    References
    ----------
    [Larin15] beta_r; the same figures as `kalman_search` where its filter can be started.
    """
    samples, directions = checked_readings(readings, axes)
    n = len(directions)
    projector = residual_projector(directions)
    ratio = np.full(samples.shape, np.nan)
    for last in range(n):
        rest = [(last + step) % n for step in range(1, n)]
        without = residual_projector(directions[rest])
        checked = np.flatnonzero(np.diag(without) > RANK_TOLERANCE)
        if projector[last, last] <= RANK_TOLERANCE or not len(checked):
            continue
        k_last = (samples @ projector[last]) ** 2 / projector[last, last]
        before = checked[-1]
        k_before = (samples[:, rest] @ without[before]) ** 2 / without[before, before]
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio[:, last] = k_last / k_before
    return ratio


@dataclass(frozen=True, kw_only=True)
class KalmanDetector:
    """Permuted filter as a vote, on every block with two channels more than unknowns.

    Three aligned triads are three blocks of one unknown each: across blocks the rule would compare
    innovations that have nothing to do with one another. Two aligned triads are not tested.
    """

    description: ClassVar[str] = "last innovation under cyclic permutation [Larin15]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel that, coming last, surprises most after those before agreed."""
        naming = ballot(last_innovation_ratio, largest=True)
        return [voted_evidence("kalman", survey, naming, needs=2)]
