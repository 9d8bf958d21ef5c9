"""Runs of one repeated value."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.analysis import judge
from fdilog.config import Config
from fdilog.detectors.flatline import runs_of_equal
from fdilog.table import ChannelTable
from tests.tables import DEG, table_of

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
