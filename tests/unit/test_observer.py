from __future__ import annotations

import numpy as np
import pytest

from fdilog.detectors.identification import identify_model
from fdilog.detectors.observer import (
    assess_gain,
    design_observer,
    directional_metric,
    held_step,
    observer_residual,
    propagate,
)
from fdilog.maths.geometry import Floats

A = np.array([[-0.25, -0.9], [-0.05, -0.6]])
B = np.array([[0.1], [-0.3]])
STEP_S = 0.05


def sailed(samples: int = 2000) -> tuple[Floats, Floats]:
    """States (samples, 2) and inputs (samples, 1) of the model."""
    inputs = np.sign(np.sin(np.arange(samples) * STEP_S / 3.0))[:, None]
    step, held = held_step(A, B, STEP_S)
    return propagate(step, inputs[:-1] @ held.T, np.array([0.2, -0.1])), inputs


def watched(
    measured: Floats, inputs: Floats, gain: Floats, outputs: Floats | None = None
) -> Floats:
    return observer_residual(
        measured, inputs, step_s=STEP_S, dynamics=A, inputs=B, gain=gain, outputs=outputs
    )


def test_the_gain_makes_each_a_c_an_eigenvector_with_the_wanted_eigenvalue() -> None:
    design = design_observer(A, [-1.0, -3.0])
    closed = A - design.gain
    for i, eigenvalue in enumerate([-1.0, -3.0]):
        np.testing.assert_allclose(closed @ A[:, i], eigenvalue * A[:, i], atol=1e-12)
        np.testing.assert_allclose(design.directions[i], A[:, i])
    np.testing.assert_allclose(np.sort(design.eigenvalues), [-3.0, -1.0])
    assert design.directional.all()
    assert design.problems == ()


def test_a_model_that_forgets_one_state_cannot_hold_its_fault_on_a_line() -> None:
    # A c_1 = 0: a constant fault of the integrated state leaves no residual in the end.
    design = design_observer([[0.0, 1.0], [0.0, -1.0]], [-1.0, -2.0])
    np.testing.assert_array_equal(design.directional, [False, True])
    assert "the fault of sensor 0 does not stay on one line" in design.problems
    assert "the lines of the sensors are not independent" in design.problems


def test_redundant_sensors_cannot_all_have_their_own_line() -> None:
    design = design_observer(A, [-1.0, -2.0, -3.0], [[1.0, 0], [0, 1.0], [1.0, 1.0]])
    assert not design.directional.all()
    assert "the lines of the sensors are not independent" in design.problems


def test_one_sensor_of_two_states_may_leave_the_observer_unstable_and_that_is_said() -> None:
    unstable = np.array([[-1.0, 0.5], [0.0, 0.3]])
    design = design_observer(unstable, [-2.0], [[1.0, 0.0]])
    assert design.directional.all()
    assert design.problems == ("the observer is not stable",)


def test_a_gain_of_another_kind_is_told_where_it_fails() -> None:
    plain = assess_gain(A, np.diag([2.0, 3.0]))
    np.testing.assert_array_equal(plain.directional, [False, False])
    assert plain.problems == (
        "the fault of sensor 0 does not stay on one line",
        "the fault of sensor 1 does not stay on one line",
    )
    designed = design_observer(A, [-1.0, -3.0])
    again = assess_gain(A, designed.gain)
    np.testing.assert_allclose(again.rates_per_s, [-1.0, -3.0], rtol=1e-9)
    assert again.problems == ()
    with pytest.raises(ValueError, match="does not fit C"):
        assess_gain(A, np.ones((2, 3)))


@pytest.mark.parametrize("eigenvalues", [[-1.0], [-1.0, 0.0], [-1.0, 2.0]])
def test_eigenvalues_must_be_negative_and_one_for_each_sensor(eigenvalues: list[float]) -> None:
    with pytest.raises(ValueError, match="negative eigenvalues"):
        design_observer(A, eigenvalues)


def test_propagation_is_the_recursion() -> None:
    rng = np.random.default_rng(0)
    step, drive, state = np.array([[0.9, 0.3], [-0.2, 0.7]]), rng.normal(size=(300, 2)), np.ones(2)
    states = propagate(step, drive, state)
    for k in range(300):
        np.testing.assert_allclose(states[k], state, atol=1e-12)
        state = step @ state + drive[k]
    np.testing.assert_allclose(states[300], state, atol=1e-12)


def test_propagation_of_a_system_that_does_not_forget_sums_up() -> None:
    drive = np.arange(10.0)[:, None]
    summed = propagate(np.eye(1), drive, np.zeros(1))
    np.testing.assert_allclose(summed[1:, 0], np.cumsum(drive))


def test_a_held_step_is_exact() -> None:
    step, held = held_step(np.array([[-2.0]]), np.array([[3.0]]), 0.7)
    assert step[0, 0] == pytest.approx(np.exp(-1.4))
    assert held[0, 0] == pytest.approx(1.5 * (1 - np.exp(-1.4)))


def test_a_healthy_record_leaves_no_residual() -> None:
    states, inputs = sailed()
    residual = watched(states, inputs, design_observer(A, [-1.0, -1.0]).gain)
    np.testing.assert_allclose(residual, 0.0, atol=1e-12)


def test_the_residual_of_a_fault_follows_its_equation() -> None:
    # r' = (A - K) r - A c f + c f': jumps by f, then settles at (A - K)^-1 A c f.
    states, inputs = sailed()
    design = design_observer(A, [-1.0, -2.0])
    states[1000:, 1] += 0.4
    residual = watched(states, inputs, design.gain)
    np.testing.assert_allclose(residual[1000], [0.0, 0.4], atol=1e-12)
    settled = np.linalg.solve(A - design.gain, A[:, 1] * 0.4)
    np.testing.assert_allclose(residual[-1], settled, atol=1e-8)


def test_any_output_matrix_serves() -> None:
    outputs = np.array([[2.0, 1.0], [0.0, -1.0]])
    states, inputs = sailed()
    design = design_observer(A, [-1.0, -2.0], outputs)
    assert design.problems == ()
    measured = states @ outputs.T
    measured[1000:, 0] += 0.4
    residual = watched(measured, inputs, design.gain, outputs)
    np.testing.assert_allclose(residual[:1000], 0.0, atol=1e-12)
    assert directional_metric(residual[-1:], design.directions)[0, 0] == pytest.approx(1.0)


def test_fewer_sensors_than_states_serve_where_the_model_allows() -> None:
    outputs = np.array([[0.0, 1.0]])
    states, inputs = sailed()
    design = design_observer(A, [-1.0], outputs)
    assert design.directional.all()
    assert (design.eigenvalues.real < 0).all()
    residual = watched(states[:, 1:], inputs, design.gain, outputs)
    # Its start guesses the speed it does not see, and has to forget that.
    assert np.abs(residual[:100]).max() > 1e-3
    np.testing.assert_allclose(residual[-1], 0.0, atol=1e-6)


def test_an_observer_does_not_cross_a_gap() -> None:
    states, inputs = sailed(10)
    states[4, 0] = np.nan
    with pytest.raises(ValueError, match="split the record"):
        watched(states, inputs, np.eye(2))


def test_records_and_models_that_do_not_fit_are_refused() -> None:
    states, inputs = sailed(10)
    with pytest.raises(ValueError, match="do not fit the model"):
        watched(states[:, :1], inputs, np.eye(2))
    with pytest.raises(ValueError, match="do not fit one another"):
        design_observer(np.zeros((2, 3)), [-1.0, -1.0])
    with pytest.raises(ValueError, match="do not fit one another"):
        identify_model(states, inputs[:-1], STEP_S)


def test_an_empty_record_leaves_an_empty_residual() -> None:
    assert watched(np.zeros((0, 2)), np.zeros((0, 1)), np.eye(2)).shape == (0, 2)


def test_the_metric_is_the_squared_cosine_to_each_line() -> None:
    metric = directional_metric([[3.0, 4.0], [0.0, 0.0]], [[2.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(metric[0], [0.36, 1.0])
    assert np.isnan(metric[1]).all()


def test_a_model_is_identified_exactly_from_a_clean_record_with_biased_sensors() -> None:
    states, inputs = sailed()
    dynamics, through = identify_model(states + np.array([0.3, -0.7]), inputs, STEP_S)
    np.testing.assert_allclose(dynamics, A, atol=1e-9)
    np.testing.assert_allclose(through, B, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_of_the_sensors_does_not_pull_the_model_aside(seed: int) -> None:
    states, inputs = sailed(8000)
    noise = np.random.default_rng(seed).normal(0.0, 0.01, states.shape)
    dynamics, through = identify_model(states + noise, inputs, STEP_S)
    # One-stage least squares of the same records is off by 0.15 and more.
    np.testing.assert_allclose(dynamics, A, atol=0.05)
    np.testing.assert_allclose(through, B, atol=0.02)


def test_an_identified_model_finds_a_fault_in_the_rest_of_the_record() -> None:
    states, inputs = sailed(4000)
    measured = states + np.random.default_rng(1).normal(0.0, 0.002, states.shape)
    measured[3000:3600, 1] += 0.3
    dynamics, through = identify_model(measured[:2000:10], inputs[:2000:10], 10 * STEP_S)
    design = design_observer(dynamics, [-1.0, -1.0])
    residual = observer_residual(
        measured,
        inputs,
        step_s=STEP_S,
        dynamics=dynamics,
        inputs=through,
        gain=design.gain,
    )
    size = np.linalg.norm(residual, axis=1)
    assert size[3100:3600].min() > 2 * size[:3000].max()
    metric = directional_metric(residual[3100:3600], design.directions).mean(axis=0)
    assert metric.argmax() == 1


@pytest.mark.parametrize(
    ("states", "complaint"),
    [
        (np.ones((3, 2)), "too short"),
        (np.zeros((50, 2)), "zero all along"),
        (np.ones((50, 2)), "does not move enough"),
    ],
)
def test_a_record_that_fixes_no_model_is_refused(states: Floats, complaint: str) -> None:
    inputs = np.sin(np.arange(len(states), dtype=float))[:, None]
    with pytest.raises(ValueError, match=complaint):
        identify_model(states, inputs, STEP_S)


def test_a_step_that_no_continuous_model_makes_is_refused() -> None:
    alternating = propagate(np.array([[-0.5]]), np.sin(np.arange(20.0))[:, None], np.ones(1))
    with pytest.raises(ValueError, match="too coarse"):
        identify_model(alternating, np.append(np.sin(np.arange(20.0)), 0.0)[:, None], 1.0)
