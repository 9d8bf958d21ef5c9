"""From a table to findings, channel status and verdict."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.decision.verdict import conclude
from fdilog.finding import Finding
from fdilog.table import ChannelTable
from tests.tables import DEG, changed, put, table_of, triads

CONFIG = Config()


def only(findings: tuple[Finding, ...]) -> Finding:
    assert len(findings) == 1, findings
    return findings[0]


def test_three_sound_triads_are_healthy() -> None:
    judged = judge(triads(3), CONFIG)
    assert judged.findings == ()
    assert set(judged.status) == {"healthy"}


def test_a_bias_among_three_is_isolated_with_its_span_and_size() -> None:
    table = changed(triads(3), "imu1.y", 20.0, 40.0, add=2.0 * DEG)
    finding = only(judge(table, CONFIG).findings)
    assert finding.kind == "bias"
    assert finding.suspects == ("imu1.y",)
    assert finding.isolated
    assert finding.start_s == pytest.approx(20.0, abs=0.5)
    assert finding.end_s == pytest.approx(40.0, abs=0.5)
    assert finding.size is not None
    assert finding.size.low < 2.0 * DEG < finding.size.high
    assert finding.size.unit == "rad/s"
    assert "parity" in finding.detectors
    assert "difference" in finding.detectors


def test_a_bias_that_lasts_through_a_turn_is_not_taken_for_misalignment() -> None:
    # In the only fast turn of the flight three deg/s look like a misalignment of 1.7 deg.
    table = triads(3, seconds=120.0)
    turning = (table.time_s > 45.0) & (table.time_s < 67.0)
    rate = table.rate_rad_s.copy()
    rate[turning, 2::3] += 100.0 * DEG
    flown = changed(table_of(table.time_s, rate), "imu1.x", 40.0, 70.0, add=3.0 * DEG)
    finding = only(judge(flown, CONFIG).findings)
    assert finding.suspects == ("imu1.x",)
    assert finding.start_s == pytest.approx(40.0, abs=0.5)
    assert finding.end_s == pytest.approx(70.0, abs=0.5)


@pytest.mark.parametrize("size_deg_s", [5.0, 50.0, 1000.0])
def test_a_large_fault_accuses_nobody_else(size_deg_s: float) -> None:
    table = changed(triads(3), "imu2.x", 20.0, 40.0, add=size_deg_s * DEG)
    judged = judge(table, CONFIG)
    assert only(judged.findings).suspects == ("imu2.x",)
    assert judged.status.count("failed") == 1
    assert "suspect" not in judged.status


def test_a_bias_on_an_aligned_pair_names_both_suspects() -> None:
    table = changed(triads(2), "imu0.z", 20.0, 40.0, add=-3.0 * DEG)
    judged = judge(table, CONFIG)
    finding = only(judged.findings)
    assert finding.suspects == ("imu0.z", "imu1.z")
    assert not finding.isolated
    assert judged.status == ("healthy", "healthy", "suspect", "healthy", "healthy", "suspect")
    # The size is the first suspect's error, if it is the one.
    assert finding.size is not None
    assert finding.size.low < -3.0 * DEG < finding.size.high


def test_two_faults_at_different_times_are_two_findings() -> None:
    table = changed(triads(3, seconds=120.0), "imu0.x", 20.0, 35.0, add=3.0 * DEG)
    table = changed(table, "imu0.x", 80.0, 95.0, add=3.0 * DEG)
    findings = judge(table, CONFIG).findings
    assert [f.suspects for f in findings] == [("imu0.x",), ("imu0.x",)]
    assert [round(f.start_s) for f in findings] == [20, 80]


def shaken(table: ChannelTable, start_s: float, end_s: float, sigma_deg_s: float) -> ChannelTable:
    """Shake every gyro by itself for a while, as an airframe at resonance does."""
    rng = np.random.default_rng(5)
    rate = table.rate_rad_s.copy()
    during = (table.time_s >= start_s) & (table.time_s < end_s)
    rate[during] += rng.normal(0.0, sigma_deg_s * DEG, rate[during].shape)
    return put(table, rate)


def test_a_bias_that_vibration_hides_for_a_while_is_one_finding() -> None:
    table = changed(triads(3, seconds=90.0), "imu0.x", 20.0, 60.0, add=3.0 * DEG)
    finding = only(judge(shaken(table, 30.0, 50.0, 12.0), CONFIG).findings)
    assert (round(finding.start_s), round(finding.end_s)) == (20, 60)
    assert finding.size is not None
    assert finding.size.low < 3.0 * DEG < finding.size.high


def test_a_bias_that_pauses_is_two_findings_though_short_windows_know_little() -> None:
    table = changed(triads(3, seconds=90.0), "imu0.x", 20.0, 35.0, add=3.0 * DEG)
    table = changed(table, "imu0.x", 45.0, 60.0, add=3.0 * DEG)
    findings = judge(shaken(table, 35.0, 45.0, 6.0), CONFIG).findings
    assert [(round(f.start_s), round(f.end_s)) for f in findings] == [(20, 35), (45, 60)]


def test_two_faults_on_different_axes_are_both_isolated() -> None:
    table = changed(triads(3), "imu0.x", 20.0, 40.0, add=3.0 * DEG)
    table = changed(table, "imu2.z", 20.0, 40.0, add=3.0 * DEG)
    findings = judge(table, CONFIG).findings
    assert {f.suspects for f in findings} == {("imu0.x",), ("imu2.z",)}


def test_three_that_all_disagree_are_all_suspects() -> None:
    table = changed(triads(3), "imu0.x", 0.0, 60.0, add=5.0 * DEG)
    table = changed(table, "imu1.x", 0.0, 60.0, add=-5.0 * DEG)
    finding = only(judge(table, CONFIG).findings)
    assert finding.suspects == ("imu0.x", "imu1.x", "imu2.x")


def test_one_triad_alone_is_insufficient_never_healthy() -> None:
    judged = judge(triads(1), CONFIG)
    assert judged.findings == ()
    assert set(judged.status) == {"insufficient"}
    assert conclude(judged.status, whole=True) == "insufficient"


def test_noise_that_hides_the_tolerance_is_undecided() -> None:
    judged = judge(triads(2, sigma_deg_s=30.0), CONFIG)
    assert judged.findings == ()
    assert set(judged.status) == {"undecided"}


def test_a_gyro_that_becomes_zero_is_dead_and_only_dead() -> None:
    table = changed(triads(3), "imu1.x", 30.0, 45.0, put=0.0)
    finding = only(judge(table, CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("dead", ("imu1.x",))
    assert finding.start_s == pytest.approx(30.0, abs=0.05)
    assert finding.end_s == pytest.approx(45.0, abs=0.05)
    assert finding.size is None


def test_a_repeated_value_is_stuck() -> None:
    table = changed(triads(2), "imu1.y", 30.0, 45.0, put=0.1)
    finding = only(judge(table, CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("stuck", ("imu1.y",))


def test_a_value_held_at_full_scale_is_saturated() -> None:
    table = changed(triads(3), "imu2.z", 30.0, 33.0, put=-2000.0 * DEG)
    finding = only(judge(table, CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("saturated", ("imu2.z",))


def test_a_coarse_gyro_at_rest_is_not_stuck() -> None:
    rng = np.random.default_rng(3)
    time_s = np.arange(3000) / 50.0
    rate = rng.normal(0, 0.02 * DEG, (3000, 6))
    step = 0.25 * DEG
    rate[1000:] += 20 * DEG * np.sin(time_s[1000:, None] * [1.0, 1.3, 0.7, 1.0, 1.3, 0.7])
    rate = np.round(rate / step) * step
    assert judge(table_of(time_s, rate), CONFIG).findings == ()


def test_a_silent_source_is_a_dropout_of_its_channels() -> None:
    table = triads(3)
    rate = table.rate_rad_s.copy()
    rows = (table.time_s >= 30.0) & (table.time_s < 31.0)
    rate[rows, 3:6] = np.nan
    findings = judge(table_of(table.time_s, rate), CONFIG).findings
    assert [f.kind for f in findings] == ["dropout"] * 3
    assert [f.suspects for f in findings] == [("imu1.x",), ("imu1.y",), ("imu1.z",)]
    size = findings[0].size
    assert size is not None
    assert size.low <= 1.0 <= size.high
    assert size.unit == "s"


def test_a_hole_in_the_whole_log_is_no_dropout_and_no_window() -> None:
    table = triads(2, seconds=120.0)
    keep = (table.time_s < 30.0) | (table.time_s > 70.0)
    judged = judge(table.only(keep), CONFIG)
    assert judged.findings == ()
    for evidence in judged.evidence:
        spans_hole = (evidence.windows.start_s < 30.0) & (evidence.windows.end_s > 70.0)
        assert not spans_hole.any()


def test_one_sample_is_undecided() -> None:
    judged = judge(triads(2).between(0.0, 0.0), CONFIG)
    assert judged.findings == ()
    assert set(judged.status) == {"undecided"}


@pytest.mark.parametrize(
    ("status", "whole", "verdict"),
    [
        (("healthy", "healthy"), True, "healthy"),
        (("healthy", "insufficient"), True, "healthy"),
        (("healthy", "healthy"), False, "undecided"),
        (("healthy", "undecided"), True, "undecided"),
        (("insufficient", "insufficient"), True, "insufficient"),
        (("insufficient", "insufficient"), False, "insufficient"),
        (("healthy", "suspect"), False, "failed"),
        (("failed", "undecided"), True, "failed"),
    ],
)
def test_the_verdict_follows_from_the_channels(
    status: tuple[str, ...], whole: bool, verdict: str
) -> None:
    assert conclude(status, whole=whole) == verdict  # type: ignore[arg-type]


def test_a_lone_gyro_that_is_read_slowly_cannot_tell_an_impulse_from_a_turn() -> None:
    table = triads(1)
    for every, expected in ((1, {"impulse"}), (13, set())):  # 50 Hz, and 3.8 Hz
        time_s, rate = table.time_s[::every], table.rate_rad_s[::every].copy()
        rate[len(rate) // 2, 0] += 300.0 * DEG
        found = judge(table_of(time_s, rate), CONFIG).findings
        assert {finding.kind for finding in found} == expected


def test_a_source_that_falls_silent_again_and_again_is_one_finding_a_channel() -> None:
    table = triads(2, seconds=120.0)
    rate = table.rate_rad_s.copy()
    rate[table.time_s % 10.0 > 8.0, 3:] = np.nan
    findings = judge(table_of(table.time_s, rate), CONFIG).findings
    assert [(f.kind, f.suspects) for f in findings] == [
        ("dropout", (f"imu1.{axis}",)) for axis in "xyz"
    ]
    assert all("12 times" in f.detail for f in findings)


@pytest.mark.parametrize("rate_hz", [1.0, 4.0, 50.0])
def test_readings_that_never_change_are_no_error(rate_hz: float) -> None:
    table = table_of(np.arange(100) / rate_hz, np.full((100, 6), 0.1))
    assert "healthy" in judge(table, CONFIG).status or judge(table, CONFIG).findings
