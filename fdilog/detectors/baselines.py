"""What a navigator would try first: residuals of least squares and of least absolute deviations.

Both spread a large fault over healthy channels, which is why the other methods exist; they are
here to be compared with.

References
----------
[Baarda68] W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic
    Commission, Publications on Geodesy 2(5), 1968: the normalised residual.
[Matasov24] A. I. Matasov, E. V. Shestakova, "Failure determination for a redundant inertial sensor
    unit by guaranteeing estimation", Vestnik MSU ser. 1, 2024, no. 5, 77-81: compares with both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from fdilog.detectors.one_norm import one_norm_errors
from fdilog.detectors.vote import ballot, voted_evidence
from fdilog.finding import Evidence
from fdilog.maths.geometry import RANK_TOLERANCE, Floats, checked_readings, residual_projector
from fdilog.registry import Stage
from fdilog.windows.survey import Survey


def least_squares_errors(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Errors of the channels as least squares sees them.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    errors : (n_samples, n_channels)
        Residuals ``z - H (H'H)^-1 H' z = G z``. [the rate]
    """
    samples, directions = checked_readings(readings, axes)
    errors: Floats = samples @ residual_projector(directions)
    return errors


def least_absolute_errors(readings: ArrayLike, axes: ArrayLike) -> Floats:
    """Errors of the channels as least absolute deviations sees them.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Returns
    -------
    errors : (n_samples, n_channels)
        Residuals ``z - H w`` of the w with the smallest sum of their moduli: the error vector of
        smallest 1-norm that has the parity of the readings. [the rate]
    """
    samples, directions = checked_readings(readings, axes)
    return one_norm_errors(samples, directions)


def normalised_residuals(errors: Floats, axes: ArrayLike, sigma: ArrayLike) -> Floats:
    """Residuals in units of what noise alone would make them.

    Parameters
    ----------
    errors : (n_samples, n_channels)
        Residuals of least squares. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    sigma : ()
        Standard deviation s of the noise, the same for every channel. [the rate]

    Returns
    -------
    residuals : (n_samples, n_channels)
        ``(G z)_i / (s sqrt(G_ii))``, standard normal if all are healthy; not-a-number where
        nothing checks the channel. [1]

    References
    ----------
    [Baarda68] data snooping: the channel with the largest modulus is the suspect.
    """
    redundancy = np.diag(residual_projector(axes)).copy()
    redundancy[redundancy <= RANK_TOLERANCE] = np.nan
    residuals: Floats = errors / (np.asarray(sigma) * np.sqrt(redundancy))
    return residuals


@dataclass(frozen=True, kw_only=True)
class LeastSquaresDetector:
    """Data snooping: the largest normalised residual is struck out and the fit repeated.

    The interval of an error is that of the channel against the fit of all others but those struck
    out.
    """

    description: ClassVar[str] = "largest normalised residual of least squares [Baarda68]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel with the largest normalised residual, where some disagree."""

        def snoop(readings: Floats, axes: Floats) -> Floats:
            # The noise is the same for all channels and does not change which is the largest.
            return np.abs(normalised_residuals(least_squares_errors(readings, axes), axes, 1.0))

        naming = ballot(snoop, largest=True)
        return [voted_evidence("least-squares", survey, naming, intervals=True)]


@dataclass(frozen=True, kw_only=True)
class LeastAbsoluteDetector:
    """The largest residual of least absolute deviations is struck out and the fit repeated."""

    description: ClassVar[str] = "largest residual of least absolute deviations [Matasov24, rival]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name the channel that lies farthest from the fit, where some disagree."""
        naming = ballot(lambda z, h: np.abs(least_absolute_errors(z, h)), largest=True)
        return [voted_evidence("least-absolute", survey, naming)]
