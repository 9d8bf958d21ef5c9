"""What the reports of a campaign say, and that nothing in a log can speak in them."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import html
import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from fdilog.campaign.progress import summary_lines
from fdilog.finding import Size
from fdilog_reports import campaign_html, campaign_json, campaign_junit, campaign_markdown
from fdilog_reports.campaign_view import campaign_view
from tests.campaign_factory import campaign, finding, large, log, series

HOSTILE = "</script><script>alert(1)</script>\"'&<img src=x onerror=alert(2)>\u202e\x00|`"
MOST_BYTES = 5_000_000


def rows_of(page: str) -> dict[str, list[list[object]]]:
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert match is not None
    found: dict[str, list[list[object]]] = json.loads(match[1])
    return found


def test_the_page_begins_with_the_answer_and_what_to_look_at() -> None:
    made = campaign(
        log("ann/1.bin", verdict="failed", start_utc="2024-05-01T10:00:00Z",
            channels=(("imu1.y", "failed"), ("imu0.y", "healthy")),
            findings=(finding("bias", "imu1.y"),)),
        log("ann/2.bin", channels=(("imu1.y", "healthy"), ("imu0.y", "healthy"))),
        log("bob/3.bin", "bob", None, error_kind="unreadable", error="the file is empty"),
        log("bob/4.bin", "bob", "undecided", whole=False, bytes_lost=12, seconds_lost=1.5),
    )  # fmt: skip
    view = campaign_view(made)
    assert view.headline == "A gyro failed in 1 of 3 analysed logs, on 1 vehicle."
    assert view.attention[0].vehicle == "ann"
    assert view.attention[0].text == ("imu1.y failed in 1 of 2 flights (bias); last on 2024-05-01")
    assert view.attention[1].text == "1 log could not be analysed: not readable."
    assert view.attention[2].text.startswith("1 log is not whole: 12 bytes")
    assert [row.vehicle for row in view.matrix] == ["ann"]
    cells = dict(zip(view.channels, view.matrix[0].cells, strict=True))
    assert cells["imu1.y"] is not None
    assert (cells["imu1.y"].mark, cells["imu1.y"].text) == ("failed", "1 of 2")
    states = [view.table["states"][row[0]][0] for row in view.table["rows"]]
    assert states == ["failed", "not analysed", "undecided", "healthy"]


@pytest.mark.parametrize(
    ("verdicts", "state"),
    [
        (["healthy", "healthy"], "healthy"),
        (["healthy", "undecided"], "undecided"),
        (["healthy", "failed", None], "failed"),
        ([None, None], "insufficient"),
    ],
)
def test_the_headline_is_the_worst_that_matters(verdicts: list[str | None], state: str) -> None:
    assert (
        campaign_view(campaign(*[log(f"{k}", verdict=v) for k, v in enumerate(verdicts)])).mark
        == state
    )


def test_a_drifting_sensor_is_named_before_it_fails_and_a_steady_one_is_not() -> None:
    rng = np.random.default_rng(3)
    steady = series(0.02 * rng.normal(size=30), channel="imu0.x")
    rising = series(0.02 * rng.normal(size=30) + 0.015 * np.arange(30.0), channel="imu2.z")
    made = campaign(log("ann/1.bin"), all_series=(steady, rising))
    view = campaign_view(made)
    assert view.mark == "suspect"
    (item,) = view.attention
    assert item.text.startswith("bias of imu2.z: Drifts by +0.")
    # 0.015 deg/s every third day from nothing: 1 deg/s after 200 days, in July.
    assert "reaches 1 deg/s about 2024-07" in item.text
    assert [group.title for group in view.trends] == [
        "Drifting: 1 series",
        "No drift shown: 1 series",
    ]
    assert [group.folded for group in view.trends] == [False, True]
    assert "No drift shown" in view.trends[1].panels[0].words
    page = campaign_html.render(made)
    assert '<a href="#trends">Show trends</a>' in page
    assert 'id="trends"' in page


def test_series_that_are_too_short_to_test_are_folded_away() -> None:
    made = campaign(log("ann/1.bin"), all_series=(series(np.arange(3.0)), series(np.ones(1))))
    (group,) = campaign_view(made).trends
    assert (group.title, group.folded) == ("Fewer than 5 flights, not tested: 1 series", True)


def test_channels_that_failed_alike_are_one_phrase() -> None:
    states = {f"imu{k}.{axis}": "failed" for k in range(2) for axis in "xyz"}
    states |= {"imu1.x": "healthy", "imu2.x": "insufficient"}
    dead = finding("dead", *[name for name, state in states.items() if state == "failed"])
    made = campaign(
        log("1.bin", verdict="failed", channels=tuple(states.items()), findings=(dead,)),
        log("2.bin", channels=tuple((name, "insufficient") for name in states)),
    )
    (item,) = campaign_view(made).attention
    assert item.text == "all of imu0, imu1.y and imu1.z failed in 1 of 1 flight (dead)"


def test_flights_in_which_a_gyro_is_one_of_several_suspects_are_counted_by_themselves() -> None:
    sure, pair = finding("bias", "imu1.y"), finding("bias", "imu0.y", "imu1.y")
    one_of_two = (("imu0.y", "suspect"), ("imu1.y", "suspect"))
    healthy = (("imu0.y", "healthy"), ("imu1.y", "healthy"))
    failed = (("imu0.y", "healthy"), ("imu1.y", "failed"))
    made = campaign(
        log("1.bin", verdict="failed", channels=failed, findings=(sure,)),
        log("2.bin", verdict="failed", channels=failed, findings=(sure,)),
        log("3.bin", verdict="failed", channels=one_of_two, findings=(pair,)),
        log("4.bin", channels=healthy),
    )
    view = campaign_view(made)
    assert view.attention[0].text == (
        "imu1.y failed in 2 of 4 flights, suspect in 1 more (bias);"
        " imu0.y suspect in 1 of 4 flights (bias)"
    )
    cells = dict(zip(view.channels, view.matrix[0].cells, strict=True))
    assert [cells[name].text for name in ("imu0.y", "imu1.y")] == ["1 of 4", "2 + 1 of 4"]
    told = list(summary_lines(made, Path("out")))
    assert told[1] == (
        "  failed: ann: imu1.y in 2 flights (suspect in 1 more), imu0.y suspect in 1 flight"
    )


def test_a_flight_that_is_there_twice_counts_once() -> None:
    logs = (
        log("a.bin", channels=(("imu0.x", "healthy"),)),
        log("copy of a.bin", channels=(("imu0.x", "healthy"),), sha256=b"a.bin".hex()),
        log("b.csv", channels=(("left.x", "healthy"),)),
        log("unread.bin", verdict=None, duration_s=None),
    )
    made = campaign(*logs)
    assert [one.path for one in made.flights] == ["copy of a.bin", "b.csv"]
    view = campaign_view(made)
    assert ("Flight time", "2 min") in view.facts
    assert [row.flights for row in view.matrix] == ["2"]


def test_the_worst_failure_is_first_and_its_size_is_told() -> None:
    suspected = finding("bias", "imu0.x", "imu1.x")
    short = dataclasses.replace(finding("bias", "imu1.y"), end_s=2.0)
    large_one = Size(estimate=-0.2, low=-0.21, high=-0.19, confidence=0.999, unit="rad/s")
    longer = dataclasses.replace(finding("bias", "imu1.y"), end_s=50.0, size=large_one)
    sure = (("imu1.y", "failed"),)
    made = campaign(
        log("1.bin", verdict="failed", findings=(suspected,), channels=(("imu0.x", "suspect"),)),
        log("2.bin", verdict="failed", findings=(short,), channels=sure),
        log("3.bin", verdict="failed", findings=(short, longer), channels=sure),
    )
    view = campaign_view(made)
    told = [(row[2], row[7]) for row in view.table["rows"]]
    assert told == [
        ("3.bin", "bias imu1.y, up to 11.5 deg/s"),
        ("2.bin", "bias imu1.y, 2.9 deg/s"),
        ("1.bin", "bias imu0.x or imu1.x, 2.9 deg/s"),
    ]
    assert [listed.path for listed in view.failed] == ["3.bin", "2.bin", "1.bin"]


def test_a_witness_that_is_not_decided_is_no_open_question_of_a_gyro() -> None:
    channels = (("imu0.x", "healthy"), ("att.x", "undecided"))
    of_witness = log("a", verdict="undecided", channels=channels, derived=frozenset(["att.x"]))
    of_gyro = log("b", verdict="undecided", channels=(("imu0.x", "undecided"),))
    told = [row[7] for row in campaign_view(campaign(of_witness, of_gyro)).table["rows"]]
    assert told == ["part of the log is lost", "not decided: imu0.x"]


def test_nothing_in_a_log_becomes_markup_or_script() -> None:
    made = campaign(
        log(f"a/{HOSTILE}.bin", HOSTILE, "failed", channels=((HOSTILE, "failed"),),
            findings=(finding("bias", HOSTILE),)),
        log("b.bin", HOSTILE, None, error_kind="unreadable", error=HOSTILE),
        all_series=(series(np.arange(9.0), HOSTILE, HOSTILE),),
    )  # fmt: skip
    page = campaign_html.render(made)
    assert "<img" not in page
    assert page.count("<script") == 2
    assert rows_of(page)["rows"]
    markdown = campaign_markdown.render(made)
    assert re.search(r"(?<!\\)<", markdown) is None
    suite = ET.fromstring(campaign_junit.render(made))  # noqa: S314  our own text
    assert len(list(suite.iter("testcase"))) == 2
    assert json.loads(campaign_json.render(made))["logs"][0]["path"].startswith("a/</script>")


def test_the_policy_of_the_page_lets_its_own_script_and_style_in_and_nothing_else() -> None:
    page = campaign_html.render(campaign(log("a.bin")))
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert policy is not None
    for tag in ("script", "style"):
        inside = re.search(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        assert inside is not None
        digest = base64.b64encode(hashlib.sha256(inside[1].encode()).digest()).decode()
        assert f"{tag}-src 'sha256-{digest}'" in html.unescape(policy[1])
    assert "default-src 'none'" in policy[1]
    assert not re.search(r"\s(style|on\w+)=", page)
    assert not re.search(r'(src|href)="(?!#|audit\.|logs/)', page)


def test_ten_thousand_logs_fit_in_five_megabytes_with_a_row_each() -> None:
    page = campaign_html.render(large(10_000))
    assert len(page.encode()) <= MOST_BYTES
    assert len(rows_of(page)["rows"]) == 10_000


def test_the_same_campaign_gives_the_same_bytes() -> None:
    for report in (campaign_html, campaign_json, campaign_junit, campaign_markdown):
        assert report.render(large(200)) == report.render(large(200))


def test_junit_keeps_to_the_schema_that_ci_servers_read() -> None:
    """Elements and attributes of the schema of Jenkins, which GitLab and others follow."""
    known = {
        "testsuites": {"name", "time", "tests", "failures", "disabled", "errors"},
        "testsuite": {
            "name", "tests", "failures", "errors", "time", "disabled", "skipped", "timestamp",
            "hostname", "id", "package",
        },
        "testcase": {"name", "assertions", "time", "classname", "status"},
        "error": {"type", "message"}, "failure": {"type", "message"}, "skipped": {"message"},
    }  # fmt: skip
    logs = [
        log("a", verdict="failed", findings=(finding("bias", "imu0.x"),)),
        log("b", verdict=None, error_kind="unreadable", error="cut"),
        log("c", verdict="undecided", whole=False, bytes_lost=1),
        log("d", duration_s=None),
    ]
    root = ET.fromstring(campaign_junit.render(campaign(*logs)))  # noqa: S314  our own text
    assert root.tag == "testsuites"
    for element in root.iter():
        assert set(element.attrib) <= known[element.tag], element.tag
    (suite,) = root
    told = [int(suite.attrib[name]) for name in ("tests", "failures", "errors", "skipped")]
    assert told == [4, 1, 1, 1]
    assert [[child.tag for child in case] for case in suite] == [
        ["failure"], ["error"], ["skipped"], [],
    ]  # fmt: skip
