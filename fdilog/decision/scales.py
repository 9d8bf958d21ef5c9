"""From evidence of scale errors to findings, in place of the biases that they look like."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdilog.config import Config
from fdilog.decision.accusations import Cluster, accusations, clusters, region
from fdilog.decision.shapes import FEWEST_SHAPED, OTHER_SHAPE, disagreement, size_of
from fdilog.finding import Evidence, Finding
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape, best_ramp, best_scale, best_step
from fdilog.windows.slopes import scale_over
from fdilog.windows.traces import trace_of

# A bias of which this part lies in the span of a scale error is what the latter looks like.
COVERED = 0.5


def with_scales(
    table: ChannelTable,
    calibrated: ChannelTable,
    evidence: Sequence[Evidence],
    known: Sequence[Finding],
    config: Config,
) -> list[Finding]:
    """Add findings of scale errors to those of biases, and take out the biases that they explain.

    A finding stands if over its own span the scale error is still beyond tolerance for sure, and
    explains what the channel is off by far better than any step or ramp.
    """
    said = [accusation for item in evidence for accusation in accusations(item)]
    findings = list(known)
    for cluster in clusters(table.time_s, said):
        shape = _shape(calibrated, cluster)
        found = None if shape is None else _finding(table, cluster, shape, config)
        if found is not None:
            findings = [one for one in findings if not _explains(found, one)]
            findings.append(found)
    return [one for one in findings if not _shadow(table, one, findings)]


def _shadow(table: ChannelTable, one: Finding, findings: Sequence[Finding]) -> bool:
    """Tell whether a scale error is that of another gyro of the axis, over a part of its span."""
    if one.kind != "scale":
        return False
    axis = {
        table.names[k]
        for name in one.suspects
        for k in np.flatnonzero(table.along(table.names.index(name)))
    }
    return any(
        other.kind == "scale"
        and set(other.suspects) <= axis
        and not set(other.suspects) & set(one.suspects)
        and other.end_s - other.start_s > one.end_s - one.start_s
        and _covers(other, one)
        for other in findings
    )


def _shape(table: ChannelTable, cluster: Cluster) -> Shape | None:
    """Find the span of a scale error, if it is one."""
    first, last = region(table, cluster.start, cluster.stop, cluster.longest_s)
    trace = trace_of(table, min(cluster.suspects), frozenset(), first, last)
    if trace is None:
        return None
    trace = trace.averaged()
    shape = best_scale(trace.residual, trace.predicted)
    if shape.stop - shape.start < FEWEST_SHAPED:
        return None
    noise, dof = trace.noise_about(shape)
    others = (best_step(trace.residual), best_ramp(trace.residual, trace.time_s))
    more = shape.gain - max(other.gain for other in others)
    return trace.placed(shape) if dof > 0 and more > OTHER_SHAPE * noise else None


def _finding(table: ChannelTable, cluster: Cluster, shape: Shape, config: Config) -> Finding | None:
    suspects = sorted(cluster.suspects)
    sizes = []
    for channel in suspects:
        fitted = scale_over(table, channel, (shape.start, shape.stop), config)
        if fitted is None:
            return None
        half_width = float(fitted.half_width(config.windows.confidence)[0])
        sizes.append((float(fitted.slope[0]), half_width))
    slope, half_width = sizes[0]
    if abs(slope) - half_width <= config.tolerance.scale:
        return None
    # The rates that each suspect tells must show it: held against a noisy one, the other seems to
    # read too little.
    if not all(abs(size) > uncertain for size, uncertain in sizes):
        return None
    names = tuple(table.names[channel] for channel in suspects)
    return Finding(
        kind="scale",
        suspects=names,
        start_s=float(table.time_s[shape.start]),
        end_s=float(table.time_s[shape.stop - 1]),
        size=size_of(1.0 + slope, half_width, "scale", config),
        detectors=tuple(sorted({member.detector for member in cluster.members})),
        detail=disagreement(names),
    )


def _explains(scale: Finding, other: Finding) -> bool:
    """Tell whether a finding is what a scale error looks like."""
    return bool(set(scale.suspects) & set(other.suspects)) and _covers(scale, other)


def _covers(scale: Finding, other: Finding) -> bool:
    together = min(scale.end_s, other.end_s) - max(scale.start_s, other.start_s)
    return together >= COVERED * (other.end_s - other.start_s)
