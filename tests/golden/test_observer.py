"""[Observer24]: the timeline of two failures, on another vessel of the same model."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.detectors.observer import design_observer, directional_metric, observer_residual
from fdilog.reproduce.observer import alarms, timeline, vessel


@pytest.mark.parametrize("seed", range(3))
def test_both_failures_of_the_timeline_are_found_and_told_apart(seed: int) -> None:
    found = alarms(timeline(seed))
    assert [sensor for sensor, _, _ in found] == ["gyro", "speed"]
    np.testing.assert_allclose([start for _, start, _ in found], [20.0, 50.0], atol=0.1)
    # The residual dies away with a time constant of half a second.
    np.testing.assert_allclose([end for _, _, end in found], [30.0, 70.0], atol=2.0)


def test_the_vessel_is_stable_and_answers_its_rudder() -> None:
    dynamics, inputs = vessel()
    assert (np.linalg.eigvals(dynamics).real < 0).all()
    assert np.abs(inputs).min() > 0


def test_a_constant_fault_settles_on_its_own_line_and_on_no_other() -> None:
    dynamics, inputs = vessel()
    design = design_observer(dynamics, [-1.0, -2.0])
    time_s = np.arange(0.0, 20.0, 0.01)
    for sensor in range(2):
        measured = np.zeros((len(time_s), 2))
        measured[time_s >= 5.0, sensor] = 0.3
        residual = observer_residual(
            measured,
            np.zeros((len(time_s), 1)),
            step_s=0.01,
            dynamics=dynamics,
            inputs=inputs,
            gain=design.gain,
        )
        metric = directional_metric(residual, design.directions)
        assert metric[-1, sensor] == pytest.approx(1.0, abs=1e-9)
        assert metric[-1, 1 - sensor] < 0.999
