"""Student quantiles, held against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import stdtr, stdtrit

from fdilog.maths.student import _quantile, student_quantile, two_sided_tail

CONFIDENCES = (0.5, 0.95, 0.999, 1 - 1e-6, 1 - 1e-9, 1 - 1e-12)


@pytest.mark.parametrize("confidence", CONFIDENCES)
def test_quantiles_are_those_of_scipy(confidence: float) -> None:
    dof = np.r_[0.5, 0.7, 1.0, 2.0, np.geomspace(3.0, 1e6, 50), 999.9, 1000.0]
    expected = -stdtrit(dof, 0.5 * (1.0 - confidence))
    np.testing.assert_allclose(_quantile(dof, confidence), expected, rtol=1e-8)
    # What windows use is interpolated.
    np.testing.assert_allclose(student_quantile(dof, confidence), expected, rtol=3e-5)


def test_tails_are_those_of_scipy_near_and_far() -> None:
    dof, t = np.meshgrid([0.5, 1.0, 3.0, 10.0, 100.0, 900.0], [0.01, 0.5, 1.0, 3.0, 10.0, 100.0])
    found = two_sided_tail(t.ravel(), dof.ravel())
    np.testing.assert_allclose(found, 2.0 * stdtr(dof, -t).ravel(), rtol=1e-9)


def test_no_degrees_of_freedom_bound_nothing() -> None:
    assert student_quantile(np.array([0.0, 5.0]), 0.999)[0] == np.inf
    assert student_quantile(0.0, 0.0) == np.inf
    assert student_quantile(3.0, 0.0) == 0.0


def test_a_confidence_of_one_is_refused() -> None:
    with pytest.raises(ValueError, match="confidence"):
        student_quantile(np.array([5.0]), 1.0)
