"""Weights and joint hypotheses."""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls
from scipy.special import erfc

from fdilog.config import Config
from fdilog.windows.isolation import family_wise_confidence, non_negative_least_squares


def test_non_negative_least_squares_is_that_of_scipy() -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        k = int(rng.integers(1, 13))
        design, target = rng.normal(size=(k + 5, k)), rng.normal(size=k + 5)
        np.testing.assert_allclose(
            non_negative_least_squares(design, target), nnls(design, target)[0], atol=1e-9
        )


def test_windows_laid_to_fit_are_judged_like_the_many_spans_they_are_chosen_from() -> None:
    rng = np.random.default_rng(3)
    hz, hours, limit = 2, 150, 4.5
    beyond = 0
    for _ in range(hours):
        total = np.concatenate([[0.0], np.cumsum(rng.standard_normal(3600 * hz))])
        beyond += any(
            np.abs(total[n:] - total[:-n]).max() > limit * np.sqrt(n)
            for n in range(5 * hz, 60 * hz + 1)
        )
    looks = -np.log(1.0 - beyond / hours) / erfc(limit / np.sqrt(2.0))
    settings = Config().windows
    share = (1.0 - family_wise_confidence(Config(), 0.0, 1)) * len(settings.lengths_s)
    assumed = settings.false_findings_per_hour / share
    # At the 6 sigma of a real decision there are half as many looks again as at these.
    assert looks < assumed < 3.0 * looks
