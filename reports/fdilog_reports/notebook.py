"""An analysis in a notebook: a small fragment that shows it, and the figure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fdilog.analysis import Analysis
from fdilog_reports.sentences import negated, printed_size
from fdilog_reports.strip import MARKS, strip
from fdilog_reports.template import html_environment
from fdilog_reports.terminal import short_facts
from fdilog_reports.view import report
from fdilog_reports.words import several

if TYPE_CHECKING:
    from fdilog_reports.plots import LinkedFigure

suffix = ".fragment.html"

MOST_FINDINGS = 20
"""As many rows as pandas would show of a frame without asking."""
STRIP_WIDTH = 80

# Of middle lightness: readable on a light notebook and on a dark one.
COLOUR = {
    "failed": "#d6453d",
    "suspect": "#c2549d",
    "one of several": "#c2549d",
    "undecided": "#b07d10",
    "insufficient": "#b07d10",
    "healthy": "#2f9e57",
    "within tolerance": "#2f9e57",
    "not compared": "#858585",
    "no data": "#858585",
}


def render(analysis: Analysis) -> str:
    """Return a fragment of HTML without script, style sheet, link or identifier."""
    seen = report(analysis)
    rows = [
        (row, printed_size(finding, flipped=negated(finding, analysis)))
        for row, finding in zip(seen.findings, analysis.findings[:MOST_FINDINGS], strict=False)
    ]
    drawn = strip(analysis, STRIP_WIDTH)
    rest = len(analysis.findings) - len(rows)
    return (
        html_environment()
        .get_template("fragment.html")
        .render(
            report=seen,
            rows=rows,
            rest=f"{several(rest, 'more finding')}: see .findings_frame()" if rest > 0 else "",
            strip=drawn,
            names=max((len(lane.channel) for lane in drawn.lanes), default=0) if drawn else 0,
            facts=short_facts(seen),
            marks=MARKS,
            colour=COLOUR,
        )
    )


def figure(analysis: Analysis) -> LinkedFigure:
    """Return the linked plots: rates, residuals, intervals and findings on one time axis."""
    from fdilog_reports.plots import linked_figure

    return linked_figure(analysis)
