"""[Larin15]: Table 2 digit by digit, Table 1 by its pattern (its digits hang on one noise draw)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
import pytest

from fdilog.detectors.determinants import (
    condition_search,
    determinant_search,
    smallest_singular_value_search,
)
from fdilog.detectors.kalman import kalman_search
from fdilog.detectors.parity import parity_search
from fdilog.maths.geometry import Floats, named_axes

Search = Callable[..., tuple[Floats, Any]]

# Rows: fault e = 1 in channel i; columns: determinant without channel j.
TABLE_2 = [
    [0.0814, 0.6730, 1.0075, 0.9572, 0.5413],
    [0.4245, 0.1671, 0.6949, 0.9572, 0.8539],
    [0.7371, 0.3388, 0.1890, 0.6446, 0.8539],
    [0.8999, 0.9857, 0.6949, 0.1387, 0.4705],
    [0.5873, 0.9857, 1.0075, 0.6446, 0.0354],
]

# The paper's noise draw, solved from the table; only its parity part can be known.
NOISE = [0.080067, 0.042537, -0.011242, 0.060726, 0.087015]

AXES = named_axes("pentagon")


def readings(body_rate: tuple[float, float, float]) -> Floats:
    return AXES @ body_rate + NOISE + np.eye(5)


@pytest.mark.parametrize("body_rate", [(1.0, 2.0, 3.0), (0.0, 0.0, 0.0), (-7.0, 0.3, 20.0)])
def test_determinants_are_those_of_table_2_whatever_the_body_rate(
    body_rate: tuple[float, float, float],
) -> None:
    determinants, named = determinant_search(readings(body_rate), AXES)
    np.testing.assert_allclose(determinants, TABLE_2, atol=0.5e-4, rtol=0)
    np.testing.assert_array_equal(named, np.arange(5))


def test_determinants_by_cofactors_equal_determinants_of_the_matrices() -> None:
    z = readings((1.0, 2.0, 3.0))
    for sample, row in zip(z, determinant_search(z, AXES)[0], strict=True):
        matrix = np.column_stack([AXES, sample])
        direct = [abs(np.linalg.det(np.delete(matrix, j, axis=0))) for j in range(5)]
        np.testing.assert_allclose(row, direct, rtol=1e-10)


@pytest.mark.parametrize("search", [condition_search, smallest_singular_value_search])
def test_the_costlier_variants_name_the_same_channels(search: Search) -> None:
    np.testing.assert_array_equal(search(readings((1.0, 2.0, 3.0)), AXES)[1], np.arange(5))


@pytest.mark.parametrize("factors", ["svd", "qr"])
def test_the_parity_search_names_the_same_channels_and_sizes_their_error(
    factors: Literal["svd", "qr"],
) -> None:
    misfit, error = parity_search(readings((1.0, 2.0, 3.0)), AXES, factors)
    np.testing.assert_array_equal(misfit.argmin(axis=1), np.arange(5))
    # The error of 1, give or take the noise vector as its residual shows it (at most 0.22).
    np.testing.assert_allclose(np.diag(error), 1.0, atol=0.25)


def test_the_largest_ratio_stands_at_shift_n_minus_i_as_table_1_shows() -> None:
    # Over many draws a row shows the pattern in about 95 %, all five at once in about 86 %;
    # 10 000 draws have binomial standard deviations of 0.22 % and 0.35 %: allow three.
    draws = 10_000
    noise = np.random.default_rng(5).normal(0.0, 0.1, (draws, 5))
    shown = np.empty((draws, 5), dtype=bool)
    for i in range(5):
        z = AXES @ (1.0, 2.0, 3.0) + noise
        z[:, i] += 1.0
        _, ratio, named = kalman_search(z, AXES, 0.1)
        np.testing.assert_array_equal(named == i, ratio.argmax(axis=1) == 5 - (i + 1))
        shown[:, i] = named == i
    np.testing.assert_allclose(shown.mean(axis=0), 0.95, atol=0.0066)
    assert shown.all(axis=1).mean() == pytest.approx(0.864, abs=0.0105)
