"""Where in the file the losses lie, as a strip from its first byte to its last."""

from __future__ import annotations

from fdilog.analysis import Analysis
from fdilog_reports.figures import LEAST_WIDTH, WIDE, Span
from fdilog_reports.words import SHOWN_TEXT, count, shown

MOST_MARKS = 500
"""Marks on the strip; the table below it lists as many."""


def loss_strip(analysis: Analysis) -> tuple[Span, ...]:
    """Place every loss that has an offset; nothing where none has."""
    size = analysis.log.bytes
    spans: list[Span] = []
    for problem in analysis.completeness.problems:
        if problem.note or problem.offset is None or not 0 <= problem.offset <= size or not size:
            continue
        if len(spans) == MOST_MARKS:
            break
        width = max(WIDE * (problem.bytes_lost or 0) / size, LEAST_WIDTH)
        left = min(WIDE * problem.offset / size, WIDE - LEAST_WIDTH)
        spans.append(
            Span(
                state="failed",
                left=f"{left:.1f}",
                width=f"{min(width, WIDE - left):.1f}",
                title=f"byte {count(problem.offset)}: {shown(problem.what, SHOWN_TEXT)}",
            )
        )
    return tuple(spans)
