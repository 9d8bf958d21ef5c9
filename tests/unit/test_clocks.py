"""Stamps that repeat, run backwards or stop."""

from __future__ import annotations

import numpy as np

from fdilog.sources.clocks import RESTART_PAUSE_NS, clean_stamps, place, time_base

SECOND = 1_000_000_000


def stamps(*values: float) -> np.ndarray:
    return np.array([round(v * SECOND) for v in values], np.int64)


def test_stamps_in_order_are_left_alone() -> None:
    clean = clean_stamps([stamps(1, 2, 3)])[0]
    assert clean.time_ns.tolist() == stamps(1, 2, 3).tolist()
    assert (clean.repeated, clean.misplaced, clean.restarts) == (0, 0, ())


def test_a_repeated_stamp_keeps_its_first_record() -> None:
    clean = clean_stamps([stamps(1, 2, 2, 3)])[0]
    assert clean.keep.tolist() == [0, 1, 3]
    assert clean.repeated == 1


def test_a_single_stamp_far_ahead_is_dropped_and_time_goes_on() -> None:
    clean = clean_stamps([stamps(1, 2, 50_000, 3, 4)])[0]
    assert clean.keep.tolist() == [0, 1, 3, 4]
    assert clean.misplaced == 1


def test_a_single_stamp_that_falls_back_is_dropped() -> None:
    clean = clean_stamps([stamps(10, 11, 2, 12, 13)])[0]
    assert clean.keep.tolist() == [0, 1, 3, 4]
    assert clean.misplaced == 1


def test_a_restarted_clock_begins_a_new_stretch_in_every_stream_alike() -> None:
    one, other = clean_stamps([stamps(10, 11, 1, 2), stamps(10, 11, 12, 1, 2)])
    assert one.restarts == ((11 * SECOND, 10 * SECOND),)
    assert one.time_ns[2] == 12 * SECOND + RESTART_PAUSE_NS
    # Records of the two streams that were taken together stay together.
    assert one.time_ns[2:].tolist() == other.time_ns[3:].tolist()


def test_random_stamps_end_up_increasing_whatever_they_were() -> None:
    rng = np.random.default_rng(0)
    for size in (0, 1, 2, 3, 50, 5000):
        clean = clean_stamps([rng.integers(0, 2**62, size)])[0]
        assert (np.diff(clean.time_ns) > 0).all()


def test_a_hole_of_the_fastest_source_is_filled_with_instants_of_the_next() -> None:
    fast = np.concatenate([np.arange(0, 2, 0.01), np.arange(5, 7, 0.01)])
    slow = np.arange(0, 7, 0.02)
    base = time_base([stamps(*fast), stamps(*slow)], dropout_s=0.5)
    inside = (base.time_ns > 2.1 * SECOND) & (base.time_ns < 4.9 * SECOND)
    assert np.isin(base.time_ns[inside], stamps(*slow)).all()
    assert inside.sum() > 100


def test_a_slow_source_is_not_multiplied_by_a_fast_base() -> None:
    fast, slow = stamps(*np.arange(0, 10, 0.01)), stamps(*np.arange(0.003, 10, 0.1))
    base = time_base([fast, slow], dropout_s=0.5)
    values = np.sin(slow / SECOND)[:, None]
    placed, valid = place(slow, values, base)
    assert valid.sum() == len(slow)
    # Values are brought to the base's instants along the source's own samples.
    expected = np.sin(base.time_ns[valid[:, 0]] / SECOND)
    # Before its first sample a source is not extrapolated.
    assert np.abs(placed[valid] - expected)[1:].max() < 2e-3


def test_equal_stamps_give_the_readings_to_the_last_bit() -> None:
    time = stamps(*np.arange(0, 1, 0.01))
    values = np.random.default_rng(0).normal(size=(len(time), 3))
    placed, valid = place(time, values, time_base([time, time], dropout_s=0.5))
    assert valid.all()
    assert (placed == values).all()


def test_a_reading_that_is_repeated_stays_the_same_between_the_instants_of_others() -> None:
    base = time_base([np.arange(100) * 50_000_000 + 1_234_567], 0.5)
    held = np.full((101, 1), 0.411)
    placed, valid = place(np.arange(101) * 50_000_000, held, base)
    assert valid.all()
    assert np.unique(placed).tolist() == [0.411]


def test_of_sources_of_one_rate_the_first_is_the_base_however_stamps_are_rounded() -> None:
    even = np.arange(100, dtype=np.int64) * 50_019_000
    rounded = (even + 21_000_000) // 1_000_000 * 1_000_000  # whole ms: the median step is shorter
    assert np.median(np.diff(rounded)) < np.median(np.diff(even))
    np.testing.assert_array_equal(time_base([even, rounded], 0.5).time_ns[:50], even[:50])
    twice = np.arange(200, dtype=np.int64) * 25_000_000
    np.testing.assert_array_equal(time_base([even, twice], 0.5).time_ns[:50], twice[:50])
