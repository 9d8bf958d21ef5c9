"""A campaign as JUnit XML: each log is a test, so that any CI server shows which ones failed."""

from __future__ import annotations

from xml.sax.saxutils import escape, quoteattr

from fdilog.campaign.summary import NOT_ANALYSED, Campaign, LogEntry
from fdilog_reports.campaign_words import accused, lost
from fdilog_reports.words import SHOWN_TEXT, shown

file_name = "audit.xml"


def render(campaign: Campaign) -> str:
    """Return the whole file.

    A failed gyro is a failure, a log without a verdict an error, one that decides nothing skipped.
    """
    counts = campaign.counts
    skipped = counts["undecided"] + counts["insufficient"]
    numbers = (
        f'tests="{len(campaign.logs)}" failures="{counts["failed"]}"'
        f' errors="{counts[NOT_ANALYSED]}"'
    )
    return "\n".join(
        [
            '<?xml version="1.0" encoding="utf-8"?>',
            f'<testsuites name="fdilog audit" {numbers}>',
            f'<testsuite name="fdilog audit" {numbers} skipped="{skipped}">',
            *(_case(log) for log in campaign.logs),
            "</testsuite>",
            "</testsuites>",
            "",
        ]
    )


def _case(log: LogEntry) -> str:
    head = f"<testcase classname={_attribute(log.vehicle)} name={_attribute(log.path)}"
    duration = f' time="{log.duration_s:.3f}"' if log.duration_s is not None else ""
    if log.verdict == "healthy":
        return f"{head}{duration}/>"
    if log.verdict is None:
        kind = _attribute(log.error_kind or "pending")
        body = f"<error type={kind} message={_attribute(log.error or '')}/>"
    elif log.verdict == "failed":
        words = accused(log)
        lines = escape("\n".join(shown(f.detail, SHOWN_TEXT) for f in log.findings))
        body = f'<failure type="failed" message={_attribute(words)}>{lines}</failure>'
    else:
        message = "; ".join(filter(None, [log.verdict, lost(log)]))
        body = f"<skipped message={_attribute(message)}/>"
    return f"{head}{duration}>{body}</testcase>"


def _attribute(text: str) -> str:
    return quoteattr(shown(text, SHOWN_TEXT))
