"""The two pictures as SVG files, to stand beside a Markdown report."""

from __future__ import annotations

from fdilog.analysis import Analysis
from fdilog_reports.residual_picture import Panel, residual_picture
from fdilog_reports.template import html_environment
from fdilog_reports.timeline import timeline

MOST_LANES = 30
MOST_PANELS = 8
"""Pictures of more are higher than a page; the HTML report has them all."""


def pictures(analysis: Analysis) -> dict[str, str]:
    """Return SVG by file name, of what there is to draw."""
    drawn = {}
    lanes = timeline(analysis)
    if lanes.lanes and len(analysis.table.time_s):
        drawn["timeline.svg"] = _rendered(
            "timeline.svg",
            lanes=lanes.lanes[:MOST_LANES],
            left_out=max(0, len(lanes.lanes) - MOST_LANES),
            ticks=lanes.time_ticks,
        )
    shown = residual_picture(analysis)
    panels = [panel for group in shown.groups for panel in group.panels]
    if panels:
        panels.sort(key=_least_in_doubt)
        drawn["residuals.svg"] = _rendered(
            "residuals.svg",
            panels=panels[:MOST_PANELS],
            left_out=max(0, len(panels) - MOST_PANELS),
            picture=shown,
        )
    return drawn


def _least_in_doubt(panel: Panel) -> int:
    """Put the accused first, then the undecided; others keep their order."""
    rank = ("failed", "suspect", "undecided", "insufficient", "healthy")
    return min(rank.index(status) for _, status in panel.channels)


def _rendered(name: str, **values: object) -> str:
    return html_environment().get_template(name).render(**values)
