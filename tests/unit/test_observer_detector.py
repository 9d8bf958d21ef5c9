"""The observer as a detector: sensors of a log against a model of the vehicle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.detectors.observer import held_step, propagate
from fdilog.detectors.observer_evidence import ObserverDetector, alarms
from fdilog.detectors.observer_watch import check, explained, watched
from fdilog.errors import UsageError
from fdilog.finding import Evidence
from fdilog.maths.geometry import Floats
from fdilog.reproduce.observer import NOISE, vessel
from fdilog.windows.survey import Survey
from tests.vessels import OUTPUTS, configured, gyros, sailed, survey_of

TIME_S = np.arange(2400) * 0.05
MODEL = configured()
IDENTIFIED = configured(A=(), B=(), identify=True)


def answer(survey: Survey) -> Evidence:
    (found,) = ObserverDetector().detect(survey)
    return found


def between(start_s: float, end_s: float, size: float) -> Floats:
    time_s = TIME_S
    return np.where((time_s >= start_s) & (time_s < end_s), size, 0.0)


def test_without_a_model_in_the_configuration_nothing_is_asked() -> None:
    assert ObserverDetector().detect(sailed(Config())) == []


@pytest.mark.parametrize("config", [MODEL, IDENTIFIED], ids=["given", "identified"])
@pytest.mark.parametrize("seed", range(3))
def test_a_healthy_boat_raises_no_alarm(config: Config, seed: int) -> None:
    found = answer(sailed(config, seed=seed))
    assert len(found.windows) == 0
    assert found.note.startswith("observer: a constant error raises an alarm beyond")


@pytest.mark.parametrize("config", [MODEL, IDENTIFIED], ids=["given", "identified"])
@pytest.mark.parametrize("seed", range(3))
def test_a_failed_gyro_is_named_with_its_error_and_its_time(config: Config, seed: int) -> None:
    found = answer(sailed(config, faults={"imu0.z": between(70.0, 85.0, 0.1)}, seed=seed))
    assert found.accused.tolist() == [[0, 0, 1]]
    assert found.beside == ((),)
    assert found.windows.start_s[0] == pytest.approx(70.0, abs=0.15)
    assert found.windows.end_s[0] == pytest.approx(85.0, abs=1.5)
    assert found.low[0, 2] < 0.1 < found.high[0, 2]
    assert found.high[0, 2] - found.low[0, 2] < 0.06
    assert found.tested[0].tolist() == [False, False, True]


@pytest.mark.parametrize("config", [MODEL, IDENTIFIED], ids=["given", "identified"])
def test_a_failed_speed_is_named_beside_the_channels(config: Config) -> None:
    found = answer(sailed(config, faults={"boat.sway": between(70.0, 90.0, -0.5)}))
    assert not found.accused.any()
    assert found.beside == (("boat.sway",),)
    assert "off by -0.5" in found.details[0]


def test_how_often_intervals_hold_the_error() -> None:
    held = []
    for seed in range(30):
        faults = {"imu0.z": between(60.0, 80.0, 0.08)}
        watch = watched(sailed(MODEL, faults=faults, seed=seed))
        (alarm,) = alarms(watch, MODEL)
        held.append(alarm.low[1] < 0.08 < alarm.high[1])
    assert all(held)


def test_an_error_below_what_is_said_to_show_shows_nothing_and_one_above_does() -> None:
    least = watched(sailed(MODEL)).least_errors()[1]
    for part, shown in ((0.6, False), (1.5, True)):
        found = answer(sailed(MODEL, faults={"imu0.z": between(60.0, 90.0, part * least)}))
        assert bool(found.accused.any()) is shown


def test_an_error_within_tolerance_is_no_failure() -> None:
    faults = {"imu0.z": between(60.0, 90.0, 0.1)}
    lenient = MODEL.replace("tolerance", bias_deg_s=10.0)
    found = answer(sailed(lenient, faults=faults))
    assert len(found.windows) == 1
    assert not found.accused.any()
    assert found.beside == ((),)


def test_both_at_once_accuse_nobody_and_the_alarm_is_told() -> None:
    faults = {"imu0.z": between(60.0, 80.0, 0.3), "boat.sway": between(60.0, 80.0, -2.0)}
    found = answer(sailed(MODEL, faults=faults))
    assert not found.accused.any()
    assert not any(found.beside)
    assert "contradicted 6" in found.note
    assert "no single sensor explains it" in found.note


def test_one_reading_far_off_is_too_short_to_tell_whose_it_is() -> None:
    found = answer(sailed(MODEL, faults={"imu0.z": between(60.0, 60.05, 2.0)}))
    assert not found.accused.any()
    assert "no single sensor explains it" in found.note


def test_rounding_in_a_record_without_noise_is_no_fault() -> None:
    dynamics, inputs = vessel()
    rudder = 0.17 * np.sign(np.sin(TIME_S * 0.4))
    step, held = held_step(dynamics, inputs, 0.05)
    states = propagate(step, rudder[:-1, None] @ held.T, np.zeros(2))
    coarse = configured(step_s=0.05)
    found = answer(survey_of(gyros(TIME_S, states[:, 1]), coarse, states[:, 0], rudder))
    assert not found.accused.any()
    assert not any(found.beside)
    nothing = 0.0 * TIME_S
    still = answer(survey_of(gyros(TIME_S, nothing), MODEL, nothing, nothing))
    assert "an output is zero all along" in still.note


def test_where_a_command_is_beyond_the_healthy_ones_nobody_is_accused() -> None:
    survey = sailed(MODEL)
    rudder = survey.signals["boat.rudder"]
    # The rudder goes hard over, and stalls: the boat does not turn with it.
    hard = replace(rudder, values=rudder.values + between(70.0, 80.0, 0.5))
    found = answer(replace(survey, signals={**survey.signals, "boat.rudder": hard}))
    assert len(found.windows) >= 1
    assert not found.accused.any()
    assert not any(found.beside)
    assert "beyond those of the healthy stretch" in found.note


def three_sensors(coupling: float) -> Survey:
    """Three states at rest, of which the first and the third move the more alike the closer to 1
    the coupling is; the first sensor fails.
    """
    config = configured(
        outputs=("boat.sway", "imu0.z", "boat.rudder"),
        inputs=(),
        A=((-1.0, 0.0, -coupling), (0.0, -1.0, 0.0), (-coupling, 0.0, -1.0)),
        B=(),
        eigenvalues_per_s=(-1.0, -1.0, -1.0),
    )
    noise = np.random.default_rng(3).normal(0.0, 0.01, (3, len(TIME_S)))
    sway = noise[0] + between(60.0, 80.0, 1.0)
    return survey_of(gyros(TIME_S, noise[1]), config, sway, noise[2])


def test_sensors_whose_lines_are_too_close_are_suspects_together() -> None:
    assert answer(three_sensors(0.2)).beside == (("boat.sway",),)
    assert answer(three_sensors(0.9999)).beside == (("boat.sway", "boat.rudder"),)


def test_sensors_whose_lines_coincide_cannot_be_watched_and_that_is_said() -> None:
    note = answer(three_sensors(1.0)).note
    assert note.startswith("observer: not asked: ")
    assert "the lines of the sensors are not independent" in note
    assert "the observer is not stable" in note


def test_a_gain_of_ones_own_is_checked_and_what_it_misses_is_said() -> None:
    own = configured(K=((2.0, 0.0), (0.0, 3.0)))
    note = answer(sailed(own)).note
    assert "the fault of boat.sway does not stay on one line" in note
    assert "the fault of imu0.z does not stay on one line" in note
    designed = watched(sailed(MODEL)).design
    same = configured(K=tuple(map(tuple, designed.gain.tolist())))
    assert "line" not in answer(sailed(same)).note
    np.testing.assert_allclose(
        watched(sailed(same)).design.rates_per_s, designed.rates_per_s, rtol=1e-9
    )


def test_units_threshold_and_a_model_need_no_healthy_stretch() -> None:
    config = configured(healthy_s=(), units=NOISE, threshold=10.0)
    faults = {"imu0.z": between(60.0, 80.0, 0.1)}
    assert answer(sailed(config, faults=faults)).accused.tolist() == [[0, 0, 1]]


def test_a_gap_is_not_crossed() -> None:
    survey = sailed(MODEL, faults={"imu0.z": between(70.0, 85.0, 0.1)})
    sway = survey.signals["boat.sway"]
    keep = (sway.time_s < 50.0) | (sway.time_s > 60.0)
    cut = replace(sway, time_s=sway.time_s[keep], values=sway.values[keep])
    found = answer(replace(survey, signals={**survey.signals, "boat.sway": cut}))
    assert found.accused.tolist() == [[0, 0, 1]]
    watch = watched(replace(survey, signals={**survey.signals, "boat.sway": cut}))
    assert not ((watch.time_s > 50.0) & (watch.time_s < 60.0)).any()


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (configured(healthy_s=(200.0, 300.0)), "0 steps are left"),
        (configured(A=(), B=(), identify=True, healthy_s=(0.0, 0.5)), "too short"),
        (configured(inputs=("boat.oar",)), "no boat.oar"),
    ],
)
def test_what_the_log_does_not_hold_is_said(config: Config, why: str) -> None:
    found = answer(sailed(config))
    assert found.note.startswith("observer: not asked: ")
    assert why in found.note
    assert len(found.windows) == 0


def test_commands_that_do_not_drive_the_sensors_make_no_model() -> None:
    rng = np.random.default_rng(5)
    wander = np.cumsum(rng.normal(0.0, 0.01, (2, len(TIME_S))), axis=1)
    rudder = np.sign(np.sin(TIME_S))
    found = answer(survey_of(gyros(TIME_S, wander[1]), IDENTIFIED, wander[0], rudder))
    assert "not asked: no model from the healthy stretch" in found.note


def test_what_a_model_explains_is_its_share_of_the_variance() -> None:
    dynamics, inputs = vessel()
    driven = np.sign(np.sin(np.arange(400) * 0.3))[:, None]
    outputs = np.random.default_rng(1).normal(0.0, 1.0, (400, 2))
    none = explained(outputs, driven, dynamics, 0.0 * inputs, step_s=0.1)
    np.testing.assert_allclose(none, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "complaint"),
    [
        ({"A": ()}, "give A and B, or identify"),
        ({"identify": True}, "finds A and B itself"),
        ({"B": ((1.0, 2.0), (3.0, 4.0))}, "observer.B must have 2 rows of 1 numbers"),
        ({"A": ((1.0, 2.0),)}, "observer.A must have 1 rows of 1 numbers"),
        ({"C": ((1.0, 0.0),)}, "observer.C must have 2 rows of 2 numbers"),
        ({"K": ((1.0, 0.0),)}, "observer.K must have 2 rows of 2 numbers"),
        ({"units": (1.0,)}, "observer.units must have 2 numbers"),
        ({"eigenvalues_per_s": (-1.0,)}, "observer.eigenvalues_per_s must have 2 numbers"),
        ({"healthy_s": ()}, "healthy_s"),
        ({"outputs": ("imu0.z",)}, "1 outputs of 2 states need C"),
    ],
)
def test_keys_that_do_not_fit_one_another_are_refused(
    keys: dict[str, object], complaint: str
) -> None:
    with pytest.raises(UsageError, match=complaint):
        check(configured(**keys).observer)


def test_the_outputs_are_those_of_the_configuration() -> None:
    assert MODEL.observer.outputs == OUTPUTS
