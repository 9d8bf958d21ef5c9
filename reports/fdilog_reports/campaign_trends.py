"""Bias and noise of each channel over the flights, as the coordinates of small pictures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from fdilog.campaign.summary import Campaign, Point, Series
from fdilog.campaign.trend import FEWEST
from fdilog_reports.campaign_words import days_of, trend_words
from fdilog_reports.words import DEG_PER_RAD, figure, several, shown

MOST_PANELS = 72
MOST_POINTS = 120
"""Flights in one picture; of more, every k-th is drawn. The test uses all."""
WIDTH, HEIGHT = 300.0, 80.0
FEWEST_DRAWN = 2
FLAT_RAD_S = 1e-6
"""Height of a picture of a series that does not move at all."""


@dataclass(frozen=True, kw_only=True)
class TrendPanel:
    """One series: a line through the estimates, and a bar for each interval."""

    vehicle: str
    sensor: str
    channel: str
    quantity: str
    drifts: bool
    words: str
    line: str
    bars: str
    dots: str
    zero: str
    slope: str
    top: str
    bottom: str
    first: str
    last: str


@dataclass(frozen=True, kw_only=True)
class TrendGroup:
    """Series with the same answer; ``folded`` where nobody needs to see them at first."""

    title: str
    folded: bool
    panels: tuple[TrendPanel, ...]


@dataclass(frozen=True, kw_only=True)
class Trends:
    """The pictures, and what is not in them."""

    groups: tuple[TrendGroup, ...]
    left_out: str
    note: str


def trend_panels(campaign: Campaign) -> Trends:
    """Draw the series that have flights to compare, those that drift first."""
    drawn = [series for series in campaign.series if len(series.points) >= FEWEST_DRAWN]
    drawn.sort(key=_interest)
    tolerance = campaign.config.tolerance.bias_deg_s / DEG_PER_RAD
    undated = sum(not series.dated for series in drawn)
    note = ""
    if undated:
        note = (
            "The logs of some vehicles tell no date: their flights are in the order of their"
            " paths, and trends are per flight."
        )
    rest = len(drawn) - MOST_PANELS
    return Trends(
        groups=_groups(drawn, tolerance),
        left_out=f"{rest} more series, none of which drifts: see audit.json." if rest > 0 else "",
        note=note,
    )


def _groups(drawn: Sequence[Series], tolerance_rad_s: float) -> tuple[TrendGroup, ...]:
    """Sort series into those that drift, those that do not, and those too short to tell."""
    answers = {
        "Drifting": [series for series in drawn if series.trend and series.trend.drifts],
        "No drift shown": [series for series in drawn if series.trend and not series.trend.drifts],
        f"Fewer than {FEWEST} flights, not tested": [s for s in drawn if s.trend is None],
    }
    room = MOST_PANELS
    groups = []
    for answer, alike in answers.items():
        shown_ones, room = alike[:room], max(0, room - len(alike))
        if shown_ones:
            group = TrendGroup(
                title=f"{answer}: {several(len(alike), 'series', 'series')}",
                folded=answer != "Drifting",
                panels=tuple(_panel(series, tolerance_rad_s) for series in shown_ones),
            )
            groups.append(group)
    return tuple(groups)


def _interest(series: Series) -> tuple[bool, float, str, str, str]:
    trend = series.trend
    drifts = trend is not None and trend.drifts
    p_value = trend.p_value if trend is not None else 2.0
    return (not drifts, p_value, series.vehicle, series.channel, series.quantity)


def _panel(series: Series, tolerance_rad_s: float) -> TrendPanel:
    days = days_of(series)
    step = -(-len(days) // MOST_POINTS)
    points, days = series.points[::step], days[::step]
    low, high = _bounds(points)
    scale = _Scale(days[0], days[-1], low, high)
    trend = series.trend
    drifts = trend is not None and trend.drifts
    slope = ""
    if trend is not None and drifts:
        middle = sorted(
            point.estimate - trend.slope * day for point, day in zip(points, days, strict=True)
        )[len(points) // 2]
        slope = " L".join(scale.at(day, middle + trend.slope * day) for day in (days[0], days[-1]))
    at = [scale.at(day, point.estimate) for day, point in zip(days, points, strict=True)]
    return TrendPanel(
        vehicle=shown(series.vehicle),
        sensor=f"{shown(series.sensor)}, id {shown(series.device_id)}"
        if series.device_id
        else shown(series.sensor),
        channel=shown(series.channel),
        quantity=series.quantity,
        drifts=drifts,
        words=trend_words(series, tolerance_rad_s),
        line="M" + " ".join(at),
        bars="".join(
            f"M{scale.at(day, point.low)}V{scale.y(point.high)}"
            for day, point in zip(days, points, strict=True)
        ),
        dots="".join(f"M{place}h0" for place in at),
        zero=scale.y(0.0) if low < 0.0 < high else "",
        slope=f"M{slope}" if slope else "",
        top=figure(high * DEG_PER_RAD, 2),
        bottom=figure(low * DEG_PER_RAD, 2),
        first=(points[0].start_utc or "first")[:10] if series.dated else "first",
        last=(points[-1].start_utc or "last")[:10] if series.dated else "last",
    )


def _bounds(points: Sequence[Point]) -> tuple[float, float]:
    """Fit estimates and intervals, but let no few very wide ones flatten all the others."""
    estimates = [point.estimate for point in points]
    halves = sorted((point.high - point.low) / 2.0 for point in points)
    room = 3.0 * halves[len(halves) // 2]
    low = max(min(point.low for point in points), min(estimates) - room)
    high = min(max(point.high for point in points), max(estimates) + room)
    return low, high if high > low else low + FLAT_RAD_S


@dataclass(frozen=True)
class _Scale:
    first: float
    last: float
    low: float
    high: float

    def at(self, day: float, value: float) -> str:
        span = self.last - self.first
        x = WIDTH * (day - self.first) / span if span > 0 else WIDTH / 2.0
        return f"{x:.1f},{self.y(value)}"

    def y(self, value: float) -> str:
        share = (value - self.low) / (self.high - self.low)
        y = HEIGHT * (1.0 - min(max(share, 0.0), 1.0))
        return f"{y:.1f}" if math.isfinite(y) else "0"
