"""How good a redundant gyro unit is by its geometry alone, and the best arrangement of two triads.

References
----------
[Triads] "Improving the efficiency of search for a failed sensor in redundant angular-rate meters":
    asks how two triads should stand to one another, and leaves it open.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from fdilog.maths.geometry import (
    RANK_TOLERANCE,
    Floats,
    checked_axes,
    minimal_detectable_fault,
    parity_cosines,
    two_triads,
)


def _spanning_singular_values(axes: ArrayLike) -> Floats | None:
    """Three singular values of H, or None if the axes do not span space."""
    values = np.linalg.svd(checked_axes(axes), compute_uv=False).astype(np.float64)
    return values if len(values) == 3 and values[-1] > RANK_TOLERANCE * values[0] else None


def covariance_trace(axes: ArrayLike) -> float:
    """Trace of (H'H)^-1: the summed variance of the least-squares body rate per unit variance."""
    values = _spanning_singular_values(axes)
    return np.inf if values is None else float(np.sum(values**-2.0))


def condition_number(axes: ArrayLike) -> float:
    """Condition number of H in the 2-norm: 1 where every direction is measured equally well."""
    values = _spanning_singular_values(axes)
    return np.inf if values is None else float(values[0] / values[-1])


def smallest_minor(axes: ArrayLike) -> float:
    """Smallest modulus of a 3x3 minor of H: how well the worst three gyros alone give the rate."""
    array = checked_axes(axes)
    if len(array) < 3:
        return 0.0
    triples = array[list(itertools.combinations(range(len(array)), 3))]
    return float(np.abs(np.linalg.det(triples)).min())


def largest_cosine(axes: ArrayLike) -> float:
    """Largest |cos| between two parity columns: 1 where a fault cannot be pinned to one channel."""
    return float(min(parity_cosines(axes).max(), 1.0))


def _worst_detectable_fault(axes: ArrayLike) -> float:
    return float(minimal_detectable_fault(axes, sigma=1.0).max())


@dataclass(frozen=True, kw_only=True)
class BestTriads:
    """The arrangement of two triads that is best by one criterion.

    Parameters
    ----------
    criterion
        Name of the figure that was optimised.
    value
        What it reaches.
    azimuth_rad, cone_rad, second_cone_rad
        Where it does so first: see `fdilog.maths.geometry.two_triads`. [rad]
    ties : (n_ties, 3)
        Every (azimuth, cone, second cone) of the grid that is as good, this one among them. [rad]
    """

    criterion: str
    value: float
    azimuth_rad: float
    cone_rad: float
    second_cone_rad: float
    ties: Floats


CRITERIA: tuple[tuple[str, Callable[[ArrayLike], float], int], ...] = (
    ("covariance trace", covariance_trace, -1),
    ("condition number", condition_number, -1),
    ("smallest minor", smallest_minor, +1),
    ("largest parity cosine", largest_cosine, -1),
    ("worst minimal detectable fault", _worst_detectable_fault, -1),
)
"""Figures of merit with the sign of better: the fault is per unit sigma of one sample."""


def search_two_triads(
    azimuths_rad: ArrayLike,
    cone_angles_rad: ArrayLike,
    second_cone_angles_rad: ArrayLike | None = None,
) -> list[BestTriads]:
    """Best relative azimuth and cone angle of two triads, by each criterion in turn.

    Parameters
    ----------
    azimuths_rad : (n_azimuths,)
        Azimuths of the second triad relative to the first to try; the triads repeat after 120 deg
        and the sense of the turn does not matter, so 0 to 60 deg is all there is. [rad]
    cone_angles_rad : (n_cones,)
        Angles of the axes to the axis of the cone to try. [rad]
    second_cone_angles_rad : (n_second_cones,)
        The same for the second triad; if not given, it has the cone of the first. [rad]

    Returns
    -------
    best
        One entry for each of `CRITERIA`.

    Notes
    -----
    With one cone for both, the mirrored orthogonal triads of [Triads] are among the best by every
    one of these criteria. With two different cones the six axes of the dodecahedron are: parity
    cosines 0.447 in place of 0.667, smallest minor 0.470 in place of 0.333, at the same covariance.

    References
    ----------
    [Triads] raises the question; this is an exhaustive search over the grid.
    """
    azimuths = np.atleast_1d(np.asarray(azimuths_rad, dtype=np.float64))
    cones = np.atleast_1d(np.asarray(cone_angles_rad, dtype=np.float64))
    pairs = (
        [(cone, cone) for cone in cones]
        if second_cone_angles_rad is None
        else itertools.product(cones, np.atleast_1d(np.asarray(second_cone_angles_rad)))
    )
    grid = np.array([(azimuth, *pair) for azimuth, pair in itertools.product(azimuths, pairs)])
    units = [two_triads(*map(float, point)) for point in grid]
    found = []
    for criterion, figure, better in CRITERIA:
        values = np.array([figure(axes) for axes in units])
        best = values[np.argmax(better * values)]
        ties = grid[np.isclose(values, best, rtol=RANK_TOLERANCE, atol=0.0)]
        azimuth, cone, second = map(float, ties[0])
        found.append(
            BestTriads(
                criterion=criterion,
                value=float(best),
                azimuth_rad=azimuth,
                cone_rad=cone,
                second_cone_rad=second,
                ties=ties,
            )
        )
    return found
