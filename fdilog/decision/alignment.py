"""Windows laid where a fault seems to lie, for faults that regular windows see in part only.

A fault of twenty seconds fills no window of twenty seconds that advances by ten, and a window of
ten knows its mean less well than the whole span would. Regular windows whose interval excludes zero
and whose middle lies beyond tolerance are hints; the span that explains most of the readings around
them is one more window, for all detectors to look at.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from fdilog.decision.accusations import Accusation, Cluster, region, spanned
from fdilog.finding import Evidence, Windows
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape, best_step
from fdilog.windows.survey import spans
from fdilog.windows.traces import trace_of

# Vibration near the logging rate comes back as a wander of a second or two, whose swells look like
# steps to whoever may choose where to look; over five seconds it averages out.
SHORTEST_S = 5.0
# Keeps the ratio finite where repeated readings leave no doubt at all. [rad/s]
TINY = 1e-12


def aligned_windows(table: ChannelTable, evidence: Sequence[Evidence]) -> Windows | None:
    """Lay windows over the spans that hints point at, or none if there are no hints.

    Parameters
    ----------
    evidence
        Of the leading detector, over regular windows; with intervals for a bias.
    """
    known = _accused(table, evidence)
    hints = [
        hint
        for item in evidence
        for hint in _hints(item)
        if not known[hint.start : hint.stop, min(hint.suspects)].all()
    ]
    found = {
        (span.start, span.stop)
        for span in spanned(table.time_s, hints, lambda cluster: _step(table, cluster))
        if table.time_s[span.stop - 1] - table.time_s[span.start] >= SHORTEST_S
    }
    if not found:
        return None
    start, stop = np.array(sorted(found)).T
    return spans(table, start, stop)


def _step(table: ChannelTable, cluster: Cluster) -> Shape | None:
    """Find the step that explains most of the readings around some hints."""
    first, last = region(table, cluster.start, cluster.stop, cluster.longest_s / 2)
    trace = trace_of(table, min(cluster.suspects), frozenset(), first, last)
    return None if trace is None else trace.placed(best_step(trace.residual, trace.weight()))


def _accused(table: ChannelTable, evidence: Sequence[Evidence]) -> NDArray[np.bool_]:
    """Tell where a channel is accused by some window: no hints are needed there, by sample."""
    edges = np.zeros((len(table.time_s) + 1, len(table.channels)), np.int32)
    for item in evidence:
        rows, channels = np.nonzero(item.accused)
        np.add.at(edges, (item.windows.start[rows], channels), 1)
        np.add.at(edges, (item.windows.stop[rows], channels), -1)
    accused: NDArray[np.bool_] = np.cumsum(edges, axis=0)[:-1] > 0
    return accused


def _hints(evidence: Evidence) -> Iterator[Accusation]:
    """List the windows in which the channel that is off the most may well be beyond tolerance."""
    windows = evidence.windows
    if windows.length_s < SHORTEST_S:
        return
    rows = np.flatnonzero(~evidence.accused.any(axis=1))
    low, high = evidence.low[rows], evidence.high[rows]
    bounded = evidence.tested[rows] & np.isfinite(low) & np.isfinite(high)
    low, high = np.where(bounded, low, -1.0), np.where(bounded, high, 1.0)
    middle, half_width = (low + high) / 2.0, (high - low) / 2.0
    beyond = bounded & (np.abs(middle) > np.maximum(half_width, evidence.tolerance[rows]))
    surest = np.where(beyond, np.abs(middle) / (half_width + TINY), -1.0).argmax(axis=1)
    for k in np.flatnonzero(beyond.any(axis=1)):
        yield Accusation(
            kind=evidence.kind,
            detector=evidence.detector,
            suspects=frozenset({int(surest[k])}),
            start=int(windows.start[rows[k]]),
            stop=int(windows.stop[rows[k]]),
            length_s=windows.length_s,
        )
