"""The Markdown report: CommonMark with tables, to paste into an issue or a ticket."""

from __future__ import annotations

from fdilog.analysis import Analysis
from fdilog_reports.template import markdown_environment
from fdilog_reports.view import report

suffix = ".md"


def render(analysis: Analysis) -> str:
    """Return the report as Markdown."""
    return markdown_environment().get_template("report.md").render(report=report(analysis))
