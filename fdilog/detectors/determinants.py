"""Rank of the equations with one channel struck out: consistent equations are nearly singular.

References
----------
[Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
    Mechanics 51(6), 2015, 112-118: determinants and condition numbers, Table 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import ballot, named_channel, voted_evidence
from fdilog.finding import Evidence
from fdilog.maths.geometry import Floats, checked_axes, checked_readings, parity_matrix
from fdilog.registry import Stage
from fdilog.windows.survey import Survey

BLOCK_SAMPLES = 4096
"""Samples whose matrices are held at once where every sample needs a factorisation."""


def determinant_rows(axes: ArrayLike) -> Floats:
    """Coefficients that give all determinants of five channels as one matrix product.

    Returns
    -------
    rows : (5, 5)
        c_j with ``det [H z] without row j = c_j' z``: cofactors of the column z. [1]

    Raises
    ------
    ValueError
        If there are not five channels: only then are the matrices square.
    """
    directions = checked_axes(axes)
    if len(directions) != 5:
        raise ValueError(f"determinants need five channels, not {len(directions)}")
    return _cofactors(directions)


def _cofactors(directions: Floats) -> Floats:
    """Cofactors of the column z in [H z] with each row struck out; H has two rows too many."""
    n = len(directions)
    rows = np.zeros((n, n))
    for j in range(n):
        left = [i for i in range(n) if i != j]
        for place, i in enumerate(left):
            minor = directions[[other for other in left if other != i]]
            # The column z is the last, number n - 2 from 0: the sign is that of place + n - 2.
            rows[j, i] = (-1.0) ** (place + n - 2) * np.linalg.det(minor)
    return rows


def determinant_search(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, NDArray[np.intp]]:
    """Compute the determinants of [H z] with each of five channels struck out.

    Parameters
    ----------
    readings : (n_samples, 5)
        Readings z. [any rate]
    axes : (5, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    determinants : (n_samples, 5)
        ``D_j = |det [H z] without row j|``; the failed channel has the smallest. [the rate]
    candidate : (n_samples,)
        That channel, -1 where readings are not numbers.

    References
    ----------
    [Larin15] Table 2.
    """
    samples, directions = checked_readings(readings, axes)
    determinants = np.abs(samples @ determinant_rows(directions).T)
    return determinants, named_channel(determinants, largest=False)


def _struck_singular_values(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Four singular values of [H z] with each row struck out, (n_samples, n_channels, 4)."""
    samples, directions = checked_readings(readings, axes)
    if len(directions) < 5:
        raise ValueError(
            f"striking out a channel needs five channels or more, not {len(directions)}"
        )
    return _struck_values(samples, directions)


def _struck_values(samples: Floats, directions: Floats) -> Floats:
    """Singular values (n_samples, n, m + 1) of [H z], H (n, m) of rank m, without each row."""
    n, m = directions.shape
    values = np.full((len(samples), n, m + 1), np.nan)
    left = np.array([[i for i in range(n) if i != j] for j in range(n)])
    whole = np.flatnonzero(np.isfinite(samples).all(axis=1))
    for start in range(0, len(whole), BLOCK_SAMPLES):
        at = whole[start : start + BLOCK_SAMPLES]
        matrices = np.empty((len(at), n, n - 1, m + 1))
        matrices[..., :m] = directions[left]
        matrices[..., m] = samples[at][:, left]
        values[at] = np.linalg.svd(matrices, compute_uv=False)
    return values


def condition_search(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, NDArray[np.intp]]:
    """Condition numbers of [H z] with each channel struck out, in place of determinants.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z of five channels or more. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    conditions : (n_samples, n_channels)
        Largest over smallest singular value; the failed channel has the largest. [1]
    candidate : (n_samples,)
        That channel, -1 where readings are not numbers.

    References
    ----------
    [Larin15], which notes that it costs more: a factorisation of every sample.
    """
    values = _struck_singular_values(readings, axes)
    with np.errstate(divide="ignore"):
        conditions: Floats = values[..., 0] / values[..., -1]
    return conditions, named_channel(conditions, largest=True)


def smallest_singular_value_search(
    readings: ArrayLike, axes: ArrayLike
) -> tuple[Floats, NDArray[np.intp]]:
    """Smallest singular values of [H z] with each channel struck out, for any number of channels.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z of five channels or more. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    singular_values : (n_samples, n_channels)
        Distance of [H z] without row j from a consistent system; the failed channel has the
        smallest. [the rate, where it is small beside 1]
    candidate : (n_samples,)
        That channel, -1 where readings are not numbers.

    Notes
    -----
    Not in [Larin15], whose determinants exist for five channels only; this is the same question,
    how near to rank three the equations are, asked of a matrix that is not square.
    """
    smallest: Floats = _struck_singular_values(readings, axes)[..., -1]
    return smallest, named_channel(smallest, largest=False)


def _unit_errors(readings: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Minimum-norm errors of unit length, and the axes (n, m) in a basis of the m they span.

    [H z] and [H e0] with e0 = G z have the same determinants, but their singular values differ
    with the body rate and with the unit of the readings: of e0 / |e0| they do not.
    """
    parity = parity_matrix(axes)
    errors = (readings @ parity.T) @ parity
    length = np.linalg.norm(errors, axis=1, keepdims=True)
    basis = np.linalg.svd(axes)[2][: len(axes) - len(parity)]
    with np.errstate(divide="ignore", invalid="ignore"):
        unit: Floats = errors / length
    return unit, axes @ basis.T


def struck_determinants(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """How far from consistent the equations are with each channel struck out, at any rank.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z of at least two channels more than the axes have rank m. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    distance : (n_samples, n_channels)
        With m + 2 channels the determinants of [H e], e the minimum-norm errors G z in units of
        their length: those of [Larin15] but for a factor common to all channels. With more the
        smallest singular values of the same matrices, which is not in the source. The failed
        channel has the smallest. [1]
    """
    samples, directions = checked_readings(readings, axes)
    errors, coordinates = _unit_errors(samples, directions)
    if len(coordinates) == coordinates.shape[1] + 2:
        return np.abs(errors @ _cofactors(coordinates).T)
    return _struck_values(errors, coordinates)[..., -1]


def struck_conditions(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Condition numbers of the equations with each channel struck out, at any rank.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z of at least two channels more than the axes have rank m. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    conditions : (n_samples, n_channels)
        Condition numbers of [H e], e the minimum-norm errors G z in units of their length; the
        failed channel has the largest. [1]
    """
    samples, directions = checked_readings(readings, axes)
    values = _struck_values(*_unit_errors(samples, directions))
    with np.errstate(divide="ignore", invalid="ignore"):
        conditions: Floats = values[..., 0] / values[..., -1]
    return conditions


@dataclass(frozen=True, kw_only=True)
class DeterminantsDetector:
    """Determinants as a vote, on every block with two channels more than unknowns.

    Three parallel gyros are such a block (one unknown), two are not and stay untested. In larger
    blocks the smallest singular value takes the place of the determinant.
    """

    description: ClassVar[str] = "determinants without each gyro in turn [Larin15]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel without which the equations are nearest to consistent."""
        naming = ballot(struck_determinants, largest=False)
        return [voted_evidence("determinants", survey, naming, needs=2)]


@dataclass(frozen=True, kw_only=True)
class ConditionDetector:
    """Condition numbers as a vote, on the blocks on which determinants vote."""

    description: ClassVar[str] = "condition numbers without each gyro in turn [Larin15]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel without which the equations are worst conditioned."""
        return [
            voted_evidence("condition", survey, ballot(struck_conditions, largest=True), needs=2)
        ]
