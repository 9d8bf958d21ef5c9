"""Words and numbers of a campaign, the same in every format of its report."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Collection, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import PurePath

from fdilog.campaign.summary import NOT_ANALYSED, Campaign, Cell, LogEntry, Series
from fdilog.campaign.trend import CONFIDENCE, FEWEST
from fdilog.finding import Finding
from fdilog_reports.rows import amount_lost
from fdilog_reports.sentences import printed_size
from fdilog_reports.words import DEG_PER_RAD, figure, listed, percent, several, shown

ERROR_WORDS = {
    "unreadable": "not readable",
    "no-gyro": "without gyro channels",
    "configuration": "not fitting the configuration",
    "internal": "stopped by an internal error",
    "unreachable": "not to be opened",
    "changed": "changing while read",
    "memory": "too large for a worker's memory",
    "died": "ended by the death of a worker",
    "timeout": "over the time limit",
    "pending": "not done yet",
}
SOONEST_YEARS = 10.0
"""Extrapolations beyond are no news to anybody."""
DAYS_PER_YEAR = 365.25


def name_of(log: LogEntry) -> str:
    """Name of a log without its folders."""
    return shown(PurePath(log.path).name or log.path)


def accused(log: LogEntry, most: int = 4) -> str:
    """Say what the findings of a log accuse, and how large the worst of each kind is."""
    of_kind: dict[str, list[Finding]] = defaultdict(list)
    for finding in log.findings:
        of_kind[finding.kind].append(finding)
    phrases = []
    for kind, findings in of_kind.items():
        who = dict.fromkeys(
            listed([shown(name) for name in finding.suspects], "or") for finding in findings
        )
        size = _worst_size(findings)
        phrases.append(
            f"{kind} {', '.join(_shortened(list(who), 3))}" + (f", {size}" if size else "")
        )
    return "; ".join(_shortened(phrases, most))


def _worst_size(findings: Sequence[Finding]) -> str:
    """Print the largest of some sizes of one kind; empty if they have none."""
    sizes = {f.size.estimate: f for f in findings if f.size and math.isfinite(f.size.estimate)}
    if not sizes:
        return ""
    usual = 1.0 if findings[0].kind == "scale" else 0.0
    printed = str(printed_size(sizes[max(sizes, key=lambda size: abs(size - usual))]))
    return printed if len(sizes) == 1 else f"up to {printed.removeprefix('-')}"


def faulty_share(log: LogEntry) -> float:
    """Return the share of a flight that the longest of its findings covers."""
    longest_s = max((finding.end_s - finding.start_s for finding in log.findings), default=0.0)
    return longest_s / log.duration_s if log.duration_s else 0.0


def open_question(log: LogEntry) -> str:
    """Say why a log without a finding is not healthy; empty if it is."""
    if log.verdict == "insufficient":
        return "nothing to compare its gyros with"
    undecided = [
        shown(name)
        for name, status in log.channels
        if status == "undecided" and name not in log.derived
    ]
    if log.verdict == "undecided" and undecided:
        return f"not decided: {', '.join(_shortened(undecided, 4))}"
    return "part of the log is lost" if log.verdict == "undecided" else ""


def _shortened(items: list[str], most: int) -> list[str]:
    return items if len(items) <= most else [*items[:most], f"{len(items) - most} more"]


def lost(log: LogEntry) -> str:
    """Say what is missing of a log; empty if it is whole."""
    return "" if log.whole else amount_lost(log.bytes_lost, log.seconds_lost)


def why_not(log: LogEntry) -> str:
    """Say why a log has no verdict."""
    return shown(log.error or "not done yet", 300)


def headline(campaign: Campaign) -> tuple[str, str]:
    """Return the state of the whole campaign, and a sentence that says it."""
    counts, logs = campaign.counts, len(campaign.logs)
    analysed = logs - counts[NOT_ANALYSED]
    if not analysed:
        return "insufficient", f"None of {several(logs, 'log')} could be analysed."
    if counts["failed"]:
        vehicles = {log.vehicle for log in campaign.logs if log.verdict == "failed"}
        return "failed", (
            f"A gyro failed in {counts['failed']} of {several(analysed, 'analysed log')},"
            f" on {several(len(vehicles), 'vehicle')}."
        )
    if campaign.drifting:
        return "suspect", "No gyro failed yet, but some move from flight to flight."
    if counts["undecided"] or counts["insufficient"]:
        open_ones = counts["undecided"] + counts["insufficient"]
        return "undecided", (
            f"No gyro was found to have failed, but {several(open_ones, 'log')} of {analysed}"
            " could not decide."
        )
    return "healthy", f"Every gyro in {several(analysed, 'analysed log')} kept to its tolerance."


def not_analysed(campaign: Campaign) -> str:
    """Say how many logs have no verdict, and why; empty if none."""
    kinds = Counter(log.error_kind or "pending" for log in campaign.logs if not log.verdict)
    number = sum(kinds.values())
    if not number:
        return ""
    told = f"{several(number, 'log')} could not be analysed"
    if len(kinds) == 1:
        return f"{told}: {ERROR_WORDS[next(iter(kinds))]}."
    reasons = [f"{count} {ERROR_WORDS[kind]}" for kind, count in kinds.most_common()]
    return f"{told}: {listed(reasons)}."


def not_whole(campaign: Campaign) -> str:
    """Say how many logs have lost something; empty if none."""
    broken = [log for log in campaign.logs if not log.whole]
    if not broken:
        return ""
    amount = amount_lost(
        sum(log.bytes_lost for log in broken), sum(log.seconds_lost for log in broken)
    )
    verb = "is" if len(broken) == 1 else "are"
    return f"{several(len(broken), 'log')} {verb} not whole: {amount}."


def nothing_to_compare(campaign: Campaign) -> str:
    """Say how many logs hold nothing that their gyros could be compared with; empty if none."""
    number = campaign.counts["insufficient"]
    if not number:
        return ""
    return f"{several(number, 'log has', 'logs have')} nothing to compare the gyros with."


def times(cell: Cell, of: str) -> str:
    """Say in how many of some flights a channel failed, and in how many it is one of several."""
    if not cell.failed:
        return f"suspect in {cell.suspect} of {of}"
    more = f", suspect in {cell.suspect} more" if cell.suspect else ""
    return f"failed in {cell.failed} of {of}{more}"


def failing(campaign: Campaign) -> list[tuple[str, str, str]]:
    """Vehicles with failures, the worst first: name, what failed how often, one channel."""
    cells = defaultdict(list)
    for cell in campaign.cells:
        cells[cell.vehicle].append(cell)
    kinds: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    latest: dict[str, str] = {}
    for log in campaign.logs:
        for finding in log.findings:
            for name in finding.suspects:
                kinds[log.vehicle, name][finding.kind] += 1
        if log.verdict == "failed" and log.start_utc:
            latest[log.vehicle] = max(latest.get(log.vehicle, ""), log.start_utc)
    rows = []
    for vehicle, own in cells.items():
        bad = [cell for cell in own if cell.failed or cell.suspect]
        if not bad:
            continue
        bad.sort(key=lambda cell: (-cell.failed, -cell.suspect, cell.channel))
        alike: dict[str, list[str]] = defaultdict(list)
        for cell in bad:
            what = listed([kind for kind, _ in kinds[vehicle, cell.channel].most_common(3)])
            of = several(cell.flights - cell.insufficient, "flight")
            told = f"{times(cell, of)}{f' ({what})' if what else ''}"
            alike[told].append(cell.channel)
        names = {cell.channel for cell in own}
        phrases = [f"{_channels(some, names)} {told}" for told, some in alike.items()]
        when = f"; last on {latest[vehicle][:10]}" if vehicle in latest else ""
        text = f"{'; '.join(_shortened(phrases, 4))}{when}"
        rows.append(
            (max(c.failed + c.suspect for c in bad), latest.get(vehicle, ""), vehicle, text, bad)
        )
    rows.sort(key=lambda row: row[2])
    rows.sort(key=lambda row: row[:2], reverse=True)
    return [(shown(vehicle), text, bad[0].channel) for *_, vehicle, text, bad in rows]


def _channels(some: Sequence[str], names: Collection[str]) -> str:
    """Name channels; those of a source that are all of it by the source alone."""
    own: dict[str, list[str]] = defaultdict(list)
    for name in some:
        own[name.rpartition(".")[0]].append(name)
    told: list[str] = []
    for source, channels in own.items():
        every = {name for name in names if name.rpartition(".")[0] == source}
        whole = source and len(every) > 1 and every == set(channels)
        told += [f"all of {shown(source)}"] if whole else map(shown, channels)
    return listed(told)


def trend_words(series: Series, bias_tolerance_rad_s: float) -> str:
    """Say how a series moves, how sure that is, and where it leads."""
    trend = series.trend
    if trend is None:
        return f"{several(len(series.points), 'flight')}: at least {FEWEST} are needed to test."
    if not trend.drifts:
        return f"No drift shown in {several(trend.flights, 'flight')} (p = {_p(trend.p_adjusted)})."
    per, unit = (100.0, "100 days") if series.dated else (1.0, "flight")
    scale = per * DEG_PER_RAD
    text = (
        f"Drifts by {trend.slope * scale:+.3g} deg/s per {unit}"
        f" ({trend.low * scale:+.3g} to {trend.high * scale:+.3g} at {percent(CONFIDENCE)}),"
        f" {several(trend.flights, 'flight')}, p = {_p(trend.p_adjusted)}."
    )
    when = _reaches(series, bias_tolerance_rad_s)
    if when:
        text += f" If it goes on so, it reaches {figure(bias_tolerance_rad_s * DEG_PER_RAD)} deg/s"
        text += f" about {when}."
    return text


def _p(p_value: float) -> str:
    return f"{p_value:.1e}" if p_value < 0.001 else f"{p_value:.3f}"


def _reaches(series: Series, tolerance_rad_s: float) -> str:
    """Month in which a bias that drifts reaches the tolerance; empty where it does not soon."""
    trend = series.trend
    if trend is None or not series.dated or series.quantity != "bias" or trend.slope == 0.0:
        return ""
    last = series.points[-1]
    now = _line_end(series, trend.slope)
    days = (math.copysign(tolerance_rad_s, trend.slope) - now) / trend.slope
    if not 0.0 < days < SOONEST_YEARS * DAYS_PER_YEAR or last.start_utc is None:
        return ""
    start = datetime.fromisoformat(last.start_utc)
    start = start if start.tzinfo else start.replace(tzinfo=UTC)
    return f"{start + timedelta(days=days):%Y-%m}"


def _line_end(series: Series, slope: float) -> float:
    """Where the Theil-Sen line stands at the last flight: median intercept. [rad/s]"""
    days = days_of(series)
    residual = sorted(
        point.estimate + slope * (days[-1] - day)
        for point, day in zip(series.points, days, strict=True)
    )
    return residual[len(residual) // 2]


def days_of(series: Series) -> list[float]:
    """Return where the flights of a series lie: days since the first, or flight numbers."""
    if not series.dated:
        return [float(number) for number in range(len(series.points))]
    moments = [datetime.fromisoformat(point.start_utc or "") for point in series.points]
    aware = [each if each.tzinfo else each.replace(tzinfo=UTC) for each in moments]
    return [(moment - aware[0]).total_seconds() / 86400.0 for moment in aware]


def hours(logs: Sequence[LogEntry]) -> str:
    """Say how long some logs are together."""
    total_h = sum(log.duration_s or 0.0 for log in logs) / 3600.0
    return f"{figure(total_h)} h" if total_h >= 1.0 else f"{figure(total_h * 60.0)} min"
