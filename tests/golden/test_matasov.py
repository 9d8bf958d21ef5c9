"""[Matasov24]: what the two rivals of guaranteed estimation make of its worked example."""

from __future__ import annotations

import numpy as np

from fdilog.detectors.baselines import least_absolute_errors, least_squares_errors
from fdilog.maths.geometry import named_axes
from fdilog.reproduce import reproduce

AXES = named_axes("matasov")
# Channels 2 and 3 have errors of 20 and -51 deg/h, the others of 0.5 at most.
READINGS_DEG_H = np.array([[-393.04, 1075.35, -612.73, -593.11, 1254.79, 761.19]])
FAILED = [1, 2]


def test_least_squares_leaves_a_healthy_channel_almost_as_bad_as_the_worst() -> None:
    errors = np.abs(least_squares_errors(READINGS_DEG_H, AXES)[0])
    healthy = np.delete(errors, FAILED).max()
    assert healthy > 0.9 * errors.max()
    assert healthy > errors[1]


def test_least_absolute_deviations_finds_a_cheaper_story_than_the_truth() -> None:
    errors = np.abs(least_absolute_errors(READINGS_DEG_H, AXES)[0])
    body_rate = (-172.82, 604.19, -1284.63)
    truth = np.abs(READINGS_DEG_H[0] - AXES @ body_rate)
    assert errors.sum() < 0.75 * truth.sum()
    # The larger fault comes out on top, the other one vanishes altogether.
    assert errors.argmax() == FAILED[1]
    assert errors[FAILED[0]] < 1e-9


def test_every_printed_figure_of_the_example_comes_out() -> None:
    rows = reproduce("matasov")
    assert len(rows) == 18
    assert [row.quantity for row in rows if not row.agrees] == []
