"""The summary on a terminal: verdict, findings, a strip of the timeline, what was lost."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from fdilog.analysis import Analysis
from fdilog.finding import Finding
from fdilog_reports.sentences import KIND_NAME, negated, printed_size, suspects
from fdilog_reports.strip import MARKS, strip
from fdilog_reports.text import asides
from fdilog_reports.view import Report, report
from fdilog_reports.words import flight_time, several, utc

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

MOST_FINDINGS = 10
"""So many are listed one by one; of more, those of one kind and channel share a line."""
MOST_GROUPS = 15
MOST_LOSSES = 5
NARROW = 60
"""Terminals below this width get sentences in place of a table."""

WIDE = 110
"""Terminals from this width on have room for UTC beside flight time."""

_FACTS = {"Analysed": "", "Gyros": "", "Began": "began ", "Vehicle": ""}

_STYLE = {
    "failed": "bold red",
    "suspect": "bold magenta",
    "one of several": "magenta",
    "undecided": "yellow",
    "insufficient": "yellow",
    "healthy": "green",
    "within tolerance": "green",
    "not compared": "dim",
    "no data": "dim",
}


def show(analysis: Analysis, console: Console) -> None:
    """Print the summary; every string of the log's has lost what a terminal would obey."""
    from rich.text import Text

    seen = report(analysis)
    word = Text(f" {analysis.verdict.upper()} ", f"{_STYLE[analysis.verdict]} reverse")
    console.print(Text.assemble(word, " ", (seen.log_name, "bold")))
    console.print(Text(seen.verdict.sentence))
    for note in seen.verdict.notes:
        console.print(Text(note, "yellow"))
    for limit in seen.limits if seen.slow else ():
        console.print(Text(limit, "dim"))
    console.print(Text(short_facts(seen), "dim"))
    if analysis.findings:
        console.print()
        _show_findings(analysis, seen, console)
    _show_strip(analysis, console)
    _show_losses(seen, console)
    for sentence in asides(seen):
        console.print(Text(sentence, "dim"))


def short_facts(seen: Report) -> str:
    """Say in a line how long, how many gyros, when, what flew."""
    facts = {fact.label: fact.value for fact in seen.facts if fact.value != "not known"}
    return "; ".join(f"{lead}{facts[label]}" for label, lead in _FACTS.items() if label in facts)


def _show_findings(analysis: Analysis, seen: Report, console: Console) -> None:
    from rich.text import Text

    many = len(analysis.findings) > MOST_FINDINGS
    if many:
        groups = _grouped(analysis.findings)
        rows = [_group_row(group) for group in groups[:MOST_GROUPS]]
        head: tuple[str, ...] = ("", "What", "Suspects", "When", "Size")
    else:
        rows = [
            _row(number, one, analysis) for number, one in enumerate(analysis.findings, start=1)
        ]
        head = ("", "What", "Suspects", "When", "Size", "Detectors")
        if console.width >= WIDE and analysis.log.start_utc:
            head = (*head, "UTC")
    if console.width < NARROW and not many:
        for finding in seen.findings:
            console.print(Text(f"{finding.number}. {finding.sentence}"))
    else:
        console.print(_table(head, rows))
    if not many:
        return
    rest = f"; {len(groups) - MOST_GROUPS} more lines left out" if len(groups) > MOST_GROUPS else ""
    console.print(
        Text(
            f"{several(len(analysis.findings), 'finding')}, those of one kind and channel on one"
            f" line{rest}. Each by itself: -o DIR, --json, or a pipe.",
            "dim",
        )
    )


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim", pad_edge=False)
    for number, title in enumerate(head):
        table.add_column(Text(title), justify="left" if number else "right", overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row[: len(head)]))
    return table


def _row(number: int, finding: Finding, analysis: Analysis) -> tuple[str, ...]:
    votes = f"{len(finding.detectors)} agree"
    if finding.dissent:
        votes += f", {len(finding.dissent)} dissent"
    return (
        str(number),
        KIND_NAME[finding.kind],
        suspects(finding),
        _span(finding.start_s, finding.end_s),
        _size(finding, analysis),
        votes,
        utc(analysis.log.start_utc, finding.start_s, finding.end_s),
    )


def _size(finding: Finding, analysis: Analysis) -> str:
    size = printed_size(finding, flipped=negated(finding, analysis))
    if size is None:
        return ""
    exact = finding.size is None or finding.size.low == finding.size.high
    return str(size) if exact else f"{size} ({size.interval})"


def _span(start_s: float, end_s: float) -> str:
    return flight_time(start_s, end_s).removeprefix("from ").removeprefix("at ")


def _grouped(findings: Sequence[Finding]) -> list[list[Finding]]:
    groups: dict[tuple[str, tuple[str, ...]], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.kind, finding.suspects), []).append(finding)
    return list(groups.values())


def _group_row(group: Sequence[Finding]) -> tuple[str, ...]:
    first = group[0]
    sized = sorted((f for f in group if f.size is not None), key=lambda f: f.size.estimate)  # type: ignore[union-attr]
    size = ""
    if sized:
        least, most = printed_size(sized[0]), printed_size(sized[-1])
        if least is not None and most is not None:
            same = least.estimate == most.estimate
            size = str(most) if same else f"{least.estimate} to {most}"
    return (
        f"{len(group)} \u00d7" if len(group) > 1 else "",
        KIND_NAME[first.kind],
        suspects(first),
        _span(min(f.start_s for f in group), max(f.end_s for f in group)),
        size,
    )


def _show_strip(analysis: Analysis, console: Console) -> None:
    from rich.text import Text

    ascii_only = console.options.ascii_only
    names = max((len(name) for name in analysis.table.names), default=0)
    names = min(names, console.width // 3)
    status = max((len(one) for one in analysis.status), default=0)
    drawn = strip(analysis, console.width - names - status - 3, ascii_only=ascii_only)
    if drawn is None:
        return
    console.print()
    for lane in drawn.lanes:
        name = Text(lane.channel)
        name.truncate(names, overflow="ellipsis", pad=True)
        runs = [(run.text, _STYLE[run.state]) for run in lane.runs]
        word = (lane.status, _STYLE[lane.status])
        console.print(Text.assemble(name, " ", *runs, "  ", word), no_wrap=True, overflow="crop")
    console.print(Text(" " * (names + 1) + drawn.times, "dim"), no_wrap=True, overflow="crop")
    legend = Text(" " * (names + 1))
    for state in drawn.states:
        legend.append(MARKS[state][ascii_only], _STYLE[state])
        legend.append(f" {state}   ", "dim")
    console.print(legend)
    if drawn.left_out:
        console.print(Text(f"{several(drawn.left_out, 'more channel')} not drawn", "dim"))


def _show_losses(seen: Report, console: Console) -> None:
    """List what was lost; that something was, and how much, the verdict's notes say."""
    from rich.text import Text

    losses = [loss for loss in seen.losses if loss.sort == "loss"]
    console.print()
    console.print(Text("Lost:" if losses else seen.completeness, "" if losses else "dim"))
    for loss in losses[:MOST_LOSSES]:
        said = (loss.what, loss.place, loss.lost)
        console.print(Text(f"  {', '.join(part for part in said if part)}"))
    if len(losses) > MOST_LOSSES:
        console.print(Text(f"  and {len(losses) - MOST_LOSSES} more", "dim"))
