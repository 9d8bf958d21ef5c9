"""The HTML report: one file that needs no network and no other file, and reads without a script."""

from __future__ import annotations

import base64

from fdilog.analysis import Analysis
from fdilog_reports import json as json_report
from fdilog_reports import plots
from fdilog_reports.losses import loss_strip
from fdilog_reports.residual_picture import residual_picture
from fdilog_reports.template import SCRIPT_SAFE, html_environment
from fdilog_reports.timeline import timeline
from fdilog_reports.view import report

suffix = ".html"

LONGEST_LINK = 200_000
"""Characters of a result that are in the page twice, the second time as a link."""


def render(analysis: Analysis) -> str:
    """Return the report as one self-contained HTML file."""
    return _render(analysis, shared=False)


def render_shared(analysis: Analysis) -> str:
    """Return the report as a file that needs those of `shared_files` in its folder to draw."""
    return _render(analysis, shared=True)


def shared_files() -> dict[str, str]:
    """Return what the reports of one folder share, by file name: the plotting library."""
    return {plots.shared_name(): plots.library()}


def _render(analysis: Analysis, *, shared: bool) -> str:
    from markupsafe import Markup

    result = json_report.render(analysis)
    drawn = plots.plots(analysis)
    # A link needs no script but holds the result once more; a long one is left to the script.
    twice = drawn is None or len(result) < LONGEST_LINK
    return (
        html_environment()
        .get_template("report.html")
        .render(
            report=report(analysis),
            timeline=timeline(analysis),
            residuals=residual_picture(analysis),
            losses=loss_strip(analysis),
            json=Markup(result.translate(SCRIPT_SAFE)),  # noqa: S704  escaped for where it goes
            json_base64=base64.b64encode(result.encode()).decode() if twice else "",
            plots=drawn,
            **(plots.script_parts(shared=shared) if drawn else {"policy": ""}),
        )
    )
