"""Healthy gyros that are logged late, with gaps, or at different rates: nobody is accused."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.detectors.excess_noise import NoiseDetector
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.sources.assembly import assemble, channel_table
from fdilog.sources.clocks import clean_stamps, place, time_base
from fdilog.table import ChannelTable
from fdilog.windows.calibration import _corrected
from fdilog.windows.survey import Survey, cut
from tests.tables import DEG, changed, table_of, triads

Floats = NDArray[np.float64]
CONFIG = Config().replace("detectors", use=("parity", "impulse", "noise"))
SECOND = 1_000_000_000


def recording(*sources: tuple[Floats, Floats]) -> Recording:
    """Sources of stamps (n,) [s] and readings (n, 3) [rad/s]."""
    streams = tuple(
        Stream(
            name=f"imu_{sensor}",
            time_ns=np.round(stamp_s * SECOND).astype(np.int64),
            columns=dict(zip("xyz", rate.T, strict=True)),
            units=dict.fromkeys("xyz", "rad/s"),
            clock="boot",
            gyro=("x", "y", "z"),
            sensor=sensor,
        )
        for sensor, (stamp_s, rate) in enumerate(sources)
    )
    return Recording(path="", format="made", bytes=0, streams=streams)


def flips(time_s: Floats) -> Floats:
    """Rates of hard turns, 300 deg/s within 50 ms, every five seconds, (n, 3). [rad/s]"""
    edges = np.arange(5.0, 100.0, 5.0)
    ramp = np.clip((time_s[:, None] - edges) / 0.05, 0.0, 1.0)
    level = ramp @ np.where(np.arange(len(edges)) % 2, -300.0, 300.0) * DEG
    return np.column_stack([level, -0.5 * level, 0.3 * level])


def vibration(time_s: Floats, seed: int, highest_hz: float = 40.0) -> Floats:
    """Vibration of one gyro, smooth at 200 Hz and folded at 25 Hz, (n, 3). [rad/s]"""
    rng = np.random.default_rng(seed)
    hz = rng.uniform(5.0, highest_hz, 60)
    phase = rng.uniform(0, 2 * np.pi, (60, 3))
    waves = np.sin(2 * np.pi * hz[:, None, None] * time_s[:, None] + phase[:, None, :])
    return np.asarray(waves.sum(axis=0) * 0.3 * DEG)


def test_records_that_were_held_up_are_left_out_and_the_last_of_the_burst_stays() -> None:
    even = np.arange(0.0, 20.0, 0.02)
    late = even.copy()
    late[500:504] = late[504] - np.array([0.004, 0.003, 0.002, 0.001])
    (clean,) = clean_stamps([np.round(late * SECOND).astype(np.int64)])
    assert clean.late == 4
    assert np.setdiff1d(np.arange(len(even)), clean.keep).tolist() == [500, 501, 502, 503]
    rate = np.random.default_rng(1).normal(0.0, DEG, (len(even), 3))
    (problem,) = assemble(recording((late, rate), (even, 2.0 * rate)), CONFIG).problems
    assert problem.note
    assert problem.what == "imu_0: 4 records were held up and stamped too late, in bursts; left out"


@pytest.mark.parametrize("pair_s", [0.002, 0.02])
def test_records_that_always_come_in_pairs_are_not_held_up(pair_s: float) -> None:
    stamps = np.sort(np.concatenate([np.arange(0, 20, 0.04), np.arange(0, 20, 0.04) + pair_s]))
    (clean,) = clean_stamps([np.round(stamps * SECOND).astype(np.int64)])
    assert clean.late == 0


def test_one_lost_record_is_bridged_and_beside_a_hole_nothing_is_taken_for_another_instant() -> (
    None
):
    base_s, other_s = np.arange(0.0, 4.0, 0.04), np.arange(0.0, 4.0, 0.04) + 0.015
    kept = np.ones(len(other_s), bool)
    kept[[30, 60, 61, 62]] = False
    base_ns, other_ns = (np.round(s * SECOND).astype(np.int64) for s in (base_s, other_s))
    base = time_base([base_ns, other_ns], dropout_s=0.5)
    # A steep turn: a reading taken for another instant would be off.
    values, valid = place(other_ns[kept], 100.0 * other_s[kept][:, None], base)
    assert valid[31, 0]
    assert not valid[61:63, 0].any()
    np.testing.assert_allclose(values[valid], 100.0 * base_s[:, None][valid], atol=1.6)
    inner = valid[1:, 0]
    np.testing.assert_allclose(values[1:][inner, 0], 100.0 * base_s[1:][inner], atol=1e-9)


@pytest.mark.parametrize("rate_hz", [25.0, 100.0])
def test_edges_of_hard_turns_read_a_few_milliseconds_apart_are_no_impulses(rate_hz: float) -> None:
    time_s = np.arange(0.0, 100.0, 1.0 / rate_hz)
    rng = np.random.default_rng(3)
    late_s = np.zeros_like(time_s)
    edges = np.searchsorted(time_s, [20.02, 55.02, 80.02])
    late_s[edges] = [0.004, -0.004, 0.004]
    rates = [
        flips(time_s - late) + rng.normal(0.0, 0.1 * DEG, (len(time_s), 3))
        for late in (late_s, 0.0 * time_s)
    ]
    apart = np.abs(rates[0] - rates[1])[edges, 0]
    assert (apart > 20.0 * DEG).all()
    assert judge(table_of(time_s, np.hstack(rates)), CONFIG).findings == ()
    # Without the turn it is one.
    still = rates[0] - flips(time_s - late_s)
    still[edges, 0] += apart
    peers = rates[1] - flips(time_s)
    findings = judge(table_of(time_s, np.hstack([still, peers])), CONFIG).findings
    assert {(f.kind, f.suspects) for f in findings} == {("impulse", ("imu0.x",))}


def test_a_blow_that_a_gyro_read_at_another_instant_misses_is_no_impulse() -> None:
    rng = np.random.default_rng(4)
    sources: list[tuple[Floats, Floats]] = []
    for late in (0.0, 0.02):
        stamp_s = np.arange(0.0, 200.0, 0.05) + late
        rate = vibration(stamp_s, 7) * 0.2 + rng.normal(0, 0.1 * DEG, (len(stamp_s), 3))
        # Every blow of 25 deg/s lasts 10 ms: only the first gyro is read meanwhile.
        blow = np.exp(-(((stamp_s[:, None] - np.arange(20.0, 200.0, 30.0)) / 0.005) ** 2)).sum(
            axis=1
        )
        sources.append((stamp_s, rate + 25.0 * DEG * blow[:, None] * [1.0, 0.0, 0.0]))
    assert np.abs(sources[0][1]).max() > 20.0 * DEG > 4.0 * np.abs(sources[1][1]).max()
    assert judge(channel_table(recording(*sources)), CONFIG).findings == ()


def test_what_one_of_its_peers_reads_too_is_no_impulse_of_a_slow_gyro() -> None:
    rng = np.random.default_rng(4)
    sources: list[tuple[Floats, Floats]] = []
    for rate_hz in (50.0, 10.0, 10.0):
        stamp_s = np.arange(0.0, 300.0, 1.0 / rate_hz)
        if len(sources) == 2:  # it misses the blow
            stamp_s = stamp_s[np.abs(stamp_s - 140.0) > 0.15]
        rate = rng.normal(0.0, 4.0 * DEG, (len(stamp_s), 3))
        # At ten readings a second the blow is one reading, at fifty several, none of them sudden.
        rate[:, 0] += 150.0 * DEG * np.exp(-(((stamp_s - 140.0) / 0.05) ** 2))
        sources.append((stamp_s, rate))
    assert judge(channel_table(recording(*sources)), CONFIG).findings == ()


def test_an_impulse_of_a_gyro_that_is_read_together_with_another_is_still_found() -> None:
    table = triads(2, seconds=100.0, rate_hz=25.0)
    rate = table.rate_rad_s.copy()
    rate[1000, 3] += 30.0 * DEG
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("impulse", ("imu1.x",))


def test_a_slower_gyro_is_not_noisier_for_its_vibration_being_less_smooth() -> None:
    rng = np.random.default_rng(5)
    sources = []
    for rate_hz in (200.0, 25.0):
        time_s = np.arange(0.0, 100.0, 1.0 / rate_hz)
        noise = rng.normal(0.0, 0.02 * DEG, (len(time_s), 3))
        sources.append((time_s, vibration(time_s, int(rate_hz)) + noise))
    table = channel_table(recording(*sources))
    assert table.deviation_rad_s is not None
    logged = np.nanstd(table.deviation_rad_s, axis=0)
    np.testing.assert_allclose(logged, logged.mean(), rtol=0.2)
    assert judge(table, CONFIG).findings == ()


def test_what_is_not_known_of_a_reading_is_not_taken_for_silence() -> None:
    rng = np.random.default_rng(6)
    time_s = np.arange(0.0, 300.0, 0.01)
    rate = rng.normal(0.0, 2.0 * DEG, (len(time_s), 6))
    # Of the second gyro mostly pairs of readings are there, of which none has two neighbours.
    place_in_60 = np.arange(len(time_s)) % 60
    there = (place_in_60 % 6 < 2) | (place_in_60 == 2)
    rate[~there, 3:] = np.nan
    assert judge(table_of(time_s, rate), CONFIG).findings == ()


def test_noise_in_windows_that_hold_rest_and_flight_is_that_of_both() -> None:
    rng = np.random.default_rng(7)
    time_s = np.arange(0.0, 120.0, 0.04)
    table = table_of(time_s, rng.normal(0.0, 0.1 * DEG, (len(time_s), 6)))
    # The medians of the two gyros fall on either side: 45 and 55 % of the window are in flight.
    rate = table.rate_rad_s.copy()
    for channel, from_s in ((0, 61.0), (3, 59.0)):
        loud = time_s >= from_s
        rate[loud, channel] = rng.normal(0.0, 8.0 * DEG, int(loud.sum()))
    table = table_of(time_s, rate)
    (windows,) = (w for w in cut(table, CONFIG) if w.length_s == 20.0)
    (evidence,) = NoiseDetector().detect(Survey(table=table, windows=windows, config=CONFIG))
    middle = int(np.argmin(np.abs((windows.start_s + windows.end_s) / 2 - 60.0)))
    assert not evidence.accused[middle, [0, 3]].any()


def test_noise_for_twenty_seconds_begins_where_it_does_and_not_with_the_longest_window() -> None:
    table = triads(3, seconds=200.0, sigma_deg_s=2.0)
    rate = table.rate_rad_s.copy()
    inside = (table.time_s >= 100.0) & (table.time_s < 120.0)
    rate[inside, 4] += np.random.default_rng(2).normal(0.0, 12.0 * DEG, int(inside.sum()))
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("noise", ("imu1.y",))
    assert finding.start_s == pytest.approx(100.0, abs=0.3)
    assert finding.end_s == pytest.approx(120.0, abs=0.3)


def _named(tables: Sequence[ChannelTable]) -> list[tuple[str, tuple[str, ...]]]:
    return [(f.kind, f.suspects) for table in tables for f in judge(table, CONFIG).findings]


def test_a_misalignment_is_calibrated_where_the_sources_are_of_different_rates() -> None:
    rng = np.random.default_rng(8)
    sources = []
    for rate_hz, turned in ((100.0, 0.0), (25.0, 0.012)):
        time_s = np.arange(0.0, 200.0, 1.0 / rate_hz)
        spin = 150.0 * DEG * np.sin(2 * np.pi * time_s[:, None] * [0.01, 0.013, 0.017])
        rate = spin + turned * spin[:, [1, 2, 0]]
        sources.append((time_s, rate + rng.normal(0.0, 0.1 * DEG, (len(time_s), 3))))
    assert _named([channel_table(recording(*sources))]) == []


def test_a_large_bias_does_not_come_up_on_the_other_axes_by_way_of_misalignment() -> None:
    rng = np.random.default_rng(9)
    time_s = np.arange(0.0, 120.0, 0.04)
    spin = 40.0 * DEG * np.sin(2 * np.pi * time_s[:, None] * [0.11, 0.13, 0.17])
    rates = [
        spin + turned * spin[:, [1, 2, 0]] + rng.normal(0.0, 0.1 * DEG, (len(time_s), 3))
        for turned in (0.0, 0.01, -0.012)
    ]
    rate = np.hstack(rates)
    rate[(time_s >= 40.0) & (time_s < 70.0), 3] += 400.0 * DEG
    assert _named([table_of(time_s, rate)]) == [("bias", ("imu1.x",))]


@pytest.mark.parametrize("n_triads", [2, 3])
def test_a_misalignment_is_taken_out_by_the_rate_of_the_gyros_that_are_not_far_off(
    n_triads: int,
) -> None:
    table = triads(n_triads)
    error_per_rate = np.zeros((3 * n_triads, 3))
    error_per_rate[[2, 5], 0] = 0.02, -0.02
    sound = _corrected(table, error_per_rate).rate_rad_s
    biased = changed(table, "imu1.x", 20.0, 40.0, add=400.0 * DEG)
    left = _corrected(biased, error_per_rate).rate_rad_s - sound
    # By the mean of two it would be 4 deg/s.
    assert np.abs(np.delete(left, 3, axis=1)).max() < 0.1 * DEG


def test_a_bias_is_isolated_from_those_that_are_left_while_a_third_gyro_is_silent() -> None:
    table = triads(4, seconds=120.0)
    rate = table.rate_rad_s.copy()
    time_s = table.time_s
    rate[time_s >= 40.0, 0] = np.nan
    rate[time_s >= 40.0, 3] += 10.0 * DEG
    (finding,) = (f for f in judge(table_of(time_s, rate), CONFIG).findings if f.kind == "bias")
    assert finding.suspects == ("imu1.x",)
    assert finding.start_s == pytest.approx(40.0, abs=0.1)


def test_vibration_that_stands_still_for_a_second_or_two_is_no_bias() -> None:
    rng = np.random.default_rng(10)
    time_s = np.arange(0.0, 200.0, 0.02)
    # Folded to 11 Hz by the logging, and now to none at all, at its peak.
    hz = np.where((time_s >= 99.0) & (time_s < 101.0), 0.0, 11.3)
    phase = 2 * np.pi * np.cumsum(hz) * 0.02
    phase -= phase[np.searchsorted(time_s, 99.5)]
    rate = rng.normal(0.0, 2.0 * DEG, (len(time_s), 6))
    rate[:, 0] += 6.0 * DEG * np.cos(phase)
    assert judge(table_of(time_s, rate), CONFIG).findings == ()


def test_large_impulses_do_not_hide_one_another_where_few_other_peaks_are() -> None:
    table = triads(2, seconds=30.0, sigma_deg_s=0.2)
    rate = table.rate_rad_s.copy()
    at = np.arange(150, 1500, 250)
    rate[at, 0] += 2000.0 * DEG
    findings = judge(table_of(table.time_s, rate), CONFIG).findings
    assert {f.kind for f in findings} == {"impulse"}
    assert sorted(round(f.start_s * 50) for f in findings) == at.tolist()
    assert {f.suspects for f in findings} == {("imu0.x",)}


@pytest.mark.parametrize(("first_s", "whole"), [(0.4, None), (5.0, True), (40.0, False)])
def test_a_gyro_that_is_recorded_later_than_the_others_is_said_to_be(
    first_s: float, whole: bool | None
) -> None:
    table = triads(2, seconds=100.0)
    later = table.time_s >= first_s
    sources = [
        (table.time_s, table.rate_rad_s[:, :3]),
        (table.time_s[later], table.rate_rad_s[later, 3:]),
    ]
    problems = assemble(recording(*sources), CONFIG).problems
    said = f"imu_1: nothing recorded before {first_s:.3f} s, while other gyros were"
    expected = [] if whole is None else [(said, whole)]
    assert [(problem.what, problem.note) for problem in problems] == expected


@pytest.mark.parametrize(
    ("from_s", "until_s", "said"),
    [
        (0, 60, []),
        (0, 40, ["no gyro was recorded after 40.000 s, while attitude was until 59.900 s"]),
        (20, 60, ["no gyro was recorded before 0.000 s, while attitude was from -20.000 s"]),
        (3, 60, []),
    ],
)
def test_gyros_that_are_silent_while_the_attitude_is_not_are_a_loss(
    from_s: int, until_s: int, said: list[str]
) -> None:
    whole = simulate(60.0, 25.0, sources=2, seed=3).recording()
    streams = []
    for stream in whole.streams:
        time_ns = stream.time_ns - whole.streams[0].time_ns[0]
        kept = (time_ns >= from_s * 10**9) & (time_ns < until_s * 10**9)
        kept |= not stream.gyro
        columns = {name: column[kept] for name, column in stream.columns.items()}
        streams.append(replace(stream, time_ns=stream.time_ns[kept], columns=columns))
    problems = assemble(replace(whole, streams=tuple(streams)), CONFIG).problems
    assert [problem.what for problem in problems] == said
    assert all(problem.seconds_lost and not problem.note for problem in problems)


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_a_restart_is_no_hole_whatever_the_clocks_are_off(late_s: float) -> None:
    slow_s, fast_s = np.arange(0.0, 120.0, 0.01), np.arange(0.0, 120.0, 0.005)

    def source(time_s: Floats, late_s: float) -> tuple[Floats, Floats]:
        phase = np.arange(3.0)
        rate = 0.5 * np.sin(2 * np.pi * time_s[:, None] * [0.31, 0.27, 0.23] + phase)
        stamp_s = time_s + late_s
        return np.where(stamp_s < 60.0, stamp_s, stamp_s - 60.0), rate

    problems = assemble(recording(source(slow_s, 0.0), source(fast_s, late_s)), CONFIG).problems
    said = [problem.what for problem in problems]
    assert len(said) == 2
    assert all("the clock jumps back by" in what for what in said)


@pytest.mark.parametrize("days", [2.0, 20_000.0])
def test_a_clock_that_is_set_forward_begins_a_stretch_of_its_own(days: float) -> None:
    table = triads(2, seconds=120.0)
    stamp_s = np.where(table.time_s < 60.0, table.time_s, table.time_s + days * 86_400.0)
    log = recording((stamp_s, table.rate_rad_s[:, :3]), (stamp_s, table.rate_rad_s[:, 3:]))
    assembly = assemble(log, CONFIG)
    assert assembly.table.duration_s < 200.0
    said = f"the clock jumps forward by {days:.1f} days (it was set); what follows is a stretch"
    assert len(assembly.problems) == 2
    assert all(said in problem.what for problem in assembly.problems)
    assert judge(assembly.table, CONFIG).findings == ()


def test_a_pause_of_hours_costs_the_comparison_of_clocks_nothing() -> None:
    table = triads(2, seconds=240.0, sigma_deg_s=0.1)
    stamp_s = np.where(table.time_s < 120.0, table.time_s, table.time_s + 36_000.0)
    late = recording((stamp_s, table.rate_rad_s[:, :3]), (stamp_s + 0.1, table.rate_rad_s[:, 3:]))
    tracemalloc.start()
    (clock,) = assemble(late, CONFIG).clocks
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert clock.low < 0.1 < clock.high
    assert peak < 50_000_000
