"""Drift: a fault of another shape than a step, told from one and measured."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from fdilog.config import Config
from fdilog.decision.accusations import region
from fdilog.decision.testimony import Statement
from fdilog.finding import SIZE_UNIT, Kind, Size
from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape, best_ramp, best_step
from fdilog.windows.traces import Trace, trace_of

# Another shape than a step is believed if its likelihood is a thousand times larger, 2 ln 1000.
OTHER_SHAPE = 2.0 * np.log(1000.0)
# Fewer samples have no shape to speak of.
FEWEST_SHAPED = 20


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Suspects, and the shape and span in which they are off; ``removed`` failed meanwhile."""

    suspects: frozenset[int]
    shape: Shape
    longest_s: float
    removed: frozenset[int] = frozenset()
    testimony: Statement | None = None

    @property
    def start(self) -> int:
        """First sample."""
        return self.shape.start

    @property
    def stop(self) -> int:
        """One past the last sample."""
        return self.shape.stop


def shaped(table: ChannelTable, fault: Fault, config: Config) -> Fault:
    """Return the fault as a drift where that explains far more than a step.

    A drift is noticed late, when it has grown: the region in which it is looked for is widened as
    long as it reaches to its edges, up to the longest windows.
    """
    length_s = float(table.time_s[fault.stop - 1] - table.time_s[fault.start])
    found = None
    for trace in widened(table, fault, max(length_s, fault.longest_s), config):
        ramp = best_ramp(trace.residual, trace.time_s)
        found = other_shape(trace, ramp)
        if trace.holds(ramp):
            break
    return fault if found is None else replace(fault, shape=found)


def widened(table: ChannelTable, fault: Fault, reach_s: float, config: Config) -> Iterator[Trace]:
    """Trace the first suspect around a fault, ever further, up to the longest windows."""
    while True:
        around = region(table, fault.start, fault.stop, reach_s)
        trace = trace_of(table, min(fault.suspects), fault.removed, *around)
        if trace is None:
            return
        yield trace
        if reach_s > max(config.windows.lengths_s):
            return
        reach_s = 2.0 * max(reach_s, table.period_s)


def other_shape(trace: Trace, shape: Shape) -> Shape | None:
    """Return a shape, placed in the table, if it explains a trace far better than a step does."""
    if shape.stop - shape.start < FEWEST_SHAPED:
        return None
    noise, dof = trace.noise_about(shape)
    more = shape.gain - best_step(trace.residual).gain
    return trace.placed(shape) if dof > 0 and more > OTHER_SHAPE * noise else None


def shaped_size(table: ChannelTable, fault: Fault, config: Config) -> Size | None:
    """Rate of drift of the first suspect, with its Student interval."""
    trace = trace_of(table, min(fault.suspects), fault.removed, fault.start, fault.stop)
    if trace is None:
        return None
    form = trace.form(replace(fault.shape, start=0, stop=len(trace.rows)))
    # A free level, since the onset is not known to the sample.
    form = form - form.mean()
    power = float((form**2).sum())
    if power <= 0.0:
        return None
    size = float((form * trace.residual).sum()) / power
    left = trace.residual - size * form
    looks = windowed_mean((left - left.mean())[None, :, None])
    if not looks.dof[0] > 0:
        return None
    noise = float(looks.covariance[0, 0, 0]) * len(form)
    quantile = float(student_quantile(looks.dof, config.windows.confidence)[0])
    return size_of(size, quantile * float(np.sqrt(noise / power)), fault.shape.kind, config)


def size_of(estimate: float, half_width: float, kind: Kind, config: Config) -> Size:
    """Put an estimate and its interval into the unit of its kind."""
    return Size(
        estimate=estimate,
        low=estimate - half_width,
        high=estimate + half_width,
        confidence=config.windows.confidence,
        unit=SIZE_UNIT[kind],
    )


def disagreement(names: tuple[str, ...]) -> str:
    """Say in words who disagrees with whom."""
    if len(names) == 1:
        return "reads off from what the other gyros that sense its axis agree on"
    return (
        f"{', '.join(names)} disagree and the redundancy of this log cannot tell which of them"
        f" failed; the size is {names[0]}'s error if it is the one"
    )
