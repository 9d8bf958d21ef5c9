"""Scale errors that no window need show as a bias."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fdilog.biases import finding_of
from fdilog.calibration import Calibration
from fdilog.config import Config
from fdilog.edges import best_scale
from fdilog.finding import Finding
from fdilog.shapes import Fault, other_shape
from fdilog.table import ChannelTable
from fdilog.traces import trace_of


def scale_findings(
    table: ChannelTable,
    calibrated: ChannelTable,
    calibration: Sequence[Calibration],
    known: Sequence[Finding],
    config: Config,
) -> list[Finding]:
    """Find scale errors of a whole flight, which no window need show as a bias.

    The calibration leaves in what is beyond the scale tolerance. Of several sources of an axis the
    one that is off from their median alone is isolated; two are both suspects. The finding stands
    if a scale error explains the residual far better than a step, and its interval lies beyond the
    tolerance.
    """
    findings = []
    for axis in range(3):
        column = np.eye(3)[axis]
        columns = [
            k
            for k, c in enumerate(table.channels)
            if not c.derived and np.array_equal(c.axis, column)
        ]
        relative = {c.source: c.scale[axis] for c in calibration}
        scales = np.array([relative.get(table.channels[k].source, 1.0) for k in columns])
        if len(columns) < 2 or len(relative) < len(columns) - 1:
            continue
        off = np.abs(scales / np.median(scales) - 1.0) > config.tolerance.scale
        pair = len(columns) == 2 and abs(scales[1] / scales[0] - 1.0) > config.tolerance.scale
        suspects = frozenset(columns if pair else np.array(columns)[off].tolist())
        if not suspects or (len(suspects) > 1 and not pair):
            continue
        trace = trace_of(calibrated, min(suspects), frozenset(), 0, len(table.time_s))
        names = {table.names[k] for k in suspects}
        if trace is None or any(names & set(finding.suspects) for finding in known):
            continue
        means = trace.averaged()
        shape = other_shape(means, best_scale(means.residual, means.predicted))
        if shape is None:
            continue
        fault = Fault(suspects=suspects, shape=shape, longest_s=0.0)
        finding = finding_of(table, fault, config)
        size = finding.size
        least = 0.0 if size is None else max(size.low - 1.0, 1.0 - size.high)
        if least > config.tolerance.scale:
            findings.append(replace(finding, detectors=("parity",)))
    return findings
