"""An analysis in a notebook: a fragment that is harmless, a figure, and tables of pandas."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdilog.finding import Interval
from tests.reports_factory import analysis, bias, failed_analysis, pair_analysis, table

HOSTILE = "</pre><script>alert(1)</script>\"' onload=x <img src=http://a/b>\x00\u202e&lt;"


class Seen(HTMLParser):
    """Every tag and attribute of a fragment, and whether each tag is closed."""

    def __init__(self, fragment: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: set[str] = set()
        self.open: list[str] = []
        self.text = ""
        self.feed(fragment)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= {name for name, _ in attrs}
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


TAGS = {"div", "p", "strong", "table", "thead", "tbody", "tr", "th", "td", "pre", "span"}


def test_a_notebook_shows_verdict_findings_and_timeline() -> None:
    seen = Seen(failed_analysis()._repr_html_())
    assert seen.open == []
    assert set(seen.tags) == TAGS
    assert "imu1.y read 2.0 deg/s too much" in seen.text.replace("\u00a0", " ")
    assert "1.7 to 2.3" in seen.text
    assert "█" in seen.text


@pytest.mark.parametrize("made", [analysis(), failed_analysis(), pair_analysis()])
def test_the_fragment_is_small_and_needs_nothing_else(made: object) -> None:
    fragment = made._repr_html_()  # type: ignore[attr-defined]
    seen = Seen(fragment)
    assert len(fragment) < 20_000
    assert set(seen.tags) <= TAGS
    assert seen.attributes <= {"style", "role", "aria-label"}
    assert "url(" not in fragment


def test_nothing_of_a_log_becomes_markup() -> None:
    made = failed_analysis()
    channels = tuple(
        dataclasses.replace(channel, name=HOSTILE + channel.name, source=HOSTILE)
        for channel in made.table.channels
    )
    hostile = dataclasses.replace(
        made,
        log=dataclasses.replace(made.log, path=HOSTILE, vehicle={HOSTILE: HOSTILE}),
        table=dataclasses.replace(made.table, channels=channels),
        findings=(bias((f"{HOSTILE}imu1.y",), detectors=(HOSTILE,)),),
    )
    seen = Seen(hostile._repr_html_())
    assert set(seen.tags) <= TAGS
    assert seen.attributes <= {"style", "role", "aria-label"}
    assert "<script>alert(1)" in seen.text
    assert "\x00" not in seen.text
    assert "\u202e" not in seen.text


def test_of_many_findings_some_are_shown_and_the_rest_counted() -> None:
    made = failed_analysis(findings=tuple(bias(start_s=float(k)) for k in range(60)))
    seen = Seen(made._repr_html_())
    assert seen.tags.count("tr") == 21
    assert "40 more findings: see .findings_frame()" in seen.text


def test_an_analysis_of_nothing_shows_itself_too() -> None:
    empty = table().only(np.zeros(len(table().time_s), bool))
    seen = Seen(analysis(empty, evidence=(), verdict="insufficient")._repr_html_())
    assert "Nothing could be compared" in seen.text
    assert "pre" not in seen.tags


def test_in_a_console_an_analysis_is_a_line() -> None:
    assert repr(failed_analysis()) == (
        "<Analysis of 'flights/2024-05-01 copter.bin': failed, 1 finding>"
    )


def test_the_figure_shows_itself_and_is_saved_as_a_page(tmp_path: Path) -> None:
    figure = failed_analysis().plot()
    assert figure._repr_html_().startswith("<iframe ")
    figure.save(tmp_path / "plots.html")
    page = (tmp_path / "plots.html").read_text(encoding="utf-8")
    assert page.lower().startswith("<!doctype html>")
    assert "imu1.y" in page


def test_findings_are_a_frame_in_si_units_with_utc() -> None:
    frame = failed_analysis(
        findings=(
            bias(guaranteed=Interval(low=float("-inf"), high=0.5)),
            bias(("imu0.x", "imu1.x"), kind="stuck", size=None, guaranteed=None),
        )
    ).findings_frame()
    first, second = frame.to_dict("records")
    assert first["size"] == pytest.approx(np.radians(2.0))
    assert first["size_low"] == pytest.approx(np.radians(1.7))
    assert first["unit"] == "rad/s"
    assert first["guaranteed_low_rad_s"] == float("-inf")
    assert first["start_utc"] == pd.Timestamp("2024-05-01T13:05:22.3Z")
    assert np.isnan(second["size"])
    assert second["unit"] is None
    assert not second["isolated"]
    assert list(frame.explode("suspects")["suspects"]) == ["imu1.y", "imu0.x", "imu1.x"]


def test_a_frame_without_findings_has_the_columns_and_types_of_one_with() -> None:
    one, none = failed_analysis().findings_frame(), analysis().findings_frame()
    assert len(none) == 0
    assert none.dtypes.to_dict() == one.dtypes.to_dict()
    assert len(pd.concat([none, one])) == 1


@pytest.mark.parametrize("start", [None, "not a time", "9999-12-31T23:59:59Z"])
def test_a_start_that_is_no_time_is_not_a_time(start: str | None) -> None:
    made = failed_analysis()
    unknown = dataclasses.replace(made, log=dataclasses.replace(made.log, start_utc=start))
    stamps = unknown.findings_frame()["start_utc"]
    assert str(stamps.dtype) == "datetime64[us, UTC]"
    assert stamps.isna().all() == (start is None or not start[0].isdigit())


def test_channels_are_a_frame_by_name() -> None:
    made = failed_analysis()
    frame = made.channels_frame()
    assert frame.loc["imu1.y", "status"] == "failed"
    assert frame.loc["imu1.y", ["axis_x", "axis_y", "axis_z"]].tolist() == [0.0, 1.0, 0.0]
    assert list(frame.index) == list(made.table.to_pandas().columns)


def test_no_plotting_library_is_imported_before_a_figure_is_asked_for() -> None:
    code = (
        "import sys, fdilog.analysis; print([m for m in ('bokeh', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout.strip() == b"[]"


def test_a_notebook_runs(tmp_path: Path, sample_logs: Path) -> None:
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    nbclient = pytest.importorskip("nbclient", reason="nbclient is not installed")
    pytest.importorskip("ipykernel", reason="ipykernel is not installed")
    log = str(sample_logs / "two_imus_bias.bin")
    book = nbformat.v4.new_notebook(
        cells=[
            nbformat.v4.new_code_cell(
                f"import fdilog\nanalysis = fdilog.analyse({log!r})\nanalysis"
            ),
            nbformat.v4.new_code_cell("analysis.plot()"),
            nbformat.v4.new_code_cell("analysis.findings_frame()"),
        ]
    )
    nbclient.NotebookClient(book, timeout=120, resources={"metadata": {"path": tmp_path}}).execute()
    shown = [cell["outputs"][0]["data"]["text/html"] for cell in book["cells"]]
    assert "One of imu0.y and imu1.y" in shown[0]
    assert "<iframe" in shown[1]
    assert "rad/s" in shown[2]
