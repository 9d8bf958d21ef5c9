from __future__ import annotations

import numpy as np
import pytest

from fdilog.maths.geometry import TRIAD_CONE_RAD, named_axes, two_triads
from fdilog.maths.unit_design import (
    CRITERIA,
    condition_number,
    covariance_trace,
    largest_cosine,
    search_two_triads,
    smallest_minor,
)


def test_figures_of_the_mirrored_triads_are_those_of_the_paper() -> None:
    axes = named_axes("mirrored-triads")
    assert covariance_trace(axes) == pytest.approx(1.5)
    assert condition_number(axes) == pytest.approx(1.0)
    assert smallest_minor(axes) == pytest.approx(1.0 / 3.0)


@pytest.mark.parametrize(
    ("name", "cosine"),
    [("aligned-triads", 1.0), ("dodecahedron", 0.4472), ("mirrored-triads", 0.6667)],
)
def test_largest_parity_cosine(name: str, cosine: float) -> None:
    assert largest_cosine(named_axes(name)) == pytest.approx(cosine, abs=1e-4)


def test_axes_in_a_plane_give_no_rate() -> None:
    plane = [[1.0, 0, 0], [0, 1.0, 0], [0.6, 0.8, 0]]
    assert covariance_trace(plane) == np.inf
    assert condition_number(plane) == np.inf
    assert smallest_minor(plane) == pytest.approx(0.0)
    assert smallest_minor(plane[:2]) == 0.0


def test_turning_the_unit_as_a_whole_changes_no_figure() -> None:
    for _, figure, _ in CRITERIA:
        turned = two_triads(0.3, 0.9, first_azimuth_rad=1.1)
        assert figure(turned) == pytest.approx(figure(two_triads(0.3, 0.9)))


def test_on_one_cone_mirrored_orthogonal_triads_are_best_by_every_criterion() -> None:
    cones = np.append(np.deg2rad(np.arange(20.0, 86.0, 5.0)), TRIAD_CONE_RAD)
    for best in search_two_triads(np.deg2rad(np.arange(0.0, 61.0, 5.0)), cones):
        mirrored = np.array([0.0, TRIAD_CONE_RAD, TRIAD_CONE_RAD])
        assert np.isclose(best.ties, mirrored).all(axis=1).any(), best.criterion


def test_on_two_cones_the_dodecahedron_is_best() -> None:
    axes = named_axes("dodecahedron")
    diagonal = axes[0] + axes[2] + axes[4]
    cones = np.arccos(np.abs(axes[[0, 1]] @ diagonal) / np.linalg.norm(diagonal))
    tried = np.append(np.deg2rad(np.arange(25.0, 86.0, 10.0)), [TRIAD_CONE_RAD, *cones])
    found = {
        best.criterion: best
        for best in search_two_triads(np.deg2rad(np.arange(0.0, 61.0, 10.0)), tried, tried)
    }
    for criterion, figure, _ in CRITERIA:
        assert found[criterion].value == pytest.approx(figure(axes)), criterion
    only = found["smallest minor"]
    assert {only.cone_rad, only.second_cone_rad} == {*map(float, cones)}
    assert only.value == pytest.approx(0.4702, abs=1e-4)


def test_azimuth_does_not_matter_to_the_covariance() -> None:
    best = search_two_triads([0.0, 0.4, 0.8], [TRIAD_CONE_RAD])[0]
    assert best.criterion == "covariance trace"
    assert len(best.ties) == 3
