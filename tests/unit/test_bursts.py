"""Errors of a moment: shorter than any regular window, longer than a reading."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.table import ChannelTable
from fdilog.windows.bursts import burst_windows
from tests.tables import DEG, changed, table_of, triads

CONFIG = Config().replace("detectors", use=("parity", "impulse", "dropout", "flatline", "noise"))


@pytest.mark.parametrize(("n_triads", "suspects"), [(2, {"imu0.y", "imu1.y"}), (3, {"imu1.y"})])
@pytest.mark.parametrize(
    ("length_s", "size_deg_s"),
    [
        (0.2, -200.0),
        (0.3, 40.0),
        (0.5, -200.0),
        (0.5, 20.0),
        (0.8, 40.0),
        (1.2, -200.0),
        (1.2, 20.0),
    ],
)
def test_an_error_of_a_moment_is_found_where_it_is(
    n_triads: int, suspects: set[str], length_s: float, size_deg_s: float
) -> None:
    begin_s = 31.3
    table = changed(triads(n_triads), "imu1.y", begin_s, begin_s + length_s, add=size_deg_s * DEG)
    (finding,) = judge(table, CONFIG).findings
    assert (finding.kind, set(finding.suspects)) == ("bias", suspects)
    assert finding.start_s == pytest.approx(begin_s, abs=0.05)
    assert finding.end_s == pytest.approx(begin_s + length_s, abs=0.05)
    assert finding.size is not None
    sign = 1.0 if n_triads == 3 else -1.0
    low, high = sorted([sign * finding.size.low, sign * finding.size.high])
    assert low < size_deg_s * DEG < high


def test_a_turn_of_a_moment_that_all_feel_lays_no_window() -> None:
    table = triads(3)
    rate = table.rate_rad_s.copy()
    rate[1500:1530] += 200.0 * DEG
    assert burst_windows(table_of(table.time_s, rate), CONFIG) is None


def test_a_step_and_a_drift_lay_no_window() -> None:
    table = triads(3)
    rate = table.rate_rad_s.copy()
    rate[1000:, 0] += 30.0 * DEG
    rate[:, 4] += 5.0 * DEG * table.time_s
    assert burst_windows(table_of(table.time_s, rate), CONFIG) is None


def test_vibration_that_stands_still_for_a_moment_lays_no_window_in_hours() -> None:
    for seed in range(10):
        rng = np.random.default_rng(seed)
        time_s = np.arange(0.0, 600.0, 0.02)
        folded_hz = 4.0 * np.sin(2 * np.pi * 0.013 * time_s[:, None] + rng.uniform(0, 6.3, 9))
        phase = 2 * np.pi * np.cumsum(folded_hz, axis=0) * 0.02
        rate = 20.0 * DEG * np.sin(phase + rng.uniform(0, 6.3, 9))
        rate += rng.normal(0.0, 0.3 * DEG, rate.shape)
        assert burst_windows(table_of(time_s, rate), CONFIG) is None


@pytest.mark.parametrize("sources", [2, 3])
@pytest.mark.parametrize("readings", [2, 3, 4, 5, 7])
@pytest.mark.parametrize("size_deg_s", [-30.0, 500.0])
def test_a_few_readings_that_are_off_are_an_impulse_of_their_channel(
    sources: int, readings: int, size_deg_s: float
) -> None:
    table = triads(sources)
    rate = table.rate_rad_s.copy()
    rate[1400 : 1400 + readings, 1] += size_deg_s * DEG
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("impulse", ("imu0.y",))
    assert finding.start_s == pytest.approx(28.0)
    assert finding.end_s == pytest.approx(28.0 + 0.02 * (readings - 1))
    assert finding.size is not None
    assert finding.size.low < size_deg_s * DEG < finding.size.high


def flips(rate_hz: float, late_s: float) -> ChannelTable:
    """Two gyros, one a little later than the other, of a vehicle that turns over in 0.2 s."""
    table = triads(2, seconds=300.0, rate_hz=rate_hz, sigma_deg_s=0.3)
    rate = table.rate_rad_s.copy()
    for source, delay_s in enumerate((0.0, late_s)):
        since_s = np.mod(table.time_s + 0.37 * np.floor(table.time_s / 10.0) - delay_s, 10.0)
        turning = np.clip(since_s / 0.06, 0.0, 1.0) - np.clip((since_s - 1.0) / 0.06, 0.0, 1.0)
        rate[:, 3 * source] += 400.0 * DEG * turning
    return table_of(table.time_s, rate)


@pytest.mark.parametrize(("rate_hz", "late_s"), [(50.0, 0.003), (4.0, 0.02), (200.0, 0.004)])
def test_gyros_that_follow_a_flip_at_other_instants_are_not_off(
    rate_hz: float, late_s: float
) -> None:
    table = flips(rate_hz, late_s)
    assert [f for f in judge(table, CONFIG).findings if f.kind == "impulse"] == []


def test_of_two_gyros_read_slowly_neither_is_accused_of_what_may_be_a_turn() -> None:
    table = triads(2, rate_hz=6.0)
    rate = table.rate_rad_s.copy()
    rate[150:156, 1] += 90.0 * DEG
    findings = judge(table_of(table.time_s, rate), CONFIG).findings
    assert [f for f in findings if f.isolated] == []
