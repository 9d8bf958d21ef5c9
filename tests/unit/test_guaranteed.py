"""Guaranteed intervals against linear programs, and where there is nothing to compare with."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import linprog

from fdilog.detectors.guaranteed import BLOCK, guaranteed_intervals
from fdilog.maths.circuits import find_circuits
from fdilog.maths.geometry import named_axes
from tests.oracles import EDGE, SCALE, guaranteed_by_programs, random_instance, skewed_axes, slabs

Floats = NDArray[np.float64]

INSTANCES = 100


def assert_same(ours: Floats, programs: Floats) -> None:
    """Agree to 1e-9 of the readings, or of an end that nearly coplanar axes put far beyond them."""
    np.testing.assert_allclose(ours, programs, rtol=1e-9, atol=1e-9 * SCALE)


@pytest.mark.parametrize("aligned", [False, True], ids=["skewed", "aligned"])
@pytest.mark.parametrize("n_channels", [4, 5, 6, 8, 9])
def test_intervals_are_those_of_the_linear_programs(n_channels: int, *, aligned: bool) -> None:
    rng = np.random.default_rng(1000 * n_channels + aligned)
    compared = infeasible = unbounded = 0
    for _ in range(INSTANCES):
        z, axes, bound, k = random_instance(rng, n_channels, aligned=aligned)
        # All channels where there are few; of many, two drawn anew each time, to save time.
        targets = rng.permutation(n_channels)[: 6 if n_channels <= 6 else 2]
        low, high, feasible, edge = guaranteed_by_programs(z, axes, bound, k, targets.tolist())
        if edge < EDGE * SCALE:
            continue
        ours = guaranteed_intervals(z[None], axes, bound, k)
        np.testing.assert_array_equal(ours[2][0], feasible)
        assert_same(ours[0][0, targets], low[targets])
        assert_same(ours[1][0, targets], high[targets])
        compared += 1
        infeasible += not feasible.all()
        unbounded += bool(np.isinf(ours[0]).any())
    assert compared >= 0.9 * INSTANCES
    # Any three skewed channels agree.
    assert (infeasible > 0) == (n_channels > 4 or aligned)
    # Five skewed channels without two still span space, so do three aligned triads.
    assert (unbounded > 0) == (n_channels == 4 or (aligned and n_channels < 9))


@pytest.mark.parametrize("n_channels", [3, 6, 9])
def test_no_and_many_failures_are_those_of_the_linear_programs(n_channels: int) -> None:
    rng = np.random.default_rng(n_channels)
    for k in (0, 3, n_channels - 1, n_channels):
        z, axes, bound, _ = random_instance(rng, n_channels, aligned=False)
        low, high, feasible, _ = guaranteed_by_programs(z, axes, bound, k)
        ours = guaranteed_intervals(z[None], axes, bound, k)
        np.testing.assert_array_equal(ours[2][0], feasible)
        assert_same(ours[0][0], low)
        assert_same(ours[1][0], high)


def test_a_subset_said_feasible_has_a_rate_and_one_said_infeasible_has_none() -> None:
    rng = np.random.default_rng(5)
    z, axes, bound, _ = random_instance(rng, 6, aligned=False)
    z[4] += 20.0
    _, _, feasible = guaranteed_intervals(z[None], axes, bound, 2)
    for subset, good in zip(combinations(range(6), 2), feasible[0], strict=True):
        matrix, limit = slabs(z, axes, bound, [i for i in range(6) if i not in subset])
        answer = linprog(np.zeros(3), A_ub=matrix, b_ub=limit, bounds=(None, None))
        assert answer.status == (0 if good else 2)
    assert not feasible.all()
    assert feasible.any()


def test_a_channel_whose_axis_nothing_else_covers_is_unbounded_and_the_others_are_not() -> None:
    # Both x gyros of two aligned triads may have failed; of the y gyros at most one has with them.
    axes = np.vstack([np.eye(3), np.eye(3), np.eye(3)[1:]])
    z = np.array([5.0, 1.0, 2.0, 5.1, 1.1, 2.1, 1.05, 2.05])
    low, high, feasible = guaranteed_intervals(z[None], axes, 0.2, 2)
    assert feasible.all()
    assert np.isinf(low[0, [0, 3]]).all()
    assert np.isinf(high[0, [0, 3]]).all()
    # Three y gyros, two may have failed: the third alone holds, whichever it is.
    np.testing.assert_allclose(low[0, 1], 1.0 - 0.2)
    np.testing.assert_allclose(high[0, 1], 1.1 + 0.2)


def test_one_failure_in_two_aligned_triads_leaves_both_of_a_pair_in_question() -> None:
    axes = np.vstack([np.eye(3), np.eye(3)])
    low, high, feasible = guaranteed_intervals([[7.0, 0.0, 0.0, 0.0, 0.0, 0.0]], axes, 1.0, 1)
    assert feasible[0].tolist() == [True, False, False, True, False, False]
    # If imu0.x failed its true reading is near 0, if imu1.x failed it is near 7.
    assert (low[0, 0], high[0, 0]) == pytest.approx((-1.0, 8.0))
    assert (low[0, 1], high[0, 1]) == pytest.approx((-1.0, 1.0))


def test_four_channels_with_two_failures_say_nothing() -> None:
    rng = np.random.default_rng(0)
    z, axes, bound, _ = random_instance(rng, 4, aligned=False)
    low, high, feasible = guaranteed_intervals(z[None], axes, bound, 2)
    assert feasible.all()
    assert (low == -np.inf).all()
    assert (high == np.inf).all()


def test_a_violated_bound_gives_no_interval() -> None:
    axes = named_axes("dodecahedron")
    z = axes @ [1.0, 2.0, 3.0] + [0.0, 50.0, -30.0, 20.0, 0.0, 10.0]
    low, high, feasible = guaranteed_intervals(z[None], axes, 0.1, 2)
    assert not feasible.any()
    assert np.isnan(low).all()
    assert np.isnan(high).all()


def test_more_failures_than_channels_leave_everything_open() -> None:
    low, high, feasible = guaranteed_intervals(np.zeros((2, 3)), np.eye(3), 1.0, 4)
    assert feasible.shape == (2, 0)
    assert (low == -np.inf).all()
    assert (high == np.inf).all()


@pytest.mark.parametrize("aligned", [False, True], ids=["skewed", "aligned"])
def test_a_missing_channel_is_a_channel_without_a_bound(*, aligned: bool) -> None:
    rng = np.random.default_rng(3)
    for n_channels in (4, 6, 9):
        z, axes, bound, k = random_instance(rng, n_channels, aligned=aligned)
        samples = np.tile(z, (40, 1))
        missing = rng.random(samples.shape) < 0.25
        ours = guaranteed_intervals(np.where(missing, np.nan, samples), axes, bound, k)
        for row, gone in enumerate(missing):
            loose = np.where(gone, np.inf, bound)
            theirs = guaranteed_intervals(samples[[row]], axes, loose, k)
            for one, other in zip(ours, theirs, strict=True):
                assert_same(one[row], other[0])


def test_a_missing_channel_is_bounded_by_the_others_as_the_linear_programs_say() -> None:
    rng = np.random.default_rng(8)
    for _ in range(10):
        z, axes, bound, _ = random_instance(rng, 6, aligned=False)
        gone = int(rng.integers(6))
        loose = bound.copy()
        loose[gone] = 1e6  # as good as none, and a linear program can have it
        low, high, feasible, edge = guaranteed_by_programs(z, axes, loose, 1)
        if edge < EDGE * SCALE:
            continue
        z[gone] = np.nan
        ours = guaranteed_intervals(z[None], axes, bound, 1)
        np.testing.assert_array_equal(ours[2][0], feasible)
        assert_same(ours[0][0], low)
        assert_same(ours[1][0], high)


def test_a_sample_does_not_depend_on_its_neighbours() -> None:
    rng = np.random.default_rng(11)
    axes = named_axes("matasov")
    n_samples = 2 * BLOCK + 7
    z = rng.normal(0.0, 10.0, (n_samples, 3)) @ axes.T + rng.uniform(-1.0, 1.0, (n_samples, 6))
    z[rng.random(z.shape) < 0.02] += 30.0
    z[rng.random(z.shape) < 0.02] = np.nan
    together = guaranteed_intervals(z, axes, 1.0)
    some = np.r_[0:50, BLOCK - 5 : BLOCK + 5, n_samples - 9 : n_samples]
    for row in some.tolist():
        alone = guaranteed_intervals(z[[row]], axes, 1.0)
        for one, other in zip(together, alone, strict=True):
            np.testing.assert_allclose(one[row], other[0], rtol=0, atol=1e-11)


def test_readings_exactly_on_their_bound_are_not_lost_to_rounding() -> None:
    rng = np.random.default_rng(2)
    for name in ("matasov", "dodecahedron", "aligned-triads"):
        axes = named_axes(name)
        truth = rng.normal(0.0, 7.3, (2000, 3)) @ axes.T
        errors = 0.1 * rng.choice([-1.0, 1.0], truth.shape)
        for k in (0, 1):
            low, high, feasible = guaranteed_intervals(truth + errors, axes, 0.1, k)
            assert feasible.all()
            assert (low <= high).all()
            assert (low <= truth + 1e-12).all()
            assert (truth <= high + 1e-12).all()


@pytest.mark.parametrize("tilt_rad", [1e-3, 1e-6, 1e-8, 1e-10, 1e-12])
def test_nearly_coplanar_axes_keep_the_ends_in_order_and_the_truth_inside(tilt_rad: float) -> None:
    rng = np.random.default_rng(4)
    axes = skewed_axes(rng, 6)
    axes[2] = (axes[0] + axes[1]) / np.linalg.norm(axes[0] + axes[1])
    axes[2] += tilt_rad * np.cross(axes[0], axes[1])
    truth = rng.normal(0.0, 10.0, (3000, 3)) @ axes.T
    errors = rng.uniform(-1.0, 1.0, truth.shape)
    errors[1000:, 5] += 40.0
    low, high, feasible = guaranteed_intervals(truth + errors, axes, 1.0, 1)
    assert feasible.any(axis=1).all()
    assert (low <= high).all()
    # A relation taken as exact errs by the rank tolerance, 1e-9, of the rate.
    assert (low <= truth + 1e-7).all()
    assert (truth <= high + 1e-7).all()


def test_axes_aligned_but_for_rounding_are_aligned() -> None:
    rng = np.random.default_rng(9)
    triad = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    again = triad @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = again @ np.linalg.solve(again, triad)
    relations = find_circuits(np.vstack([triad, turned]))
    assert (relations != 0.0).sum(axis=1).tolist() == [2, 2, 2]


def test_a_zero_bound_pins_what_agrees() -> None:
    axes = named_axes("matasov")
    truth = np.array([[1.0, -2.0, 3.0]]) @ axes.T
    low, high, feasible = guaranteed_intervals(truth, axes, 0.0, 2)
    assert feasible.all()
    np.testing.assert_allclose(low, truth, atol=1e-13)
    np.testing.assert_allclose(high, truth, atol=1e-13)
    assert (low <= high).all()


def test_no_samples_give_empty_answers_of_the_right_shape() -> None:
    low, high, feasible = guaranteed_intervals(np.empty((0, 6)), named_axes("matasov"), 1.0)
    assert low.shape == high.shape == (0, 6)
    assert feasible.shape == (0, 15)


@pytest.mark.parametrize(
    ("readings", "bound", "failures", "words"),
    [
        (np.zeros((4, 5)), 1.0, 2, "shape"),
        (np.zeros((4, 6)), [1.0, 2.0], 2, "bound"),
        (np.zeros((4, 6)), -1.0, 2, "negative"),
        (np.zeros((4, 6)), np.nan, 2, "not a number"),
        (np.zeros((4, 6)), 1.0, -1, "max_failures"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    readings: Floats, bound: float | list[float], failures: int, words: str
) -> None:
    with pytest.raises(ValueError, match=words):
        guaranteed_intervals(readings, named_axes("matasov"), bound, failures)
