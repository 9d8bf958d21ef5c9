"""What the page's script is given to draw must be what the analysis says."""

from __future__ import annotations

import json

import numpy as np
import pytest

from fdilog_reports.agreement import agreement
from fdilog_reports.detectability import detectability
from fdilog_reports.losses import loss_strip
from fdilog_reports.next_steps import next_step
from fdilog_reports.plots import linked_figure, plots
from fdilog_reports.size_bar import size_bar
from fdilog_reports.view import report
from fdilog_reports.words import DEG_PER_RAD
from tests.reports_factory import (
    analysis,
    bias,
    evidence,
    failed_analysis,
    pair_analysis,
    table,
)


def test_every_channel_has_its_rate_and_every_gyro_its_residual() -> None:
    facts = json.loads(plots(failed_analysis()).facts)  # type: ignore[union-attr]
    assert [channel["name"] for channel in facts["channels"]][:2] == ["imu0.x", "imu0.y"]
    assert [group["channels"] for group in facts["groups"]] == [[0, 3, 6], [1, 4, 7], [2, 5, 8]]
    assert [[panel["channels"] for panel in g["panels"]] for g in facts["groups"]][1] == [
        [1], [4], [7],
    ]  # fmt: skip
    (finding,) = facts["findings"]
    assert (finding["start"], finding["end"], finding["channels"]) == (40.1, 60.2, [4])
    assert finding["state"] == "failed"


def test_a_pair_has_one_residual() -> None:
    facts = json.loads(plots(pair_analysis()).facts)  # type: ignore[union-attr]
    assert [len(group["panels"]) for group in facts["groups"]] == [1, 1, 1]
    assert facts["findings"][0]["state"] == "suspect"


def test_a_gyro_that_nothing_checks_is_drawn_all_the_same() -> None:
    alone = analysis(table(sources=1), evidence=(), verdict="insufficient")
    facts = json.loads(plots(alone).facts)  # type: ignore[union-attr]
    assert [(group["channels"], group["panels"]) for group in facts["groups"]] == [
        ([0], []), ([1], []), ([2], []),
    ]  # fmt: skip


def test_a_figure_needs_samples() -> None:
    empty = analysis(table(duration_s=0.0), evidence=(), verdict="insufficient")
    assert plots(empty) is None
    with pytest.raises(ValueError, match="no gyro sample"):
        linked_figure(empty)


def test_the_same_analysis_gives_the_same_figure() -> None:
    assert linked_figure(failed_analysis()).page == linked_figure(failed_analysis()).page


def test_every_detector_has_its_answer_to_every_finding() -> None:
    found = (bias(detectors=("difference", "ours"), dissent=("kalman",)), bias())
    seen = agreement(failed_analysis(findings=found))
    answers = {row.name: row.answers for row in seen.rows}
    assert seen.findings == ("1", "2")
    assert answers["ours"] == ("agrees", "silent")
    assert answers["kalman"] == ("dissents", "silent")
    assert answers["difference"] == ("agrees", "agrees")


def test_windows_of_all_lengths_are_counted() -> None:
    made = table()
    items = (evidence(made, 5.0), evidence(made, 30.0))
    (row,) = agreement(analysis(made, evidence=items)).rows
    assert row.looked == str(sum(len(item.windows) for item in items))
    assert row.accused == "0"


def test_the_smallest_error_that_shows_is_tolerance_plus_half_width() -> None:
    made = table(noise_deg_s=1.0)
    items = (evidence(made, 30.0), evidence(made, 5.0))
    seen = detectability(analysis(made, evidence=items))
    assert seen.lengths == ("5 s", "30 s")
    half_width = float(np.median(items[1].high[:, 4] - items[1].low[:, 4])) / 2.0 * DEG_PER_RAD
    assert float(seen.rows[4].smallest[0]) == pytest.approx(1.0 + half_width, rel=0.05)
    assert seen.rows[4].apart == "yes"


def test_a_pair_is_checked_but_not_told_apart_and_a_single_gyro_is_not_checked() -> None:
    row = detectability(pair_analysis()).rows[0]
    assert (row.checked, row.apart) == (True, "not from imu1.x")
    alone = detectability(analysis(table(sources=1), verdict="insufficient")).rows[0]
    assert (alone.checked, alone.apart, alone.smallest) == (False, "never checked", ())


def test_a_bar_stands_outside_the_band_where_the_interval_is_outside_the_tolerance() -> None:
    tolerance = failed_analysis().config.tolerance
    bar = size_bar(bias(deg_s=2.0, half_deg_s=0.3), tolerance)
    assert bar is not None
    band_end = float(bar.tolerated[0]) + float(bar.tolerated[1])
    assert float(bar.interval[0]) > band_end
    assert float(bar.interval[0]) < float(bar.estimate) < 100.0
    flipped = size_bar(bias(deg_s=2.0, half_deg_s=0.3), tolerance, flipped=True)
    assert flipped is not None
    assert float(flipped.estimate) == pytest.approx(100.0 - float(bar.estimate), abs=0.2)
    assert size_bar(bias(kind="drift"), tolerance) is None
    assert size_bar(bias(kind="stuck", size=None), tolerance) is None


def test_what_to_do_names_the_device_or_all_suspects() -> None:
    made = failed_analysis()
    assert "imu1 should be replaced" in next_step(made.findings[0], made)
    single = analysis(table(sources=1), findings=(bias(("imu0.x",)),), verdict="failed")
    assert "imu0.x should be replaced" in next_step(single.findings[0], single)
    pair = pair_analysis()
    assert next_step(pair.findings[0], pair).startswith("Treat all of imu0.x and imu1.x as suspect")


def test_losses_have_their_place_in_the_file() -> None:
    (span,) = loss_strip(pair_analysis())  # the other problem is a note
    assert float(span.left) == pytest.approx(1000 * 1_048_576 / 8_123_456, abs=0.1)
    assert float(span.width) == 3.0


def test_what_is_missing_is_among_the_first_facts() -> None:
    facts = {fact.label: fact.value for fact in report(pair_analysis()).facts}
    assert facts["Missing"] == "12.3 kB (12\u202f345 bytes) and 4.2 s lost"
    facts = {fact.label: fact.value for fact in report(failed_analysis()).facts}
    assert facts["Missing"] == "nothing, as far as the format can tell"
