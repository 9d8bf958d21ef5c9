"""Rotations: what two attitudes say of the rate between them, whatever the angles do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fdilog.sources.attitude import (
    from_euler,
    interpolated,
    logged_attitude,
    matrices,
    mean_rates,
    product,
    rotation_vectors,
)


def scalar_last(q: np.ndarray) -> np.ndarray:
    return q[:, [1, 2, 3, 0]]


def attitudes(n: int = 200, seed: int = 1) -> tuple[np.ndarray, Rotation]:
    rng = np.random.default_rng(seed)
    angles = rng.uniform(-1, 1, (n, 3)) * [np.pi, np.pi / 2, np.pi]
    return from_euler(angles), Rotation.from_euler("ZYX", angles[:, ::-1])


def test_angles_become_the_rotations_that_scipy_makes_of_them() -> None:
    q, official = attitudes()
    np.testing.assert_allclose(matrices(q), official.as_matrix(), atol=1e-12)


def test_a_product_is_one_turn_after_the_other() -> None:
    q, official = attitudes(seed=1)
    p, other = attitudes(seed=2)
    np.testing.assert_allclose(matrices(product(p, q)), (other * official).as_matrix(), atol=1e-12)


def test_rotation_vectors_are_those_of_scipy_in_body_axes() -> None:
    q, official = attitudes()
    expected = (official[:-1].inv() * official[1:]).as_rotvec()
    np.testing.assert_allclose(rotation_vectors(q), expected, atol=1e-9)


def test_a_step_beyond_another_turn_is_what_scipy_leaves_of_it() -> None:
    q, official = attitudes()
    vectors = np.random.default_rng(4).normal(0.0, 5.0, (len(q) - 1, 3))
    left = Rotation.from_rotvec(vectors).inv() * official[:-1].inv() * official[1:]
    np.testing.assert_allclose(rotation_vectors(q, beyond=vectors), left.as_rotvec(), atol=1e-7)


def test_yaw_that_wraps_is_a_small_turn() -> None:
    q = from_euler(np.radians([[0.0, 0.0, 359.5], [0.0, 0.0, 0.5]]))
    np.testing.assert_allclose(np.degrees(rotation_vectors(q)), [[0.0, 0.0, 1.0]], atol=1e-9)


def test_pitching_through_the_zenith_is_pure_pitch() -> None:
    # Euler angles jump there: roll and yaw by half a turn.
    q = from_euler(np.radians([[0.0, 89.0, 30.0], [180.0, 89.0, 210.0]]))
    np.testing.assert_allclose(np.degrees(rotation_vectors(q)), [[0.0, 2.0, 0.0]], atol=1e-6)


def test_no_turn_is_zero_and_not_a_division_by_it() -> None:
    q = from_euler(np.zeros((3, 3)))
    assert not rotation_vectors(q).any()


def test_the_mean_rate_over_a_window_is_its_net_turn() -> None:
    time_s = np.arange(0.0, 30.05, 0.1)
    angle = np.sin(time_s) + 0.3 * time_s
    q = from_euler(np.column_stack([angle, np.zeros_like(angle), np.zeros_like(angle)]))
    at_s = np.arange(0.02, 30.0, 0.02)
    rate, valid = mean_rates(time_s, rotation_vectors(q), np.ones(len(time_s) - 1, bool), at_s)
    assert valid.all()
    inside = (at_s > 5.0) & (at_s <= 15.001)
    net = np.interp(15.0, time_s, angle) - np.interp(5.0, time_s, angle)
    assert rate[inside, 0].mean() * 10.0 == pytest.approx(net, abs=1e-6)


def test_nothing_is_said_of_a_step_that_is_not_sound_nor_beyond_the_ends() -> None:
    time_s = np.array([1.0, 1.1, 3.0, 3.1])
    q = from_euler(np.zeros((4, 3)))
    at_s = np.array([0.5, 1.05, 2.0, 3.05, 3.5])
    rate, valid = mean_rates(time_s, rotation_vectors(q), np.array([True, False, True]), at_s)
    assert valid.tolist() == [False, True, False, True, False]
    assert np.isnan(rate[~valid]).all()


def test_interpolation_takes_the_shorter_way() -> None:
    q = from_euler(np.radians([[0.0, 0.0, 350.0], [0.0, 0.0, 10.0]]))
    between = matrices(interpolated(np.array([0.0, 1.0]), q, np.array([0.5])))
    np.testing.assert_allclose(between[0], np.eye(3), atol=1e-12)


def test_a_quaternion_of_zeros_is_no_attitude() -> None:
    parts = {f"orientation.{part}": np.zeros(5) for part in "wxyz"}
    q = logged_attitude(parts)
    assert q is not None
    assert np.isnan(q).all()


def test_columns_without_angles_are_no_attitude() -> None:
    assert logged_attitude({"Roll": np.zeros(3), "Pitch": np.zeros(3)}) is None
