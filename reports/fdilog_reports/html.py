"""The HTML report: one file that needs no network, no script and no other file."""

from __future__ import annotations

import base64

from fdilog.analysis import Analysis
from fdilog_reports import json as json_report
from fdilog_reports.residual_picture import residual_picture
from fdilog_reports.template import SCRIPT_SAFE, html_environment
from fdilog_reports.timeline import timeline
from fdilog_reports.view import report

suffix = ".html"


def render(analysis: Analysis) -> str:
    """Return the report as one self-contained HTML file."""
    from markupsafe import Markup

    result = json_report.render(analysis)
    return (
        html_environment()
        .get_template("report.html")
        .render(
            report=report(analysis),
            timeline=timeline(analysis),
            residuals=residual_picture(analysis),
            json=Markup(result.translate(SCRIPT_SAFE)),  # noqa: S704  escaped for where it goes
            json_base64=base64.b64encode(result.encode()).decode(),
        )
    )
