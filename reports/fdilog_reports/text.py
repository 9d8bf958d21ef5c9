"""The summary on the terminal: verdict, findings, what is missing; or one line."""

from __future__ import annotations

from fdilog.analysis import Analysis
from fdilog_reports.view import report

suffix = ".txt"

MOST_FINDINGS = 20


def render(analysis: Analysis, *, brief: bool = False) -> str:
    """Return the summary as plain text, or as one line."""
    seen = report(analysis)
    head = f"{seen.log_name}: {seen.verdict.word}. {seen.verdict.sentence}"
    if brief:
        return head + "\n"
    lines = [head, *(f"  {note}" for note in seen.verdict.notes)]
    lines += [
        f"  {number}. {finding.sentence}"
        for number, finding in enumerate(seen.findings[:MOST_FINDINGS], start=1)
    ]
    if len(analysis.findings) > MOST_FINDINGS:
        lines.append(f"  and {len(analysis.findings) - MOST_FINDINGS} more; see the report")
    return "\n".join(lines) + "\n"
