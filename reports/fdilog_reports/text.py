"""The summary as plain text: verdict, findings, what is missing; or one line."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fdilog.analysis import Analysis
from fdilog_reports.rows import QuoteRow
from fdilog_reports.view import Report, report

if TYPE_CHECKING:
    from rich.console import Console

suffix = ".txt"
MOST_QUOTES = 3


def render(analysis: Analysis, *, brief: bool = False) -> str:
    """Return the summary as plain text, a finding a line, or all of it as one line."""
    seen = report(analysis)
    head = f"{seen.log_name}: {seen.verdict.word}. {seen.verdict.sentence}"
    if brief:
        return head + "\n"
    lines = [head, *(f"  {note}" for note in seen.verdict.notes)]
    if [finding.sentence for finding in seen.findings] != [seen.verdict.sentence]:
        lines += [f"  {finding.number}. {finding.sentence}" for finding in seen.findings]
    if seen.findings_left_out:
        lines.append(f"  {seen.findings_left_out}")
    lines += [f"  {sentence}" for sentence in asides(seen)]
    return "\n".join(lines) + "\n"


def asides(seen: Report) -> list[str]:
    """Say what a slow log could not have shown, and what the autopilot itself complained of."""
    said = list(seen.limits) if seen.slow else []
    said += [f"The autopilot: {_quote(quote)}." for quote in seen.autopilot[:MOST_QUOTES]]
    rest = len(seen.autopilot) - MOST_QUOTES
    if rest > 0:
        said.append(f"The autopilot: {rest} more, in the reports (-o DIR) and in --json.")
    return said


def _quote(quote: QuoteRow) -> str:
    what = f"{quote.gyro} {quote.what}" if quote.gyro else quote.what
    return f"{what}, {quote.when} ({quote.source})"


def show(analysis: Analysis, console: Console) -> None:
    """Print the summary on a terminal, in its width and its colours."""
    from fdilog_reports import terminal

    terminal.show(analysis, console)
