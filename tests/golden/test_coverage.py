"""Counted: how often the interval of a windowed mean covers the true mean.

The bounds are what the documentation promises (docs/intervals.md); 20 000 windows make the standard
error of a coverage of 95 % 0.15 %, 100 000 windows that of one miss in 1000 a tenth of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]
N_WINDOWS = 20_000


def coloured(innovations: Floats, rho: float) -> Floats:
    """Stationary first-order autoregression (windows, samples) from unit innovations."""
    n = innovations.shape[1]
    lag = np.abs(np.arange(n)[:, None] - np.arange(n))
    return np.asarray(innovations @ np.linalg.cholesky(rho**lag / (1.0 - rho**2)).T)


def autoregressive(rho: float, n: int, n_windows: int = N_WINDOWS, seed: int = 11) -> Floats:
    return coloured(np.random.default_rng(seed).standard_normal((n_windows, n)), rho)


def autoregressive_plus_white(rho: float, n: int, n_windows: int = N_WINDOWS) -> Floats:
    """Both of equal variance."""
    white = np.random.default_rng(12).standard_normal((n_windows, n))
    return white + float(np.sqrt(1.0 - rho**2)) * autoregressive(rho, n, n_windows)


def misses(x: Floats, confidence: float, combination: Floats | None = None) -> float:
    """Share of the windows (windows, samples[, series]) whose interval leaves out the mean, 0."""
    series = x[:, :, None] if x.ndim == 2 else x
    c = np.ones(1) if combination is None else combination
    answer = windowed_mean(series)
    mean = (answer.mean * c).sum(axis=1)
    return float(np.mean(np.abs(mean) > answer.half_width(c, confidence)))


@pytest.mark.parametrize("n_samples", [25, 125])
def test_95_percent_of_white_windows_are_covered_and_not_many_more(n_samples: int) -> None:
    assert 0.03 <= misses(autoregressive(0.0, n_samples), 0.95) <= 0.06


@pytest.mark.parametrize("n_samples", [3, 6, 12])
def test_short_white_windows_are_covered(n_samples: int) -> None:
    assert misses(autoregressive(0.0, n_samples), 0.95) <= 0.055


@pytest.mark.parametrize("make", [autoregressive, autoregressive_plus_white])
@pytest.mark.parametrize(("rho", "n_samples"), [(0.6, 125), (0.9, 125), (0.9, 300)])
def test_94_percent_of_coloured_windows_are_covered(
    make: Callable[[float, int], Floats], rho: float, n_samples: int
) -> None:
    assert misses(make(rho, n_samples), 0.95) <= 0.06


def test_the_textbook_interval_fails_where_ours_holds() -> None:
    x = autoregressive(0.9, 125)
    half = student_quantile(124, 0.95) * x.std(axis=1, ddof=1) / np.sqrt(125)
    assert np.mean(np.abs(x.mean(axis=1)) > half) > 0.5


@pytest.mark.parametrize("highest", [0.02, 0.5])
def test_a_sinusoid_of_a_period_or_more_is_always_covered(highest: float) -> None:
    rng = np.random.default_rng(13)
    cycles = rng.uniform(1.0 / 125, highest, (N_WINDOWS, 1))
    x = np.sin(2 * np.pi * (cycles * np.arange(125) + rng.random((N_WINDOWS, 1))))
    assert misses(x, 0.95) <= 0.001


def test_the_interval_under_aliased_vibration_is_a_fraction_of_the_textbook_one() -> None:
    rng = np.random.default_rng(14)
    cycles = rng.uniform(0.2, 0.5, (2000, 1))
    x = np.sin(2 * np.pi * (cycles * np.arange(125) + rng.random((2000, 1))))
    ours = windowed_mean(x[:, :, None]).half_width([1.0], 0.95)
    textbook = student_quantile(124, 0.95) * x.std(axis=1, ddof=1) / np.sqrt(125)
    assert np.median(ours / textbook) < 0.3


@pytest.mark.parametrize("n_samples", [25, 125])
@pytest.mark.parametrize("tails", ["normal", "student"])
def test_white_windows_miss_at_99_9_percent_as_rarely_as_stated(tails: str, n_samples: int) -> None:
    rng = np.random.default_rng(15)
    shape = (100_000 if n_samples == 25 else 50_000, n_samples)
    x = rng.standard_normal(shape) if tails == "normal" else rng.standard_t(3, shape)
    assert misses(x, 0.999) <= 0.0013
    assert misses(x, 1 - 1e-7) <= 1e-5


@pytest.mark.parametrize("tails", ["normal", "student"])
def test_coloured_windows_miss_at_99_9_percent_twice_as_often_at_most(tails: str) -> None:
    rng = np.random.default_rng(16)
    shape = (30_000, 125)
    drive = rng.standard_normal(shape) if tails == "normal" else rng.standard_t(3, shape)
    assert misses(coloured(drive, 0.9), 0.999) <= 0.002


def test_white_windows_of_125_samples_keep_their_degrees_of_freedom() -> None:
    assert np.median(windowed_mean(autoregressive(0.0, 125)[:, :, None]).dof) > 30.0
    three = np.random.default_rng(17).standard_normal((2000, 125, 3))
    assert np.median(windowed_mean(three).dof) > 80.0


@pytest.mark.parametrize("n_samples", [25, 125])
@pytest.mark.parametrize("q", [3, 6])
def test_any_combination_of_white_series_is_covered(q: int, n_samples: int) -> None:
    rng = np.random.default_rng(18)
    x = rng.standard_normal((N_WINDOWS // q, n_samples, q)) @ rng.standard_normal((q, q))
    c = rng.standard_normal((len(x), q))
    assert 0.02 <= misses(x, 0.95, c) <= 0.06


def test_any_combination_of_a_coloured_and_two_white_series_is_covered() -> None:
    rng = np.random.default_rng(19)
    x = rng.standard_normal((8000, 125, 3))
    x[:, :, 0] = 0.436 * coloured(x[:, :, 0], 0.9)
    x = x @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    assert misses(x, 0.95, rng.standard_normal((8000, 3))) <= 0.055


def test_a_coloured_difference_hidden_under_common_white_noise_is_covered() -> None:
    rng = np.random.default_rng(20)
    x = rng.standard_normal((8000, 125, 2))
    x[:, :, 0] = x[:, :, 1] + 0.087 * coloured(x[:, :, 0], 0.9)
    assert misses(x, 0.95, np.array([1.0, -1.0])) <= 0.055
