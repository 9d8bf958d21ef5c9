"""A campaign as one HTML file: its own script sorts and filters, nothing else can run in it."""

from __future__ import annotations

import base64
import hashlib
import json

from fdilog.campaign.summary import Campaign
from fdilog_reports.campaign_view import campaign_view
from fdilog_reports.template import FOLDER, SCRIPT_SAFE, html_environment

file_name = "index.html"


def render(campaign: Campaign) -> str:
    """Return the whole file."""
    from markupsafe import Markup

    view = campaign_view(campaign)
    script = (FOLDER / "campaign.js").read_text("utf-8")
    style = "\n".join((FOLDER / name).read_text("utf-8") for name in ("report.css", "campaign.css"))
    data = json.dumps(view.table, ensure_ascii=False, separators=(",", ":"))
    return (
        html_environment()
        .get_template("campaign.html")
        .render(
            view=view,
            script=Markup(script),  # noqa: S704  our own files
            style=Markup(style),  # noqa: S704
            script_hash=_hash(script),
            style_hash=_hash(style),
            data=Markup(data.translate(SCRIPT_SAFE)),  # noqa: S704  escaped for where it goes
        )
    )


def _hash(text: str) -> str:
    """Return the source expression by which a content security policy knows a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
