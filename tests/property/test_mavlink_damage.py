"""Whatever happens to a telemetry log: no exception, no lost packet, and every byte told."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import mavlink
from tests.mavlink_oracle import flight, official, stamped

STAMP = 8
PACKETS = flight(3.0) + flight(1.0, signed=True) + flight(1.0, version=1)
CLEAN = stamped(PACKETS)
ENDS = np.cumsum([STAMP + len(packet) for packet in PACKETS])
STARTS = ENDS - [len(packet) for packet in PACKETS]
GYROS = ("RAW_IMU", "SCALED_IMU2")


def read(data: bytes) -> Recording | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.tlog"
        path.write_bytes(data)
        try:
            return mavlink.read(path)
        except UnreadableLogError:
            return None


def counts(recording: Recording | None) -> dict[str, int]:
    return {s.name: s.count for s in recording.streams} if recording else {}


def lost(recording: Recording) -> int:
    return sum(p.bytes_lost or 0 for p in recording.problems)


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
    recording = read(bytes(damaged))
    untouched = (at >= ENDS) | (end <= STARTS)
    if not untouched.any():
        assert recording is None
        return
    assert recording is not None
    # A byte of random filling may be the one that was there.
    kept = sum(counts(recording).values())
    assert kept >= untouched.sum()
    if kept == untouched.sum():
        assert lost(recording) == len(CLEAN) - (ENDS - STARTS + STAMP)[untouched].sum()


@given(cut=places())
def test_a_cut_log_gives_all_that_is_left_and_the_rest_is_no_loss(cut: int) -> None:
    recording = read(CLEAN[:cut])
    whole = cut >= ENDS
    if not whole.any():
        assert recording is None
        return
    assert recording is not None
    assert sum(counts(recording).values()) == whole.sum()
    assert all(problem.note for problem in recording.problems)
    assert lost(recording) == cut - ENDS[whole].max()


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
    ours = counts(read(data))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.tlog"
        path.write_bytes(data)
        theirs = official(path)
    for name in GYROS:
        assert ours.get(name, 0) >= len(theirs.get((1, 1, name), []))


@given(data=st.binary(max_size=3000))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    read(data)
    mavlink.sniff(data)


@given(seed=st.integers(0, 2**32), size=st.integers(0, 100_000))
def test_random_files_are_refused(seed: int, size: int) -> None:
    assert read(np.random.default_rng(seed).bytes(size)) is None
