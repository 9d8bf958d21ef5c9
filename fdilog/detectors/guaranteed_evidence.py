"""Guaranteed estimation on every sample of a flight: failed is what no healthy error explains.

The formula is `fdilog.detectors.guaranteed.guaranteed_intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.detectors.guaranteed import guaranteed_intervals
from fdilog.finding import Evidence
from fdilog.maths.geometry import blocks, leave_one_out, parity_matrix
from fdilog.maths.noise import robust_sigma
from fdilog.registry import Stage
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey

Floats = NDArray[np.float64]

# Where no bound is stated, this many robust sigmas of a channel's difference from the others stand
# for it: vibration has far heavier tails than a normal law, and a bound that is violated every
# second says nothing.
BOUND_SIGMAS = 6.0


@dataclass(frozen=True, kw_only=True)
class GuaranteedDetector:
    """Intervals for every channel's error at every sample, true as long as the bound holds.

    A block of channels takes part if two of them are more than its rank: with one to spare, any
    channel may be the failed one and nothing is bounded.
    """

    description: ClassVar[str] = "guaranteed set-membership intervals on every sample [Matasov24]"
    stage: ClassVar[Stage] = "samples"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Accuse a channel where its whole interval lies beyond the tolerance, [Matasov24]."""
        table, config = survey.table, survey.config
        shape = (len(table.time_s), len(table.channels))
        low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
        tested = np.zeros(shape, bool)
        for block in blocks(table.axes):
            columns = np.array(block)
            axes = table.axes[columns]
            spare = len(parity_matrix(axes)) - 1
            if spare < 1 or config.detectors.max_failures < 1:
                continue
            readings = table.rate_rad_s[:, columns]
            bound = bounds(table, columns, config.noise.bound_deg_s)
            if not bool(np.isfinite(bound).all()):
                continue  # too few samples to estimate one
            least, greatest, feasible = guaranteed_intervals(
                readings,
                axes,
                bound,
                max_failures=min(config.detectors.max_failures, spare),
            )
            # Where no subset is feasible the bound is violated: there is no interval to give.
            explained = np.asarray(feasible.any(axis=1), bool)
            holds = explained[:, None] & table.valid[:, columns]
            low[:, columns] = np.where(holds, readings - greatest, -np.inf)
            high[:, columns] = np.where(holds, readings - least, np.inf)
            tested[:, columns] = holds & np.isfinite(least) & np.isfinite(greatest)
        limit = np.radians(config.tolerance.bias_deg_s)
        failed = (low > limit) | (high < -limit)
        numbers = np.cumsum(failed, axis=1, dtype=np.int8)
        return [
            Evidence(
                detector="guaranteed",
                kind="bias",
                windows=survey.windows,
                tested=tested,
                low=low,
                high=high,
                tolerance=np.broadcast_to(limit, shape),
                accused=np.where(failed, numbers, np.int8(0)),
                confidence=1.0,
            )
        ]


def bounds(table: ChannelTable, columns: NDArray[np.int64], stated_deg_s: float) -> Floats:
    """Bound of a healthy error of each channel: the one stated, or estimated from the log.

    Returns
    -------
    bound : (n_columns,)
        [rad/s]
    """
    if stated_deg_s > 0.0:
        return np.full(len(columns), np.radians(stated_deg_s))
    rows = leave_one_out(table.axes[columns])
    readings = table.rate_rad_s[table.valid[:, columns].all(axis=1)][:, columns]
    if len(readings) < 3:
        return np.full(len(columns), np.inf)
    residual = readings @ rows.T
    steps = np.array([table.channels[k].step_rad_s for k in columns])
    estimate: Floats = np.abs(np.median(residual, axis=0)) + BOUND_SIGMAS * robust_sigma(residual)
    return np.maximum(estimate, steps / 2.0)
