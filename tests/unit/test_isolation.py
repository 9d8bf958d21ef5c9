"""Weights and joint hypotheses."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

from fdilog.isolation import non_negative_least_squares


def test_non_negative_least_squares_is_that_of_scipy() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        k = int(rng.integers(1, 13))
        design, target = rng.normal(size=(k + 5, k)), rng.normal(size=k + 5)
        np.testing.assert_allclose(
            non_negative_least_squares(design, target), nnls(design, target)[0], atol=1e-9
        )
