"""Drift, scale, noise and impulses, each told from the others; offsets and misalignment."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.finding import Finding
from fdilog.sources.offsets import estimate_offset
from fdilog.windows.calibration import calibrate
from fdilog.windows.edges import best_ramp, best_scale, best_step
from fdilog.windows.loudness import capped_sigma
from tests.tables import DEG, changed, table_of, triads

CONFIG = Config()


def only(findings: tuple[Finding, ...]) -> Finding:
    assert len(findings) == 1, findings
    return findings[0]


def test_a_drift_is_told_from_a_step_with_its_rate_and_onset() -> None:
    table = triads(3, seconds=80.0)
    rows = (table.time_s >= 30.0) & (table.time_s < 60.0)
    ramp = np.where(rows, 0.2 * DEG * (table.time_s - 30.0), 0.0)
    rate = table.rate_rad_s.copy()
    rate[:, 4] += ramp
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("drift", ("imu1.y",))
    assert finding.start_s == pytest.approx(30.0, abs=2.0)
    assert finding.end_s == pytest.approx(60.0, abs=0.5)
    assert finding.size is not None
    assert finding.size.unit == "rad/s^2"
    assert finding.size.low < 0.2 * DEG < finding.size.high


def test_a_scale_error_is_told_from_a_bias_with_its_factor() -> None:
    table = triads(3, seconds=80.0, sigma_deg_s=0.1)
    rate = table.rate_rad_s.copy()
    rate[:, 0] *= 1.2
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("scale", ("imu0.x",))
    assert finding.size is not None
    assert finding.size.low < 1.2 < finding.size.high


def test_five_times_the_noise_is_a_finding_of_noise_and_nothing_else() -> None:
    table = triads(3, sigma_deg_s=0.5)
    rng = np.random.default_rng(4)
    rows = (table.time_s >= 20.0) & (table.time_s < 40.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 8] += rng.normal(0.0, 0.5 * DEG * np.sqrt(24.0), int(rows.sum()))
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("noise", ("imu2.z",))
    assert finding.start_s == pytest.approx(20.0, abs=3.0)
    assert finding.end_s == pytest.approx(40.0, abs=3.0)
    assert finding.size is not None
    assert finding.size.low < 5.0 < finding.size.high


@pytest.mark.parametrize("triads_", [2, 3])
@pytest.mark.parametrize("hertz", [1.5, 2.0, 3.0, 5.0, 8.0, 11.0])
def test_a_gyro_that_swings_by_itself_is_noisy_from_its_first_swing_to_the_last(
    triads_: int, hertz: float
) -> None:
    table = triads(triads_)
    rows = (table.time_s >= 20.0) & (table.time_s < 40.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 3] += 20.0 * DEG * np.sin(2 * np.pi * hertz * table.time_s[rows])
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("noise", ("imu1.x",))
    assert finding.start_s == pytest.approx(20.0, abs=0.2)
    assert finding.end_s == pytest.approx(40.0, abs=0.2)


@pytest.mark.parametrize("hertz", [0.3, 0.7])
def test_a_slow_swing_is_a_disagreement_at_rest_too(hertz: float) -> None:
    table = triads(3, seconds=120.0)
    rate = table.rate_rad_s.copy()
    resting = (table.time_s < 15.0) | (table.time_s > 105.0)
    still = np.random.default_rng(5).normal(0.0, 0.05 * DEG, (int(resting.sum()), rate.shape[1]))
    rate[resting] = still
    rate[:, 3] += 20.0 * DEG * np.sin(2 * np.pi * hertz * table.time_s)
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("disagreement", ("imu1.x",))
    assert finding.start_s < 1.0
    assert finding.end_s > 119.0


def test_what_stands_out_of_readings_that_mostly_repeat_is_capped() -> None:
    size = np.repeat([0.0, 0.1, 20.0], [46, 10, 4])  # at rest, steps of 0.1, the edges of a bias
    assert 0.0 < capped_sigma(size) < 0.3
    assert capped_sigma(np.zeros(60)) == 0.0


def test_a_turn_that_all_gyros_make_is_no_noise_of_the_one_that_reads_it_late() -> None:
    table = triads(2, seconds=120.0)
    time_s = table.time_s
    flips = (time_s % 20.0) > 15.0
    turn = np.where(flips, 200.0 * DEG * np.sin(2 * np.pi * 2.0 * time_s), 0.0)
    late = np.interp(time_s - 0.002, time_s, turn)
    rate = table.rate_rad_s.copy()
    rate[:, 0] += turn
    rate[:, 3] += late
    assert judge(table_of(time_s, rate), CONFIG).findings == ()


def test_a_bias_before_it_is_no_part_of_the_noise() -> None:
    table = changed(triads(3), "imu1.x", 10.0, 20.0, add=200.0 * DEG)
    rows = (table.time_s >= 30.0) & (table.time_s < 45.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 3] += np.random.default_rng(2).normal(0.0, 3.0 * DEG, int(rows.sum()))
    bias, noise = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (bias.kind, noise.kind) == ("bias", "noise")
    assert noise.start_s == pytest.approx(30.0, abs=0.2)
    assert noise.end_s == pytest.approx(45.0, abs=0.2)


@pytest.mark.parametrize("triads_", [2, 3])
def test_a_gyro_a_fifth_of_whose_readings_are_random_is_one_finding(triads_: int) -> None:
    table = triads(triads_)
    rng = np.random.default_rng(3)
    rate = table.rate_rad_s.copy()
    at = rng.random(len(rate)) < 0.2
    rate[at, 3] = rng.uniform(-60.0 * DEG, 60.0 * DEG, int(at.sum()))
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("impulse", ("imu1.x",))


def test_a_gyro_that_reads_little_of_a_noisy_one_has_no_scale_error() -> None:
    table = triads(2, seconds=400.0, sigma_deg_s=1.0)
    rng = np.random.default_rng(1)
    rows = (table.time_s >= 83.0) & (table.time_s < 332.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 3] += rng.normal(0.0, 50.0 * DEG, int(rows.sum()))
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("noise", ("imu1.x",))


@pytest.mark.parametrize("triads_", [1, 2, 3])
def test_single_readings_far_off_accuse_their_channel(triads_: int) -> None:
    table = triads(triads_)
    rate = table.rate_rad_s.copy()
    rate[1500, 2] += 90.0 * DEG
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("impulse", ("imu0.z",))
    assert finding.start_s == finding.end_s == pytest.approx(30.0)
    assert finding.size is not None
    assert finding.size.low < 90.0 * DEG < finding.size.high


def test_a_shock_that_every_gyro_feels_is_no_impulse() -> None:
    table = triads(2)
    rate = table.rate_rad_s.copy()
    rate[1500] += 90.0 * DEG
    assert judge(table_of(table.time_s, rate), CONFIG).findings == ()


def test_the_edges_of_a_step_are_no_impulses() -> None:
    table = changed(triads(3), "imu0.x", 20.0, 40.0, add=500.0 * DEG)
    assert [f.kind for f in judge(table, CONFIG).findings] == ["bias"]


def test_the_best_shapes_are_found_to_the_sample_without_noise() -> None:
    time_s = np.arange(3000) / 50.0
    residual = np.zeros(3000)
    residual[1003:1777] = 2.0
    step = best_step(residual)
    assert (step.start, step.stop, step.size) == (1003, 1777, pytest.approx(2.0))
    residual[1003:1777] = 0.1 * (time_s[1003:1777] - time_s[1003])
    ramp = best_ramp(residual, time_s)
    assert abs(ramp.start - 1003) <= 1
    assert ramp.stop == 1777
    assert ramp.size == pytest.approx(0.1, rel=1e-3)
    predicted = np.sin(time_s)
    residual = np.where((time_s > 20) & (time_s < 40), 0.3 * predicted, 0.0)
    scale = best_scale(residual, predicted)
    assert scale.size == pytest.approx(0.3)
    assert time_s[scale.start] == pytest.approx(20.0, abs=0.1)


def test_a_time_offset_is_found_to_a_fraction_of_a_sample() -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 120.0, 0.02)
    fine = np.arange(-1.0, 121.0, 0.001)
    kernel = np.ones(300) / 300
    smooth = np.column_stack(
        [np.convolve(rng.normal(size=len(fine)), kernel, mode="same") for _ in range(3)]
    )

    def at(stamps: np.ndarray) -> np.ndarray:
        clean = np.column_stack([np.interp(stamps, fine, column) for column in smooth.T])
        return clean + rng.normal(0.0, 0.005, clean.shape)

    found = estimate_offset("imu1", (time_s, at(time_s)), (time_s + 0.03, at(time_s)), 0.999)
    assert found is not None
    assert found.offset_s == pytest.approx(0.03, rel=0.2)
    assert found.low < 0.03 < found.high


def test_no_offset_is_claimed_of_gyros_that_do_not_move() -> None:
    rng = np.random.default_rng(2)
    time_s = np.arange(0.0, 120.0, 0.02)
    one, other = rng.normal(size=(2, len(time_s), 3))
    assert estimate_offset("imu1", (time_s, one), (time_s, other), 0.999) is None


def test_misalignment_and_scale_are_reported_and_taken_out_and_a_bias_is_not() -> None:
    table = triads(2, seconds=200.0, sigma_deg_s=0.05)
    angle = 2.0 * DEG
    rate = table.rate_rad_s.copy()
    x, y = rate[:, 3].copy(), rate[:, 4].copy()
    rate[:, 3], rate[:, 4] = x + angle * y, y - angle * x
    rate[:, 5] = 1.01 * rate[:, 5] + 0.5 * DEG
    corrected, (found,) = calibrate(table_of(table.time_s, rate), CONFIG)
    assert found.source == "imu1"
    np.testing.assert_allclose(np.abs(found.rotation_deg), [0.0, 0.0, 2.0], atol=0.2)
    np.testing.assert_allclose(found.scale, [1.0, 1.0, 1.01], atol=0.002)
    assert found.bias_rad_s[2] == pytest.approx(0.5 * DEG, abs=0.05 * DEG)
    left = corrected.rate_rad_s[:, 3:] - corrected.rate_rad_s[:, :3]
    assert np.abs(left[:, :2].mean(axis=0)).max() < 0.02 * DEG
    assert left[:, 2].mean() == pytest.approx(0.5 * DEG, abs=0.05 * DEG)


def test_a_fault_for_a_third_of_the_flight_does_not_pass_for_misalignment() -> None:
    table = changed(triads(2, seconds=120.0), "imu1.x", 20.0, 60.0, add=20.0 * DEG)
    _, (found,) = calibrate(table, CONFIG)
    assert np.abs(found.rotation_deg).max() < 0.3
    assert np.abs(np.array(found.scale) - 1.0).max() < 0.01


def test_a_gyro_beyond_the_scale_tolerance_is_left_as_it_is() -> None:
    table = triads(2, seconds=120.0, sigma_deg_s=0.05)
    rate = table.rate_rad_s.copy()
    rate[:, 3] *= 1.3
    changed_table = table_of(table.time_s, rate)
    corrected, (found,) = calibrate(changed_table, CONFIG)
    np.testing.assert_array_equal(corrected.rate_rad_s[:, 3], rate[:, 3])
    assert found.scale[0] > 1.2
    assert replace(found, note=None) != found
