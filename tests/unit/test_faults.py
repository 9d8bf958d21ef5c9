"""Each kind of fault does to the readings what it says, and nothing outside of its span."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from fdilog.errors import UsageError
from fdilog.experiments.faults import KINDS, SIZE_UNITS, Fault, apply, noise_sigma, touched

TIME_S = np.arange(0.0, 100.0, 0.02)
BEFORE = TIME_S < 40.0
AFTER = TIME_S > 60.0
INSIDE = ~BEFORE & ~AFTER
SIZES = {"bias": 0.05, "drift": 0.002, "scale": 1.2, "noise": 5.0, "impulse": 1.5, "saturated": 0.1}


def fault(kind: Any, **changes: Any) -> Fault:
    settings: dict[str, Any] = {
        "channel": "imu1.y",
        "start_s": 40.0,
        "end_s": 60.0,
        "size": SIZES.get(kind),
    }
    return Fault(kind=kind, **(settings | changes))


def healthy() -> np.ndarray[Any, np.dtype[np.float64]]:
    rng = np.random.default_rng(1)
    return 0.3 * np.sin(0.7 * TIME_S) + 0.002 * rng.standard_normal(len(TIME_S))


def faulty(kind: Any, **changes: Any) -> np.ndarray[Any, np.dtype[np.float64]]:
    rng = np.random.default_rng(2)
    return apply(fault(kind, **changes), TIME_S, healthy(), rng, noise_rad_s=0.002)


@pytest.mark.parametrize("kind", KINDS)
def test_readings_outside_of_the_span_keep_every_bit(kind: str) -> None:
    after = faulty(kind)
    assert after[BEFORE].tobytes() == healthy()[BEFORE].tobytes()
    assert after[AFTER].tobytes() == healthy()[AFTER].tobytes()
    assert not np.array_equal(after[INSIDE], healthy()[INSIDE], equal_nan=False)


@pytest.mark.parametrize("kind", KINDS)
def test_the_readings_that_were_given_are_left_alone(kind: str) -> None:
    given = healthy()
    apply(fault(kind), TIME_S, given, np.random.default_rng(2), noise_rad_s=0.002)
    assert given.tobytes() == healthy().tobytes()


def test_a_bias_is_added() -> None:
    np.testing.assert_allclose((faulty("bias") - healthy())[INSIDE], 0.05, atol=1e-15)


def test_a_drift_grows_from_nothing() -> None:
    error = (faulty("drift") - healthy())[INSIDE]
    assert error[0] == 0.0
    np.testing.assert_allclose(error[-1], 0.002 * 20.0, atol=1e-12)
    np.testing.assert_allclose(np.diff(error), 0.002 * 0.02, atol=1e-12)


def test_a_scale_of_1_2_reads_a_fifth_too_much() -> None:
    np.testing.assert_allclose(faulty("scale")[INSIDE], 1.2 * healthy()[INSIDE], rtol=1e-15)


def test_a_noise_factor_of_five_makes_five_times_the_noise() -> None:
    truth = 0.3 * np.sin(0.7 * TIME_S)
    noise = (faulty("noise") - truth)[INSIDE]
    # 1001 readings: the standard deviation of a standard deviation is 2.2 %.
    assert np.std(noise) == pytest.approx(5 * 0.002, rel=0.1)


def test_noise_may_change_along_the_flight() -> None:
    rng = np.random.default_rng(2)
    sigma = np.where(TIME_S < 50.0, 0.0, 0.01)
    added = apply(fault("noise"), TIME_S, healthy(), rng, sigma) - healthy()
    assert not added[TIME_S < 50.0].any()
    assert np.std(added[INSIDE & (TIME_S >= 50.0)]) == pytest.approx(math.sqrt(24) * 0.01, rel=0.1)


def test_noise_cannot_be_multiplied_where_there_is_none() -> None:
    with pytest.raises(UsageError, match="no noise to multiply"):
        apply(fault("noise"), TIME_S, healthy(), np.random.default_rng(2))


def test_an_impulse_hits_the_first_reading_of_its_span_alone() -> None:
    error = faulty("impulse", start_s=40.01) - healthy()
    assert np.flatnonzero(error).tolist() == [int(np.argmax(TIME_S >= 40.01))]
    assert error.max() == pytest.approx(1.5)


def test_impulses_are_spread_over_the_span() -> None:
    hits = np.flatnonzero(faulty("impulse", count=4) - healthy())
    assert TIME_S[hits].tolist() == pytest.approx([40.0, 45.0, 50.0, 55.0], abs=0.03)


def test_a_saturated_gyro_reads_no_more_than_its_limit() -> None:
    after = faulty("saturated")[INSIDE]
    assert np.abs(after).max() == 0.1
    below = np.abs(healthy()[INSIDE]) < 0.1
    assert after[below].tobytes() == healthy()[INSIDE][below].tobytes()


def test_a_stuck_gyro_repeats_the_last_reading_before_the_start() -> None:
    assert np.unique(faulty("stuck")[INSIDE]).tolist() == [healthy()[BEFORE][-1]]


def test_a_gyro_that_is_stuck_from_the_start_repeats_its_first_reading() -> None:
    assert np.unique(faulty("stuck", start_s=0.0)[~AFTER]).tolist() == [healthy()[0]]


def test_a_dead_gyro_reads_exactly_zero() -> None:
    assert not faulty("dead")[INSIDE].any()


def test_a_dropout_leaves_no_readings() -> None:
    assert np.isnan(faulty("dropout")[INSIDE]).all()


def test_a_fault_outside_of_the_flight_touches_nothing() -> None:
    late = fault("impulse", start_s=200.0, end_s=300.0)
    assert not touched(late, TIME_S).any()
    after = apply(late, TIME_S, healthy(), np.random.default_rng(2))
    assert after.tobytes() == healthy().tobytes()


def test_the_noise_of_a_flight_is_told_from_its_motion() -> None:
    rng = np.random.default_rng(3)
    flight = np.sin(2 * np.pi * 0.5 * TIME_S) + 0.004 * rng.standard_normal(len(TIME_S))
    assert noise_sigma(flight) == pytest.approx(0.004, rel=0.06)
    flight[100:200] = np.nan
    assert noise_sigma(flight) == pytest.approx(0.004, rel=0.06)
    assert noise_sigma(flight[:3]) == 0.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_truth_survives_json(kind: Any) -> None:
    whole = Fault(kind=kind, channel="imu0.x", size=SIZES.get(kind))
    for one in (fault(kind), whole):
        truth = json.loads(json.dumps(one.to_dict(), allow_nan=False))
        assert Fault.from_dict(truth) == one
        assert truth["unit"] == SIZE_UNITS.get(kind)


@pytest.mark.parametrize(
    ("kind", "changes", "said"),
    [
        ("biass", {"size": 1.0}, "did you mean 'bias'"),
        ("bias", {"size": None}, r"needs a size \[rad/s\]"),
        ("bias", {"size": math.nan}, "needs a size"),
        ("stuck", {"size": 1.0}, "has no size"),
        ("noise", {"size": 0.5}, "below 1"),
        ("saturated", {"size": 0.0}, "above zero"),
        ("bias", {"start_s": 61.0}, "starts after it ends"),
        ("bias", {"end_s": math.nan}, "starts after it ends"),
        ("bias", {"count": 2}, "count"),
        ("impulse", {"count": 0}, "count"),
    ],
)
def test_a_fault_that_makes_no_sense_is_refused(
    kind: str, changes: dict[str, Any], said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        fault(kind, **changes)
