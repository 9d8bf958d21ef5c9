"""The step that some accusations speak of, as calibrated and as logged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.accusations import Cluster, accusations, spanned
from fdilog.decision.shapes import Fault, widened
from fdilog.finding import Evidence
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape, best_step


def step_of(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the step that some accusations speak of."""
    span = Shape(kind="bias", start=cluster.start, stop=cluster.stop, gain=0.0, size=0.0)
    accused = Fault(suspects=cluster.suspects, shape=span, longest_s=cluster.longest_s)
    return replace(
        accused, shape=_placed_step(table, accused, cluster.longest_s / 2, config) or span
    )


def steps_as_logged(
    table: ChannelTable, calibrated: ChannelTable, evidence: Sequence[Evidence], config: Config
) -> NDArray[np.float64]:
    """Find the steps that accusations speak of in the readings as logged, to calibrate without.

    A bias that lasts while the vehicle turns steadily looks as if it were in proportion to the
    rate. The calibration takes a part of it, and leaves what is before and after the turn, or an
    error in turns without the bias. In the readings as logged it is one step. A step of which what
    was left is no part is another matter.

    Returns
    -------
    steps : (N, n)
        As large as what the calibration left of them, in one of the suspects. [rad/s]
    """
    steps = np.zeros(table.rate_rad_s.shape)
    leading = [item for item in evidence if item.detector == evidence[0].detector]
    accused = [accusation for item in leading for accusation in accusations(item)]
    longest_s = max(config.windows.lengths_s)
    faults = spanned(table.time_s, accused, lambda cluster: step_of(calibrated, cluster, config))
    # Where two are a part of one step, what explains the most tells its size.
    for left in sorted(faults, key=lambda fault: fault.shape.gain):
        whole = _placed_step(table, left, longest_s, config)
        if whole is not None and whole.start <= left.start and whole.stop >= left.stop:
            steps[whole.start : whole.stop, min(left.suspects)] = left.shape.size
    return steps


def _placed_step(
    table: ChannelTable, accused: Fault, reach_s: float, config: Config
) -> Shape | None:
    """Find the step around some accusations, no further away than a reach at first.

    Manoeuvres and vibration may leave in doubt what it is a part of: the region in which it is
    looked for is widened as long as it reaches to its edges.
    """
    found = None
    for trace in widened(table, accused, reach_s, config):
        step = best_step(trace.residual, trace.weight())
        placed = trace.placed(step)
        if placed.start >= accused.stop or placed.stop <= accused.start:
            break  # what shakes beside it more than it is off is nothing of it
        if found is not None and (placed.start > found.start or placed.stop < found.stop):
            break  # a larger fault nearby is another one
        found = placed
        if trace.holds(step):
            break
    return found
