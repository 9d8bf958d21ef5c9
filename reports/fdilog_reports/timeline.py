"""The picture of what was known of every channel, and when."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import Analysis
from fdilog.finding import Evidence
from fdilog_reports.figures import BINS, Floats, Span, Tick, TimeAxis, finding_spans
from fdilog_reports.lone import unheld
from fdilog_reports.residuals import leading
from fdilog_reports.words import flight_time, shown


@dataclass(frozen=True, kw_only=True)
class Lane:
    """One channel's line of the timeline."""

    channel: str
    status: str
    spans: tuple[Span, ...]
    findings: tuple[Span, ...]


@dataclass(frozen=True, kw_only=True)
class Timeline:
    """What was known of every channel, and when."""

    lanes: tuple[Lane, ...]
    time_ticks: tuple[Tick, ...]


HEALTHY_COVERAGE = 0.9
"""Share of a channel's time that the windows which decide its status cover: the contract's rule."""

_STATES = ("no data", "not tested", "undecided", "healthy")
_STATE_WORDS = {
    "no data": "no data",
    "not tested": "not compared with any other channel",
    "undecided": "compared, undecided",
    "healthy": "within the tolerance",
}


def timeline(analysis: Analysis) -> Timeline:
    """Draw what was known of every channel, and when."""
    axis = TimeAxis.of(analysis)
    edges = axis.edges(analysis, BINS)
    lanes = []
    for column, channel in enumerate(analysis.table.channels):
        state = channel_state(analysis, column, edges)
        lanes.append(
            Lane(
                channel=shown(channel.name),
                status=analysis.status[column],
                spans=_runs(axis, edges, state),
                findings=finding_spans(analysis, axis, {channel.name}),
            )
        )
    return Timeline(lanes=tuple(lanes), time_ticks=axis.ticks())


def channel_state(analysis: Analysis, column: int, edges: Floats) -> NDArray[np.int64]:
    """Index into `_STATES` for every bin, by the windows that decide a channel's status.

    The longest that cover the flight speak first; shorter ones speak where those are silent or
    hold a fault that a finding names already.
    """
    table = analysis.table
    present = _present(table.time_s, table.valid[:, column], edges)
    tested = np.zeros(len(edges) - 1, bool)
    state = np.full(len(edges) - 1, -1)
    name = table.names[column]
    faults = [(f.start_s, f.end_s) for f in analysis.findings if name in f.suspects]
    for evidence in _deciding_first(analysis.evidence, column, edges, present):
        start_s, end_s = evidence.windows.start_s, evidence.windows.end_s
        seen = evidence.tested[:, column]
        tested |= _covered(edges, start_s[seen], end_s[seen])
        for fault_start_s, fault_end_s in faults:
            seen = seen & ((end_s < fault_start_s) | (start_s > fault_end_s))
        tolerance = evidence.tolerance[:, column]
        inside = evidence.low[:, column] > -tolerance
        inside &= evidence.high[:, column] < tolerance
        healthy, unsure = seen & inside, seen & ~inside
        silent = state < 0
        state[silent & _covered(edges, start_s[healthy], end_s[healthy])] = 3
        state[silent & _covered(edges, start_s[unsure], end_s[unsure])] = 2
    state = np.where(state < 0, np.where(tested, 2, 1), state)
    if name in unheld(analysis):
        state = np.minimum(state, 2)
    return np.where(present, state, 0)


def _present(time_s: Floats, valid: NDArray[np.bool_], edges: Floats) -> NDArray[np.bool_]:
    """Bins in which the channel was recorded."""
    sums = np.concatenate([[0], np.cumsum(valid)])
    places = np.searchsorted(time_s, edges)
    places[-1] = len(time_s)  # the last sample lies on the last border
    present: NDArray[np.bool_] = np.diff(sums[places]) > 0
    return present


def _deciding_first(
    evidence: Sequence[Evidence], column: int, edges: Floats, present: NDArray[np.bool_]
) -> list[Evidence]:
    """Order the leading detector's evidence: the longest windows that cover a channel, shorter."""
    lead = [item for item in leading(evidence) if item.tested[:, column].any()]
    lead.sort(key=lambda item: -item.windows.length_s)
    for place, item in enumerate(lead):
        seen = item.tested[:, column]
        covered = _covered(edges, item.windows.start_s[seen], item.windows.end_s[seen])
        if (covered & present).sum() >= HEALTHY_COVERAGE * present.sum():
            return lead[place:]
    return lead


def _covered(edges: Floats, start_s: Floats, end_s: Floats) -> NDArray[np.bool_]:
    """Bins that any of the windows touches."""
    change = np.zeros(len(edges), np.int64)
    first = np.clip(np.searchsorted(edges, start_s, "right") - 1, 0, len(edges) - 2)
    last = np.clip(np.searchsorted(edges, end_s, "left"), first + 1, len(edges) - 1)
    np.add.at(change, first, 1)
    np.add.at(change, last, -1)
    covered: NDArray[np.bool_] = np.cumsum(change)[:-1] > 0
    return covered


def _runs(axis: TimeAxis, edges: Floats, state: NDArray[np.int64]) -> tuple[Span, ...]:
    """Join bins of one state."""
    breaks = np.flatnonzero(np.diff(state)) + 1
    starts = np.concatenate([[0], breaks])
    stops = np.concatenate([breaks, [len(state)]])
    spans = []
    for start, stop in zip(starts, stops, strict=True):
        name = _STATES[state[start]]
        left, right = axis.x(edges[[start, stop]])
        spans.append(
            Span(
                state=name.replace(" ", "-"),
                left=f"{left:.1f}",
                width=f"{right - left:.1f}",
                title=f"{_STATE_WORDS[name]}, {flight_time(edges[start], edges[stop])}",
            )
        )
    return tuple(spans)
