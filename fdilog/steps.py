"""The step that some accusations speak of, and steps that a calibration has taken for its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.accusations import Cluster, accusations, spanned
from fdilog.config import Config
from fdilog.edges import Shape, best_step
from fdilog.finding import Evidence
from fdilog.shapes import Fault, widened
from fdilog.table import ChannelTable

MORE = 1.5
"""What a calibration took a third of explains half as much again as what it left; misalignment that
it took rightly changes that by less."""


def step_of(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the step that some accusations speak of."""
    span = Shape(kind="bias", start=cluster.start, stop=cluster.stop, gain=0.0, size=0.0)
    accused = Fault(suspects=cluster.suspects, shape=span, longest_s=cluster.longest_s)
    return replace(
        accused, shape=_placed_step(table, accused, cluster.longest_s / 2, config) or span
    )


def absorbed(
    table: ChannelTable, calibrated: ChannelTable, evidence: Sequence[Evidence], config: Config
) -> NDArray[np.float64]:
    """Find faults of which the calibration took a part for misalignment or scale.

    A bias that lasts while the vehicle turns steadily looks as if it were in proportion to the
    rate. What is left of it before and after the turn is accused, and in the readings as logged
    that is a part of a step that explains far more.

    Returns
    -------
    steps : (N, n)
        Such steps, as large as what was left of them, in one of the suspects. [rad/s]
    """
    steps = np.zeros(table.rate_rad_s.shape)
    leading = [item for item in evidence if item.detector == evidence[0].detector]
    accused = [accusation for item in leading for accusation in accusations(item)]
    longest_s = max(config.windows.lengths_s)
    faults = spanned(table.time_s, accused, lambda cluster: step_of(calibrated, cluster, config))
    for left in sorted(faults, key=lambda fault: fault.shape.gain):
        whole = _placed_step(table, left, longest_s, config)
        if whole is None or whole.start > left.start or whole.stop < left.stop:
            continue
        if whole.gain > MORE * left.shape.gain > 0.0:
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
        if found is not None and (placed.start > found.start or placed.stop < found.stop):
            break  # a larger fault nearby is another one
        found = placed
        if trace.holds(step):
            break
    return found
