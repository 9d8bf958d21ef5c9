"""Each gyro against its prediction from all the others, with a tolerance that follows the rate.

References
----------
[Triads] "Improving the efficiency of search for a failed sensor in redundant angular-rate meters",
    simplified search (the fourth); the other three are in `fdilog.detectors.searches`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import named_channel
from fdilog.finding import Evidence
from fdilog.maths.geometry import (
    Floats,
    checked_axes,
    checked_readings,
    detectable,
    isolability_groups,
    leave_one_out,
)
from fdilog.registry import Stage
from fdilog.windows.isolation import Answer, comparative_evidence, compare, family_wise_confidence
from fdilog.windows.survey import Moments, Survey

TOLERANCE_SIGMAS = 3.0
"""[Triads]: the tolerance is three standard deviations."""


def leave_one_out_residuals(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, Floats]:
    """Difference of every channel from its least-squares prediction from the others.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    residual : (n_samples, n_channels)
        ``r_i = z_i - h_i' pinv(H_-i) z_-i``; not-a-number where nothing checks the channel. [the
        rate]
    predicted : (n_samples, n_channels)
        ``zp_i = h_i' pinv(H_-i) z_-i``. [the rate]
    """
    samples, directions = checked_readings(readings, axes)
    residual: Floats = samples @ leave_one_out(directions).T
    return residual, samples - residual


def maximum_difference(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, NDArray[np.intp]]:
    """Search 4 of [Triads]: the channel that differs most from its prediction.

    Returns
    -------
    statistic : (n_samples, n_channels)
        ``|r_i|``; the failed channel has the largest. [the rate]
    candidate : (n_samples,)
        That channel, -1 where none was compared.
    """
    statistic = np.abs(leave_one_out_residuals(readings, axes)[0])
    return statistic, named_channel(statistic, largest=True)


def rate_tolerance(
    predicted: ArrayLike,
    axes: ArrayLike,
    bias_sigma: float,
    scale_sigma: float,
    *,
    rate_of_change: ArrayLike = 0.0,
    time_sigma_s: float = 0.0,
    leverage_corrected: bool = True,
) -> Floats:
    """How far a healthy channel may stray from its prediction at the present rate.

    Parameters
    ----------
    predicted : (n_samples, n_channels)
        Predicted readings zp. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    bias_sigma
        Standard deviation s_b of a healthy bias. [the rate]
    scale_sigma
        Standard deviation s_k of a healthy scale error. [1]
    rate_of_change : (n_samples, n_channels)
        Rate of change dz/dt of every reading. [the rate/s]
    time_sigma_s
        Standard deviation s_t of the instants at which the channels are sampled. [s]
    leverage_corrected
        Whether the errors of the *other* channels count too, as they must: they stand in the
        prediction. [Triads] leaves them out, and so calls 14.7 % of healthy samples failed on its
        unit, where each residual has twice the variance that the paper's tolerance allows for.

    Returns
    -------
    tolerance : (n_samples, n_channels)
        ``d_i = 3 sqrt(q_i)`` with ``q_j = s_b^2 + (s_k zp_j)^2 + (s_t dz_j/dt)^2``, and corrected
        ``d_i = 3 sqrt(sum_j L_ij^2 q_j)`` with L the rows of `leave_one_out`; if all q are equal
        the sum is q / (1 - leverage_i). Not-a-number where nothing checks the channel. [the rate]

    References
    ----------
    [Triads], tolerance of the candidate; the term in dz/dt is an addition for channels that are
    not sampled at one instant.
    """
    directions = checked_axes(axes)
    rate = np.asarray(predicted, dtype=np.float64)
    change = np.broadcast_to(np.asarray(rate_of_change, dtype=np.float64), rate.shape)
    variance: Floats = bias_sigma**2 + (scale_sigma * rate) ** 2 + (time_sigma_s * change) ** 2
    if leverage_corrected:
        rows = leave_one_out(directions)
        # No row leans on a channel that nothing checks, but 0 times not-a-number is not 0.
        variance = np.where(detectable(directions), variance, 0.0) @ (rows**2).T
    tolerance: Floats = TOLERANCE_SIGMAS * np.sqrt(variance)
    return tolerance


def declared_failed(
    candidate: NDArray[np.intp], residual: Floats, tolerance: Floats
) -> NDArray[np.intp]:
    """Keep the candidate of a search only where its difference exceeds its tolerance.

    Parameters
    ----------
    candidate : (n_samples,)
        Channel that the search names, -1 for none.
    residual, tolerance : (n_samples, n_channels)
        Leave-one-out residual r and tolerance d. [one rate]

    Returns
    -------
    failed : (n_samples,)
        The channel declared failed, -1 for none.

    References
    ----------
    [Triads]: searches 2 and 3 compare the squares, which decides the same.
    """
    at = candidate[:, None].clip(min=0)
    beyond = np.abs(np.take_along_axis(residual, at, axis=1)) > np.take_along_axis(
        tolerance, at, axis=1
    )
    return np.where((candidate >= 0) & beyond[:, 0], candidate, -1)


@dataclass(frozen=True, kw_only=True)
class DifferenceDetector:
    """Bias of the channel that differs most from its prediction, found one after the other."""

    description: ClassVar[str] = "leave-one-out difference, largest first [Triads, search 4]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel with the largest difference, strike it out, and look again."""
        return [
            comparative_evidence(
                "difference", survey, [_search(moments, survey) for moments in survey.moments]
            )
        ]


def _search(moments: Moments, survey: Survey) -> Answer:
    """Run the sequential search on the window means of one block of channels."""
    config = survey.config
    axes = survey.table.axes[list(moments.channels)]
    confidence = family_wise_confidence(config, survey.windows.length_s, len(axes))
    healthy = np.radians(config.noise.bias_sigma_deg_s)
    alone = partial(
        compare, axes=axes, variance=np.ones(len(axes)), config=config, family_confidence=confidence
    )
    alike = np.eye(len(axes), dtype=bool)
    for group in isolability_groups(axes):
        alike[np.ix_(group, group)] = True
    answer = Answer.of(alone(moments, removed=()))
    # The channels struck out differ from window to window; there are few such sets.
    todo: list[tuple[tuple[int, ...], NDArray[np.intp]]] = [((), np.arange(len(moments.windows)))]
    while todo:
        removed, rows = todo.pop()
        found = alone(moments.at(rows), removed=removed)
        left = np.ones(len(axes), bool)
        left[list(removed)] = False
        outside = found.outside(healthy) & left
        size = np.where(outside, np.abs(found.error), -np.inf)
        candidate = np.where(outside.any(axis=1), size.argmax(axis=1), -1)
        for bound, values in ((answer.low, -found.half_width), (answer.high, found.half_width)):
            bound[rows] = np.where(found.tested, found.error + values, bound[rows])
        for channel in np.unique(candidate[candidate >= 0]).tolist():
            named = rows[candidate == channel]
            answer.accused[np.ix_(named, np.flatnonzero(alike[channel]))] = len(removed) + 1
            if len(removed) + 1 < min(config.detectors.max_failures, len(moments.parity)):
                todo.append(((*removed, channel), named))
    return answer
