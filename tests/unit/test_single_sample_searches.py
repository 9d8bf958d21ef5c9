"""Parity, difference, searches, Kalman, determinants and baselines, each against its definition."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from fdilog.detectors.baselines import (
    least_absolute_errors,
    least_squares_errors,
    normalised_residuals,
)
from fdilog.detectors.determinants import (
    BLOCK_SAMPLES,
    condition_search,
    determinant_search,
    smallest_singular_value_search,
)
from fdilog.detectors.difference import (
    declared_failed,
    leave_one_out_residuals,
    maximum_difference,
    rate_tolerance,
)
from fdilog.detectors.kalman import innovation_rows, kalman_search, total_chi_square
from fdilog.detectors.parity import parity_search
from fdilog.detectors.searches import mean_modulus, mean_square, mean_square_rate_deviation
from fdilog.detectors.vote import named_channel
from fdilog.maths.geometry import Floats, named_axes, parity_matrix, residual_projector

SKEWED = ("mirrored-triads", "matasov", "pentagon", "dodecahedron")
Search = Callable[[Floats, Floats], tuple[Floats, Any]]
SEARCHES = (mean_modulus, mean_square, mean_square_rate_deviation, maximum_difference)


def noisy(axes: Floats, samples: int = 40, seed: int = 0) -> Floats:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(samples, 3)) @ axes.T + 0.1 * rng.normal(size=(samples, len(axes)))


def with_fault(axes: Floats, channel: int) -> Floats:
    readings = noisy(axes)
    readings[:, channel] += 5.0
    return readings


@pytest.mark.parametrize("name", SKEWED)
def test_misfit_is_what_remains_after_taking_the_best_error_of_one_channel_out(name: str) -> None:
    axes = named_axes(name)
    readings = noisy(axes)
    projector = residual_projector(axes)
    misfit, error = parity_search(readings, axes)
    for k in range(len(axes)):
        residual = readings @ projector  # e0, one row a sample
        g = projector[k]
        alpha = residual @ g / (g @ g)
        np.testing.assert_allclose(error[:, k], alpha, rtol=1e-9, atol=1e-12)
        left = ((residual - alpha[:, None] * g) ** 2).sum(axis=1)
        np.testing.assert_allclose(misfit[:, k], left, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", SKEWED)
def test_svd_and_qr_search_alike(name: str) -> None:
    axes = named_axes(name)
    for by_svd, by_qr in zip(
        parity_search(noisy(axes), axes), parity_search(noisy(axes), axes, "qr"), strict=True
    ):
        np.testing.assert_allclose(by_svd, by_qr, atol=1e-12)


def test_a_channel_that_nothing_checks_has_no_error_and_explains_nothing() -> None:
    axes = np.vstack([np.eye(3), [[np.sqrt(0.5), np.sqrt(0.5), 0]]])
    misfit, error = parity_search(noisy(axes), axes)
    assert np.isnan(error[:, 2]).all()
    assert (misfit[:, 2] > misfit[:, 0] + 1e-12).all()


def test_an_aligned_pair_explains_a_fault_equally_well() -> None:
    axes = named_axes("aligned-triads")
    misfit, error = parity_search(with_fault(axes, 1), axes)
    np.testing.assert_allclose(misfit[:, 1], misfit[:, 4], atol=1e-12)
    np.testing.assert_allclose(error[:, 1], -error[:, 4])
    assert (misfit[:, [1, 4]] < misfit[:, [0, 2]]).all()


def test_a_reading_that_is_not_a_number_makes_no_misfit_out_of_nothing() -> None:
    axes = named_axes("pentagon")
    readings = noisy(axes, samples=2)
    readings[0, 3] = np.nan
    misfit, error = parity_search(readings, axes)
    assert np.isnan(misfit[0]).all()
    assert np.isnan(error[0]).all()
    assert np.isfinite(misfit[1]).all()


@pytest.mark.parametrize("name", SKEWED)
@pytest.mark.parametrize("search", SEARCHES)
def test_every_search_names_a_large_fault(name: str, search: Search) -> None:
    axes = named_axes(name)
    for channel in range(len(axes)):
        _, named = search(with_fault(axes, channel), axes)
        np.testing.assert_array_equal(named, channel)


@pytest.mark.parametrize("name", SKEWED)
def test_searches_are_those_of_the_pseudo_inverses_of_all_pairs(name: str) -> None:
    axes = named_axes(name)
    readings = noisy(axes, samples=7)
    n = len(axes)
    difference = np.zeros((7, n, n))
    deviation = np.zeros((7, n, n))
    for i in range(n):
        without = [k for k in range(n) if k != i]
        rate = readings[:, without] @ np.linalg.pinv(axes[without]).T
        for j in without:
            rest = [k for k in without if k != j]
            rate_of_rest = readings[:, rest] @ np.linalg.pinv(axes[rest]).T
            difference[:, i, j] = readings[:, j] - rate_of_rest @ axes[j]
            deviation[:, i, j] = ((rate - rate_of_rest) ** 2).mean(axis=1)
    count = n - 1  # the diagonal is zero
    modulus, _ = mean_modulus(readings, axes)
    np.testing.assert_allclose(modulus, np.abs(difference).sum(axis=2) / count, rtol=1e-9)
    square, _ = mean_square(readings, axes)
    np.testing.assert_allclose(square, (difference**2).sum(axis=2) / count, rtol=1e-9)
    rate_square, _ = mean_square_rate_deviation(readings, axes)
    np.testing.assert_allclose(rate_square, deviation.sum(axis=2) / count, rtol=1e-9)


def test_searches_average_over_the_channels_that_can_be_compared() -> None:
    # Without x of one triad, x of the other has nothing to be compared with.
    axes = named_axes("aligned-triads")
    readings = np.array([[3.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    statistic, _ = mean_modulus(readings, axes)
    # Left out: x. Compared: y pair (0, 0) and z pair (-1, 1).
    assert statistic[0, 0] == pytest.approx((0.0 + 0.0 + 1.0 + 1.0) / 4)
    # Left out: z. Compared: x pair (3, -3) and y pair.
    assert statistic[0, 2] == pytest.approx((3.0 + 3.0 + 0.0 + 0.0) / 4)


def test_searches_name_nobody_where_nothing_is_compared() -> None:
    axes = named_axes("aligned-triads", 3)
    for search in SEARCHES:
        statistic, named = search(noisy(axes), axes)
        assert np.isnan(statistic).all()
        assert (named == -1).all()


def test_the_prediction_is_least_squares_from_the_others() -> None:
    axes = named_axes("mirrored-triads")
    readings = noisy(axes)
    residual, predicted = leave_one_out_residuals(readings, axes)
    rate = readings[:, 1:] @ np.linalg.pinv(axes[1:]).T
    np.testing.assert_allclose(predicted[:, 0], rate @ axes[0])
    np.testing.assert_allclose(residual + predicted, readings)


def test_the_printed_tolerance_follows_bias_scale_and_timing() -> None:
    axes = named_axes("mirrored-triads")
    predicted = np.full((1, 6), 2.0)
    tolerance = rate_tolerance(
        predicted,
        axes,
        0.3,
        0.2,
        rate_of_change=np.full((1, 6), 6.0),
        time_sigma_s=0.2,
        leverage_corrected=False,
    )
    np.testing.assert_allclose(tolerance, 3.0 * np.sqrt(0.3**2 + 0.4**2 + 1.2**2))


def test_leverage_doubles_the_variance_on_mirrored_triads() -> None:
    axes = named_axes("mirrored-triads")
    predicted = np.zeros((1, 6))
    plain = rate_tolerance(predicted, axes, 0.1, 0.0, leverage_corrected=False)
    np.testing.assert_allclose(
        rate_tolerance(predicted, axes, 0.1, 0.0), plain * np.sqrt(2.0), rtol=1e-12
    )


def test_the_corrected_tolerance_is_three_deviations_of_the_residual() -> None:
    axes = named_axes("pentagon")
    rate = np.array([3.0, -1.0, 2.0])
    rng = np.random.default_rng(1)
    scale, bias = rng.normal(0, 0.02, (40_000, 5)), rng.normal(0, 0.01, (40_000, 5))
    readings = (axes @ rate) * (1 + scale) + bias
    residual, _ = leave_one_out_residuals(readings, axes)
    tolerance = rate_tolerance((axes @ rate)[None], axes, 0.01, 0.02)
    np.testing.assert_allclose(3.0 * residual.std(axis=0), tolerance[0], rtol=0.02)


def test_tolerance_survives_a_channel_that_nothing_checks() -> None:
    axes = np.vstack([np.eye(3), [[np.sqrt(0.5), np.sqrt(0.5), 0]]])
    _, predicted = leave_one_out_residuals(noisy(axes, samples=2), axes)
    tolerance = rate_tolerance(predicted, axes, 0.1, 0.01)
    np.testing.assert_array_equal(np.isnan(tolerance).all(axis=0), [False, False, True, False])


def test_only_a_candidate_beyond_its_tolerance_is_declared_failed() -> None:
    candidate = np.array([0, 1, -1])
    residual = np.array([[-2.0, 9.0], [9.0, 1.0], [np.nan, np.nan]])
    tolerance = np.full((3, 2), 1.5)
    np.testing.assert_array_equal(declared_failed(candidate, residual, tolerance), [0, -1, -1])


@pytest.mark.parametrize("name", SKEWED)
def test_innovations_are_prediction_errors_from_the_channels_before(name: str) -> None:
    axes = named_axes(name)
    readings = noisy(axes)[0]
    rows = innovation_rows(axes)
    n = len(axes)
    for shift in range(n):
        order = [(k - shift) % n for k in range(n)]
        for step in range(3, n):
            known, new = order[:step], order[step]
            spread = axes[new] @ np.linalg.inv(axes[known].T @ axes[known]) @ axes[new] + 1.0
            rate = np.linalg.lstsq(axes[known], readings[known])[0]
            expected = (readings[new] - axes[new] @ rate) / np.sqrt(spread)
            assert rows[shift, step - 3] @ readings == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("name", SKEWED)
def test_innovations_of_any_shift_add_up_to_the_square_of_the_parity_vector(name: str) -> None:
    axes = named_axes(name)
    readings = noisy(axes)
    k, _, _ = kalman_search(readings, axes, 0.1)
    square = ((readings @ parity_matrix(axes).T) ** 2).sum(axis=1) / 0.1**2
    for shift in range(len(axes)):
        np.testing.assert_allclose(k[:, shift].sum(axis=1), square, rtol=1e-8)
    np.testing.assert_allclose(total_chi_square(k), square, rtol=1e-8)


def test_a_shift_that_starts_in_a_plane_is_left_out() -> None:
    # Rows 0, 1 and 3 lie in a plane: the order 1, 2, 3 starts, the order 3, 0, 1 cannot.
    half = np.sqrt(0.5)
    axes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1.0], [half, half, 0], [half, -half, 0]])
    readings = noisy(axes)
    k, ratio, named = kalman_search(readings, axes, 1.0)
    startable = np.isfinite(ratio[0])
    assert 0 < startable.sum() < 5
    assert np.isfinite(total_chi_square(k)).all()
    assert (named >= 0).all()


def test_five_gyros_in_a_plane_give_the_filter_no_start() -> None:
    angle = np.arange(5.0)
    plane = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5)])
    k, _, named = kalman_search(noisy(plane), plane, 1.0)
    assert (named == -1).all()
    assert np.isnan(total_chi_square(k)).all()


def test_four_channels_have_no_ratio_of_innovations() -> None:
    axes = named_axes("pentagon")[:4]
    with pytest.raises(ValueError, match="five channels or more, not 4"):
        kalman_search(noisy(axes), axes, 1.0)


@pytest.mark.parametrize("search", [condition_search, smallest_singular_value_search])
def test_struck_out_singular_values_of_six_channels(search: Search) -> None:
    axes = named_axes("dodecahedron")
    readings = with_fault(axes, 4)
    statistic, named = search(readings, axes)
    assert (named == 4).mean() > 0.9
    matrix = np.column_stack([axes, readings[0]])
    for j in range(6):
        values = np.linalg.svd(np.delete(matrix, j, axis=0), compute_uv=False)
        expected = values[0] / values[-1] if search is condition_search else values[-1]
        assert statistic[0, j] == pytest.approx(expected, rel=1e-8)


def test_long_records_are_searched_block_by_block_with_the_same_answer() -> None:
    axes = named_axes("pentagon")
    readings = noisy(axes, samples=BLOCK_SAMPLES + 3)
    readings[1] = np.nan
    whole, named = smallest_singular_value_search(readings, axes)
    tail, _ = smallest_singular_value_search(readings[-5:], axes)
    np.testing.assert_array_equal(whole[-5:], tail)
    assert np.isnan(whole[1]).all()
    assert named[1] == -1


@pytest.mark.parametrize("channels", [4, 6])
def test_determinants_exist_for_five_channels_only(channels: int) -> None:
    axes = named_axes("dodecahedron")[:channels]
    with pytest.raises(ValueError, match=f"five channels, not {channels}"):
        determinant_search(noisy(axes), axes)


def test_least_squares_spreads_a_fault_and_least_absolute_deviations_does_not() -> None:
    axes = named_axes("dodecahedron")
    readings = np.random.default_rng(2).normal(size=(20, 3)) @ axes.T
    readings[:, 2] += 1.0
    spread = least_squares_errors(readings, axes)
    np.testing.assert_allclose(spread[:, 2], 0.5)
    assert (np.abs(spread[:, [0, 1, 3, 4, 5]]) > 0.2).all()
    alone = least_absolute_errors(readings, axes)
    np.testing.assert_allclose(alone, np.eye(6)[[2] * 20], atol=1e-12)


def test_normalised_residuals_of_noise_have_unit_variance() -> None:
    axes = named_axes("pentagon")
    noise = np.random.default_rng(4).normal(0.0, 0.3, (20_000, 5))
    residuals = normalised_residuals(least_squares_errors(noise, axes), axes, 0.3)
    np.testing.assert_allclose(residuals.std(axis=0), 1.0, atol=0.02)


def test_normalised_residuals_of_an_unchecked_channel_are_not_numbers() -> None:
    axes = named_axes("aligned-triads", 3)
    errors = least_squares_errors(noisy(axes), axes)
    assert np.isnan(normalised_residuals(errors, axes, 1.0)).all()


def test_votes_skip_what_was_not_compared_and_take_the_infinite() -> None:
    nan, inf = np.nan, np.inf
    statistic = np.array([[nan, 2.0, 1.0], [nan, nan, nan], [inf, nan, 3.0], [1.0, 1.0, 1.0]])
    np.testing.assert_array_equal(named_channel(statistic, largest=True), [1, -1, 0, 0])
    np.testing.assert_array_equal(named_channel(statistic, largest=False), [2, -1, 2, 0])


def test_without_noise_the_ratio_of_the_failed_channel_is_as_good_as_infinite() -> None:
    axes = named_axes("pentagon")
    readings = np.zeros((5, 5)) + np.eye(5)
    _, ratio, named = kalman_search(readings, axes, 1.0)
    np.testing.assert_array_equal(named, np.arange(5))
    np.testing.assert_array_equal(ratio > 1e20, np.eye(5, dtype=bool)[:, ::-1])
