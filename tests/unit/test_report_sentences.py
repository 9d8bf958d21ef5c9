"""The plain words of a report: each must be true, and exact."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fdilog
from fdilog.analysis import Part
from fdilog.config import Config
from fdilog.decision.autopilot import AutopilotNote
from fdilog.finding import Finding, Size
from fdilog.sources.gyros import SourceInfo
from fdilog.table import ChannelTable
from fdilog_reports import html
from fdilog_reports.sentences import blind_spots, finding_sentence, taken_out, verdict_sentence
from fdilog_reports.timeline import timeline
from fdilog_reports.view import report
from fdilog_reports.words import DEG_PER_RAD
from tests.reports_factory import (
    DEG,
    analysis,
    bias,
    failed_analysis,
    pair_analysis,
    status_of,
    table,
)


def size(estimate: float, low: float, high: float, unit: str, confidence: float = 0.999) -> Size:
    return Size(estimate=estimate, low=low, high=high, confidence=confidence, unit=unit)


def test_a_bias_is_said_in_degrees_with_its_interval_and_its_time() -> None:
    made = failed_analysis()
    assert verdict_sentence(made) == (
        "imu1.y read 2.0 deg/s too much (99.9 %: 1.7 to 2.3) from 40.1 s to 60.2 s."
    )


def test_a_negative_bias_is_too_little_by_a_positive_amount() -> None:
    sentence = finding_sentence(bias(deg_s=-2.0), failed_analysis())
    assert sentence.startswith("imu1.y read 2.0 deg/s too little (99.9 %: 1.7 to 2.3)")


def test_two_suspects_are_both_named_and_none_is_chosen() -> None:
    assert verdict_sentence(pair_analysis()) == (
        "One of imu0.x and imu1.x was wrong by 3.0 deg/s (99.9 %: 2.7 to 3.3) from 30.0 s to"
        " 70.0 s; this log cannot tell which."
    )


def test_where_the_size_depends_on_the_suspect_it_says_whose_it_is() -> None:
    found = bias(("imu0.x", "imu1.y"))
    assert "(99.9 %: 1.7 to 2.3) if it was imu0.x" in finding_sentence(found, pair_analysis())


@pytest.mark.parametrize(
    ("values", "said"),
    [
        (
            {"kind": "drift", "size": size(0.001, 0.0008, 0.0012, "rad/s^2")},
            "drifted upwards by 0.057 deg/s per second (99.9 %: 0.045 to 0.069)",
        ),
        (
            {"kind": "scale", "size": size(0.928, 0.915, 0.941, "1")},
            "read rates 7.2 % too small (99.9 %: 5.9 to 8.5)",
        ),
        (
            {"kind": "scale", "size": size(8.04, 7.9, 8.15, "1")},
            "read 8.04 times the true rate (99.9 %: 7.90 to 8.15)",
        ),
        (
            {"kind": "scale", "size": size(0.0175, 0.0173, 0.0177, "1")},
            "read 0.01750 times the true rate (99.9 %: 0.01730 to 0.01770)",
        ),
        (
            {"kind": "noise", "size": size(4.2, 3.1, 5.5, "1")},
            "was 4.2 times as noisy as the others (99.9 %: 3.1 to 5.5)",
        ),
        (
            {"kind": "dropout", "size": size(1.3, 1.3, 1.3, "s", 1.0)},
            "imu1.y was silent for 1.30 s while others went on from 40.1 s",
        ),
        ({"kind": "dead", "size": None}, "was dead: it read zero"),
        ({"kind": "bias", "size": None}, "by how much the log does not bound"),
        (
            {"size": size(2 * DEG, 1.7 * DEG, float("inf"), "rad/s")},
            "read 2.00 deg/s too much (99.9 %: at least 1.70)",
        ),
        (
            {"size": size(float("nan"), float("-inf"), -1.7 * DEG, "rad/s")},
            "read an unknown number of deg/s too little (99.9 %: at least 1.70)",
        ),
    ],
)
def test_every_kind_has_its_words(values: dict[str, Any], said: str) -> None:
    assert said in finding_sentence(bias(**values), failed_analysis())


def test_a_fault_that_lasts_from_end_to_end_is_said_to() -> None:
    sentence = finding_sentence(bias(start_s=0.0, end_s=119.98), failed_analysis())
    assert sentence.endswith("throughout, from 0.0 s to 120.0 s.")


def test_several_failures_are_counted_and_named() -> None:
    findings = (bias(("imu1.y",)), bias(("imu0.x", "imu1.x")), bias(("imu1.y",), start_s=80.0))
    assert verdict_sentence(pair_analysis(findings=findings)) == (
        "imu1.y failed (bias); one of imu0.x and imu1.x failed, and this log cannot tell"
        " which: 3 findings."
    )


def test_healthy_says_what_was_compared_and_within_what() -> None:
    sentence = verdict_sentence(analysis())
    assert "all 9 channels that could be compared kept within 1 deg/s" in sentence
    assert "90 %" in sentence


def test_undecided_names_the_channels_it_is_about() -> None:
    made = table()
    sentence = verdict_sentence(
        analysis(made, verdict="undecided", status=status_of(made, imu0_z="undecided"))
    )
    assert "1 of 9 compared could not be shown to keep within 1 deg/s: imu0.z" in sentence


def test_a_damaged_log_of_healthy_channels_is_undecided_because_of_what_is_lost() -> None:
    made = analysis(verdict="undecided", completeness=pair_analysis().completeness)
    assert verdict_sentence(made).endswith("but part of the log is lost.")
    (note,) = report(made).verdict.notes
    assert note == (
        "The log is not whole: 12.3 kB (12\u202f345 bytes) and 4.2 s lost."
        " What happened in the missing part is not known."
    )


def test_readings_lost_here_and_there_are_no_time_lost_and_told_as_they_are(
    tmp_path: Path,
) -> None:
    rng = np.random.default_rng(1)
    frame = table(duration_s=60.0).to_pandas()
    frame.mask(rng.random(frame.shape) < 0.1).to_csv(tmp_path / "log.csv")
    found = fdilog.analyse(tmp_path / "log.csv")
    assert (found.completeness.whole, found.completeness.seconds_lost) == (False, 0.0)
    (note,) = report(found).verdict.notes
    assert re.fullmatch(
        r"The log is not whole: imu0\.x: \d+ of [\d,\u202f]+ readings are not finite numbers,"
        r" or beyond any turn, and 8 more losses\. What happened .*",
        note,
    )


def test_of_a_log_of_seconds_it_is_said_how_short_it_is() -> None:
    said = verdict_sentence(analysis(table(duration_s=4.0), verdict="healthy"))
    assert said.endswith(" It lasts 3.98 s, in which hardly a fault would have shown.")
    assert "lasts" not in verdict_sentence(analysis(verdict="healthy"))


def test_one_gyro_alone_is_insufficient_and_why() -> None:
    made = analysis(table(sources=1), verdict="insufficient")
    assert verdict_sentence(made) == (
        "Nothing could be compared: the log holds one gyro source, imu0, and nothing to hold it"
        " against."
    )
    assert (
        "imu0.x, imu0.y and imu0.z: nothing else in this log measures along their axes, so a wrong"
        " rate would not have shown." in blind_spots(made)
    )


def test_an_attitude_that_is_no_witness_is_said_to_be_none_and_why() -> None:
    attitude = SourceInfo(
        name="att",
        topic="ATT",
        used=False,
        reason="no witness: lost, 84 deg from the accelerometers' vertical",
        rate_hz=50.0,
        samples=6000,
        derived=True,
    )
    made = analysis(table(sources=1), verdict="insufficient")
    made = replace(made, sources=(*made.sources, attitude))
    why = "he attitude, ATT, is no witness: lost, 84 deg from the accelerometers' vertical."
    assert verdict_sentence(made).endswith("nothing to hold it against; t" + why)
    assert "T" + why in blind_spots(made)


def test_a_gyro_that_only_a_model_of_the_vehicle_checks_is_said_to_be() -> None:
    config = Config().replace("observer", outputs=("imu0.z", "GPS.Spd"))
    said = blind_spots(analysis(table(sources=1), verdict="insufficient", config=config))
    assert (
        "imu0.x and imu0.y: nothing else in this log measures along their axes, so a wrong rate"
        " would not have shown." in said
    )
    assert (
        "imu0.z: nothing else in this log measures along its axis, so only the model of the vehicle"
        " could have shown a wrong rate, as its note says." in said
    )


def with_attitude() -> ChannelTable:
    """One gyro an axis, beside an attitude."""
    two = table(sources=2)
    channels = tuple(
        replace(c, name=f"att.{c.name[-1]}", source="att", derived=True)
        if c.source == "imu1"
        else c
        for c in two.channels
    )
    return replace(two, channels=channels)


def test_that_a_gyro_agrees_with_an_attitude_that_nothing_holds_decides_nothing() -> None:
    made = with_attitude()
    why = "imu0.x: held against the attitude alone, which nothing else in this log holds"
    unheld = status_of(made, imu0_x="undecided", att_x="undecided")
    for status, doubtful in ((unheld, True), (status_of(made), False)):
        found = analysis(made, status=status)
        assert any(said.startswith(why) for said in blind_spots(found)) == doubtful
        drawn = {
            lane.channel: {span.state for span in lane.spans} for lane in timeline(found).lanes
        }
        assert drawn["imu0.x"] == ({"undecided"} if doubtful else {"healthy"})
        assert drawn["imu0.y"] == {"healthy"}


def test_what_an_attitude_does_not_tell_of_a_gyro_is_said_where_no_other_gyro_checks_it() -> None:
    one, two = with_attitude(), table(sources=2)
    why = (
        ": checked by no other gyro, so noise, a scale error, or a few readings that are off by no"
        " more than a vehicle may turn would hardly have shown."
    )
    assert "imu0.x, imu0.y and imu0.z" + why in blind_spots(analysis(one))
    assert not any(why in said for said in blind_spots(analysis(two)))


def test_pairs_that_cannot_be_told_apart_are_listed() -> None:
    said = blind_spots(pair_analysis())
    assert said[0] == (
        "A fault of one looks like a fault of the other, so these are accused together, never"
        " apart: imu0.x and imu1.x; imu0.y and imu1.y; imu0.z and imu1.z."
    )


def test_the_tolerance_is_said_to_hide_smaller_errors() -> None:
    assert blind_spots(analysis())[-1].startswith("Errors below the tolerance of 1 deg/s")


def test_the_finding_is_told_with_utc_tolerance_and_guarantee() -> None:
    facts = {fact.label: fact.value for fact in report(failed_analysis()).findings[0].facts}
    assert facts["Tolerance"] == "±1 deg/s"
    assert facts["UTC"] == "2024-05-01 13:05:22.3 to 13:05:42.4 UTC"
    # No bound was stated, so it is one that was estimated.
    estimated = "as long as the bound estimated from this log holds"
    assert facts["Guaranteed"] == f"0.8 to 3.2 deg/s {estimated}"
    assert facts["Agree"] == "3: difference, guaranteed and parity"
    assert facts["Dissent"] == "none"


def test_a_guarantee_without_a_bound_says_so() -> None:
    from fdilog.finding import Interval

    found = bias(guaranteed=Interval(low=float("-inf"), high=float("inf")))
    facts = {f.label: f.value for f in report(failed_analysis(findings=(found,))).findings[0].facts}
    assert facts["Guaranteed"].startswith("unbounded")


def test_how_sharp_the_intervals_were_is_said() -> None:
    made = analysis()
    (said,) = [sentence for sentence in blind_spots(made) if sentence.startswith("Over 5 s")]
    half_widths = [DEG_PER_RAD * np.median(made.evidence[0].high - made.evidence[0].low, 0) / 2]
    least, most = f"{np.min(half_widths):.2g}", f"{np.max(half_widths):.2g}"
    assert f"within {least} to {most} deg/s, by channel" in said


def test_groups_of_suspects_are_named_as_long_as_a_sentence_holds_them() -> None:
    findings = tuple(bias((f"imu0.{axis}", f"imu1.{axis}")) for axis in "xy")
    assert verdict_sentence(pair_analysis(findings=findings)) == (
        "One of imu0.x and imu1.x, and one of imu0.y and imu1.y failed, and this log cannot tell"
        " which: 2 findings."
    )
    many = tuple(bias((f"a{k}", f"b{k}")) for k in range(5))
    assert verdict_sentence(pair_analysis(findings=many)).startswith(
        "One in each of 5 groups of channels failed"
    )


def test_a_device_that_is_mounted_otherwise_is_named_as_a_whole() -> None:
    found = Finding(
        kind="mounting",
        suspects=("imu1.x", "imu1.y", "imu1.z"),
        start_s=0.0,
        end_s=119.98,
        one_source=True,
        detail="imu1 is turned by 90 deg about z (x reads y); the attitude tells",
    )
    made = analysis(findings=(found,), verdict="failed")
    assert finding_sentence(found, made) == (
        "imu1.x, imu1.y and imu1.z read as if mounted otherwise throughout, from 0.0 s to 120.0 s:"
        " imu1 is turned by 90 deg about z (x reads y)."
    )
    both = (found, bias(("imu2.x",)))
    assert "imu1.x, imu1.y and imu1.z failed (mounting)" in verdict_sentence(
        analysis(findings=both, verdict="failed")
    )


def test_the_part_that_was_asked_for_is_a_fact_of_the_report() -> None:
    facts = {f.label: f.value for f in report(analysis(part=Part(start_s=30.0, armed=True))).facts}
    assert "(from 30 s while armed)" in facts["Analysed"]


def test_the_autopilot_is_quoted_in_every_report() -> None:
    quote = AutopilotNote(
        source="IMU[1]", gyro="imu1", what="flagged unhealthy", start_s=1.0, end_s=2.5
    )
    made = analysis(autopilot=(quote,) * 5)
    said = made.to_text()
    assert said.count("The autopilot: imu1 flagged unhealthy, from 1.0 s to 2.5 s (IMU[1]).") == 3
    assert "The autopilot: 2 more, in the reports (-o DIR) and in --json." in said
    assert made.to_markdown().count("| imu1 | flagged unhealthy |") == 5
    page = html.render(made)
    assert page.count('<td class="any wide" data-label="What">flagged unhealthy</td>') == 5
    assert 'href="#autopilot"' in page
    assert 'id="autopilot"' not in html.render(analysis())
    assert "autopilot" not in analysis().to_text()


def test_intervals_say_what_was_taken_out_of_the_readings_beside_them() -> None:
    made = failed_analysis()
    assert taken_out(made) == ""
    turned = replace(made.findings[0], kind="mounting", size=None, detectors=("mounting",))
    doubled = replace(made.findings[0], kind="scale", detectors=("gains",))
    made = replace(made, findings=(turned, doubled))
    assert taken_out(made) == "; mounting and scale error taken out"
    assert "; mounting and scale error taken out)" in html.render(made)
