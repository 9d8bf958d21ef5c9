"""What no answer of the observer may depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fdilog.detectors.observer import held_step, propagate
from fdilog.detectors.observer_evidence import Alarm, ObserverDetector, alarms
from fdilog.detectors.observer_watch import watched
from fdilog.maths.geometry import Floats
from fdilog.reproduce.observer import NOISE, vessel
from fdilog.windows.survey import Survey
from tests.vessels import configured, gyros, sailed, survey_of

TIME_S = np.arange(1600) * 0.05
# The units of the outputs are given, since what a stretch leaves depends on its motion.
MODEL = configured(healthy_s=(0.0, 30.0), units=NOISE, threshold=8.0)


def fault(size: float) -> Floats:
    rows = np.zeros(len(TIME_S))
    rows[800:1200] = size
    return rows


def failing(sensor: str, seed: int) -> Survey:
    size = {"imu0.z": 0.1, "boat.sway": 0.5}[sensor]
    return sailed(MODEL, seconds=80.0, faults={sensor: fault(size)}, seed=seed)


def found(survey: Survey) -> Alarm:
    (alarm,) = alarms(watched(survey), survey.config)
    return alarm


SENSORS = st.sampled_from(["imu0.z", "boat.sway"])


@settings(max_examples=10)
@given(sensor=SENSORS, seed=st.integers(0, 1000))
def test_a_motion_that_the_model_explains_changes_no_answer(sensor: str, seed: int) -> None:
    survey = failing(sensor, seed)
    dynamics, inputs = vessel()
    # Steps of the observer's grid, so that the motion is the model's own to the last digit.
    more = 0.05 * np.repeat(np.random.default_rng(seed).choice([-1.0, 1.0], 160), 10)
    step, held = held_step(dynamics, inputs, 0.05)
    motion = propagate(step, more[:-1, None] @ held.T, np.zeros(2))
    rudder, sway = survey.signals["boat.rudder"].values, survey.signals["boat.sway"].values
    wide = MODEL.replace("observer", healthy_s=())
    moved = survey_of(
        gyros(TIME_S, survey.table.rate_rad_s[:, 2] + motion[:, 1]),
        wide,
        sway + motion[:, 0],
        rudder + more,
    )
    still = found(replace(survey, config=wide))
    turned = found(moved)
    assert turned.suspects == still.suspects
    # Means over a step of a curved motion differ from the motion at its instant by a little.
    np.testing.assert_allclose(turned.low, still.low, atol=0.05 * np.abs(still.low).max())


@settings(max_examples=10)
@given(
    sensor=SENSORS,
    seed=st.integers(0, 1000),
    speed=st.sampled_from([0.01, 1.94, 3.6]),
    rudder=st.sampled_from([0.1, 57.3]),
)
def test_other_units_scale_the_sizes_and_change_nothing_else(
    sensor: str, seed: int, speed: float, rudder: float
) -> None:
    survey = failing(sensor, seed)
    dynamics, inputs = vessel()
    unit = np.array([speed, 1.0])
    told = survey.signals
    config = configured(
        A=tuple(map(tuple, (dynamics * unit[:, None] / unit).tolist())),
        B=tuple(map(tuple, (inputs * unit[:, None] / rudder).tolist())),
        healthy_s=(0.0, 30.0),
        units=tuple((NOISE * unit).tolist()),
        threshold=8.0,
    )
    scaled = survey_of(
        survey.table, config, told["boat.sway"].values * speed, told["boat.rudder"].values * rudder
    )
    plain, other = found(survey), found(scaled)
    assert (other.suspects, other.start_s, other.end_s) == (
        plain.suspects, plain.start_s, plain.end_s,
    )  # fmt: skip
    np.testing.assert_allclose(other.low, plain.low * unit, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(other.high, plain.high * unit, rtol=1e-6, atol=1e-12)


@settings(max_examples=10)
@given(sensor=SENSORS, seed=st.integers(0, 1000))
def test_the_order_of_outputs_states_and_channels_does_not_matter(sensor: str, seed: int) -> None:
    survey = failing(sensor, seed)
    settings_ = MODEL.observer
    turned = MODEL.replace(
        "observer",
        outputs=settings_.outputs[::-1],
        A=tuple(row[::-1] for row in settings_.A[::-1]),
        B=settings_.B[::-1],
        units=settings_.units[::-1],
    )
    order = [2, 0, 1]
    other = replace(survey, config=turned, table=survey.table.columns(order))
    (mine,), (theirs,) = ObserverDetector().detect(survey), ObserverDetector().detect(other)
    assert theirs.beside == mine.beside
    np.testing.assert_array_equal(theirs.accused, mine.accused[:, order])
    np.testing.assert_allclose(theirs.low, mine.low[:, order], rtol=1e-6)
