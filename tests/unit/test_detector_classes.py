"""Every voting detector on windows: whom it accuses, and that it accuses nobody for nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.detectors.determinants import (
    determinant_search,
    struck_conditions,
    struck_determinants,
)
from fdilog.detectors.kalman import kalman_search, last_innovation_ratio
from fdilog.detectors.vote import exchangeable
from fdilog.finding import Evidence
from fdilog.maths.geometry import named_axes
from fdilog.registry import plugin
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, cut
from tests.tables import DEG, biased, put, unit

VOTING = (
    "condition",
    "determinants",
    "joint",
    "kalman",
    "least-absolute",
    "least-squares",
    "mean-modulus",
    "mean-square",
    "one-norm",
    "rate-deviation",
)
# They compare consistent sets of equations, and two gyros of one axis are one equation too few.
NEED_THREE = ("condition", "determinants", "kalman")
UNITS = (("aligned-triads", 9), ("mirrored-triads", 6), ("dodecahedron", 6))
CONFIG = Config().replace("windows", lengths_s=(1.0, 5.0))
ONE_LENGTH = CONFIG.replace("windows", lengths_s=(5.0,))


def surveys(table: ChannelTable, config: Config = CONFIG) -> list[Survey]:
    return [Survey(table=table, windows=windows, config=config) for windows in cut(table, config)]


def evidence(name: str, survey: Survey) -> Evidence:
    found: list[Evidence] = plugin("detectors", name)().detect(survey)
    assert len(found) == 1
    return found[0]


def inside(survey: Survey, start_s: float, end_s: float) -> np.ndarray:
    return (survey.windows.start_s >= start_s) & (survey.windows.end_s < end_s)


@pytest.mark.parametrize("name", VOTING)
@pytest.mark.parametrize(("geometry", "channels"), UNITS)
@pytest.mark.parametrize("size_deg_s", [5.0, 50.0])
def test_a_failed_channel_is_accused_and_nobody_else(
    name: str, geometry: str, channels: int, size_deg_s: float
) -> None:
    for failed in range(channels):
        table = biased(unit(geometry, channels, seed=failed), failed, size_deg_s, 10.0, 20.0)
        (survey,) = surveys(table, ONE_LENGTH)
        accused = evidence(name, survey).accused > 0
        assert accused[inside(survey, 10.0, 20.0), failed].all()
        assert not np.delete(accused, failed, axis=1).any()
        before_or_after = inside(survey, 0.0, 10.0) | (survey.windows.start_s >= 20.0)
        assert not accused[before_or_after].any()


@pytest.mark.parametrize("name", VOTING)
@pytest.mark.parametrize(("geometry", "channels"), UNITS)
def test_an_enormous_fault_drags_nobody_along(name: str, geometry: str, channels: int) -> None:
    table = biased(unit(geometry, channels), 1, 2000.0, 10.0, 20.0)
    (survey,) = surveys(table, ONE_LENGTH)
    accused = evidence(name, survey).accused > 0
    assert accused[inside(survey, 10.0, 20.0), 1].all()
    assert not np.delete(accused, 1, axis=1).any()


def healthy_flights(geometry: str, channels: int, flights: int) -> ChannelTable:
    """Flights of 20 s with biases of their own, parted by holes that no window bridges."""
    flown = []
    for seed in range(flights):
        table = unit(geometry, channels, seconds=20.0, seed=seed)
        bias = np.random.default_rng((seed, 1)).normal(0.0, 0.1 * DEG, channels)
        flown.append(table.rate_rad_s + np.clip(bias, -0.3 * DEG, 0.3 * DEG))
    time_s = (table.time_s + 100.0 * np.arange(flights)[:, None]).ravel()
    rate = np.concatenate(flown)
    return replace(table, time_s=time_s, rate_rad_s=rate, valid=np.isfinite(rate))


@pytest.mark.parametrize(("geometry", "channels"), [*UNITS, ("aligned-triads", 6)])
def test_fifty_healthy_flights_accuse_nobody(geometry: str, channels: int) -> None:
    # The budget is one false finding in a hundred hours; these are a quarter of an hour.
    for survey in surveys(healthy_flights(geometry, channels, 50)):
        assert len(survey.windows) > 300
        for name in VOTING:
            assert not evidence(name, survey).accused.any(), name


@pytest.mark.parametrize("name", VOTING)
def test_of_two_aligned_gyros_both_are_suspects_of_one_fault(name: str) -> None:
    table = biased(unit("aligned-triads", 6), 1, -5.0, 10.0, 20.0)
    (survey,) = surveys(table, ONE_LENGTH)
    found = evidence(name, survey)
    if name in NEED_THREE:
        assert not found.tested.any()
        assert not found.accused.any()
        return
    np.testing.assert_array_equal(
        np.unique(found.accused[inside(survey, 10.0, 20.0)], axis=0), [[0, 1, 0, 0, 1, 0]]
    )


@pytest.mark.parametrize("name", VOTING)
def test_two_failures_on_one_axis_of_three_leave_all_three_suspects(name: str) -> None:
    table = biased(unit("aligned-triads", 9), 0, 5.0, 0.0, 30.0)
    table = biased(table, 3, -8.0, 0.0, 30.0)
    (survey,) = surveys(table, ONE_LENGTH)
    accused = evidence(name, survey).accused
    np.testing.assert_array_equal(np.unique(accused, axis=0), [[1, 0, 0, 1, 0, 0, 1, 0, 0]])


@pytest.mark.parametrize("name", VOTING)
@pytest.mark.parametrize("pair", [(0, 3), (2, 5)])
def test_two_failures_on_skewed_axes_are_both_named_or_nobody_is_alone(
    name: str, pair: tuple[int, int]
) -> None:
    table = biased(unit("dodecahedron"), pair[0], 6.0, 0.0, 30.0)
    table = biased(table, pair[1], -11.0, 0.0, 30.0)
    (survey,) = surveys(table, ONE_LENGTH)
    accused = evidence(name, survey).accused
    assert (accused[:, pair] > 0).all()
    healthy = np.delete(accused, pair, axis=1)
    # A healthy one is only ever named with everybody, where the vote did not stand.
    everybody = (accused == 1).all(axis=1)
    assert not healthy[~everybody].any()
    assert (accused[~everybody, pair[0]] != accused[~everybody, pair[1]]).all()


@pytest.mark.parametrize("name", VOTING)
def test_without_failures_allowed_all_that_disagree_are_suspects(name: str) -> None:
    config = ONE_LENGTH.replace("detectors", max_failures=0)
    table = biased(unit("dodecahedron"), 2, 5.0, 0.0, 30.0)
    (survey,) = surveys(table, config)
    assert (evidence(name, survey).accused == 1).all()


def test_only_least_squares_gives_intervals_and_they_hold_the_error() -> None:
    table = biased(unit("dodecahedron"), 2, 5.0, 0.0, 30.0)
    (survey,) = surveys(table, ONE_LENGTH)
    for name in VOTING:
        found = evidence(name, survey)
        assert np.isnan(found.low).all() == np.isnan(found.high).all() == (name != "least-squares")
    found = evidence("least-squares", survey)
    truth = np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]) * DEG
    assert ((found.low < truth) & (truth < found.high)).all()
    assert (found.high - found.low < 1.0 * DEG).all()


def test_the_interval_of_an_aligned_pair_allows_for_either_having_failed() -> None:
    table = biased(unit("aligned-triads", 6), 1, 5.0, 0.0, 30.0)
    (survey,) = surveys(table, ONE_LENGTH)
    found = evidence("least-squares", survey)
    for channel, errors in ((1, (0.0, 5.0)), (4, (0.0, -5.0))):
        for error in errors:
            assert (found.low[:, channel] < error * DEG).all()
            assert (found.high[:, channel] > error * DEG).all()


@pytest.mark.parametrize(("geometry", "channels"), UNITS)
def test_a_scale_error_that_averages_out_is_seen_by_the_joint_test_alone(
    geometry: str, channels: int
) -> None:
    table = unit(geometry, channels, seconds=60.0, sigma_deg_s=0.1)
    rate = table.rate_rad_s.copy()
    rate[:, 1] *= 1.25
    table = put(table, rate)
    (survey,) = surveys(table, Config().replace("windows", lengths_s=(20.0,)))
    accused = evidence("joint", survey).accused > 0
    assert accused[:, 1].all()
    assert not np.delete(accused, 1, axis=1).any()
    assert not (evidence("mean-square", survey).accused > 0).any()


def test_windows_of_few_samples_are_not_tested_jointly() -> None:
    (survey,) = surveys(unit("dodecahedron"), Config().replace("windows", lengths_s=(0.5,)))
    assert not evidence("joint", survey).tested.any()


def test_wandering_noise_gives_the_joint_test_no_failure() -> None:
    for seed in range(20):
        table = unit("dodecahedron", sigma_deg_s=0.1, seed=seed)
        steps = np.random.default_rng(seed).normal(0.0, 0.5 * DEG, table.rate_rad_s.shape)
        wander = np.zeros_like(steps)
        for k in range(1, len(steps)):
            wander[k] = 0.9 * wander[k - 1] + steps[k]
        (survey,) = surveys(put(table, table.rate_rad_s + wander), ONE_LENGTH)
        found = evidence("joint", survey)
        assert found.tested.any()
        assert not found.accused.any()


@pytest.mark.parametrize(("geometry", "channels"), [*UNITS, ("aligned-triads", 6)])
def test_unequal_noise_at_rest_is_no_scale_error(geometry: str, channels: int) -> None:
    # The estimated rate is all noise there, and the noisy gyro's stands in it and in the residual.
    sigma = np.where(np.arange(channels) == 2, 1.0, 0.1) * DEG
    for seed in range(5):
        table = unit(geometry, channels, seconds=60.0)
        noise = np.random.default_rng(seed).normal(0.0, sigma, table.rate_rad_s.shape)
        for survey in surveys(
            put(table, noise), Config().replace("windows", lengths_s=(5.0, 20.0))
        ):
            found = evidence("joint", survey)
            assert found.tested.all()
            assert not found.accused.any()


@pytest.mark.parametrize("geometry", ["pentagon", "dodecahedron", "mirrored-triads"])
def test_the_ratio_of_innovations_is_that_of_the_filter(geometry: str) -> None:
    axes = named_axes(geometry)
    readings = np.random.default_rng(0).normal(size=(20, len(axes)))
    _, by_shift, named = kalman_search(readings, axes, 1.0)
    ratio = last_innovation_ratio(readings, axes)
    np.testing.assert_allclose(ratio[:, ::-1], by_shift, rtol=1e-8)
    np.testing.assert_array_equal(ratio.argmax(axis=1), named)


def test_the_determinants_of_windows_are_those_of_the_paper_up_to_a_common_factor() -> None:
    axes = named_axes("pentagon")
    readings = np.random.default_rng(0).normal(size=(20, 5))
    expected, named = determinant_search(readings, axes)
    found = struck_determinants(readings, axes)
    ratio = found / expected
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[:, :1], ratio.shape), rtol=1e-9)
    np.testing.assert_array_equal(found.argmin(axis=1), named)


@pytest.mark.parametrize("statistic", [struck_determinants, struck_conditions])
@pytest.mark.parametrize("geometry", ["pentagon", "dodecahedron"])
def test_neither_the_rate_nor_its_unit_changes_a_struck_out_statistic(
    statistic: object, geometry: str
) -> None:
    assert callable(statistic)
    axes = named_axes(geometry)
    rng = np.random.default_rng(0)
    readings = rng.normal(size=(20, len(axes)))
    moved = 57.3 * (readings + rng.normal(0.0, 10.0, (20, 3)) @ axes.T)
    np.testing.assert_allclose(statistic(moved, axes), statistic(readings, axes), rtol=1e-8)


def test_what_cannot_be_told_apart_can_be_exchanged() -> None:
    pair = named_axes("aligned-triads", 6)
    assert exchangeable(pair, (1,)) == [(1,), (4,)]
    three = named_axes("aligned-triads", 9)
    assert exchangeable(three, (1,)) == [(1,)]
    assert exchangeable(three, (1, 4)) == [(1, 4), (1, 7), (4, 7)]
    assert exchangeable(three, (0, 4)) == [(0, 4)]
    assert exchangeable(named_axes("dodecahedron"), (0, 4)) == [(0, 4)]
