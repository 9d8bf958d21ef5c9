"""The Markdown report: tables that stay tables whatever the log holds."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import pytest
from markdown_it import MarkdownIt

from fdilog.analysis import Analysis
from fdilog.recording import Problem
from fdilog_reports import markdown
from fdilog_reports.template import code_block, markdown_text
from tests.reports_factory import analysis, failed_analysis, pair_analysis, table

HOSTILE = [
    "a|b", "`code`", "<script>alert(1)</script>", "[x](javascript:alert(1))", "![x](http://a/b)",
    "*a* _b_ ~~c~~", "# h", "&lt;", "a\nb", "https://evil.example/x", "www.evil.example",
    "me@evil.example", "\\|", "|||", "<!--", "\u202e", "```",
]  # fmt: skip


def rendered(text: str) -> Any:
    return MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"]).parse(text)


def rows(text: str) -> list[list[str]]:
    """Cells of every table row, as a Markdown reader sees them."""
    found: list[list[str]] = []
    tokens = rendered(text)
    for token, after in itertools.pairwise(tokens):
        if token.type == "tr_open":
            found.append([])
        if token.type in {"th_open", "td_open"}:
            found[-1].append("".join(child.content for child in after.children or ()))
    return found


def inline_types(text: str) -> set[str]:
    return {child.type for token in rendered(text) for child in token.children or ()}


def with_source(name: str, made: Analysis | None = None) -> Analysis:
    made = made or failed_analysis()
    first = dataclasses.replace(made.sources[0], name=name, topic=name, reason=name)
    return dataclasses.replace(made, sources=(first, *made.sources[1:]))


def test_the_verdict_comes_first() -> None:
    lines = markdown.render(failed_analysis()).splitlines()
    assert lines[0] == "# Gyro report: 2024-05-01 copter.bin"
    assert lines[2].startswith("**Failed.** imu1.y read 2.0 deg/s too much")


def test_findings_are_a_table_with_interval_and_tolerance() -> None:
    cells = rows(markdown.render(failed_analysis()))
    head = next(row for row in cells if row[:1] == ["No."])
    finding = dict(zip(head, next(row for row in cells if row[:1] == ["1"]), strict=True))
    assert finding["Suspects"] == "imu1.y"
    assert finding["Interval"] == "1.7 to 2.3 deg/s (99.9 %)"
    assert finding["Tolerance"] == "±1 deg/s"
    assert finding["Agree"] == "difference, guaranteed and parity"


def test_every_table_has_as_many_cells_in_each_row() -> None:
    for made in (analysis(), failed_analysis(), pair_analysis()):
        text = markdown.render(made)
        widths = [len(row) for row in rows(text)]
        assert sum(line.startswith("|") for line in text.splitlines()) == len(widths) + sum(
            token.type == "table_open" for token in rendered(text)
        )
        assert 0 not in widths


@pytest.mark.parametrize("hostile", HOSTILE)
def test_a_hostile_name_is_text_in_its_own_cell(hostile: str) -> None:
    text = markdown.render(with_source(hostile))
    head = ["Source", "Topic", "Used", "Why", "Rate", "Samples"]
    cells = rows(text)
    row = cells[cells.index(head) + 1]
    assert len(row) == len(head)
    shown = hostile.replace("\n", "\\n").replace("\u202e", "\\u202e")
    assert row[0] == row[1] == row[3] == shown
    assert inline_types(text) <= {
        "text",
        "strong_open",
        "strong_close",
        "softbreak",
        "text_special",
    }


def test_every_loss_has_its_place() -> None:
    cells = rows(markdown.render(pair_analysis()))
    loss = next(row for row in cells if row[0] == "damaged records")
    assert loss == [
        "damaged records",
        "byte 1\u202f048\u202f576",
        "12.3 kB (12\u202f345 bytes) and 4.2 s",
        "loss",
    ]


def test_more_problems_than_anyone_reads_are_counted() -> None:
    problems = tuple(Problem(what="x", offset=k, bytes_lost=1) for k in range(700))
    made = failed_analysis()
    lost = dataclasses.replace(made.completeness, whole=False, problems=problems, bytes_lost=700)
    text = markdown.render(dataclasses.replace(made, completeness=lost))
    assert "200 further problems: see the JSON result." in text


def test_a_fence_is_longer_than_any_run_of_backticks_within() -> None:
    assert code_block("a ```` b", "sh") == "`````sh\na ```` b\n`````"


def test_a_name_with_underscores_stays_readable() -> None:
    assert markdown_text("sensor_gyro_0") == "sensor_gyro_0"
    assert markdown_text("_em_") == r"\_em\_"


def test_an_empty_analysis_is_a_report_too() -> None:
    text = markdown.render(analysis(table(sources=1), verdict="insufficient"))
    assert "Nothing could be compared" in text
