"""The Markdown report: CommonMark with tables, to paste into an issue or a ticket."""

from __future__ import annotations

from urllib.parse import quote

from fdilog.analysis import Analysis
from fdilog_reports.pictures import pictures
from fdilog_reports.strip import lines, strip
from fdilog_reports.template import Verbatim, markdown_environment
from fdilog_reports.view import report

suffix = ".md"

STRIP_WIDTH = 60
"""Characters of the timeline: forums show some 80 without scrolling."""

_TITLE = {
    "timeline.svg": "What was known of each channel, and when",
    "residuals.svg": "Each channel against the others",
}


def render(analysis: Analysis) -> str:
    """Return the report as Markdown, without pictures: it can be pasted anywhere."""
    return _render(analysis, [], "")


def render_illustrated(analysis: Analysis, folder: str) -> tuple[str, dict[str, str]]:
    """Return the report, and the pictures in it by file name, to be written to ``folder``."""
    drawn = pictures(analysis)
    return _render(analysis, list(drawn), folder), drawn


def _render(analysis: Analysis, names: list[str], folder: str) -> str:
    images = [
        Verbatim(f"![{_TITLE[name]}]({quote(folder, errors='surrogateescape')}/{name})")
        for name in names
    ]
    drawn = strip(analysis, STRIP_WIDTH)
    return (
        markdown_environment()
        .get_template("report.md")
        .render(
            report=report(analysis),
            pictures=images,
            strip="\n".join(lines(drawn)) if drawn else "",
        )
    )
