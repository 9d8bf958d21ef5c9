"""The HTML report: one file that needs no network, no script and no other file."""

from __future__ import annotations

import base64

from fdilog.analysis import Analysis
from fdilog_reports import json as json_report
from fdilog_reports.residual_picture import residual_picture
from fdilog_reports.template import html_environment
from fdilog_reports.timeline import timeline
from fdilog_reports.view import report

suffix = ".html"

# JSON allows these escapes in every string; nothing of a script element's syntax is left.
SCRIPT_SAFE = str.maketrans(
    {"<": r"\u003c", ">": r"\u003e", "&": r"\u0026", "\u2028": r"\u2028", "\u2029": r"\u2029"}
)


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
