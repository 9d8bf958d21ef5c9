"""Errors of smallest 1-norm against linear programs, and what is done where they are not unique."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.detectors.one_norm import BLOCK, one_norm_errors
from fdilog.maths.geometry import named_axes
from tests.oracles import least_one_norms

Floats = NDArray[np.float64]

SCALE = 100.0


def random_case(n_channels: int, *, aligned: bool, n_samples: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(10 * n_channels + aligned)
    axes = rng.normal(size=(n_channels, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    if aligned:
        axes = axes[rng.permutation(np.arange(n_channels) % 3)]
    z = rng.normal(0.0, SCALE, (n_samples, 3)) @ axes.T + rng.normal(size=(n_samples, n_channels))
    z += (rng.random(z.shape) < 0.2) * rng.normal(0.0, 50.0, z.shape)
    return z, axes


@pytest.mark.parametrize("aligned", [False, True], ids=["skewed", "aligned"])
@pytest.mark.parametrize("n_channels", [3, 4, 5, 6, 8, 9, 12])
def test_norms_are_those_of_the_linear_programs(n_channels: int, *, aligned: bool) -> None:
    z, axes = random_case(n_channels, aligned=aligned, n_samples=100)
    norms = np.abs(one_norm_errors(z, axes)).sum(axis=1)
    np.testing.assert_allclose(norms, least_one_norms(z, axes), rtol=0, atol=1e-9 * SCALE)


@pytest.mark.parametrize("aligned", [False, True], ids=["skewed", "aligned"])
def test_readings_less_errors_are_those_of_some_rate(*, aligned: bool) -> None:
    z, axes = random_case(9, aligned=aligned, n_samples=100)
    truth = z - one_norm_errors(z, axes)
    rate = np.linalg.lstsq(axes, truth.T, rcond=None)[0]
    np.testing.assert_allclose(truth, (axes @ rate).T, rtol=0, atol=1e-11 * SCALE)


@pytest.mark.parametrize("name", ["matasov", "dodecahedron", "pentagon"])
def test_a_single_fault_without_noise_is_found_exactly(name: str) -> None:
    axes = named_axes(name)
    truth = np.random.default_rng(0).normal(0.0, 10.0, (len(axes), 3)) @ axes.T
    faults = 5.0 * np.eye(len(axes))
    np.testing.assert_allclose(one_norm_errors(truth + faults, axes), faults, atol=1e-12)


def test_a_fault_on_an_aligned_pair_is_shared_by_both_suspects() -> None:
    axes = np.vstack([np.eye(3), np.eye(3)])
    z = np.array([[1.0, 2.0, 3.0, 1.0, 2.5, 3.0]])
    expected = [[0.0, -0.25, 0.0, 0.0, 0.25, 0.0]]
    np.testing.assert_allclose(one_norm_errors(z, axes), expected, atol=1e-14)


def test_three_aligned_triads_agree_on_the_median() -> None:
    rng = np.random.default_rng(1)
    z = rng.normal(size=(200, 9))
    errors = one_norm_errors(z, np.vstack([np.eye(3)] * 3))
    median = np.median(z.reshape(200, 3, 3), axis=1)
    np.testing.assert_allclose(errors, z - np.tile(median, 3), atol=1e-14)


def test_the_order_of_the_channels_does_not_matter() -> None:
    for aligned in (False, True):
        z, axes = random_case(6, aligned=aligned, n_samples=200)
        order = np.random.default_rng(2).permutation(6)
        permuted = one_norm_errors(z[:, order], axes[order])
        np.testing.assert_allclose(permuted, one_norm_errors(z, axes)[:, order], atol=1e-10)


def test_a_missing_channel_is_left_out_of_the_fit() -> None:
    for aligned in (False, True):
        z, axes = random_case(6, aligned=aligned, n_samples=60)
        missing = np.random.default_rng(3).random(z.shape) < 0.3
        missing[0] = True
        errors = one_norm_errors(np.where(missing, np.nan, z), axes)
        np.testing.assert_array_equal(np.isnan(errors), missing)
        for row, gone in enumerate(missing[1:], start=1):
            alone = one_norm_errors(z[[row]][:, ~gone], axes[~gone])
            np.testing.assert_allclose(errors[row, ~gone], alone[0], rtol=0, atol=1e-11)


def test_channels_without_redundancy_have_no_error() -> None:
    z = np.random.default_rng(4).normal(size=(5, 3))
    np.testing.assert_array_equal(one_norm_errors(z, np.eye(3)), 0.0)
    flat = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_array_equal(one_norm_errors(z[:, :2], flat), 0.0)


def test_a_sample_does_not_depend_on_its_neighbours() -> None:
    z, axes = random_case(6, aligned=False, n_samples=BLOCK + 3)
    z[5, 2] = np.nan
    together = one_norm_errors(z, axes)
    for row in (0, 5, BLOCK - 1, BLOCK, BLOCK + 2):
        np.testing.assert_allclose(together[row], one_norm_errors(z[[row]], axes)[0], atol=1e-11)


def test_no_samples_give_no_errors() -> None:
    assert one_norm_errors(np.empty((0, 6)), named_axes("matasov")).shape == (0, 6)


def test_readings_that_do_not_fit_the_axes_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        one_norm_errors(np.zeros((2, 5)), named_axes("matasov"))
