"""The test for drift over flights: exact where it is counted, quiet without drift, sure with it."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from scipy.stats import kendalltau, theilslopes

from fdilog.campaign.trend import FEWEST, SIGNIFICANCE, Trend, holm, trend


def of(y: list[float] | np.ndarray) -> Trend:
    found = trend(np.arange(float(len(y))), np.asarray(y, float))
    assert found is not None
    return found


def test_the_p_value_counts_the_orders_that_are_as_extreme() -> None:
    observed = of([0, 2, 1, 3, 5, 4])
    s = [
        abs(sum(np.sign(b - a) for k, a in enumerate(order) for b in order[k + 1 :]))
        for order in permutations(range(6))
    ]
    own = abs(observed.tau) * 15
    assert observed.p_value == pytest.approx(np.mean(np.array(s) >= own - 1e-9))


@pytest.mark.parametrize("n", [8, 40, 90])
def test_p_and_tau_agree_with_scipy(n: int) -> None:
    rng = np.random.default_rng(n)
    y = rng.normal(size=n) + 0.02 * np.arange(n)
    expected = kendalltau(np.arange(n), y, method="exact" if n <= 60 else "asymptotic")
    found = of(y)
    assert found.tau == pytest.approx(expected.statistic)
    assert found.p_value == pytest.approx(expected.pvalue, rel=0.05 if n > 60 else 1e-9)


def test_the_slope_agrees_with_scipy_and_its_interval_holds_the_truth() -> None:
    rng = np.random.default_rng(4)
    held = 0
    for _ in range(200):
        y = 0.3 * np.arange(25.0) + rng.normal(size=25)
        found = of(y)
        assert found.slope == pytest.approx(theilslopes(y, np.arange(25.0))[0])
        held += found.low <= 0.3 <= found.high
    assert held >= 180  # 95 % of 200, less three standard deviations


def test_series_without_drift_are_called_drifting_no_oftener_than_promised() -> None:
    rng = np.random.default_rng(7)
    alarms = 0
    for _ in range(100):
        p_values = [of(rng.normal(size=20)).p_value for _ in range(18)]
        alarms += min(holm(p_values)) < SIGNIFICANCE
    assert alarms <= 4  # 1 expected; five or more happen once in 250 such tests


def test_one_outlier_is_no_drift_and_a_slow_rise_is() -> None:
    rng = np.random.default_rng(8)
    flat = 0.01 * np.cos(np.arange(20.0) ** 2)
    flat[-1] = 5.0
    assert of(flat).p_value > 0.05
    assert of(0.01 * np.arange(20.0) + rng.normal(scale=0.02, size=20)).p_value < 1e-4


def test_ties_and_constants_are_no_drift() -> None:
    assert of([1.0] * 12).p_value == 1.0
    expected = kendalltau(np.arange(12), [1, 1, 2, 2, 1, 3, 2, 3, 3, 4, 3, 4], method="asymptotic")
    found = of([1, 1, 2, 2, 1, 3, 2, 3, 3, 4, 3, 4])
    assert found.p_value == pytest.approx(expected.pvalue, rel=0.35)  # ours corrects continuity
    assert found.p_value >= expected.pvalue


def test_few_flights_give_no_answer() -> None:
    assert trend(np.arange(float(FEWEST - 1)), np.arange(float(FEWEST - 1))) is None


def test_holm_never_lowers_a_p_value_and_keeps_their_order() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []


def test_a_long_series_is_tested_on_part_of_it() -> None:
    rng = np.random.default_rng(9)
    found = of(1e-3 * np.arange(4000.0) + rng.normal(size=4000))
    assert found.flights == 4000
    assert found.slope == pytest.approx(1e-3, rel=0.1)
    assert found.p_value < 1e-6


def test_flights_that_all_have_one_date_show_no_trend() -> None:
    assert trend(np.full(12, 3.0), np.arange(12.0)) is None
    assert trend(np.array([3.0] * 11 + [4.0]), np.arange(12.0)) is not None
