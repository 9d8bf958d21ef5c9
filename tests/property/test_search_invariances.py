"""What must not depend on how the unit turns, how channels are numbered, or on the unit of rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fdilog.detectors.baselines import least_absolute_errors, least_squares_errors
from fdilog.detectors.determinants import determinant_search
from fdilog.detectors.difference import leave_one_out_residuals, maximum_difference, rate_tolerance
from fdilog.detectors.joint import joint_test
from fdilog.detectors.kalman import kalman_search, total_chi_square
from fdilog.detectors.parity import parity_search
from fdilog.detectors.searches import mean_modulus, mean_square, mean_square_rate_deviation
from fdilog.maths.geometry import (
    GEOMETRIES,
    Floats,
    blocks,
    detectable,
    isolability_groups,
    leave_one_out,
    minimal_detectable_fault,
    named_axes,
    parity_matrix,
    residual_projector,
)

Statistic = Callable[[Floats, Floats], Floats]

# Per channel, and in proportion to a power of the rate.
STATISTICS: dict[str, tuple[Statistic, int]] = {
    "parity misfit": (lambda z, h: parity_search(z, h)[0], 2),
    "parity error": (lambda z, h: parity_search(z, h)[1], 1),
    "mean modulus": (lambda z, h: mean_modulus(z, h)[0], 1),
    "mean square": (lambda z, h: mean_square(z, h)[0], 2),
    "mean square rate deviation": (lambda z, h: mean_square_rate_deviation(z, h)[0], 2),
    "maximum difference": (lambda z, h: maximum_difference(z, h)[0], 1),
    "leave-one-out residual": (lambda z, h: leave_one_out_residuals(z, h)[0], 1),
    "least squares": (least_squares_errors, 1),
    "least absolute deviations": (least_absolute_errors, 1),
}

seeds = st.integers(0, 2**32 - 1)
rates = st.tuples(*[st.floats(-10.0, 10.0)] * 3)


def random_axes(rng: np.random.Generator, channels: int) -> Floats:
    axes: Floats = rng.normal(size=(channels, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return axes


def well_spread(axes: Floats) -> bool:
    """Far enough from a special position, whichever channel is out, for rounding not to matter."""
    rests = axes[[[j for j in range(len(axes)) if j != i] for i in range(len(axes))]]
    redundancy = np.diag(residual_projector(axes)).min()
    return bool(np.linalg.svd(rests, compute_uv=False)[:, -1].min() > 0.2 and redundancy > 0.02)


@st.composite
def units(draw: st.DrawFn, smallest: int = 5, largest: int = 9) -> tuple[Floats, Floats]:
    """Axes and a few readings of a random unit, every channel of which is checked."""
    rng = np.random.default_rng(draw(seeds))
    channels = draw(st.integers(smallest, largest))
    axes = random_axes(rng, channels)
    while not well_spread(axes):
        axes = random_axes(rng, channels)
    return axes, rng.normal(size=(5, channels))


@pytest.mark.parametrize("name", STATISTICS)
@settings(max_examples=15)
@given(unit=units(), rate=rates)
def test_turning_the_unit_changes_no_statistic(
    name: str, unit: tuple[Floats, Floats], rate: tuple[float, float, float]
) -> None:
    axes, readings = unit
    statistic, _ = STATISTICS[name]
    turned = statistic(readings + axes @ rate, axes)
    np.testing.assert_allclose(turned, statistic(readings, axes), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("name", STATISTICS)
@settings(max_examples=15)
@given(unit=units(), seed=seeds)
def test_renumbering_channels_renumbers_every_statistic(
    name: str, unit: tuple[Floats, Floats], seed: int
) -> None:
    axes, readings = unit
    statistic, _ = STATISTICS[name]
    order = np.random.default_rng(seed).permutation(len(axes))
    renumbered = statistic(readings[:, order], axes[order])
    np.testing.assert_allclose(renumbered, statistic(readings, axes)[:, order], atol=1e-8)


@pytest.mark.parametrize("name", STATISTICS)
@settings(max_examples=15)
@given(unit=units(), factor=st.floats(1e-4, 1e4))
def test_another_unit_of_rate_scales_every_statistic(
    name: str, unit: tuple[Floats, Floats], factor: float
) -> None:
    axes, readings = unit
    statistic, power = STATISTICS[name]
    scaled = statistic(factor * readings, axes) / factor**power
    np.testing.assert_allclose(scaled, statistic(readings, axes), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", STATISTICS)
@settings(max_examples=15)
@given(unit=units(), seed=seeds)
def test_a_turned_body_frame_changes_no_statistic(
    name: str, unit: tuple[Floats, Floats], seed: int
) -> None:
    # Search 3 averages over the body axes, which an orthogonal turn does not change either.
    axes, readings = unit
    statistic, _ = STATISTICS[name]
    turn, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    np.testing.assert_allclose(
        statistic(readings, axes @ turn), statistic(readings, axes), rtol=1e-6, atol=1e-8
    )


@pytest.mark.parametrize("name", ["parity error", "maximum difference"])
@settings(max_examples=15)
@given(unit=units(), channel=st.integers(0, 4))
def test_turning_a_gyro_round_changes_only_its_sign(
    name: str, unit: tuple[Floats, Floats], channel: int
) -> None:
    axes, readings = unit
    statistic, _ = STATISTICS[name]
    sign = np.ones(len(axes))
    sign[channel] = -1.0
    turned = statistic(readings * sign, axes * sign[:, None])
    np.testing.assert_allclose(
        np.abs(turned), np.abs(statistic(readings, axes)), rtol=1e-6, atol=1e-9
    )


@given(unit=units(), channel=st.integers(0, 4), size=st.floats(0.1, 100.0))
def test_without_noise_every_search_names_the_failed_channel(
    unit: tuple[Floats, Floats], channel: int, size: float
) -> None:
    axes, readings = unit
    assume(not any(channel in group for group in isolability_groups(axes, tolerance=0.05)))
    readings = readings[:, :3] @ axes.T
    readings[:, channel] += size
    misfit, error = parity_search(readings, axes)
    np.testing.assert_array_equal(misfit.argmin(axis=1), channel)
    np.testing.assert_allclose(error[:, channel], size, rtol=1e-6)
    for search in (mean_modulus, mean_square, mean_square_rate_deviation):
        np.testing.assert_array_equal(search(readings, axes)[1], channel)


@given(unit=units(smallest=6), rate=rates)
def test_innovations_do_not_see_the_body_rate(
    unit: tuple[Floats, Floats], rate: tuple[float, float, float]
) -> None:
    axes, readings = unit
    starts = [axes[np.arange(r, r + 3) % len(axes)] for r in range(len(axes))]
    assume(min(np.linalg.svd(start, compute_uv=False)[-1] for start in starts) > 0.05)
    k, _, _ = kalman_search(readings, axes, 1.0)
    turned, _, _ = kalman_search(readings + axes @ rate, axes, 1.0)
    np.testing.assert_allclose(turned, k, rtol=1e-5, atol=1e-6)
    parity = readings @ parity_matrix(axes).T
    np.testing.assert_allclose(total_chi_square(k), (parity**2).sum(axis=1), rtol=1e-5)


@given(unit=units(smallest=5, largest=5), rate=rates, factor=st.floats(1e-3, 1e3))
def test_determinants_scale_with_the_reading_and_do_not_see_the_body_rate(
    unit: tuple[Floats, Floats], rate: tuple[float, float, float], factor: float
) -> None:
    axes, readings = unit
    plain, _ = determinant_search(readings, axes)
    turned, _ = determinant_search(factor * (readings + axes @ rate), axes)
    np.testing.assert_allclose(turned / factor, plain, rtol=1e-6, atol=1e-9)


@given(unit=units(), seed=seeds)
def test_the_window_test_follows_the_numbering_of_channels_and_the_unit_of_rate(
    unit: tuple[Floats, Floats], seed: int
) -> None:
    axes, _ = unit
    rng = np.random.default_rng(seed)
    n = len(axes)
    readings = rng.normal(size=(2, 20, 3)) @ axes.T + 0.1 * rng.normal(size=(2, 20, n))
    evidence = joint_test(readings, axes, 0.1, 0.05, 0.02)
    order = rng.permutation(n)
    renumbered = joint_test(readings[..., order], axes[order], 0.1, 0.05, 0.02)
    np.testing.assert_allclose(renumbered.single, evidence.single[:, order], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(renumbered.error, evidence.error[:, order], rtol=1e-6, atol=1e-9)
    in_degrees = joint_test(57.3 * readings, axes, 5.73, 57.3 * 0.05, 0.02)
    np.testing.assert_allclose(in_degrees.single, evidence.single, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(in_degrees.double, evidence.double, rtol=1e-6, atol=1e-9)


@given(unit=units(), seed=seeds)
def test_two_failed_channels_explain_at_least_as_much_as_one(
    unit: tuple[Floats, Floats], seed: int
) -> None:
    axes, _ = unit
    rng = np.random.default_rng(seed)
    readings = rng.normal(size=(2, 20, 3)) @ axes.T + 0.1 * rng.normal(size=(2, 20, len(axes)))
    evidence = joint_test(readings, axes, 0.1, 0.05, 0.02)
    for column, pair in enumerate(evidence.pairs):
        both = evidence.double[:, column, None]
        assert (both >= evidence.single[:, pair] * (1 - 1e-9) - 1e-9).all()


@given(unit=units(), faster=st.floats(1.0, 10.0))
def test_a_faster_turn_never_tightens_the_tolerance(
    unit: tuple[Floats, Floats], faster: float
) -> None:
    axes, readings = unit
    _, predicted = leave_one_out_residuals(readings, axes)
    slow = rate_tolerance(predicted, axes, 0.1, 0.02)
    assert (rate_tolerance(faster * predicted, axes, 0.1, 0.02) >= slow * (1 - 1e-12)).all()


@given(unit=units(smallest=4), seed=seeds)
def test_parity_is_orthonormal_and_complete(unit: tuple[Floats, Floats], seed: int) -> None:
    axes, _ = unit
    rng = np.random.default_rng(seed)
    parity = parity_matrix(axes)
    np.testing.assert_allclose(parity @ parity.T, np.eye(len(axes) - 3), atol=1e-12)
    errors = rng.normal(size=len(axes))
    kept, lost = parity.T @ parity @ errors, axes @ np.linalg.pinv(axes) @ errors
    np.testing.assert_allclose(kept + lost, errors, atol=1e-9)


@given(unit=units(), removed=st.lists(st.integers(0, 8), max_size=2, unique=True))
def test_a_removed_channel_has_no_say_in_the_others(
    unit: tuple[Floats, Floats], removed: list[int]
) -> None:
    axes, readings = unit
    removed = [channel for channel in removed if channel < len(axes)]
    rows = leave_one_out(axes, removed)
    wild = readings.copy()
    wild[:, removed] += 1e3
    others = [i for i in range(len(axes)) if i not in removed and not np.isnan(rows[i]).any()]
    before, after = readings @ rows[others].T, wild @ rows[others].T
    np.testing.assert_allclose(after, before, atol=1e-9)


@given(
    name=st.sampled_from(GEOMETRIES), seed=seeds, channels=st.integers(0, 8), doubled=st.booleans()
)
def test_groups_and_blocks_follow_the_numbering_of_channels(
    name: str, seed: int, channels: int, doubled: bool
) -> None:
    rng = np.random.default_rng(seed)
    axes = np.vstack([named_axes(name), random_axes(rng, channels)])
    if doubled:
        axes = np.vstack([axes, -axes[:1]])
    order = rng.permutation(len(axes))
    place = np.argsort(order)
    for relation in (isolability_groups, blocks):
        expected = sorted(tuple(sorted(place[list(group)])) for group in relation(axes))
        assert sorted(relation(axes[order])) == expected
    np.testing.assert_array_equal(detectable(axes[order]), detectable(axes)[order])
    np.testing.assert_allclose(
        minimal_detectable_fault(axes[order], 1.0), minimal_detectable_fault(axes, 1.0)[order]
    )


@given(unit=units(smallest=4), extra=seeds)
def test_another_gyro_never_raises_a_minimal_detectable_fault(
    unit: tuple[Floats, Floats], extra: int
) -> None:
    axes, _ = unit
    more = np.vstack([axes, random_axes(np.random.default_rng(extra), 1)])
    before = minimal_detectable_fault(axes, 1.0)
    assert (minimal_detectable_fault(more, 1.0)[:-1] <= before * (1 + 1e-9)).all()
