"""Runs of one repeated value."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.detectors.flatline import runs_of_equal
from fdilog.table import ChannelTable
from tests.tables import DEG, table_of, triads

CONFIG = Config().replace("detectors", use=("parity", "impulse", "flatline", "noise"))


@given(st.lists(st.integers(0, 2), max_size=40))
def test_runs_are_those_that_grouping_finds(values: list[int]) -> None:
    start, stop = runs_of_equal(np.array(values, float))
    found = [(values[a], b - a) for a, b in zip(start, stop, strict=True)]
    assert found == [(value, len(list(run))) for value, run in groupby(values)]
    assert all(a == b for a, b in zip(start[1:], stop[:-1], strict=True))


def test_a_run_ends_where_the_log_has_a_hole() -> None:
    start, stop = runs_of_equal(np.array([5.0, 5.0, 5.0, 5.0, 1.0]), [2, 5])
    assert start.tolist() == [0, 2, 4]
    assert stop.tolist() == [2, 4, 5]


def test_a_hole_before_the_first_or_behind_the_last_reading_ends_no_run() -> None:
    start, stop = runs_of_equal(np.array([5.0, 5.0]), [0, 2])
    assert (start.tolist(), stop.tolist()) == ([0], [2])


def parked(seed: int = 2) -> ChannelTable:
    """Two triads at rest, logged once a second: the first repeats its coarse zero, one flies."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(600.0)
    rate = rng.normal(0.0, [0.02, 0.02, 0.02, 0.1, 0.1, 0.1], (600, 6)) * DEG
    flying = time_s >= 400.0
    rate[flying] += 8.0 * DEG * np.tile(rng.standard_normal((flying.sum(), 3)), 2)
    step = 0.001
    return table_of(time_s, step * np.round(rate / step))


def test_a_fault_of_one_gyro_is_no_motion_that_another_at_rest_should_have_shown() -> None:
    table = parked()
    assert judge(table, CONFIG).findings == ()
    rate = table.rate_rad_s.copy()
    failing = (table.time_s >= 100.0) & (table.time_s < 160.0)
    rate[failing, 3] += np.round(np.random.default_rng(4).normal(0.0, 0.05, 60), 3)
    for finding in judge(table_of(table.time_s, rate), CONFIG).findings:
        assert "imu1.x" in finding.suspects
    # In flight the same silence accuses, for all axes show the motion.
    rate = table.rate_rad_s.copy()
    rate[450:500, 0] = rate[450, 0]
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("stuck", ("imu0.x",))


@pytest.mark.parametrize("size_deg_s", [6.0, 8.0])
def test_a_gyro_that_turns_faster_than_it_can_tell_is_saturated_once(size_deg_s: float) -> None:
    table = triads(2, seconds=80.0)
    rate = table.rate_rad_s.copy()
    rate[:, 0] = np.clip(rate[:, 0], -size_deg_s * DEG, size_deg_s * DEG)
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("saturated", ("imu0.x",))
    clipped = table.time_s[np.abs(table.rate_rad_s[:, 0]) > size_deg_s * DEG]
    assert finding.start_s == pytest.approx(float(clipped[0]), abs=0.5)
    assert finding.end_s == pytest.approx(float(clipped[-1]), abs=0.5)
    assert "times" in finding.detail


def test_a_range_that_ends_twice_on_one_side_and_once_on_the_other_ends_three_times() -> None:
    table = triads(2, seconds=14.0, sigma_deg_s=0.1)
    rate = table.rate_rad_s.copy()
    rate[:, 0] = np.clip(rate[:, 0], -7.0 * DEG, 7.0 * DEG)
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("saturated", ("imu0.x",))


def test_a_gyro_that_is_stuck_all_along_is_not_at_the_end_of_its_range() -> None:
    table = triads(2, seconds=80.0)
    rate = table.rate_rad_s.copy()
    rate[:, 0] = 0.3 * DEG
    rate[:, 3] += 4.0 * DEG
    (finding,) = judge(table_of(table.time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("stuck", ("imu0.x",))


def test_a_rate_table_that_stands_at_its_highest_rate_saturates_nobody() -> None:
    time_s = np.arange(6000) / 50.0
    plateaus = np.repeat(np.tile([0.0, 40.0, 0.0, -40.0], 5), 300) * DEG
    noise = np.random.default_rng(5).normal(0.0, 0.02 * DEG, (6000, 6))
    rate = np.round((plateaus[:, None] * [1.0, 0.2, 0.1, 1.0, 0.2, 0.1] + noise) / 0.001) * 0.001
    assert judge(table_of(time_s, rate), CONFIG).findings == ()


def test_a_short_turn_shows_that_a_gyro_repeats_itself() -> None:
    rng = np.random.default_rng(6)
    time_s = np.arange(6000) / 50.0
    rate = rng.normal(0.0, 0.05 * DEG, (6000, 6))
    turning = (time_s >= 60.0) & (time_s < 61.0)
    rate[turning] += 30.0 * DEG * np.sin(np.pi * time_s[turning, None]) * [1, 0.5, 0.5, 1, 0.5, 0.5]
    rate[1000:5000, 3] = rate[1000, 3]
    (finding,) = judge(table_of(time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("stuck", ("imu1.x",))
    assert finding.start_s == pytest.approx(20.0, abs=0.1)
    assert finding.end_s == pytest.approx(100.0, abs=0.1)


def test_a_gyro_that_is_stuck_is_nobodys_peer() -> None:
    rng = np.random.default_rng(7)
    time_s = np.arange(76) / 2.0
    body = rng.normal(0.0, 0.3 * DEG, (76, 3))
    body[69] = [250.0 * DEG, -190.0 * DEG, -66.0 * DEG]
    body[70:73] = rng.normal(0.0, 60.0 * DEG, (3, 3))
    rate = np.tile(body, (1, 2)) + rng.normal(0.0, 0.2 * DEG, (76, 6))
    assert judge(table_of(time_s, rate), CONFIG).findings == ()
    rate = rate.copy()
    rate[19:75, 2] = rate[19, 2]
    (finding,) = judge(table_of(time_s, rate), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("stuck", ("imu0.z",))


@pytest.mark.parametrize(
    ("step_deg_s", "columns", "seconds", "dead"),
    [
        (0.0, (0, 1, 2), 20.0, {"imu0.x", "imu0.y", "imu0.z"}),
        (0.06, (0, 1, 2), 20.0, set()),
        (0.0, (0, 1), 20.0, {"imu0.x", "imu0.y"}),
        (0.0, (0, 1, 2), 5.0, set()),
    ],
)
def test_fine_gyros_that_read_nothing_any_more_are_dead_whatever_the_others_do(
    step_deg_s: float, columns: tuple[int, ...], seconds: float, dead: set[str]
) -> None:
    table = triads(1, seconds=80.0)
    rate = table.rate_rad_s.copy()
    if step_deg_s:
        rate = np.round(rate / (step_deg_s * DEG)) * step_deg_s * DEG
    gone = (table.time_s >= 40.0) & (table.time_s < 40.0 + seconds)
    rate[np.ix_(gone, columns)] = 0.0
    findings = judge(table_of(table.time_s, rate), Config()).findings
    assert {name for finding in findings for name in finding.suspects} == dead
    assert {finding.kind for finding in findings} <= {"dead"}


def test_a_gyro_that_is_stuck_again_and_again_is_one_finding() -> None:
    table = triads(3, seconds=80.0)
    rate = table.rate_rad_s.copy()
    for begin_s in range(10, 70, 4):
        held = (table.time_s >= begin_s) & (table.time_s < begin_s + 1.0)
        rate[held, 4] = rate[held, 4][0]
    (finding,) = judge(table_of(table.time_s, rate), Config()).findings
    assert (finding.kind, finding.suspects) == ("stuck", ("imu1.y",))
    assert finding.start_s == pytest.approx(10.0, abs=0.05)
    assert finding.end_s == pytest.approx(67.0, abs=0.05)
    assert finding.detail.endswith("15 times, 15 s in all")


def test_what_a_gyro_did_in_a_hole_is_not_counted_as_saturated() -> None:
    table = triads(2, seconds=80.0)
    rate = table.rate_rad_s.copy()
    limit = 8.0 * DEG
    rate[:, 0] = np.clip(rate[:, 0], -limit, limit)
    saturated = np.flatnonzero(rate[:, 0] == limit)
    first, last = int(saturated[10]), int(saturated[-10])
    kept = np.ones(len(rate), bool)
    kept[first + 1 : last] = False
    rate[[first, last], 0] = limit
    (finding,) = judge(table_of(table.time_s[kept], rate[kept]), CONFIG).findings
    assert finding.kind == "saturated"
    held_s = float(finding.detail.rpartition("; ")[2].partition(", ")[2].split(" s in all")[0])
    assert held_s < 2.0 < float(table.time_s[last] - table.time_s[first])


def hung(seed: int, *, value: float, turning: bool = True) -> ChannelTable:
    """One device beside an attitude, whose gyros repeat what they read, or zero, for 20 s.

    About the x axis alone the vehicle turns by more than a tolerance for a second or more.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(0.0, 90.0, 0.02)
    motion = np.zeros((len(time_s), 3))
    if turning:
        motion[:, 0] = 12.0 * DEG * np.sin(0.9 * time_s)
    gyros = motion + rng.normal(0.0, 0.2 * DEG, motion.shape)
    hangs = (time_s >= 30.0) & (time_s < 50.0)
    gyros[hangs] = value * gyros[hangs][0]
    attitude = motion + rng.normal(0.0, 0.02 * DEG, motion.shape)
    one = table_of(time_s, gyros)
    derived = tuple(
        replace(channel, name=f"att.{channel.name[-1]}", source="att", derived=True)
        for channel in one.channels
    )
    return one.beside(attitude, np.ones(attitude.shape, bool), derived)


@pytest.mark.parametrize(("value", "kind"), [(0.0, "dead"), (1.0, "stuck")])
def test_a_device_whose_three_gyros_hang_together_is_shown_by_the_attitude(
    value: float, kind: str
) -> None:
    found = judge(hung(1, value=value), CONFIG).findings
    assert [(one.kind, one.suspects) for one in found] == [
        (kind, (f"imu0.{axis}",)) for axis in "xyz"
    ]
    for one in found:
        assert (one.start_s, one.end_s) == pytest.approx((30.0, 49.98), abs=0.03)


def test_what_repeats_while_nothing_is_known_to_turn_is_no_fault() -> None:
    assert judge(hung(2, value=1.0, turning=False), CONFIG).findings == ()


def test_a_value_that_is_once_the_end_of_a_range_is_so_on_either_side_all_along() -> None:
    time_s = np.arange(0.0, 80.0, 0.02)
    rng = np.random.default_rng(6)
    turn = 10.0 * np.sin(0.3 * time_s)
    for at_s, most in ((20.0, 70.0), (50.0, -41.6)):
        bump = np.exp(-(((time_s - at_s) / 1.5) ** 4))
        turn = (1.0 - bump) * turn + bump * most
    motion = np.column_stack([turn, 8.0 * np.sin(0.5 * time_s), 6.0 * np.cos(0.4 * time_s)])
    rate = np.tile(motion, (1, 3)) + rng.normal(0.0, 0.15, (len(time_s), 9))
    rate[:, 3] = np.clip(rate[:, 3], -40.0, 40.0)
    (finding,) = judge(table_of(time_s, rate * DEG), CONFIG).findings
    assert (finding.kind, finding.suspects) == ("saturated", ("imu1.x",))
    assert finding.detail.startswith("reads its full scale")
    assert "2 times" in finding.detail
