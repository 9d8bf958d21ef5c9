"""The simulated flight is what its settings say, and its truth is the truth."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from fdilog.errors import UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.flight import Flight
from fdilog.experiments.motion import Airframe
from fdilog.experiments.simulate import GRAVITY_M_S2, GyroErrors, Timing, simulate
from fdilog.maths.geometry import named_axes

CALM = Airframe(vibration_rad_s=0.0)
PERFECT = GyroErrors(bias_rad_s=0.0, scale=0.0, mounting_rad=0.0, noise_rad_s=0.0)
TOGETHER = Timing(jitter_s=0.0, offset_s=0.0)


def everything(flight: Flight) -> bytes:
    parts = [flight.attitude, flight.logged_attitude_rad, flight.attitude_time_ns]
    for source in flight.sources:
        force = source.acceleration_m_s2
        parts += [source.time_ns, source.rate_rad_s, source.truth_rad_s, source.temperature_c]
        parts += [] if force is None else [force]
    return b"".join(part.tobytes() for part in parts) + json.dumps(flight.truth()).encode()


def rotated(quaternion: Any, vector: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_quat(np.roll(quaternion, -1, axis=-1)).apply(vector)
    return np.asarray(turned, np.float64)


def test_the_same_seed_gives_the_same_flight_and_another_seed_another() -> None:
    assert everything(simulate(20.0, seed=5)) == everything(simulate(20.0, seed=5))
    assert everything(simulate(20.0, seed=5)) != everything(simulate(20.0, seed=6))


def test_a_fault_changes_nothing_but_its_channel() -> None:
    bias = Fault(kind="bias", channel="imu1.y", start_s=8.0, end_s=12.0, size=0.1)
    without, with_bias = simulate(20.0, seed=5), simulate(20.0, seed=5, faults=[bias])
    for k, (one, other) in enumerate(zip(without.sources, with_bias.sources, strict=True)):
        changed = one.rate_rad_s != other.rate_rad_s
        time_s = (one.time_ns - without.zero_ns) / 1e9
        touched = (time_s >= 8.0) & (time_s <= 12.0)
        for i in range(3):
            assert np.array_equal(changed[:, i], touched & ((k, i) == (1, 1)))


def test_the_attitude_is_the_integral_of_the_body_rate() -> None:
    from scipy.spatial.transform import Rotation

    flight = simulate(30.0, seed=2)
    step_s = 1e-3
    middle_s = np.arange(0.0, 30.0, step_s) + step_s / 2
    turns = Rotation.from_rotvec(flight.motion.body_rate(middle_s) * step_s)
    attitude = Rotation.from_quat(np.roll(flight.attitude[0], -1))
    for turn in turns[: round(29.9 / step_s)]:
        attitude *= turn
    reached = Rotation.from_quat(np.roll(flight.attitude[299], -1))
    # The midpoint rule is left with some 1e-5 rad after 30 s.
    assert (attitude.inv() * reached).magnitude() < 1e-4


def test_perfect_gyros_read_the_body_rate_along_their_axes() -> None:
    exact = GyroErrors(
        bias_rad_s=0.0, scale=0.0, mounting_rad=0.0, noise_rad_s=0.0, full_scale_rad_s=0.0
    )
    flight = simulate(
        20.0, geometry="matasov", airframe=CALM, errors=exact, timing=TOGETHER, seed=1
    )
    (source,) = flight.sources
    rate = flight.motion.body_rate((source.time_ns - flight.zero_ns) / 1e9)
    np.testing.assert_allclose(source.rate_rad_s, rate @ named_axes("matasov").T, atol=1e-12)
    np.testing.assert_allclose(source.truth_rad_s, rate @ named_axes("matasov").T, atol=1e-12)
    assert source.acceleration_m_s2 is None
    assert np.degrees(np.abs(source.rate_rad_s)).max() > 10.0


def test_readings_are_whole_counts_of_16_bits_over_2000_deg_s() -> None:
    flight = simulate(20.0, seed=1)
    step = np.radians(2000.0) / 2**15
    counts = flight.sources[0].rate_rad_s / step
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert np.diff(np.unique(np.round(counts))).min() == 1.0


def test_a_gyro_reads_no_more_than_its_full_scale() -> None:
    errors = GyroErrors(full_scale_rad_s=0.2)
    rates = np.concatenate([s.rate_rad_s for s in simulate(20.0, seed=1, errors=errors).sources])
    assert rates.min() == -0.2
    assert rates.max() == pytest.approx(0.2 * (1 - 2.0**-15))


def test_white_noise_is_as_strong_as_stated() -> None:
    noisy = GyroErrors(bias_rad_s=0.0, scale=0.0, mounting_rad=0.0, noise_rad_s=0.01)
    flight = simulate(100.0, errors=noisy, airframe=CALM, seed=4)
    errors = np.concatenate([s.rate_rad_s - s.truth_rad_s for s in flight.sources], axis=1)
    # 5000 readings a channel: the standard deviation of a standard deviation is 1 %.
    np.testing.assert_allclose(errors.std(axis=0), 0.01, rtol=0.04)
    together = np.corrcoef(errors.T) - np.eye(9)
    assert np.abs(together).max() < 0.06


def test_vibration_is_as_strong_as_stated_and_mostly_felt_by_all() -> None:
    shaken = Airframe(vibration_rad_s=0.05, own_share=0.2, tilt_rad=0.0, heading_rad=0.0,
                      doublet_rad=0.0, rest_s=0.0)  # fmt: skip
    flight = simulate(100.0, airframe=shaken, errors=PERFECT, timing=TOGETHER, seed=4)
    inside = slice(200, 4800)
    felt = np.stack([source.truth_rad_s[inside] for source in flight.sources])
    np.testing.assert_array_equal(felt[0], felt[1])
    np.testing.assert_allclose(felt[0].std(axis=0), 0.05, rtol=0.1)
    own = np.stack([s.rate_rad_s[inside] - s.truth_rad_s[inside] for s in flight.sources])
    np.testing.assert_allclose(own.std(axis=1), 0.2 * 0.05, rtol=0.1)


def test_nothing_shakes_or_turns_while_the_motors_are_off() -> None:
    flight = simulate(60.0, seed=3)
    source = flight.sources[0]
    time_s = (source.time_ns - flight.zero_ns) / 1e9
    rest = (time_s < 4.9) | (time_s > 55.1)
    assert not source.truth_rad_s[rest].any()
    assert source.truth_rad_s[~rest].std() > np.radians(5.0)
    assert flight.recording().armed == ((flight.zero_ns + 5 * 10**9, flight.zero_ns + 55 * 10**9),)


def test_healthy_errors_are_what_the_truth_says() -> None:
    flight = simulate(100.0, seed=7, airframe=CALM, timing=TOGETHER)
    for source in flight.sources:
        error = source.rate_rad_s - source.truth_rad_s
        turned = source.axes + np.cross(source.mounting_rad, source.axes)
        expected = source.scale * (source.truth_rad_s @ turned.T) + source.bias_rad_s
        # What is left is white noise of 0.1 deg/s over 5000 readings.
        left = error + source.truth_rad_s - expected
        np.testing.assert_allclose(left.mean(axis=0), 0.0, atol=5 * np.radians(0.1) / np.sqrt(5000))


def test_healthy_errors_are_drawn_from_their_sigmas_and_clamped() -> None:
    flight = simulate(1.0, 4.0, sources=400, seed=9)
    biases = np.concatenate([source.bias_rad_s for source in flight.sources])
    # 1200 draws: the standard deviation of a standard deviation is 2 %.
    assert np.std(biases) == pytest.approx(np.radians(0.1), rel=0.1)
    assert 2.5 * np.radians(0.1) < np.abs(biases).max() <= 3 * np.radians(0.1)


def test_late_stamps_show_the_body_rate_of_an_earlier_instant() -> None:
    exact = GyroErrors(
        bias_rad_s=0.0, scale=0.0, mounting_rad=0.0, noise_rad_s=0.0, full_scale_rad_s=0.0
    )
    late = Timing(jitter_s=0.0, offset_s=0.02)
    flight = simulate(40.0, airframe=CALM, errors=exact, timing=late, seed=8)
    offsets = [source.offset_s for source in flight.sources]
    assert len(set(offsets)) == 3
    for source in flight.sources:
        sampled_s = (source.time_ns - flight.zero_ns) / 1e9 - source.offset_s
        np.testing.assert_allclose(
            source.rate_rad_s, flight.motion.body_rate(sampled_s), atol=1e-12
        )


def test_stamps_increase_by_jittered_periods_in_whole_microseconds() -> None:
    flight = simulate(100.0, 50.0, timing=Timing(jitter_s=0.001), seed=1)
    first, second, _ = (source.time_ns for source in flight.sources)
    assert np.array_equal(first, second)
    assert first[0] == flight.zero_ns
    steps_s = np.diff(first) / 1e9
    assert steps_s.min() > 0
    assert not (first % 1000).any()
    assert steps_s.std() == pytest.approx(np.sqrt(2) * 0.001, rel=0.1)
    assert steps_s.mean() == pytest.approx(0.02, rel=1e-3)


def test_sources_can_have_clocks_and_rates_of_their_own() -> None:
    flight = simulate(20.0, [50.0, 50.0, 20.0], timing=Timing(shared=False), seed=1)
    first, second, third = (source.time_ns for source in flight.sources)
    assert len(first) == len(second) == 1000
    assert len(third) == 400
    assert not np.isin(second, first).any()
    assert min(first[0], second[0], third[0]) == flight.zero_ns


def test_the_accelerometer_feels_gravity_in_the_attitude_flown() -> None:
    flight = simulate(60.0, 10.0, seed=6, timing=TOGETHER)
    force = flight.sources[0].acceleration_m_s2
    assert force is not None
    level = rotated(flight.attitude, force)
    expected = [0.0, 0.0, -GRAVITY_M_S2]
    # 600 readings of 0.4 m/s^2 each.
    np.testing.assert_allclose(level.mean(axis=0), expected, atol=5 * 0.4 / np.sqrt(600))


def test_the_logged_attitude_is_nearly_the_true_one() -> None:
    from scipy.spatial.transform import Rotation

    flight = simulate(100.0, seed=6)
    logged = Rotation.from_euler("ZYX", flight.logged_attitude_rad[:, ::-1])
    true = Rotation.from_quat(np.roll(flight.attitude, -1, axis=1))
    apart = np.degrees((true.inv() * logged).magnitude())
    assert 0.05 < np.median(apart) < 1.5
    assert np.abs(flight.logged_attitude_rad[:, 2]).max() <= np.pi


def test_a_dropout_takes_every_reading_of_its_source() -> None:
    silent = Fault(kind="dropout", channel="imu1", start_s=8.0, end_s=9.0)
    flight = simulate(20.0, seed=5, faults=[silent])
    lengths = [len(source.time_ns) for source in flight.sources]
    assert lengths[0] == lengths[2] == 1000
    assert lengths[1] in (949, 950)
    source = flight.sources[1]
    assert {len(source.rate_rad_s), len(source.truth_rad_s), len(source.temperature_c)} == {
        lengths[1]
    }
    gap_s = np.diff(source.time_ns).max() / 1e9
    assert 1.0 < gap_s < 1.06


def test_a_stuck_gyro_repeats_a_reading_that_was_logged() -> None:
    stuck = Fault(kind="stuck", channel="imu0.z", start_s=8.0)
    flight, healthy = simulate(20.0, seed=5, faults=[stuck]), simulate(20.0, seed=5)
    time_s = (flight.sources[0].time_ns - flight.zero_ns) / 1e9
    first = int(np.argmax(time_s >= 8.0))
    after = flight.sources[0].rate_rad_s[:, 2]
    assert set(after[first:]) == {healthy.sources[0].rate_rad_s[first - 1, 2]}


def test_five_times_the_noise_is_five_times_what_the_gyro_has_of_its_own() -> None:
    noisy = Fault(kind="noise", channel="imu2.x", start_s=20.0, end_s=80.0, size=5.0)
    flight = simulate(100.0, seed=5, faults=[noisy], timing=TOGETHER)
    source = flight.sources[2]
    error = source.rate_rad_s - source.truth_rad_s
    inside = slice(1000, 4000)
    own = np.hypot(np.radians(0.1), 0.15 * np.radians(2.0))
    assert error[inside, 0].std() == pytest.approx(5 * own, rel=0.08)
    assert error[inside, 1].std() == pytest.approx(own, rel=0.15)


def test_channels_are_named_as_an_analysis_names_them() -> None:
    from fdilog.config import Config
    from fdilog.sources.gyros import choose

    for settings in ({"sources": 2}, {"geometry": "pentagon"}, {"geometry": "dodecahedron"}):
        flight = simulate(10.0, seed=1, **settings)
        gyros, _ = choose(flight.recording(), Config())
        assert tuple(name for gyro in gyros for name in gyro.channel_names) == flight.channels
    halves = simulate(10.0, geometry="mirrored-triads", sources=2)
    assert halves.channels == ("imu0.1", "imu0.2", "imu0.3", "imu1.1", "imu1.2", "imu1.3")


def test_the_truth_is_plain_json() -> None:
    bias = Fault(kind="bias", channel="imu1.y", size=0.1)
    truth = simulate(20.0, seed=5, faults=[bias]).truth()
    assert json.loads(json.dumps(truth, allow_nan=False)) == truth
    assert truth["faults"] == [bias.to_dict()]


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"geometry": "matasof"}, "matasov"),
        ({"geometry": [[0.0, 0.0, 0.0]]}, "zero"),
        ({"sources": 0}, "at least one source"),
        ({"geometry": "matasov", "sources": 4}, "cannot be divided"),
        ({"rate_hz": [50.0, 50.0]}, "one for each of 3 sources"),
        ({"rate_hz": -1.0}, "above zero"),
        ({"duration_s": 0.02}, "no two readings"),
        ({"faults": [Fault(kind="dead", channel="imu3.x")]}, "no channel 'imu3.x'"),
        ({"faults": [Fault(kind="dead", channel="imu1")]}, "no channel 'imu1'"),
        ({"faults": [Fault(kind="dead", channel="imu1.x", start_s=30.0)]}, "the flight lasts"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(settings: dict[str, Any], said: str) -> None:
    with pytest.raises(UsageError, match=said):
        simulate(**({"duration_s": 10.0} | settings))
