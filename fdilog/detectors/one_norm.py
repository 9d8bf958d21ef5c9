"""The errors of smallest 1-norm that explain the readings; their support names the failed channels.

Attributed in [Larin15] to Lebedev: minimise ``|e|_1`` subject to ``V e = V z``, which is the same
as the least absolute deviations fit of the rate, ``e = z - H w``.  No linear program is solved:
some fit passes through as many independent channels as the axes have rank, so all such bases are
tried.  With a basis B, the error of another channel i is ``c . z / c_i`` over the one circuit
(`fdilog.maths.circuits`) within B and i, so the 1-norms of all bases are one matrix product of the
moduli ``|c . z|``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.detectors.vote import voted_evidence
from fdilog.finding import Evidence
from fdilog.maths.circuits import find_circuits, linear_forms
from fdilog.maths.geometry import Floats, checked_readings
from fdilog.registry import Stage
from fdilog.windows.survey import Survey

ROUNDING = 64 * np.finfo(float).eps
"""1-norms closer than this share of the readings are a tie: they sum some tens of rounded terms."""

BLOCK = 5000
"""Samples worked on at a time; bounds the memory, and is no power of two (cache associativity)."""


@dataclass(frozen=True, kw_only=True)
class _Basis:
    """The errors of the channels outside one basis: ``e[outside] = scale * residual[circuits]``."""

    outside: NDArray[np.intp]  # (n - rank,)
    circuits: NDArray[np.intp]  # (n - rank,)
    scale: Floats  # (n - rank, 1), 1 / c_i


@dataclass(frozen=True, kw_only=True)
class _Plan:
    relations: Floats  # (n_circuits, n)
    weights: Floats  # (n_bases, n_circuits), 1-norms of the bases from |c . z|
    bases: list[_Basis]


def one_norm_errors(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Find the errors of smallest 1-norm that explain each sample.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z; a value that is not finite is missing, and the others explain themselves without
        it. [any unit of rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    errors : (n_samples, n_channels)
        Errors e with V e = V z; NaN where the reading is missing. [unit of readings]

    Raises
    ------
    ValueError
        If the shapes do not fit one another, or an axis is zero or not finite.

    Notes
    -----
    Where several bases give the same 1-norm to rounding, the errors are the mean over them: a
    minimiser too, independent of the order of the channels.  Two aligned gyros that disagree share
    the disagreement half and half, so that the support names both and accuses neither.

    References
    ----------
    [Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
        Mechanics 51(6), 2015, 112-118: the linear program attributed to Lebedev.
    """
    z, directions = checked_readings(readings, axes)
    errors = np.full(z.shape[::-1], np.nan)
    for start in range(0, len(z), BLOCK):
        block = z[start : start + BLOCK].T
        for channels, samples in _patterns(np.isfinite(block)):
            within = np.ix_(channels, start + samples)
            errors[within] = _errors(block[np.ix_(channels, samples)], directions[channels])
    return errors.T


def _patterns(
    present: NDArray[np.bool_],
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Group samples by the channels (n, n_samples) that they have."""
    codes = (1 << np.arange(len(present))) @ present
    for code in np.unique(codes).tolist():
        if code:
            samples = np.flatnonzero(codes == code)
            yield np.flatnonzero(present[:, samples[0]]), samples


def _errors(z: Floats, axes: Floats) -> Floats:
    """Errors of complete readings (n, n_samples)."""
    plan = _plan(axes.tobytes(), len(axes))
    residuals = linear_forms(plan.relations, z)
    norms = linear_forms(plan.weights, np.abs(residuals))
    tied = norms <= norms.min(axis=0) + ROUNDING * np.abs(z).sum(axis=0)
    errors = np.zeros_like(z)
    for basis, best in zip(plan.bases, tied, strict=True):
        samples = np.flatnonzero(best)
        if len(samples):
            part = basis.scale * residuals[np.ix_(basis.circuits, samples)]
            errors[np.ix_(basis.outside, samples)] += part
    mean: Floats = errors / tied.sum(axis=0)
    return mean


@lru_cache(maxsize=64)
def _plan(axes_bytes: bytes, n_channels: int) -> _Plan:
    axes = np.frombuffer(axes_bytes).reshape(n_channels, 3)
    relations = find_circuits(axes)
    inside = relations != 0.0
    bases: list[_Basis] = []
    for size in range(min(3, n_channels), 0, -1):
        for channels in combinations(range(n_channels), size):
            outside = np.ones(n_channels, dtype=bool)
            outside[list(channels)] = False
            beyond = (inside & outside).sum(axis=1)
            circuits = np.flatnonzero(beyond == 1)
            if (beyond > 0).all() and len(circuits) == n_channels - size:
                channel = (inside[circuits] & outside).argmax(axis=1)
                scale = 1.0 / relations[circuits, channel][:, None]
                bases.append(_Basis(outside=channel, circuits=circuits, scale=scale))
        if bases:
            break
    weights = np.zeros((len(bases), len(relations)))
    for row, basis in zip(weights, bases, strict=True):
        row[basis.circuits] = np.abs(basis.scale[:, 0])
    return _Plan(relations=relations, weights=weights, bases=bases)


@dataclass(frozen=True, kw_only=True)
class OneNormDetector:
    """Support of the smallest 1-norm as a vote: all failed channels at once, at any rank.

    Noise puts something into every channel outside the basis, so the support is what exceeds
    ``tolerance.bias_deg_s``.
    """

    description: ClassVar[str] = "errors of smallest 1-norm, their support [Larin15, after Lebedev]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channels whose errors are large in the sparsest explanation."""
        tolerance = np.radians(survey.config.tolerance.bias_deg_s)

        def support(readings: Floats, axes: Floats) -> NDArray[np.bool_]:
            large: NDArray[np.bool_] = np.abs(one_norm_errors(readings, axes)) > tolerance
            return large

        return [voted_evidence("one-norm", survey, support)]
