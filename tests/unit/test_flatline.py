"""Runs of one repeated value."""

from __future__ import annotations

from itertools import groupby

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.detectors.flatline import runs_of_equal


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
