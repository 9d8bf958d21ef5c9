"""Parity-space search for one failed channel, by SVD or QR.

References
----------
[Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
    Mechanics 51(6), 2015, 112-118.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from fdilog.finding import Evidence
from fdilog.maths.geometry import (
    RANK_TOLERANCE,
    Floats,
    checked_readings,
    parity_matrix,
    parity_matrix_qr,
)
from fdilog.registry import Stage
from fdilog.windows.isolation import comparative_evidence, isolate
from fdilog.windows.survey import Survey
from fdilog.windows.usual import usual


def parity_search(
    readings: ArrayLike, axes: ArrayLike, factors: Literal["svd", "qr"] = "svd"
) -> tuple[Floats, Floats]:
    """Misfit and error estimate under the hypothesis that one channel alone has failed.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z. [any rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    factors
        Factorisation that gives the parity matrix; both agree to rounding.

    Returns
    -------
    misfit : (n_samples, n_channels)
        ``J(k) = |p|^2 - (v_k' p)^2 / |v_k|^2``, what is left of the parity vector when channel k
        takes all the blame: the failed channel has the smallest. [square of the rate]
    error : (n_samples, n_channels)
        ``alpha_k = v_k' p / |v_k|^2``, the error of channel k if it has failed; not-a-number
        where nothing checks the channel. [the rate]

    References
    ----------
    [Larin15] ``alpha_k = g_k' e0 / |g_k|^2``, ``J(k) = |e0 - alpha_k g_k|^2`` with e0 = G z; the
    closed forms follow from G = V' V.
    """
    samples, directions = checked_readings(readings, axes)
    parity = (parity_matrix if factors == "svd" else parity_matrix_qr)(directions)
    column_square = (parity**2).sum(axis=0)
    column_square[column_square <= RANK_TOLERANCE] = np.nan
    vector = samples @ parity.T
    projected = vector @ parity
    total = (vector**2).sum(axis=1, keepdims=True)
    error: Floats = projected / column_square
    # A channel that nothing checks explains nothing; rounding must not make a misfit negative.
    misfit = np.maximum(total - np.nan_to_num(projected * error), 0.0)
    misfit[np.isnan(vector).any(axis=1)] = np.nan
    return misfit, error


@dataclass(frozen=True, kw_only=True)
class ParityDetector:
    """Bias of any set of channels that the redundancy can tell, by joint tests in parity space."""

    description: ClassVar[str] = "parity space, joint hypotheses of one or two failures [Larin15]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give an interval for every channel's error, and the smallest sets that explain it."""
        return [
            comparative_evidence(
                "parity",
                survey,
                [
                    isolate(
                        moments,
                        survey.table.axes[list(moments.channels)],
                        survey.config,
                        survey.windows.length_s,
                        usual(survey.table).offset[list(moments.channels)],
                    )
                    for moments in survey.moments
                ],
            )
        ]
