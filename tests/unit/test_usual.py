"""What is usual of a flight: offsets that last, and whose noise is whose."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.table import ChannelTable
from fdilog.windows.usual import usual
from tests.tables import DEG, changed, put, triads

CONFIG = Config().replace("detectors", use=("parity",))
IMU1_Y = 4


def with_a_noisy_gyro(seed: int) -> ChannelTable:
    """Gyros of which imu1.y is far noisier than the others on its axis."""
    table = triads(3, seconds=90.0, seed=seed)
    rate = table.rate_rad_s.copy()
    noise = np.random.default_rng(seed).normal(0.0, 6.0 * DEG, len(rate))
    rate[:, IMU1_Y] += noise
    return put(table, rate)


def test_a_fault_of_a_third_of_the_flight_is_not_usual() -> None:
    table = triads(3)
    faulty = changed(table, "imu1.y", 10.0, 30.0, add=2.0 * DEG)
    assert np.abs(usual(faulty).offset - usual(table).offset).max() < 0.05 * DEG


def test_offsets_from_take_off_to_landing_are_usual() -> None:
    faulty = changed(triads(3), "imu1.y", 0.0, 100.0, add=0.3 * DEG)
    found = np.degrees(usual(faulty).offset[[1, 4, 7]])
    assert found == pytest.approx([-0.1, 0.2, -0.1], abs=0.03)


def test_the_noise_of_a_channel_is_told_from_that_of_the_others() -> None:
    sigma = usual(with_a_noisy_gyro(1)).sigma
    assert sigma[IMU1_Y] > 3.0 * sigma[[1, 7]].max()


def test_a_table_without_samples_has_nothing_unusual() -> None:
    nothing = triads(2, seconds=0.0)
    assert not usual(nothing).offset.any()
    assert (usual(nothing).sigma == 1.0).all()


@pytest.mark.parametrize("seed", range(4))
def test_two_gyros_that_never_disagreed_are_told_apart_by_a_noisy_third(seed: int) -> None:
    # Over the fault the third knows to 0.2 deg/s whom it agrees with. That could also be an offset
    # of its own as large as healthy gyros have, but it has had no such offset all flight.
    table = changed(with_a_noisy_gyro(seed), "imu2.y", 30.0, 50.0, add=1.6 * DEG)
    (finding,) = judge(table, CONFIG).findings
    assert finding.suspects == ("imu2.y",)
    assert finding.start_s == pytest.approx(30.0, abs=0.5)
    assert finding.end_s == pytest.approx(50.0, abs=0.5)


def test_a_bias_from_take_off_to_landing_is_not_taken_for_usual() -> None:
    table = changed(triads(3, seconds=90.0), "imu2.y", 0.0, 100.0, add=1.6 * DEG)
    (finding,) = judge(table, CONFIG).findings
    assert (finding.kind, finding.suspects) == ("bias", ("imu2.y",))


@pytest.mark.parametrize(("vibration_deg_s", "findings"), [(0.0, 1), (8.0, 0)])
def test_a_second_of_vibration_that_stands_still_accuses_nobody(
    vibration_deg_s: float, findings: int
) -> None:
    table = triads(2, seconds=90.0, rate_hz=200.0)
    rate = table.rate_rad_s.copy()
    rate[:, IMU1_Y] += vibration_deg_s * DEG * np.sin(2.0 * np.pi * 61.8 * table.time_s)
    table = changed(put(table, rate), "imu1.y", 40.0, 41.2, add=4.0 * DEG)
    assert len(judge(table, CONFIG).findings) == findings


def test_channels_that_are_never_read_together_are_not_compared() -> None:
    table = triads(2)
    rate = table.rate_rad_s.copy()
    rate[::2, :3] = np.nan
    rate[1::2, 3:] = np.nan
    judged = judge(put(table, rate), CONFIG)
    assert judged.findings == ()
    assert set(judged.status) == {"insufficient"}
