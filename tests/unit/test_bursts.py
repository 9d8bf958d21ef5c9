"""Errors of a moment: shorter than any regular window, longer than a reading."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.analysis import judge
from fdilog.bursts import burst_windows
from fdilog.config import Config
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
