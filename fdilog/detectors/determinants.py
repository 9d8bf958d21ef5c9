"""Rank of the equations with one channel struck out: consistent equations are nearly singular.

References
----------
[Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
    Mechanics 51(6), 2015, 112-118: determinants and condition numbers, Table 2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import named_channel
from fdilog.geometry import Floats, checked_axes, checked_readings

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
    rows = np.zeros((5, 5))
    for j in range(5):
        left = [i for i in range(5) if i != j]
        for place, i in enumerate(left):
            minor = directions[[other for other in left if other != i]]
            # The column z is the fourth: the sign of its cofactor in row `place` is (-1)^(place+3).
            rows[j, i] = (-1.0) ** (place + 3) * np.linalg.det(minor)
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
    n = len(directions)
    if n < 5:
        raise ValueError(f"striking out a channel needs five channels or more, not {n}")
    values = np.full((len(samples), n, 4), np.nan)
    left = np.array([[i for i in range(n) if i != j] for j in range(n)])
    whole = np.flatnonzero(np.isfinite(samples).all(axis=1))
    for start in range(0, len(whole), BLOCK_SAMPLES):
        at = whole[start : start + BLOCK_SAMPLES]
        matrices = np.empty((len(at), n, n - 1, 4))
        matrices[..., :3] = directions[left]
        matrices[..., 3] = samples[at][:, left]
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
