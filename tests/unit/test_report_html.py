"""The HTML report: one file, no network, and nothing of a log's taken for markup."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import hashlib
import itertools
import json
import re
from html.parser import HTMLParser
from typing import Any

import pytest

from fdilog.analysis import Analysis
from fdilog_reports import html
from fdilog_reports import json as json_report
from tests.reports_factory import analysis, bias, failed_analysis, pair_analysis, table

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """Elements with their attributes, the visible text, and whether tags are nested soundly."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.texts: dict[str | None, str] = {}
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            script = self.elements[-1][1].get("id")
            self.texts[script] = self.texts.get(script, "") + data
        elif "style" not in self.open:
            self.words.append(data)

    def result(self) -> dict[str, Any]:
        """Return the JSON result that the page holds."""
        found: dict[str, Any] = json.loads(self.texts["result"])
        return found

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.elements if name == tag]


ALL = [
    analysis(),
    failed_analysis(),
    pair_analysis(),
    analysis(table(sources=1), verdict="insufficient"),
]


@pytest.mark.parametrize("made", ALL)
def test_the_page_needs_nothing_from_anywhere(made: Analysis) -> None:
    page = Page(html.render(made))
    for tag, attributes in page.elements:
        assert tag not in {"link", "img", "iframe", "object", "embed", "base", "form"}
        assert not [name for name in attributes if name.startswith("on") or name == "src"]
        target = attributes.get("href") or "#"
        assert target.startswith(("#", "data:application/json;base64,"))
    style = re.search(r"<style>(.*?)</style>", html.render(made), re.DOTALL)
    assert style
    assert "url(" not in style[1]
    assert "@import" not in style[1]


def policy_of(text: str) -> str:
    policy = next(
        meta["content"]
        for meta in Page(text).all("meta")
        if meta.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy is not None
    return policy


def test_the_policy_lets_only_our_script_and_the_library_run() -> None:
    text = html.render(analysis())
    policy = policy_of(text)
    assert policy.startswith("default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-")
    allowed = policy.split("script-src ")[1].split(";")[0].split()
    ours, library = (source.removeprefix("'sha256-").removesuffix("'") for source in allowed)
    scripts = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    assert [digest(script) for script in scripts] == [ours]
    packed = re.search(r'id="plot-library">(.*?)</script>', text, re.DOTALL)
    assert packed
    assert digest(gzip.decompress(base64.b64decode(packed[1])).decode()) == library


def digest(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()


def test_reports_of_one_folder_share_the_library_and_nothing_else() -> None:
    text = html.render_shared(analysis())
    (name,) = html.shared_files()
    assert [a["src"] for a in Page(text).all("script") if "src" in a] == [name]
    assert "'self' file:" in policy_of(text)
    assert len(text) < len(html.render(analysis())) - 400_000
    assert "Bokeh" in html.shared_files()[name]


def test_a_log_without_a_sample_has_a_page_without_scripts() -> None:
    empty = analysis(table(duration_s=0.0), evidence=(), verdict="insufficient")
    text = html.render(empty)
    assert "script-src" not in policy_of(text)
    assert [script.get("type") for script in Page(text).all("script")] == ["application/json"]


@pytest.mark.parametrize("made", ALL)
def test_every_link_within_the_page_leads_somewhere(made: Analysis) -> None:
    page = Page(html.render(made))
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [a["href"] for a in page.all("a") if (a["href"] or "").startswith("#")]
    assert links
    assert {link[1:] for link in links if link} <= set(ids)


def test_headings_tables_and_pictures_are_named() -> None:
    page = Page(html.render(failed_analysis()))
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    assert len(page.all("caption")) == len(page.all("table"))
    assert all(th.get("scope") in {"row", "col"} for th in page.all("th"))
    for svg in page.all("svg"):
        assert svg.get("aria-hidden") == "true" or svg.get("aria-label")


def test_the_verdict_is_a_word_a_sentence_and_a_shape() -> None:
    text = html.render(failed_analysis())
    banner = text[text.index('class="verdict is-failed"') : text.index('<dl class="facts">')]
    assert '<p class="word">Failed</p>' in banner
    sentence = "imu1.y read 2.0 deg/s too much (99.9 %: 1.7 to 2.3) from 40.1 s to 60.2 s."
    assert sentence in banner.replace("\u00a0", " ")
    assert "2.0\u00a0deg/s" in banner
    assert "<svg" in banner


def test_the_json_result_is_in_the_page_and_can_be_downloaded() -> None:
    made = failed_analysis()
    page = Page(html.render(made))
    result = json.loads(json_report.render(made))
    assert page.result() == result
    link = next(a for a in page.all("a") if "download" in a)
    assert link["href"] is not None
    assert json.loads(base64.b64decode(link["href"].partition(",")[2])) == result
    assert link["download"] == "2024-05-01_copter.bin.fdilog.json"


@pytest.mark.parametrize(
    "hostile",
    [
        "</script><script>alert(1)</script>", "<img src=x onerror=alert(1)>", '" onload="x',
        "' onclick='x", "</title></style>", "<!--", "]]>", "{{ 7 * 7 }}", "&amp;", "\u2028",
    ],
)  # fmt: skip
def test_a_hostile_string_is_text_wherever_it_stands(hostile: str) -> None:
    made = failed_analysis()
    channels = tuple(
        dataclasses.replace(c, name=hostile + c.name, source=hostile) for c in made.table.channels
    )
    made = dataclasses.replace(
        made,
        log=dataclasses.replace(made.log, path=hostile, format=hostile, vehicle={hostile: hostile}),
        table=dataclasses.replace(made.table, channels=channels),
        sources=tuple(dataclasses.replace(s, topic=hostile, reason=hostile) for s in made.sources),
        findings=(
            bias((hostile + "imu1.y",), detail=hostile, detectors=(hostile,), witness=hostile),
        ),
    )
    page = Page(html.render(made))
    plain = Page(html.render(failed_analysis()))
    kinds = {tag for tag, _ in plain.elements}
    assert {tag for tag, _ in page.elements} <= kinds
    names = {name for _, attributes in plain.elements for name in attributes}
    assert {name for _, attributes in page.elements for name in attributes} <= names
    assert len(page.all("script")) == len(plain.all("script"))
    assert page.result()["log"]["path"] == hostile
    assert "49" not in re.findall(r"(?<![\d.])49(?![\d.])", " ".join(page.words))


def test_findings_beyond_what_anyone_reads_are_counted() -> None:
    findings = tuple(bias(start_s=float(k), end_s=k + 1.0) for k in range(250))
    text = html.render(failed_analysis(findings=findings))
    assert "50 further findings: see the JSON result." in text
    assert text.count('class="finding failed"') == 200


def test_a_title_says_the_verdict_and_the_log() -> None:
    assert "<title>Failed: 2024-05-01 copter.bin</title>" in html.render(failed_analysis())
