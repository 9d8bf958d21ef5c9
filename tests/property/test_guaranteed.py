"""What must hold of guaranteed intervals whatever the geometry, the faults and the numbers."""

from __future__ import annotations

import random
from itertools import combinations
from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fdilog.detectors.guaranteed import guaranteed_intervals

Floats = NDArray[np.float64]

SCALE = 100.0
ROUNDING = 1e-9 * SCALE
"""Rounding of readings of that scale, multiplied by geometries down to a condition of 1e-6."""


class Case(NamedTuple):
    readings: Floats  # (20, n)
    axes: Floats
    bound: Floats
    max_failures: int
    truth: Floats  # (20, n)

    def intervals(self) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        return guaranteed_intervals(self.readings, self.axes, self.bound, self.max_failures)


@st.composite
def cases(draw: st.DrawFn, *, failures_beyond: int = 3) -> Case:
    """Channels in groups of equal axes; up to ``failures_beyond`` more may fail than allowed."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n_channels = draw(st.integers(3, 8))
    distinct = draw(st.integers(3, n_channels))
    axes = rng.normal(size=(distinct, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    axes = axes[rng.permutation(np.arange(n_channels) % distinct)]
    bound = rng.uniform(0.1, 2.0, n_channels)
    errors = draw(st.sampled_from([0.1, 1.0])) * rng.uniform(-1.0, 1.0, (20, n_channels)) * bound
    max_failures = draw(st.integers(0, 3))
    n_failed = draw(st.integers(0, min(n_channels, max_failures + failures_beyond)))
    size = draw(st.sampled_from([1.0, 30.0]))
    for row in errors:
        row[rng.permutation(n_channels)[:n_failed]] += size * rng.normal(size=n_failed)
    truth = rng.normal(0.0, SCALE, (20, 3)) @ axes.T
    return Case(truth + errors, axes, bound, max_failures, truth)


def off_the_edge(case: Case) -> bool:
    """Whether feasibility stays as it is when the bounds move by what rounding may amount to."""
    narrow = case._replace(bound=case.bound * (1.0 - 1e-7)).intervals()[2]
    wide = case._replace(bound=case.bound * (1.0 + 1e-7)).intervals()[2]
    return bool((narrow == wide).all())


@given(cases(failures_beyond=0))
def test_the_truth_is_inside_as_long_as_the_bound_holds(case: Case) -> None:
    low, high, feasible = case.intervals()
    assert feasible.any(axis=1).all()
    assert (low <= case.truth + ROUNDING).all()
    assert (case.truth <= high + ROUNDING).all()


@given(cases())
def test_the_ends_are_in_order_and_missing_exactly_where_nothing_is_feasible(case: Case) -> None:
    low, high, feasible = case.intervals()
    possible = feasible.any(axis=1)
    assert (low[possible] <= high[possible]).all()
    assert np.isnan(low[~possible]).all()
    assert np.isnan(high[~possible]).all()


@given(cases().filter(off_the_edge))
def test_a_rotation_rate_shifts_the_ends_by_what_each_channel_reads_of_it(case: Case) -> None:
    z, axes, bound, k, _ = case
    shift = np.random.default_rng(0).normal(0.0, SCALE, (20, 3)) @ axes.T
    low, high, feasible = case.intervals()
    shifted_low, shifted_high, shifted_feasible = guaranteed_intervals(z + shift, axes, bound, k)
    np.testing.assert_array_equal(shifted_feasible, feasible)
    np.testing.assert_allclose(shifted_low, low + shift, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(shifted_high, high + shift, rtol=0, atol=ROUNDING)


@given(cases().filter(off_the_edge), st.randoms(use_true_random=False))
def test_permuting_channels_permutes_the_answers(case: Case, shuffler: random.Random) -> None:
    z, axes, bound, k, _ = case
    order = list(range(len(axes)))
    shuffler.shuffle(order)
    low, high, feasible = case.intervals()
    ours = guaranteed_intervals(z[:, order], axes[order], bound[order], k)
    np.testing.assert_allclose(ours[0], low[:, order], rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(ours[1], high[:, order], rtol=0, atol=ROUNDING)
    place = {subset: index for index, subset in enumerate(combinations(range(len(axes)), k))}
    for index, subset in enumerate(combinations(order, k)):
        np.testing.assert_array_equal(ours[2][:, index], feasible[:, place[tuple(sorted(subset))]])


@given(cases().filter(off_the_edge), st.floats(1e-6, 1e6))
def test_scaling_readings_and_bounds_scales_the_answers(case: Case, factor: float) -> None:
    z, axes, bound, k, _ = case
    low, high, feasible = case.intervals()
    ours = guaranteed_intervals(factor * z, axes, factor * bound, k)
    np.testing.assert_array_equal(ours[2], feasible)
    np.testing.assert_allclose(ours[0] / factor, low, rtol=0, atol=ROUNDING)
    np.testing.assert_allclose(ours[1] / factor, high, rtol=0, atol=ROUNDING)


@given(cases())
def test_allowing_more_failures_never_narrows_an_interval(case: Case) -> None:
    z, axes, bound, k, _ = case
    low, high, _ = case.intervals()
    wider_low, wider_high, _ = guaranteed_intervals(z, axes, bound, k + 1)
    known = ~np.isnan(low)
    assert (wider_low[known] <= low[known] + ROUNDING).all()
    assert (wider_high[known] >= high[known] - ROUNDING).all()


@given(cases())
def test_losing_a_reading_never_narrows_the_interval_of_any_channel(case: Case) -> None:
    z, axes, bound, k, _ = case
    low, high, feasible = case.intervals()
    gone = z.copy()
    gone[:, 0] = np.nan
    wider_low, wider_high, still = guaranteed_intervals(gone, axes, bound, k)
    assert (still >= feasible).all()
    known = ~np.isnan(low)
    assert (wider_low[known] <= low[known] + ROUNDING).all()
    assert (wider_high[known] >= high[known] - ROUNDING).all()
