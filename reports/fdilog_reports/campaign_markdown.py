"""A campaign as Markdown: what to look at, for a ticket or a weekly note."""

from __future__ import annotations

from fdilog.campaign.summary import Campaign
from fdilog_reports.campaign_view import campaign_view
from fdilog_reports.template import markdown_environment

file_name = "audit.md"


def render(campaign: Campaign) -> str:
    """Return the whole file."""
    return markdown_environment().get_template("campaign.md").render(view=campaign_view(campaign))
