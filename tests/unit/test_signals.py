"""Series of a log that are no gyros, on the instants of an observer."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UsageError
from fdilog.recording import Recording, Stream
from fdilog.sources.signals import Signal, find_signals, held, sampled, streams_of

GRID = np.arange(0.0, 10.0, 0.1)


def signal(time_s: np.ndarray, values: np.ndarray) -> Signal:
    return Signal(name="s", unit="", time_s=time_s, values=values)


def recording(*streams: Stream) -> Recording:
    return Recording(path="log", format="test", bytes=1, streams=streams)


def stream(name: str, **columns: list[float]) -> Stream:
    n = len(next(iter(columns.values())))
    return Stream(
        name=name,
        time_ns=np.arange(n, dtype=np.int64) * 10**9,
        columns={field: np.array(values) for field, values in columns.items()},
        units=dict.fromkeys(columns, "m"),
    )


@given(st.integers(0, 100), st.sampled_from([0.013, 0.04, 0.1, 0.25]))
def test_a_straight_line_is_sampled_exactly_at_any_rate(seed: int, period_s: float) -> None:
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.5, 1.5, round(12.0 / period_s)) * period_s) - 0.5
    found = sampled(signal(time_s, 3.0 * time_s - 1.0), GRID, 1.0)
    first, last = GRID - 0.05, GRID + 0.05
    inside = (first > time_s[0]) & (last < time_s[-1])
    np.testing.assert_allclose(found[inside], 3.0 * GRID[inside] - 1.0, atol=1e-9)
    assert np.isnan(found[first < time_s[0]]).all()


def test_a_command_holds_until_the_next_one() -> None:
    # Changes from 1 to 5 a quarter into the step that begins at 2.0 s.
    found = held(signal(np.array([0.0, 2.025, 4.0]), np.array([1.0, 5.0, 2.0])), GRID, 3.0)
    np.testing.assert_allclose(found[:20], 1.0)
    assert found[20] == pytest.approx(0.25 * 1.0 + 0.75 * 5.0)
    np.testing.assert_allclose(found[21:40], 5.0)
    # After the last record it holds for one more period, 1.9875 s.
    np.testing.assert_allclose(found[40:58], 2.0)
    assert np.isnan(found[60:]).all()


def test_a_gap_is_no_reading() -> None:
    time_s = np.delete(np.arange(0.0, 10.0, 0.02), np.s_[200:300])
    for found in (
        sampled(signal(time_s, np.ones(len(time_s))), GRID, 0.5),
        held(signal(time_s, np.ones(len(time_s))), GRID, 0.5),
    ):
        assert np.isnan(found[(GRID > 3.95) & (GRID < 5.95)]).all()
        np.testing.assert_allclose(found[(GRID > 0.1) & (GRID < 3.8)], 1.0)


def test_a_grid_of_one_instant_has_no_step_to_average_over() -> None:
    assert np.isnan(sampled(signal(GRID, GRID), GRID[:1], 1.0)).all()


def test_streams_and_fields_may_hold_dots() -> None:
    assert streams_of(["RCOU.C1", "/a.b/c.twist.x", "plain"]) == [
        "RCOU", "/a", "/a.b/c", "/a.b/c.twist",
    ]  # fmt: skip


def test_a_series_is_found_by_stream_and_field_or_by_its_field_alone() -> None:
    log = recording(
        stream("RCOU", C1=[1.0, 2.0], C2=[3.0, 4.0]), stream("nav", v=[5.0, np.nan, 6.0])
    )
    found, complaints = find_signals(log, ["RCOU.C2", "v"], 10**9)
    assert complaints == []
    assert found["RCOU.C2"].values.tolist() == [3.0, 4.0]
    assert found["RCOU.C2"].time_s.tolist() == [-1.0, 0.0]
    assert found["v"].values.tolist() == [5.0, 6.0]
    assert found["v"].unit == "m"


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("RCOU.C3", r"no 'RCOU.C3' in this log; did you mean 'RCOU\.C"),
        ("C1", "'C1' is not one series; name one of RCOU.C1, RCIN.C1"),
    ],
)
def test_a_name_that_is_none_or_several_is_an_error(name: str, complaint: str) -> None:
    log = recording(stream("RCOU", C1=[1.0, 2.0], C2=[1.0, 2.0]), stream("RCIN", C1=[1.0, 2.0]))
    with pytest.raises(UsageError, match=complaint):
        find_signals(log, [name], 0)


def test_a_stream_that_a_log_does_not_hold_is_complained_of_and_no_error() -> None:
    log = recording(stream("RCOU", C1=[1.0, 2.0]))
    assert find_signals(log, ["GPS.Spd"], 0) == ({}, ["no 'GPS.Spd' in this log"])


def test_a_series_without_readings_or_with_a_restarted_clock_is_complained_of() -> None:
    back = Stream(
        name="back",
        time_ns=np.array([10, 11, 12, 1, 2, 3], dtype=np.int64) * 10**9,
        columns={"x": np.arange(6.0)},
    )
    log = recording(stream("nav", v=[np.nan, np.nan]), back)
    found, complaints = find_signals(log, ["nav.v", "back.x"], 0)
    assert found == {}
    assert complaints == ["nav.v holds no readings", "the clock of back restarts"]
