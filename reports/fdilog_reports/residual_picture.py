"""The picture of every channel against its peers, with the intervals that decided."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fdilog.analysis import Analysis
from fdilog.finding import Evidence
from fdilog.maths.geometry import blocks
from fdilog_reports.figures import (
    BINS,
    HIGH,
    WIDE,
    Floats,
    RateAxis,
    Span,
    Tick,
    TimeAxis,
    envelope,
    finding_spans,
    outline,
)
from fdilog_reports.residuals import (
    Intervals,
    Residual,
    drawn_evidence,
    intervals,
    mirrored,
    residuals,
)
from fdilog_reports.sentences import taken_out
from fdilog_reports.words import DEG_PER_RAD, figure, flight_time, listed, percent, shown


@dataclass(frozen=True, kw_only=True)
class Panel:
    """One residual: paths of SVG, and what to write beside them.

    ``channels`` are the one it is of, or both of a pair that has only one another: then it is the
    first minus the second.
    """

    channels: tuple[tuple[str, str], ...]
    against: str
    peak: str
    envelope: str
    peak_mark: str
    bars: tuple[tuple[str, str], ...]
    spans: tuple[Span, ...]
    rate_ticks: tuple[Tick, ...]
    band_top: str
    band_height: str
    band_edges: str


@dataclass(frozen=True, kw_only=True)
class PanelGroup:
    """Channels that check one another."""

    title: str
    panels: tuple[Panel, ...]


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """The picture of residuals; ``bars`` says what the bars are, empty if there are none."""

    groups: tuple[PanelGroup, ...]
    tolerance: str
    bars: str
    time_ticks: tuple[Tick, ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    """What all panels share."""

    time: TimeAxis
    rate: RateAxis
    edges: Floats
    evidence: Evidence | None


def residual_picture(analysis: Analysis) -> Residuals:
    """Draw every channel against its peers, in groups of channels that check one another."""
    axis = TimeAxis.of(analysis)
    edges = axis.edges(analysis, BINS)
    tolerance = analysis.config.tolerance.bias_deg_s
    series = {residual.channel: residual for residual in residuals(analysis)}
    lines = {
        i: DEG_PER_RAD * envelope(analysis.table.time_s, residual.value, edges)
        for i, residual in series.items()
    }
    peaks = [float(np.nanmax(np.abs(line))) for line in lines.values()]
    rate_axis = RateAxis(tolerance=tolerance, top=1.1 * max([3.0 * tolerance, *peaks]))
    drawn = drawn_evidence(analysis)
    frame = _Frame(time=axis, rate=rate_axis, edges=edges, evidence=drawn)
    groups = []
    for block in blocks(analysis.table.axes) if series else []:
        members = [i for i in block if i in series]
        once = mirrored(members, series)
        panels = tuple(
            _panel(analysis, frame, series[i], lines[i], members if once else [i])
            for i in (members[:1] if once else members)
        )
        if panels:
            names = [shown(analysis.table.channels[i].name) for i in block]
            groups.append(PanelGroup(title=listed(names), panels=panels))
    return Residuals(
        groups=tuple(groups),
        tolerance=figure(tolerance),
        bars=f"{_bars_in_words(drawn)}{taken_out(analysis)}" if drawn is not None else "",
        time_ticks=axis.ticks(),
    )


def _bars_in_words(drawn: Evidence) -> str:
    confidence = "guaranteed" if drawn.confidence >= 1.0 else percent(drawn.confidence)
    return f"{shown(drawn.detector)}, {figure(drawn.windows.length_s)} s windows, {confidence}"


def _panel(
    analysis: Analysis, frame: _Frame, residual: Residual, line: Floats, shared_by: list[int]
) -> Panel:
    channels, status = analysis.table.channels, analysis.status
    place = int(np.nanargmax(np.abs(residual.value)))
    peak, peak_s = DEG_PER_RAD * float(residual.value[place]), float(analysis.table.time_s[place])
    x, y = float(frame.time.x(peak_s)), float(frame.rate.y(peak))
    band_top, band_bottom = (float(frame.rate.y(s * frame.rate.tolerance)) for s in (1, -1))
    middle = frame.time.x((frame.edges[:-1] + frame.edges[1:]) / 2.0)
    return Panel(
        channels=tuple((shown(channels[i].name), status[i]) for i in shared_by),
        against=listed([shown(channels[i].name) for i in residual.peers]),
        peak=f"{figure(peak)} deg/s {flight_time(peak_s, peak_s)}",
        envelope=outline(middle, frame.rate.y(line)),
        peak_mark=f"M{x:.1f} {y:.1f}h0",
        bars=_bars(frame, intervals(frame.evidence, residual.channel)),
        spans=finding_spans(analysis, frame.time, {channels[i].name for i in shared_by}),
        rate_ticks=frame.rate.ticks(),
        band_top=f"{band_top:.1f}",
        band_height=f"{band_bottom - band_top:.1f}",
        band_edges=f"M0 {band_top:.1f}H{WIDE}M0 {band_bottom:.1f}H{WIDE}",
    )


def _bars(frame: _Frame, bars: Intervals | None) -> tuple[tuple[str, str], ...]:
    """Vertical bars from low to high, one path for each answer."""
    if bars is None:
        return ()
    x = frame.time.x(bars.middle_s)
    ends = np.stack([bars.low, bars.high])
    y = np.clip(frame.rate.y(DEG_PER_RAD * ends), 0.0, HIGH)
    undecided = ~bars.beyond & ~bars.inside
    answers = (("undecided", undecided), ("healthy", bars.inside), ("failed", bars.beyond))
    return tuple(
        (
            state,
            "".join(
                f"M{a:.1f} {low:.1f}V{high:.1f}"
                for a, low, high in zip(x[chosen], y[0][chosen], y[1][chosen], strict=True)
            ),
        )
        for state, chosen in answers
        if chosen.any()
    )
