"""Reports of whatever a log can hold: every string stays text, and nothing makes them fail."""

from __future__ import annotations

import dataclasses
import json
import math
from html.parser import HTMLParser
from typing import get_args

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from markdown_it import MarkdownIt

from fdilog.analysis import Analysis, Completeness
from fdilog.finding import Finding, Interval, Kind, Size
from fdilog.recording import Problem
from fdilog.table import Channel, ChannelTable
from fdilog_reports import html, markdown
from fdilog_reports import json as json_report
from fdilog_reports.template import markdown_text
from fdilog_reports.words import figure, rounded, shown
from tests.reports_factory import analysis, failed_analysis
from tests.unit.test_report_json import SCHEMA

# Surrogates are in: a path that is not UTF-8 holds them.
anything = st.text(st.characters(), max_size=40)
hostile = st.one_of(
    anything,
    st.lists(
        st.sampled_from(
            ["<", ">", "&", '"', "'", "`", "|", "\\", "\n", "*", "_", "[", "](", "http://a",
             "\u202e", "</script>", "<!--", "www.", "@", "{{", "~", "#", "\0", "\udcff",
             "א", "a", " "]
        ),
        max_size=12,
    ).map("".join),
)  # fmt: skip
number = st.floats(allow_nan=True, allow_infinity=True)
time_s = st.floats(-1e6, 1e6)

VALIDATOR = Draft202012Validator(json.loads(SCHEMA.read_text(encoding="utf-8")))


class Tags(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.seen: set[str] = set()
        self.names: set[str] = set()
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.add(tag)
        self.names |= {name for name, _ in attrs}


PLAIN = Tags(html.render(failed_analysis()))


def named(text: str) -> Analysis:
    made = failed_analysis()
    channels = tuple(
        dataclasses.replace(c, name=text + c.name, source=text) for c in made.table.channels
    )
    finding = dataclasses.replace(
        made.findings[0], suspects=(text + "imu1.y",), detail=text, dissent=(text,), witness=text
    )
    return dataclasses.replace(
        made,
        log=dataclasses.replace(made.log, path=text, format=text, vehicle={text: text}),
        completeness=Completeness(
            whole=False, bytes_lost=0, seconds_lost=0.0, problems=(Problem(what=text),)
        ),
        sources=tuple(dataclasses.replace(s, name=text, topic=text) for s in made.sources),
        table=dataclasses.replace(made.table, channels=channels),
        findings=(finding,),
    )


@given(hostile)
@settings(max_examples=25)
def test_no_string_becomes_an_element_or_an_attribute(text: str) -> None:
    page = html.render(named(text))
    page.encode("utf-8")
    tags = Tags(page)
    assert tags.seen <= PLAIN.seen
    assert tags.names <= PLAIN.names


@given(hostile)
@settings(max_examples=25)
def test_the_json_gives_every_string_back(text: str) -> None:
    line = json_report.render(named(text))
    line.encode("utf-8")
    assert line.count("\n") == 1
    result = json.loads(line)
    assert result["log"]["path"] == text
    assert result["log"]["vehicle"] == {text: text}
    assert result["findings"][0]["detail"] == text


@given(hostile)
def test_markdown_shows_a_string_as_itself(text: str) -> None:
    safe = shown(text)
    parser = MarkdownIt("commonmark", {"html": True}).enable(["table", "strikethrough"])
    tokens = parser.parse(f"| a | b |\n|---|---|\n| {markdown_text(safe)} | x |\n")
    cells = [t for t in tokens if t.type == "inline"]
    assert len(cells) == 4
    children = cells[2].children or []
    assert {child.type for child in children} <= {"text", "text_special"}
    assert "".join(child.content for child in children) == safe.strip()


@given(anything)
def test_what_is_shown_is_visible_short_and_on_one_line(text: str) -> None:
    line = shown(text, 20)
    line.encode("utf-8")
    assert not any(ord(char) < 32 or 0x7F <= ord(char) < 0xA0 for char in line)
    assert "\u202e" not in line
    assert len(shown(text * 1000, 20)) <= 20 * 10 + 40


@given(number, number, number)
def test_a_printed_interval_holds_the_computed_one(
    low: float, high: float, estimate: float
) -> None:
    ends = rounded(min(low, high), max(low, high), estimate)
    if math.isfinite(low) and math.isfinite(high) and ends[0] and ends[1]:
        slack = 1e-11 * (abs(low) + abs(high))
        assert float(ends[0]) <= min(low, high) + slack
        assert float(ends[1]) >= max(low, high) - slack


@given(number)
def test_a_figure_is_near_its_number(value: float) -> None:
    text = figure(value)
    if math.isfinite(value):
        assert math.isclose(float(text), value, rel_tol=0.0051, abs_tol=0.0)


size = st.one_of(
    st.none(),
    st.builds(
        Size,
        estimate=number,
        low=number,
        high=number,
        confidence=st.floats(0.5, 1.0),
        unit=st.sampled_from(["rad/s", "rad/s^2", "s", "1"]),
    ),
)
finding = st.builds(
    Finding,
    kind=st.sampled_from(get_args(Kind)),
    suspects=st.lists(
        st.sampled_from(["g0", "g1", "g2", "nobody"]), min_size=1, max_size=4, unique=True
    ).map(tuple),
    start_s=time_s,
    end_s=time_s,
    size=size,
    guaranteed=st.one_of(st.none(), st.builds(Interval, low=number, high=number)),
    detectors=st.lists(st.sampled_from(["a", "b", "c"]), unique=True).map(tuple),
    detail=st.text(max_size=5),
)


@st.composite
def any_analysis(draw: st.DrawFn) -> Analysis:
    """Up to twelve channels on any axes, any samples missing, any findings."""
    n, k = draw(st.integers(0, 30)), draw(st.integers(0, 12))
    random = np.random.default_rng(draw(st.integers(0, 99)))
    axes = random.normal(size=(k, 3)) if draw(st.booleans()) else np.eye(3)[np.arange(k) % 3]
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    valid = random.random((n, k)) < draw(st.sampled_from([0.0, 0.5, 1.0]))
    rate = np.where(
        valid, random.normal(size=(n, k)) * draw(st.sampled_from([0, 1e-3, 1e5])), np.nan
    )
    made = ChannelTable(
        time_s=np.cumsum(random.exponential(0.1, n) + 1e-6),
        rate_rad_s=rate,
        valid=valid,
        channels=tuple(
            Channel(
                name=f"g{i}",
                source=f"unit{i // 3}",
                axis=(float(axes[i, 0]), float(axes[i, 1]), float(axes[i, 2])),
                rate_hz=draw(st.sampled_from([0.0, 10.0])),
                samples=int(valid[:, i].sum()),
                derived=draw(st.booleans()),
            )
            for i in range(k)
        ),
    )
    return analysis(
        made,
        evidence=(),
        status=tuple(
            draw(st.sampled_from(["failed", "suspect", "healthy", "undecided", "insufficient"]))
            for _ in range(k)
        ),
        sigma_rad_s=tuple(draw(number) for _ in range(k)),
        verdict=draw(st.sampled_from(["failed", "healthy", "undecided", "insufficient"])),
        findings=tuple(draw(st.lists(finding, max_size=3))),
    )


@given(any_analysis())
@settings(max_examples=60)
def test_no_analysis_makes_a_report_fail(made: Analysis) -> None:
    VALIDATOR.validate(json.loads(json_report.render(made)))
    page = html.render(made)
    assert "nan" not in page[page.index("<body>") : page.index("<script")].lower().split()
    assert markdown.render(made).startswith("# Gyro report")
