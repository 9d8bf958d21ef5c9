"""The worked example of [Matasov24]: two failed gyros of six, found by guaranteed estimation.

A. I. Matasov, E. V. Shestakova, Vestnik MSU ser. 1, 2024, no. 5, 77-81. All rates in deg/h.

The paper prints z_2 = 1085.35. With that reading its own result does not follow: e_2 would be
estimated at 30.89, not 20.89. The true reading h_2'q plus the fault 20 and a fluctuation of 0.10 is
1075.35, one digit away, and reproduces every figure.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from fdilog.detectors.guaranteed import guaranteed_intervals
from fdilog.detectors.one_norm import one_norm_errors
from fdilog.maths.geometry import named_axes

BOUND = 1.0
THRESHOLD = 10.0
RATE = np.array([-172.82, 604.19, -1284.63])
READINGS = np.array([-393.04, 1075.35, -612.73, -593.11, 1254.79, 761.19])
PRINTED_SECOND = 1085.35
FAULTS = np.array([0.0, 20.0, -50.0, 0.0, 0.0, 0.0])
ESTIMATES = np.array([0.0, 20.89, -51.35, 0.0, 0.0, 0.0])
GUARANTEED_ERRORS = np.array([1.00, 2.74, 2.74, 1.00, 1.00, 1.00])
LEAST_TRUE_SECOND, GREATEST_TRUE_SECOND = 1051.72, 1057.20
PRINTED = 0.0051
"""Half of the last printed digit, and a little for the digits of the readings behind it."""


def test_readings_are_those_of_the_rate_with_two_faults_and_fluctuations_within_the_bound() -> None:
    fluctuations = READINGS - named_axes("matasov") @ RATE - FAULTS
    assert np.abs(fluctuations).max() < BOUND
    assert fluctuations[1] == pytest.approx(0.10, abs=0.006)
    # Printed as +0.30.
    assert fluctuations[5] == pytest.approx(-0.30, abs=0.006)


def test_only_the_pair_two_and_three_is_feasible() -> None:
    _, _, feasible = guaranteed_intervals(READINGS[None], named_axes("matasov"), BOUND)
    pairs = list(combinations(range(1, 7), 2))
    assert [pair for pair, good in zip(pairs, feasible[0], strict=True) if good] == [(2, 3)]


def test_the_true_reading_of_the_second_gyro_lies_where_the_paper_says() -> None:
    low, high, _ = guaranteed_intervals(READINGS[None], named_axes("matasov"), BOUND)
    assert low[0, 1] == pytest.approx(LEAST_TRUE_SECOND, abs=PRINTED)
    assert high[0, 1] == pytest.approx(GREATEST_TRUE_SECOND, abs=PRINTED)


def test_error_estimates_and_guaranteed_errors_are_the_printed_ones() -> None:
    low, high, _ = guaranteed_intervals(READINGS[None], named_axes("matasov"), BOUND)
    estimates = READINGS - (high[0] + low[0]) / 2.0
    guaranteed = (high[0] - low[0]) / 2.0
    np.testing.assert_allclose(estimates, ESTIMATES, atol=PRINTED)
    np.testing.assert_allclose(guaranteed, GUARANTEED_ERRORS, atol=PRINTED)
    failed = np.abs(estimates) - guaranteed > THRESHOLD
    assert failed.tolist() == [False, True, True, False, False, False]


def test_the_printed_second_reading_contradicts_the_printed_result() -> None:
    readings = READINGS.copy()
    readings[1] = PRINTED_SECOND
    low, high, _ = guaranteed_intervals(readings[None], named_axes("matasov"), BOUND)
    # The pair (2, 3) does not look at z_2, so its interval stands and the error grows by ten.
    assert low[0, 1] == pytest.approx(LEAST_TRUE_SECOND, abs=PRINTED)
    assert readings[1] - (low[0, 1] + high[0, 1]) / 2.0 == pytest.approx(30.89, abs=PRINTED)


def test_least_squares_finds_no_fault_and_least_absolute_deviations_finds_one() -> None:
    axes = named_axes("matasov")
    squares = np.abs(READINGS - axes @ np.linalg.lstsq(axes, READINGS, rcond=None)[0])
    deviations = np.abs(one_norm_errors(READINGS[None], axes)[0])
    # Least squares: the second gyro passes, and a healthy one looks as bad as the third.
    assert squares[1] < THRESHOLD
    assert squares[3] == pytest.approx(squares[2], rel=0.1)
    # Least absolute deviations: the third gyro stands out, the second is declared free of error.
    assert deviations.argmax() == 2
    assert deviations[2] > 1.5 * np.delete(deviations, 2).max()
    assert deviations[1] == 0.0
