"""Whatever happens to a telemetry log: no exception, no lost packet, and every byte told."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog_readers import mavlink
from tests.mavlink_oracle import flight, official, stamped

STAMP = 8
PACKETS = flight(3.0) + flight(1.0, signed=True) + flight(1.0, version=1)
CLEAN = stamped(PACKETS)
ENDS = np.cumsum([STAMP + len(packet) for packet in PACKETS])
STARTS = ENDS - [len(packet) for packet in PACKETS]
GYROS = ("RAW_IMU", "SCALED_IMU2")


class Outcome(NamedTuple):
    """What reading gave, in numbers: a failing assertion prints what it compares."""

    counts: dict[str, int]
    lost: int
    is_whole: bool


def read(data: bytes) -> Outcome | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.tlog"
        path.write_bytes(data)
        try:
            recording = mavlink.read(path)
        except UnreadableLogError:
            return None
    return Outcome(
        {s.name: s.count for s in recording.streams},
        sum(p.bytes_lost or 0 for p in recording.problems),
        all(problem.note for problem in recording.problems),
    )


def places(size: int = len(CLEAN)) -> st.SearchStrategy[int]:
    return st.integers(0, size)


@given(at=places(), length=st.integers(1, 5000), seed=st.none() | st.integers(0, 9))
def test_a_hole_costs_the_packets_it_touches_and_every_byte_is_told(
    at: int, length: int, seed: int | None
) -> None:
    end = min(at + length, len(CLEAN))
    filling = bytes(end - at) if seed is None else np.random.default_rng(seed).bytes(end - at)
    damaged = bytearray(CLEAN)
    damaged[at:end] = filling
    got = read(bytes(damaged))
    untouched = (at >= ENDS) | (end <= STARTS)
    n_untouched = int(untouched.sum())
    if not n_untouched:
        assert got is None
        return
    assert got is not None
    # A byte of random filling may be the one that was there.
    kept = sum(got.counts.values())
    assert kept >= n_untouched
    if kept == n_untouched:
        assert got.lost == len(CLEAN) - int((ENDS - STARTS + STAMP)[untouched].sum())


@given(cut=places())
def test_a_cut_log_gives_all_that_is_left_and_the_rest_is_no_loss(cut: int) -> None:
    got = read(CLEAN[:cut])
    whole = ENDS[cut >= ENDS].tolist()
    if not whole:
        assert got is None
        return
    assert got is not None
    assert sum(got.counts.values()) == len(whole)
    assert (got.lost, got.is_whole) == (cut - whole[-1], True)


@given(flips=st.lists(st.tuples(places(len(CLEAN) - 1), st.integers(0, 7)), max_size=30))
def test_flipped_bits_never_cost_more_samples_than_the_official_library_loses(
    flips: list[tuple[int, int]],
) -> None:
    damaged = bytearray(CLEAN)
    for at, bit in flips:
        damaged[at] ^= 1 << bit
    _never_fewer(bytes(damaged))


@given(
    head=st.binary(max_size=50),
    at=places(),
    middle=st.binary(max_size=300),
    tail=st.binary(max_size=50),
)
def test_garbage_never_costs_more_samples_than_the_official_library_loses(
    head: bytes, at: int, middle: bytes, tail: bytes
) -> None:
    _never_fewer(head + CLEAN[:at] + middle + CLEAN[at:] + tail)


def _never_fewer(data: bytes) -> None:
    got = read(data)
    ours = got.counts if got else {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.tlog"
        path.write_bytes(data)
        theirs = official(path)
    for name in GYROS:
        n_theirs = len(theirs.get((1, 1, name), []))
        assert ours.get(name, 0) >= n_theirs


@given(data=st.binary(max_size=3000))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    read(data)
    mavlink.sniff(data)


@given(seed=st.integers(0, 2**32), size=st.integers(0, 100_000))
def test_random_files_are_refused(seed: int, size: int) -> None:
    got = read(np.random.default_rng(seed).bytes(size))
    assert got is None
