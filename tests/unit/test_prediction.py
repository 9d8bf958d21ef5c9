"""What neighbours and other gyros tell of a reading, and what stands out of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.recording import Recording, Stream
from fdilog.sources.assembly import channel_table
from fdilog.table import ChannelTable
from fdilog.windows.prediction import deviations, deviations_as_logged, innovations
from tests.tables import DEG, table_of, triads

CONFIG = Config().replace("detectors", use=("parity", "impulse", "noise"))


def shaken(n_triads: int, *, seconds: float = 90.0, size_deg_s: float = 6.0) -> ChannelTable:
    """Triads at 25 Hz that feel one vibration each in its own measure, and a little noise."""
    rng = np.random.default_rng(8)
    time_s = np.arange(round(seconds * 25.0)) / 25.0
    phase = 2 * np.pi * np.cumsum(8.0 + 1.5 * np.sin(0.2 * time_s)) / 25.0
    swelling = 1.0 + 0.5 * np.sin(0.5 * time_s)
    columns = [
        np.sqrt(2.0) * size_deg_s * DEG * gain * swelling * np.sin(phase + 0.3 * gain + axis)
        for gain in np.linspace(0.8, 1.2, n_triads)
        for axis in range(3)
    ]
    rate: NDArray[np.float64] = np.column_stack(columns)
    return table_of(time_s, rate + rng.normal(0.0, 0.3 * DEG, rate.shape))


def test_vibration_is_told_by_the_other_gyros_far_better_than_by_neighbours() -> None:
    table = shaken(3)
    deviation = deviations(table)[:, 4]
    left, weights = innovations(table, 4, np.array([1, 7]), deviation)
    assert np.std(left) < 0.1 * np.std(deviation)
    assert weights.shape == (2,)


def test_without_peers_or_readings_enough_the_deviation_is_what_is_left() -> None:
    table = shaken(2)
    deviation = deviations(table)[:, 0]
    for part, peers in ((table, np.zeros(0, np.int64)), (table.between(0.0, 1.0), np.array([3]))):
        own = deviations(part)[:, 0]
        left, weights = innovations(part, 0, peers, own)
        np.testing.assert_array_equal(left, own)
        assert not weights.any()
    assert deviation.any()


@pytest.mark.parametrize("n_triads", [2, 3])
@pytest.mark.parametrize("channel", [0, 4])
def test_an_impulse_below_the_vibration_accuses_its_channel_alone(
    n_triads: int, channel: int
) -> None:
    table = shaken(n_triads)
    rate = table.rate_rad_s.copy()
    rate[1000, channel] += 20.0 * DEG
    # The neighbours alone would not show it: the vibration deviates by as much all the time.
    assert np.abs(deviations(table)[:, channel]).max() > 15.0 * DEG
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("impulse", (table.names[channel],))
    assert finding.start_s == finding.end_s == pytest.approx(40.0)
    assert finding.size is not None
    assert finding.size.low < 20.0 * DEG < finding.size.high


def test_a_blow_that_every_gyro_feels_in_its_own_measure_is_no_impulse() -> None:
    table = shaken(2)
    rate = table.rate_rad_s.copy()
    rate[1000] += 120.0 * DEG * np.array([1.0, 0.9, 0.8, 0.6, 0.7, 0.9])
    assert judge(table_of(table.time_s, rate), CONFIG).findings == ()


def test_noise_of_one_gyro_is_told_from_the_vibration_that_all_feel() -> None:
    for n_triads in (2, 3):
        table = shaken(n_triads)
        rng = np.random.default_rng(9)
        rows = (table.time_s >= 30.0) & (table.time_s < 50.0)
        rate = table.rate_rad_s.copy()
        # No more than twice the noise that it reads anyway, and so below any ratio to the others.
        rate[rows, 3] += rng.normal(0.0, 12.0 * DEG, int(rows.sum()))
        (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
        assert (finding.kind, finding.suspects) == ("noise", ("imu1.x",))
        assert finding.start_s == pytest.approx(30.0, abs=0.3)
        assert finding.end_s == pytest.approx(50.0, abs=0.3)


def test_noise_for_most_of_a_flight_begins_and_ends_where_it_does() -> None:
    table = shaken(3)
    rng = np.random.default_rng(9)
    rows = (table.time_s >= 4.0) & (table.time_s < 77.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 3] += rng.normal(0.0, 100.0 * DEG, int(rows.sum()))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("noise", ("imu1.x",))
    assert finding.start_s == pytest.approx(4.0, abs=0.3)
    assert finding.end_s == pytest.approx(77.0, abs=0.3)


@pytest.mark.parametrize("channel", [0, 3])
@pytest.mark.parametrize("span_s", [(15.0, 40.0), (10.0, 80.0), (0.0, 90.0)])
@pytest.mark.parametrize("factor", [0.05, 0.2])
def test_a_gyro_that_hardly_reads_makes_no_noise_of_the_one_beside_it(
    channel: int, span_s: tuple[float, float], factor: float
) -> None:
    table = shaken(2)
    turning = 15.0 * DEG * np.sin(table.time_s[:, None] * [0.5, 0.83, 1.31] + [0.0, 1.0, 2.0])
    rate = table.rate_rad_s + np.tile(turning, (1, 2))
    assert judge(table_of(table.time_s, rate), CONFIG).findings == ()
    rows = (table.time_s >= span_s[0]) & (table.time_s < span_s[1])
    rate = rate.copy()
    rate[rows, channel] *= factor
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert finding.kind in ("scale", "disagreement")
    assert finding.suspects == ("imu0.x", "imu1.x")


def smoothed(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """What a first-order filter of a third of a second at 25 Hz leaves."""
    left = values.copy()
    for k in range(1, len(left)):
        left[k] = left[k - 1] + 0.12 * (values[k] - left[k - 1])
    return left


@pytest.mark.parametrize("n_triads", [2, 3])
def test_a_gyro_that_smooths_makes_no_noise_of_those_beside_it(n_triads: int) -> None:
    table = shaken(n_triads)
    rows = (table.time_s >= 30.0) & (table.time_s < 50.0)
    rate = table.rate_rad_s.copy()
    rate[rows, 1] = smoothed(rate[rows, 1])
    for finding in judge(table_of(table.time_s, rate), CONFIG).findings:
        assert "imu0.y" in finding.suspects


@pytest.mark.parametrize("smooth", [True, False])
def test_of_two_gyros_that_always_differ_in_noise_either_may_be_the_one(smooth: bool) -> None:
    table = shaken(2)
    rate = table.rate_rad_s.copy()
    if smooth:
        rate[:, 1] = smoothed(rate[:, 1])
    else:
        rate[:, 4] += np.random.default_rng(2).normal(0.0, 60.0 * DEG, len(rate))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("noise", ("imu0.y", "imu1.y"))
    assert finding.detail.startswith("imu1.y is noisy, or")


@pytest.mark.parametrize("n_triads", [2, 3])
def test_a_device_that_shakes_more_on_all_axes_is_mounted_so(n_triads: int) -> None:
    table = shaken(n_triads)
    rate = table.rate_rad_s.copy()
    louder = np.array([60.0, 80.0, 100.0]) * DEG
    rate[:, 3:6] += np.random.default_rng(3).normal(0.0, louder, (len(rate), 3))
    judged = judge(table_of(table.time_s, rate), CONFIG)
    assert judged.findings == ()
    assert "times as noisy as imu0" in str(judged.calibration[0].note)
    # One of its gyros that is noisier than that is noisy all the same.
    rate = rate.copy()
    rate[:, 4] += np.random.default_rng(4).normal(0.0, 400.0 * DEG, len(rate))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert finding.kind == "noise"
    assert finding.suspects == (("imu1.y",) if n_triads == 3 else ("imu0.y", "imu1.y"))


def test_vibration_that_swells_for_all_is_nobodys_noise() -> None:
    table = shaken(3)
    rate = table.rate_rad_s.copy()
    rate[(table.time_s >= 30.0) & (table.time_s < 50.0)] *= 6.0
    assert judge(table_of(table.time_s, rate), CONFIG).findings == ()


def test_noise_is_compared_as_it_was_logged_and_not_as_interpolation_leaves_it() -> None:
    period_ns, n = 10_000_000, 6000
    rng = np.random.default_rng(11)
    # Vibration near half the logging rate, each gyro's own; between two stamps it nearly vanishes.
    alternating = (-1.0) ** np.arange(n)[:, None] * np.sqrt(2.0)
    streams = []
    for sensor in range(2):
        swell = np.cos(2 * np.pi * np.arange(n)[:, None] / 173.0 + rng.uniform(0, 6, 3))
        rate = 4.0 * DEG * alternating * swell + rng.normal(0.0, 0.3 * DEG, (n, 3))
        streams.append(
            Stream(
                name=f"imu_{sensor}",
                time_ns=np.arange(n) * period_ns + sensor * period_ns // 2,
                columns=dict(zip("xyz", rate.T, strict=True)),
                units=dict.fromkeys("xyz", "rad/s"),
                clock="boot",
                gyro=("x", "y", "z"),
                sensor=sensor,
            )
        )
    table = channel_table(Recording(path="", format="made", bytes=0, streams=tuple(streams)))
    placed, logged = deviations(table).std(axis=0), deviations_as_logged(table).std(axis=0)
    assert (placed[3:] < 0.2 * placed[:3]).all()
    np.testing.assert_allclose(logged, logged.mean(), rtol=0.05)
    assert judge(table, CONFIG).findings == ()
    # What is removed, cut out or added beside stays in step with the readings.
    for part in (table.columns([1, 4]), table.between(10.0, 20.0)):
        assert part.deviation_rad_s is not None
        assert part.deviation_rad_s.shape == part.rate_rad_s.shape


def test_a_coarse_gyro_that_mostly_repeats_itself_at_rest_is_not_noisy_for_a_short_trip() -> None:
    rng = np.random.default_rng(5)
    time_s = np.arange(400.0)
    body = 8.0 * DEG * rng.standard_normal((400, 3)) * ((time_s >= 200) & (time_s < 212))[:, None]
    noise = rng.normal(0.0, [0.01, 0.01, 0.01, 0.1, 0.1, 0.1], (400, 6)) * DEG
    table = table_of(time_s, 0.001 * np.round((np.tile(body, 2) + noise) / 0.001))
    assert table.channels[0].step_rad_s > 0.0
    # As when the stamps of the two differ: compared as logged, before scale errors are taken out.
    table = replace(table, deviation_rad_s=deviations(table))
    assert judge(table, CONFIG).findings == ()


def test_noise_soon_after_take_off_does_not_begin_with_it() -> None:
    table = triads(3, seconds=75.0)
    rng = np.random.default_rng(9)
    rate = table.rate_rad_s * np.where(table.time_s >= 25.0, 1.0, 0.02)[:, None]
    rows = (table.time_s >= 30.0) & (table.time_s < 50.0)
    usual = deviations(table)[rows, 1].std() / np.sqrt(1.5)
    rate[rows, 1] += rng.normal(0.0, 3.9 * usual, int(rows.sum()))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("noise", ("imu0.y",))
    assert finding.start_s == pytest.approx(30.0, abs=0.3)
    assert finding.end_s == pytest.approx(50.0, abs=0.3)


def test_loud_noise_of_half_a_minute_ends_where_it_does_and_is_as_large_as_it_is() -> None:
    table = shaken(3, seconds=110.0)
    rng = np.random.default_rng(9)
    flying = np.where((table.time_s >= 10.0) & (table.time_s < 95.0), 1.0, 0.02)
    rate = table.rate_rad_s * flying[:, None]
    rows = (table.time_s >= 42.0) & (table.time_s < 74.0)
    rate[rows, 7] += rng.normal(0.0, 100.0 * DEG, int(rows.sum()))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("noise", ("imu2.y",))
    assert finding.start_s == pytest.approx(42.0, abs=0.3)
    assert finding.end_s == pytest.approx(74.0, abs=0.3)
    deviation = deviations(table)[rows] / np.sqrt(1.5)
    others = np.sqrt((deviation[:, [1, 4]] ** 2).mean())
    assert finding.size is not None
    assert finding.size.low < np.hypot(100.0 * DEG, others) / others < finding.size.high
