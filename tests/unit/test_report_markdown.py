"""The Markdown report: tables that stay tables whatever the log holds."""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any
from urllib.parse import unquote
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from markdown_it import MarkdownIt

from fdilog.analysis import Analysis
from fdilog.recording import Problem
from fdilog_reports import markdown
from fdilog_reports.pictures import pictures
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
    assert "- Agree: 3: difference, guaranteed and parity" in markdown.render(failed_analysis())


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


def test_suspects_that_cannot_be_told_apart_have_a_size_without_sign() -> None:
    cells = rows(markdown.render(pair_analysis()))
    finding = next(row for row in cells if row[:1] == ["1"])
    assert finding[2] == "imu0.x or imu1.x"
    assert finding[4:6] == ["3.0 deg/s", "2.7 to 3.3 deg/s (99.9 %)"]


def test_the_timeline_is_in_characters_that_any_forum_shows() -> None:
    text = markdown.render(failed_analysis())
    block = next(
        token.content for token in rendered(text) if token.type == "fence" and token.info == "text"
    )
    line = next(line for line in block.splitlines() if line.startswith("imu1.y"))
    assert line.endswith("failed")
    assert 8 <= line.count("█") <= 12
    assert max(map(len, block.splitlines())) < 80


def test_pictures_are_linked_and_without_them_nothing_is() -> None:
    text, drawn = markdown.render_illustrated(pair_analysis(), "a (1) <b>_files")
    images = [
        child for token in rendered(text) for child in token.children or () if child.type == "image"
    ]
    assert [unquote(image.attrs["src"]) for image in images] == [
        f"a (1) <b>_files/{name}" for name in drawn
    ]
    assert list(drawn) == ["timeline.svg", "residuals.svg"]
    assert "image" not in inline_types(markdown.render(pair_analysis()))


@pytest.mark.parametrize("made", [failed_analysis(), pair_analysis(), analysis()])
def test_pictures_are_xml_that_needs_nothing_else(made: Analysis) -> None:
    channels = tuple(
        dataclasses.replace(channel, name=f'<script>\x00&"{channel.name}')
        for channel in made.table.channels
    )
    made = dataclasses.replace(made, table=dataclasses.replace(made.table, channels=channels))
    for name, text in pictures(made).items():
        root = ET.fromstring(text)  # noqa: S314  our own
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        tags = {element.tag.partition("}")[2] for element in root.iter()}
        assert not tags & {"script", "image", "foreignObject", "a", "use"}, name
        assert '<script>\\x00&"imu1.y' in "".join(root.itertext())
        assert len(text) < 300_000


def test_the_timeline_picture_shows_the_finding_where_it_is() -> None:
    root = ET.fromstring(pictures(failed_analysis())["timeline.svg"])  # noqa: S314
    failed = [
        element
        for element in root.iter()
        if element.get("class") == "state-failed" and list(element)
    ]
    assert len(failed) == 1
    left, width = (float(failed[0].get(key, "nan")) for key in ("x", "width"))
    assert left == pytest.approx(1000 * 40.1 / 119.98, abs=0.1)
    assert width == pytest.approx(1000 * 20.1 / 119.98, abs=0.1)


def test_without_channels_there_is_no_picture() -> None:
    empty = table().only(np.zeros(len(table().time_s), bool))
    assert pictures(analysis(empty, evidence=())) == {}


def test_an_empty_analysis_is_a_report_too() -> None:
    text = markdown.render(analysis(table(sources=1), verdict="insufficient"))
    assert "Nothing could be compared" in text
