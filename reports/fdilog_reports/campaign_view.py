"""The view of a campaign: everything its report prints, as words, numbers and coordinates."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

from fdilog.campaign.summary import NOT_ANALYSED, Campaign, Cell, LogEntry
from fdilog_reports import campaign_words as words
from fdilog_reports.campaign_trends import TrendGroup, trend_panels
from fdilog_reports.words import DEG_PER_RAD, SHOWN_TEXT, listed, several, shown

MOST_VEHICLES = 200
MOST_OF_A_KIND = 8
MOST_LISTED = 200
"""Rows beyond these are in audit.json and audit.sqlite; the table of logs has every log."""

STATES = ("failed", NOT_ANALYSED, "undecided", "insufficient", "healthy")
"""In the order in which somebody wants to see them."""
MARK = {NOT_ANALYSED: "unread"}


@dataclass(frozen=True, kw_only=True)
class Count:
    """Logs of one state."""

    state: str
    mark: str
    number: int


@dataclass(frozen=True, kw_only=True)
class Attention:
    """One thing to look at, with the filter of the table that shows it."""

    mark: str
    vehicle: str
    text: str
    query: str = ""
    state: str = ""


@dataclass(frozen=True, kw_only=True)
class MatrixCell:
    """How one channel of one vehicle did."""

    mark: str
    text: str
    title: str
    channel: str


@dataclass(frozen=True, kw_only=True)
class MatrixRow:
    """One vehicle."""

    vehicle: str
    origin: str
    flights: str
    cells: tuple[MatrixCell | None, ...]


@dataclass(frozen=True, kw_only=True)
class ListedLog:
    """A log in a list of the Markdown report."""

    path: str
    vehicle: str
    text: str


@dataclass(frozen=True, kw_only=True)
class CampaignView:
    """Everything that a campaign report prints."""

    title: str
    version: str
    mark: str
    headline: str
    counts: tuple[Count, ...]
    facts: tuple[tuple[str, str], ...]
    attention: tuple[Attention, ...]
    attention_left_out: str
    channels: tuple[str, ...]
    matrix: tuple[MatrixRow, ...]
    matrix_left_out: str
    trends: tuple[TrendGroup, ...]
    trends_left_out: str
    trends_note: str
    failed: tuple[ListedLog, ...]
    unread: tuple[ListedLog, ...]
    lists_left_out: str
    table: dict[str, Any]


def campaign_view(campaign: Campaign) -> CampaignView:
    """Put a campaign into words, numbers and coordinates."""
    mark, headline = words.headline(campaign)
    attention, attention_left_out = _attention(campaign)
    matrix, channels, left_out = _matrix(campaign)
    trends = trend_panels(campaign)
    failed = sorted((log for log in campaign.logs if log.verdict == "failed"), key=_rank)
    unread = [log for log in campaign.logs if log.verdict is None]
    return CampaignView(
        title=f"fdilog audit: {several(len(campaign.logs), 'log')}",
        version=campaign.version,
        mark=mark,
        headline=headline,
        counts=tuple(
            Count(state=state, mark=MARK.get(state, state), number=campaign.counts[state])
            for state in STATES
        ),
        facts=_facts(campaign),
        attention=tuple(attention),
        attention_left_out=attention_left_out,
        channels=tuple(map(shown, channels)),
        matrix=matrix,
        matrix_left_out=left_out,
        trends=trends.groups,
        trends_left_out=trends.left_out,
        trends_note=trends.note,
        failed=tuple(_listed(log, words.accused(log)) for log in failed[:MOST_LISTED]),
        unread=tuple(_listed(log, words.why_not(log)) for log in unread[:MOST_LISTED]),
        lists_left_out=_more(
            max(len(failed), len(unread)) - MOST_LISTED, "more in each list: see audit.json"
        ),
        table=_table(campaign),
    )


def _more(number: int, rest: str) -> str:
    return f"{number} {rest}." if number > 0 else ""


def _facts(campaign: Campaign) -> tuple[tuple[str, str], ...]:
    logs = campaign.logs
    vehicles = {log.vehicle for log in logs if log.verdict}
    dates = sorted(log.start_utc[:10] for log in logs if log.start_utc)
    period = "not known" if not dates else dates[0]
    if dates and dates[0] != dates[-1]:
        period = f"{dates[0]} to {dates[-1]}"
    undated = sum(bool(log.verdict and not log.start_utc) for log in logs)
    if dates and undated:
        period += f" ({several(undated, 'log')} without a date)"
    return (
        ("Logs", str(len(logs))),
        ("Vehicles", str(len(vehicles))),
        ("Flight time", words.hours(campaign.flights)),
        ("Flown", period),
    )


def _attention(campaign: Campaign) -> tuple[list[Attention], str]:
    """Say what to look at: what failed, what is about to, and what nobody could look at."""
    failing = [
        Attention(mark="failed", vehicle=vehicle, text=text, query=channel, state="failed")
        for vehicle, text, channel in words.failing(campaign)
    ]
    tolerance = campaign.config.tolerance.bias_deg_s / DEG_PER_RAD
    drifting = [
        Attention(
            mark="suspect",
            vehicle=shown(series.vehicle),
            text=f"{series.quantity} of {shown(series.channel)}: "
            f"{words.trend_words(series, tolerance)}",
        )
        for series in campaign.drifting
    ]
    rest = [
        Attention(mark=mark, vehicle="", text=text, state=state, query=query)
        for mark, text, state, query in (
            ("unread", words.not_analysed(campaign), NOT_ANALYSED, ""),
            ("undecided", words.not_whole(campaign), "", "lost"),
            ("insufficient", words.nothing_to_compare(campaign), "insufficient", ""),
        )
        if text
    ]
    left_out = [
        several(len(items) - MOST_OF_A_KIND, one, many)
        for items, one, many in (
            (failing, "more vehicle with a failed gyro", "more vehicles with a failed gyro"),
            (drifting, "more series that drifts", "more series that drift"),
        )
        if len(items) > MOST_OF_A_KIND
    ]
    more = f"And {listed(left_out)}: see below." if left_out else ""
    return [*failing[:MOST_OF_A_KIND], *drifting[:MOST_OF_A_KIND], *rest], more


def _matrix(campaign: Campaign) -> tuple[tuple[MatrixRow, ...], list[str], str]:
    by_vehicle: dict[str, dict[str, Cell]] = defaultdict(dict)
    for cell in campaign.cells:
        by_vehicle[cell.vehicle][cell.channel] = cell
    flights = Counter(log.vehicle for log in campaign.flights)
    origins = {log.vehicle: log.vehicle_from for log in campaign.logs if log.verdict}
    ranked = sorted(by_vehicle.items(), key=lambda item: (*_badness(item[1]), item[0]))
    shown_ones = ranked[:MOST_VEHICLES]
    channels = sorted({name for _, cells in shown_ones for name in cells}, key=_natural)
    rows = tuple(
        MatrixRow(
            vehicle=shown(vehicle),
            origin=origins.get(vehicle, ""),
            flights=str(flights[vehicle]),
            cells=tuple(_cell(cells.get(channel)) for channel in channels),
        )
        for vehicle, cells in shown_ones
    )
    return rows, channels, _more(len(ranked) - len(rows), "more vehicles: see audit.json")


def _badness(cells: dict[str, Cell]) -> tuple[int, int, int]:
    return (
        -max(cell.failed for cell in cells.values()),
        -max(cell.suspect for cell in cells.values()),
        -max(cell.undecided for cell in cells.values()),
    )


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort imu10 after imu9."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in parts]


def _cell(cell: Cell | None) -> MatrixCell | None:
    if cell is None:
        return None
    states = ("failed", "suspect", "undecided", "healthy", "insufficient")
    told = [f"{getattr(cell, state)} {state}" for state in states if getattr(cell, state)]
    compared = cell.flights - cell.insufficient
    bad = [str(number) for number in (cell.failed, cell.suspect) if number]
    if not compared:
        mark, text = "insufficient", "\u2013"
    elif bad:
        mark = "failed" if cell.failed else "suspect"
        text = f"{' + '.join(bad)} of {compared}"
    elif cell.undecided:
        mark, text = "undecided", f"0 of {compared} ?"
    else:
        mark, text = "healthy", f"0 of {compared}"
    title = f"{shown(cell.vehicle)}, {shown(cell.channel)}: {', '.join(told)}"
    return MatrixCell(mark=mark, text=text, title=title, channel=shown(cell.channel))


def _listed(log: LogEntry, text: str) -> ListedLog:
    return ListedLog(path=shown(log.path, SHOWN_TEXT), vehicle=shown(log.vehicle), text=text)


def _table(campaign: Campaign) -> dict[str, Any]:
    """Return the rows of the table of logs, worst first; what many rows share is there once."""
    vehicles = sorted({shown(log.vehicle) for log in campaign.logs}, key=_natural)
    folders = sorted({_folder(log) for log in campaign.logs})
    vehicle_at = {name: number for number, name in enumerate(vehicles)}
    folder_at = {name: number for number, name in enumerate(folders)}
    ranked = sorted(campaign.logs, key=_rank)
    return {
        "states": [[state, MARK.get(state, state)] for state in STATES],
        "vehicles": vehicles,
        "folders": folders,
        "rows": [
            [
                STATES.index(log.state),
                folder_at[_folder(log)],
                words.name_of(log),
                vehicle_at[shown(log.vehicle)],
                (log.start_utc or "")[:16].replace("T", " "),
                None if log.duration_s is None else round(log.duration_s, 1),
                len(log.findings),
                _about(log),
                words.lost(log),
                next((name for name in log.reports if name.endswith(".html")), ""),
            ]
            for log in ranked
        ],
    }


def _rank(log: LogEntry) -> tuple[int, bool, float]:
    """Sort key: known failures before those of one among several, long ones before short ones."""
    known = any(status == "failed" for _, status in log.channels)
    return STATES.index(log.state), not known, -words.faulty_share(log)


def _about(log: LogEntry) -> str:
    if log.verdict is None:
        return words.why_not(log)
    return words.accused(log) or words.open_question(log)


def _folder(log: LogEntry) -> str:
    folder = str(PurePath(log.path).parent)
    return "" if folder == "." else shown(folder, SHOWN_TEXT)
