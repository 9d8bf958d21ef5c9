"""The estimator of what a windowed mean knows, away from its statistics."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.maths import noise
from fdilog.maths.noise import moving_mean, quantisation_step, robust_sigma, windowed_mean
from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]


@pytest.fixture
def windows() -> Floats:
    """Two hundred windows of 50 samples: a wandering series, a white one, and one of both."""
    rng = np.random.default_rng(7)
    x = rng.standard_normal((200, 50, 3))
    x[:, :, 0] = np.cumsum(x[:, :, 0], axis=1) * 0.3
    x[:, :, 2] += 2.0 * x[:, :, 0]
    return x


def test_the_mean_is_the_plain_mean(windows: Floats) -> None:
    np.testing.assert_allclose(windowed_mean(windows).mean, windows.mean(axis=1), atol=1e-12)


def test_the_covariance_is_symmetric_and_no_combination_has_negative_variance(
    windows: Floats,
) -> None:
    covariance = windowed_mean(windows).covariance
    np.testing.assert_allclose(covariance, np.swapaxes(covariance, 1, 2), rtol=1e-9)
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_a_linear_map_of_the_series_maps_the_answer(windows: Floats) -> None:
    mixing = np.array([[1.0, 0.5, -2.0], [0.0, 3.0, 1.0], [1.0, 0.2, 0.1]])
    before, after = windowed_mean(windows), windowed_mean(windows @ mixing)
    np.testing.assert_allclose(after.mean, before.mean @ mixing, atol=1e-12)
    np.testing.assert_allclose(after.covariance, mixing.T @ before.covariance @ mixing, rtol=1e-5)
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-5)


def test_series_that_depend_on_one_another_are_answered_as_their_sources(windows: Floats) -> None:
    to_six = np.random.default_rng(1).standard_normal((3, 6))
    before, after = windowed_mean(windows), windowed_mean(windows @ to_six)
    expected = to_six.T @ before.covariance @ to_six
    np.testing.assert_allclose(after.covariance, expected, atol=1e-6 * np.abs(expected).max())
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-4)


def test_a_constant_added_changes_the_mean_alone(windows: Floats) -> None:
    before, after = windowed_mean(windows), windowed_mean(windows + 5.0)
    np.testing.assert_allclose(after.mean, before.mean + 5.0)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-8)
    np.testing.assert_allclose(after.dof, before.dof, rtol=1e-8)


def test_blocks_and_views_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.random.default_rng(2).standard_normal((400, 2))
    view = np.moveaxis(np.lib.stride_tricks.sliding_window_view(x, 40, axis=0)[::20], 2, 1)
    whole = windowed_mean(view.copy())
    monkeypatch.setattr(noise, "BLOCK_BYTES", 1)
    piecewise = windowed_mean(view)
    np.testing.assert_allclose(piecewise.mean, whole.mean, atol=1e-12)
    np.testing.assert_allclose(piecewise.covariance, whole.covariance, rtol=1e-9)
    np.testing.assert_allclose(piecewise.dof, whole.dof, rtol=1e-9)


@pytest.mark.parametrize("n_samples", [1, 2])
def test_fewer_than_three_samples_give_no_interval(n_samples: int) -> None:
    answer = windowed_mean(np.ones((4, n_samples, 2)))
    assert np.all(answer.mean == 1.0)
    assert np.all(answer.dof == 0.0)
    assert np.all(np.isinf(answer.covariance[:, [0, 1], [0, 1]]))
    assert np.all(np.isinf(answer.half_width([1.0, -1.0], 0.5)))
    assert np.all(np.isinf(answer.half_width([1.0, 0.0], 0.5)))


def test_no_samples_and_no_windows_are_answered_without_a_fuss() -> None:
    assert np.all(windowed_mean(np.ones((3, 0, 2))).dof == 0.0)
    assert windowed_mean(np.ones((0, 10, 2))).covariance.shape == (0, 2, 2)


@pytest.mark.parametrize("n_samples", range(3, 25))
def test_a_short_window_claims_no_more_degrees_of_freedom_than_it_has(n_samples: int) -> None:
    x = np.random.default_rng(n_samples).standard_normal((500, n_samples, 1))
    dof = windowed_mean(x).dof
    assert dof.max() <= (n_samples - 1) * (1.0 + 1e-6)
    assert dof.min() > 0.3


def test_one_wandering_window_has_fewer_degrees_of_freedom_than_a_white_one() -> None:
    rng = np.random.default_rng(3)
    white = rng.standard_normal((200, 125, 1))
    wandering = np.cumsum(white, axis=1)
    assert np.median(windowed_mean(white).dof) > 30.0
    assert np.median(windowed_mean(wandering).dof) < 12.0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_not_finite_spoils_its_own_window_alone(bad: float) -> None:
    x = np.random.default_rng(4).standard_normal((5, 30, 2))
    clean = windowed_mean(x)
    x[2, 11, 1] = bad
    answer = windowed_mean(x)
    others = [0, 1, 3, 4]
    assert answer.dof[2] == 0.0
    assert np.isinf(answer.half_width([1.0, 0.0], 0.95)[2])
    np.testing.assert_allclose(answer.covariance[others], clean.covariance[others], rtol=1e-9)
    np.testing.assert_allclose(answer.mean[others], clean.mean[others], rtol=1e-9)


def test_a_channel_that_does_not_move_has_no_noise_and_leaves_the_others_theirs() -> None:
    x = np.random.default_rng(5).standard_normal((6, 40, 2))
    alone = windowed_mean(x[:, :, :1])
    x[:, :, 1] = 0.25
    answer = windowed_mean(x)
    np.testing.assert_allclose(answer.covariance[:, 1, 1], 0.0, atol=1e-25)
    np.testing.assert_allclose(answer.covariance[:, 0, 0], alone.covariance[:, 0, 0], rtol=1e-6)
    still = windowed_mean(np.zeros((2, 40, 3)))
    assert np.all(still.covariance == 0.0)
    assert np.all(still.half_width([1.0, 1.0, 1.0], 0.999) == 0.0)


def test_samples_without_a_series_axis_are_refused() -> None:
    with pytest.raises(ValueError, match=r"\(n_windows, n_samples, q\), not \(5, 3\)"):
        windowed_mean(np.zeros((5, 3)))


def test_an_hour_at_200_hz_needs_little_memory() -> None:
    x = np.random.default_rng(6).standard_normal((720_000, 6))
    view = np.lib.stride_tricks.sliding_window_view(x, 6000, axis=0)[::3000]
    tracemalloc.start()
    windowed_mean(np.moveaxis(view, 2, 1))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 60e6


@pytest.mark.parametrize(
    ("dof", "confidence", "quantile"),
    [  # from printed tables of the t distribution
        (1, 0.95, 12.706),
        (4, 0.999, 8.610),
        (10, 0.95, 2.228),
        (30, 0.99, 2.750),
        (1e12, 0.95, 1.960),
        (np.inf, 0.999, 3.291),
        (5, 0.0, 0.0),
    ],
)
def test_student_quantiles_are_those_of_the_tables(
    dof: float, confidence: float, quantile: float
) -> None:
    assert student_quantile(dof, confidence) == pytest.approx(quantile, abs=6e-4)


def test_no_degrees_of_freedom_give_an_infinite_quantile() -> None:
    assert student_quantile([0.0, 3.0, 0.0], 0.95).tolist() == [
        np.inf,
        pytest.approx(3.1824463),
        np.inf,
    ]


@pytest.mark.parametrize("confidence", [0.0, 0.95, 0.999, 1 - 1e-7])
def test_quantiles_of_many_windows_are_those_of_each(confidence: float) -> None:
    dof = np.random.default_rng(8).uniform(0.5, 200.0, (3, 5000))
    many = student_quantile(dof, confidence)
    few = student_quantile(dof[1, :50], confidence)
    np.testing.assert_allclose(many[1, :50], few, rtol=1e-5)


@pytest.mark.parametrize("confidence", [1.0, -0.1, np.nan])
def test_a_confidence_that_is_no_probability_is_refused(confidence: float) -> None:
    with pytest.raises(ValueError, match="confidence must be in"):
        student_quantile(5.0, confidence)


def test_the_moments_of_log_chi_square_are_digamma_and_trigamma() -> None:
    from scipy.special import digamma, polygamma

    dof = np.geomspace(0.05, 1e4, 60)
    mean, variance = noise._log_chi_square(dof)
    np.testing.assert_allclose(mean, digamma(dof / 2) - np.log(dof / 2), atol=1e-9)
    np.testing.assert_allclose(variance, polygamma(1, dof / 2), rtol=1e-7)
    back, shift = noise._inverse_chi_square(variance)
    np.testing.assert_allclose(back, dof, rtol=1e-5)
    np.testing.assert_allclose(shift, mean, rtol=1e-4, atol=1e-8)


def test_every_shape_is_one_at_frequency_zero_or_leads_there() -> None:
    inverse, log_det, prior = noise._shapes(125, 124)
    assert prior.sum() == pytest.approx(1.0)
    assert prior[0] == noise.WHITE_PRIOR
    assert np.all(inverse[0] == 1.0)
    np.testing.assert_allclose(log_det, -np.log(inverse).sum(axis=1))


def test_robust_sigma_is_the_sigma_of_the_bulk() -> None:
    x = np.random.default_rng(9).normal(3.0, 0.5, (20_001, 2))
    x[:500, 0] = 1e6
    x[::3, 1] = np.nan
    np.testing.assert_allclose(robust_sigma(x), 0.5, rtol=0.05)
    assert robust_sigma(x, axis=None).shape == ()


def test_robust_sigma_of_nothing_is_not_a_number() -> None:
    answer = robust_sigma(np.array([[1.0, np.nan], [2.0, np.nan], [np.inf, np.nan]]))
    assert answer[0] == pytest.approx(0.5 * noise.NORMAL_CONSISTENCY)
    assert np.isnan(answer[1])
    assert np.isnan(robust_sigma(np.array([])))


LEAST_COUNT = np.deg2rad(2000.0 / 32768.0)
"""A 16-bit gyro of +-2000 deg/s. [rad/s]"""


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_the_step_of_a_16_bit_gyro_is_found(kind: type[np.floating]) -> None:
    counts = np.random.default_rng(10).integers(-32768, 32768, 30_000)
    assert quantisation_step((counts * LEAST_COUNT).astype(kind)) == pytest.approx(
        LEAST_COUNT, rel=1e-6
    )


def test_the_step_is_found_between_levels_that_skip_it() -> None:
    levels = np.array([-9, -6, -4, 0, 2, 5, 8, 11]) * 0.01
    assert quantisation_step(levels) == pytest.approx(0.01)


def test_damaged_records_do_not_hide_the_step() -> None:
    counts = np.random.default_rng(11).integers(-300, 300, 5000)
    x = np.append(counts * 0.00106, [np.nan, -30945.3, np.inf])
    assert quantisation_step(x.astype(np.float32)) == pytest.approx(0.00106, rel=1e-5)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("n_samples", [6, 20, 2000, 50_000])
def test_continuous_readings_have_no_step(kind: type[np.floating], n_samples: int) -> None:
    rng = np.random.default_rng(12)
    found = [quantisation_step(rng.standard_normal(n_samples).astype(kind)) for _ in range(5)]
    assert found == [0.0] * 5


@pytest.mark.parametrize("x", [[], [0.0] * 50, [1.0, 1.5, np.nan], [np.nan]])
def test_too_few_levels_tell_no_step(x: list[float]) -> None:
    assert quantisation_step(x) == 0.0


def test_a_long_window_is_looked_at_through_the_same_cosines() -> None:
    samples = np.random.default_rng(3).standard_normal((2001, 3)) + 4.0
    by_cosines = noise._cosines(len(samples), 60) @ samples
    np.testing.assert_allclose(noise._by_fourier(samples, 60), by_cosines, atol=1e-11)


@pytest.mark.parametrize(("n", "width"), [(100, 7), (100, 8), (5, 5), (30, 1)])
def test_a_moving_mean_is_a_convolution(n: int, width: int) -> None:
    values = np.random.default_rng(4).standard_normal(n)
    convolved = np.convolve(values, np.ones(width) / width, mode="same")
    np.testing.assert_allclose(moving_mean(values, width), convolved, atol=1e-14)


def test_a_component_that_is_known_badly_widens_what_it_is_a_part_of(windows: Floats) -> None:
    looks = windowed_mean(windows)
    reach = looks.quantile(np.eye(3), 0.999)
    each = student_quantile(looks.part_dof, 0.999)
    assert (reach >= each.min(axis=1)[:, None] - 1e-9).all()
    assert (reach <= each.max(axis=1)[:, None] + 1e-9).all()
    # The white series is known far better than the one that wanders.
    assert np.median(reach[:, 1]) < np.median(reach[:, 0])
    white = windowed_mean(windows[:, :, 1:2])
    np.testing.assert_allclose(
        white.quantile(np.ones((1, 1)), 0.999)[:, 0], student_quantile(white.dof, 0.999)
    )
