from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from fdilog.maths.geometry import (
    GEOMETRIES,
    TRIAD_CONE_RAD,
    blocks,
    checked_axes,
    checked_readings,
    detectable,
    isolability_groups,
    leave_one_out,
    minimal_detectable_fault,
    named_axes,
    parity_cosines,
    parity_matrix,
    parity_matrix_qr,
    residual_projector,
    two_triads,
)

SKEWED = ("mirrored-triads", "matasov", "pentagon", "dodecahedron")


@pytest.mark.parametrize("name", GEOMETRIES)
def test_every_named_axis_is_a_unit_vector(name: str) -> None:
    # The pentagon is printed to five digits.
    np.testing.assert_allclose(np.linalg.norm(named_axes(name), axis=1), 1.0, atol=1e-5)


@pytest.mark.parametrize(
    ("name", "information"),
    [("mirrored-triads", 2.0), ("matasov", 2.0), ("dodecahedron", 2.0), ("pentagon", 5.0 / 3.0)],
)
def test_skewed_units_measure_every_direction_equally_well(name: str, information: float) -> None:
    axes = named_axes(name)
    np.testing.assert_allclose(axes.T @ axes, information * np.eye(3), atol=3e-5)


def test_any_two_axes_of_the_dodecahedron_meet_at_one_angle() -> None:
    cosines = np.abs(named_axes("dodecahedron") @ named_axes("dodecahedron").T)
    np.testing.assert_allclose(cosines[~np.eye(6, dtype=bool)], 1.0 / np.sqrt(5.0), rtol=1e-12)


def test_the_axes_of_each_mirrored_triad_are_orthogonal() -> None:
    axes = named_axes("mirrored-triads")
    assert np.rad2deg(TRIAD_CONE_RAD) == pytest.approx(54.7356, abs=1e-4)
    for triad in (axes[:3], axes[3:]):
        np.testing.assert_allclose(triad @ triad.T, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(axes[3:], axes[:3] * [1, 1, -1])


def test_a_second_cone_upwards_is_the_downward_one_turned_by_half_a_circle() -> None:
    turned = two_triads(np.pi, 0.7)[3:]
    upright = two_triads(0.0, 0.7)[:3]
    np.testing.assert_allclose(np.sort(-turned, axis=0), np.sort(upright, axis=0), atol=1e-15)


@pytest.mark.parametrize("channels", [3, 6, 9, 12])
def test_aligned_triads_come_in_several_sizes(channels: int) -> None:
    axes = named_axes("aligned-triads", channels)
    assert axes.shape == (channels, 3)
    np.testing.assert_array_equal(axes[:3], np.eye(3))
    np.testing.assert_array_equal(axes[-3:], np.eye(3))


def test_the_caller_may_write_into_named_axes_without_harm() -> None:
    named_axes("matasov")[:] = 0.0
    assert named_axes("matasov").any()


def test_an_unknown_geometry_names_the_nearest_known_one() -> None:
    with pytest.raises(ValueError, match="'dodecaeder'; did you mean 'dodecahedron'"):
        named_axes("dodecaeder")


@pytest.mark.parametrize(("name", "channels"), [("aligned-triads", 7), ("pentagon", 6)])
def test_a_size_that_the_unit_does_not_have_is_refused(name: str, channels: int) -> None:
    with pytest.raises(ValueError, match=f"channels, not {channels}"):
        named_axes(name, channels)


@pytest.mark.parametrize(
    ("axes", "complaint"),
    [
        ([[1.0, 0.0]], r"shape \(channels, 3\)"),
        (np.zeros((0, 3)), r"shape \(channels, 3\)"),
        ([[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], "axis 1 is zero"),
        ([[np.nan, 0.0, 0.0]], "axis 0 is zero or not finite"),
    ],
)
def test_axes_that_make_no_sense_are_refused(axes: list[list[float]], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        checked_axes(axes)


@pytest.mark.parametrize("readings", [np.zeros(6), np.zeros((4, 5))])
def test_readings_that_do_not_fit_the_axes_are_refused(readings: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"shape \(samples, 6\)"):
        checked_readings(readings, named_axes("matasov"))


@pytest.mark.parametrize("name", GEOMETRIES)
def test_parity_rows_are_orthonormal_and_blind_to_the_body_rate(name: str) -> None:
    axes = named_axes(name)
    for parity in (parity_matrix(axes), parity_matrix_qr(axes)):
        np.testing.assert_allclose(parity @ axes, 0.0, atol=1e-15)
        np.testing.assert_allclose(parity @ parity.T, np.eye(len(axes) - 3), atol=1e-15)


@pytest.mark.parametrize("name", GEOMETRIES)
def test_svd_and_qr_give_one_parity_space(name: str) -> None:
    axes = named_axes(name)[:4]  # four rows: with more, LAPACK's svd begins with the same qr
    if name == "aligned-triads":
        axes = named_axes(name)
    by_svd, by_qr = parity_matrix(axes), parity_matrix_qr(axes)
    np.testing.assert_allclose(by_svd.T @ by_svd, by_qr.T @ by_qr, atol=1e-14)


def test_axes_in_a_plane_keep_the_parity_that_qr_refuses() -> None:
    plane = np.array([[1.0, 0, 0], [0, 1.0, 0], [0.6, 0.8, 0], [0.8, -0.6, 0]])
    assert parity_matrix(plane).shape == (2, 4)
    with pytest.raises(ValueError, match="span"):
        parity_matrix_qr(plane)


def test_three_orthogonal_gyros_have_no_parity_and_check_nothing() -> None:
    axes = named_axes("aligned-triads", 3)
    assert parity_matrix(axes).shape == (0, 3)
    assert not detectable(axes).any()
    assert isolability_groups(axes) == []
    assert blocks(axes) == []
    assert np.isnan(leave_one_out(axes)).all()
    assert np.isinf(minimal_detectable_fault(axes, 1.0)).all()


def test_two_aligned_triads_detect_all_and_isolate_none() -> None:
    axes = named_axes("aligned-triads")
    assert detectable(axes).all()
    assert isolability_groups(axes) == [(0, 3), (1, 4), (2, 5)]
    assert blocks(axes) == [(0, 3), (1, 4), (2, 5)]


def test_three_aligned_triads_isolate_within_three_blocks() -> None:
    axes = named_axes("aligned-triads", 9)
    assert isolability_groups(axes) == []
    assert blocks(axes) == [(0, 3, 6), (1, 4, 7), (2, 5, 8)]


@pytest.mark.parametrize("name", SKEWED)
def test_skewed_units_tell_all_channels_apart(name: str) -> None:
    axes = named_axes(name)
    assert isolability_groups(axes) == []
    assert blocks(axes) == [tuple(range(len(axes)))]


def test_a_second_triad_yawed_leaves_the_z_pair_together() -> None:
    half = np.sqrt(0.5)
    yawed = np.array([[half, half, 0], [-half, half, 0], [0, 0, 1.0]])
    axes = np.vstack([np.eye(3), yawed])
    assert isolability_groups(axes) == [(2, 5)]
    assert blocks(axes) == [(0, 1, 3, 4), (2, 5)]


def test_a_tolerance_joins_channels_that_a_small_misalignment_hardly_separates() -> None:
    angle = np.deg2rad(0.5)
    tilted = np.array(
        [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    )
    axes = np.vstack([np.eye(3), tilted])
    assert isolability_groups(axes) == [(0, 3)]
    assert isolability_groups(axes, tolerance=0.1) == [(0, 3), (1, 4), (2, 5)]
    assert blocks(axes) == [(0, 3), (1, 2, 4, 5)]
    assert blocks(axes, tolerance=0.1) == [(0, 3), (1, 4), (2, 5)]


def test_one_triad_with_a_fourth_gyro_in_a_plane_leaves_the_third_axis_unchecked() -> None:
    axes = np.vstack([np.eye(3), [[np.sqrt(0.5), np.sqrt(0.5), 0]]])
    np.testing.assert_array_equal(detectable(axes), [True, True, False, True])
    # One parity equation: every fault that it sees looks the same.
    assert isolability_groups(axes) == [(0, 1, 3)]
    assert blocks(axes) == [(0, 1, 3)]


def test_parity_cosines_of_the_dodecahedron_are_all_the_same() -> None:
    cosines = parity_cosines(named_axes("dodecahedron"))
    off_diagonal = cosines[~np.eye(6, dtype=bool)]
    np.testing.assert_allclose(off_diagonal, 1.0 / np.sqrt(5.0), rtol=1e-12)


def struck_out_directly(axes: np.ndarray, i: int, left: list[int]) -> np.ndarray:
    """h_i' pinv(H_left) as a row over all channels, by the definition."""
    row = np.zeros(len(axes))
    row[left] = -axes[i] @ np.linalg.pinv(axes[left])
    row[i] = 1.0
    return row


@pytest.mark.parametrize("name", SKEWED)
def test_leave_one_out_rows_are_those_of_the_pseudo_inverse(name: str) -> None:
    axes = named_axes(name)
    n = len(axes)
    for removed in [(), (2,), (0, 4)][: n - 3]:
        rows = leave_one_out(axes, removed)
        for i in range(n):
            left = [j for j in range(n) if j != i and j not in removed]
            np.testing.assert_allclose(rows[i], struck_out_directly(axes, i, left), atol=1e-12)


def test_leave_one_out_is_the_residual_over_its_redundancy() -> None:
    axes = named_axes("pentagon")
    projector = residual_projector(axes)
    expected = projector / np.diag(projector)[:, None]
    np.testing.assert_allclose(leave_one_out(axes), expected, atol=1e-15)


def test_a_channel_left_without_comparison_is_not_a_number() -> None:
    rows = leave_one_out(named_axes("aligned-triads", 9), removed=(0, 3))
    # The third x gyro has lost both partners; they are still compared with it.
    np.testing.assert_array_equal(np.isnan(rows).any(axis=1), np.arange(9) == 6)
    np.testing.assert_allclose(rows[0], np.eye(9)[0] - np.eye(9)[6], atol=1e-15)


def test_removing_all_channels_leaves_nothing_to_compare() -> None:
    assert np.isnan(leave_one_out(named_axes("aligned-triads"), removed=range(6))).all()


def test_removing_a_channel_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match=r"removed channels \[6\]"):
        leave_one_out(named_axes("matasov"), removed=(6,))


def test_the_minimal_detectable_fault_is_found_as_often_as_it_says() -> None:
    axes = named_axes("pentagon")
    sigma = np.array([1.0, 2.0, 0.5, 1.0, 3.0])
    n_samples, confidence, power = 4, 0.99, 0.9
    fault = minimal_detectable_fault(axes, sigma, n_samples, confidence, power)
    trials = 20_000
    noise = np.random.default_rng(3).normal(0.0, sigma / np.sqrt(n_samples), (trials, 5))
    weighted = residual_projector(axes / sigma[:, None])
    two_sided = 2.5758293  # normal quantile at 1 - 0.01 / 2
    for i in range(5):
        readings = noise.copy()
        readings[:, i] += fault[i]
        test = (readings / sigma) @ weighted[i] / np.sqrt(weighted[i, i]) * np.sqrt(n_samples)
        found = (np.abs(test) > two_sided).mean()
        assert found == pytest.approx(power, abs=3 * np.sqrt(power * (1 - power) / trials))


def test_more_samples_shrink_the_minimal_detectable_fault_by_their_root() -> None:
    axes = named_axes("matasov")
    np.testing.assert_allclose(
        minimal_detectable_fault(axes, 1.0, 100.0), minimal_detectable_fault(axes, 1.0) / 10.0
    )


def test_a_noise_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="sigma must be positive"):
        minimal_detectable_fault(named_axes("matasov"), 0.0)


@pytest.mark.parametrize("pair", list(combinations(range(4), 2)))
def test_groups_follow_the_channels_when_they_change_places(pair: tuple[int, int]) -> None:
    axes = np.vstack([np.eye(3), [[0, 0, 1.0]]])
    order = list(range(4))
    order[pair[0]], order[pair[1]] = order[pair[1]], order[pair[0]]
    assert isolability_groups(axes[order]) == [tuple(sorted((order.index(2), order.index(3))))]
