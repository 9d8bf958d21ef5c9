"""The timeline in characters: a line a channel, a character a stretch of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdilog.analysis import Analysis
from fdilog.finding import Status
from fdilog_reports.figures import TimeAxis
from fdilog_reports.timeline import channel_state
from fdilog_reports.words import shown

FEWEST_BINS = 20
"""A strip of fewer characters shows nothing that the words do not."""
MOST_BINS = 160
MOST_LANES = 18
"""Channels of six three-axis gyros; of more, those in doubt are shown."""

# By state, a character that tells them apart without colour: where fonts have blocks, and in ASCII.
MARKS = {
    "no data": (" ", " "),
    "not compared": ("\u00b7", "."),
    "undecided": ("\u2591", "?"),
    "within tolerance": ("\u2500", "-"),
    "one of several": ("\u2593", "*"),
    "failed": ("\u2588", "#"),
}
_ORDER = tuple(MARKS)
_SUSPECT, _FAILED = _ORDER.index("one of several"), _ORDER.index("failed")


@dataclass(frozen=True, kw_only=True)
class Run:
    """Characters of one state."""

    state: str
    text: str


@dataclass(frozen=True, kw_only=True)
class StripLane:
    """One channel's line."""

    channel: str
    status: Status
    runs: tuple[Run, ...]


@dataclass(frozen=True, kw_only=True)
class Strip:
    """All lines, the times below them, and what is not shown."""

    lanes: tuple[StripLane, ...]
    times: str
    states: tuple[str, ...]
    left_out: int


def strip(analysis: Analysis, width: int, *, ascii_only: bool = False) -> Strip | None:
    """Draw the timeline into ``width`` characters; nothing where these are too few."""
    channels = _chosen(analysis)
    if width < FEWEST_BINS or not channels or not len(analysis.table.time_s):
        return None
    axis = TimeAxis.of(analysis)
    edges = axis.edges(analysis, min(width, MOST_BINS))
    # A short log has fewer samples than the line has characters: each stretch takes several.
    places = np.arange(min(width, MOST_BINS)) * (len(edges) - 1) // min(width, MOST_BINS)
    lanes, seen = [], set()
    for column in channels:
        state = channel_state(analysis, column, edges)
        name = analysis.table.names[column]
        for finding in analysis.findings:
            if name in finding.suspects:
                first = max(0, int(np.searchsorted(edges, finding.start_s, "right")) - 1)
                last = max(first + 1, int(np.searchsorted(edges, finding.end_s, "left")))
                mark = _FAILED if finding.isolated else _SUSPECT
                state[first:last] = np.maximum(state[first:last], mark)
        drawn = state[places]
        seen |= set(drawn.tolist())
        lanes.append(
            StripLane(
                channel=shown(name), status=analysis.status[column], runs=_runs(drawn, ascii_only)
            )
        )
    return Strip(
        lanes=tuple(lanes),
        times=_times(axis, len(places)),
        states=tuple(_ORDER[state] for state in sorted(seen) if state),
        left_out=sum(not c.derived for c in analysis.table.channels) - len(channels),
    )


def lines(drawn: Strip, *, ascii_only: bool = False) -> list[str]:
    """Write a strip as lines of plain text: channels, times, and what the marks mean."""
    width = max(len(lane.channel) for lane in drawn.lanes)
    told = [
        f"{lane.channel:<{width}} {''.join(run.text for run in lane.runs)}  {lane.status}"
        for lane in drawn.lanes
    ]
    key = "   ".join(f"{MARKS[state][ascii_only]} {state}" for state in drawn.states)
    return [*told, f"{'':<{width}} {drawn.times}", f"{'':<{width}} {key}".rstrip()]


def _chosen(analysis: Analysis) -> list[int]:
    """Choose all gyros, or, of very many, first those that are accused, then those in doubt."""
    rank = ("failed", "suspect", "undecided", "insufficient", "healthy")
    gyros = [k for k, channel in enumerate(analysis.table.channels) if not channel.derived]
    gyros.sort(key=lambda column: rank.index(analysis.status[column]))
    return sorted(gyros[:MOST_LANES])


def _runs(state: np.ndarray[tuple[int], np.dtype[np.int64]], ascii_only: bool) -> tuple[Run, ...]:
    borders = np.flatnonzero(np.diff(state)) + 1
    return tuple(
        Run(state=_ORDER[part[0]], text=MARKS[_ORDER[part[0]]][ascii_only] * len(part))
        for part in np.split(state, borders)
    )


def _times(axis: TimeAxis, width: int) -> str:
    """Write round times below the places that they mark; one that has no room is left out."""
    line = ""
    ticks = axis.ticks()
    for number, tick in enumerate(ticks):
        label = tick.label + (" s" if number == len(ticks) - 1 else "")
        place = round(float(tick.at) / 100.0 * (width - 1))
        place = min(place, width - len(label))
        if place >= len(line) + (2 if line else 0):
            line = line.ljust(place) + label
    return line
