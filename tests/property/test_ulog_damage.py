"""Whatever happens to a PX4 log: no exception, every byte told, and what is left is read."""

from __future__ import annotations

import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog_readers import ulog
from tests.ulog_oracle import HEADER, definitions, flight, log

DEFINITIONS = definitions()
RECORDS = flight(3.0)
CLEAN = log(RECORDS, DEFINITIONS)
BEGIN = len(HEADER) + sum(map(len, DEFINITIONS))
ENDS = BEGIN + np.cumsum([len(record) for record in RECORDS])
STARTS = ENDS - [len(record) for record in RECORDS]
IS_DATA = np.array([record[2:3] == b"D" for record in RECORDS])
N_DATA = int(IS_DATA.sum())
NAMES = ("sensor_gyro[0]", "sensor_gyro[1]", "vehicle_attitude", "vehicle_status", "cpuload")
KEPT = [(NAMES[record[3]], len(record)) for record in RECORDS if record[2:3] == b"D"]
COUNTS = Counter(name for name, _ in KEPT)
SIZES = dict(KEPT)


class Outcome(NamedTuple):
    """What reading gave, in numbers: a failing assertion prints what it compares."""

    counts: dict[str, int]
    n_data: int
    lost: int
    is_whole: bool


def read(content: bytes) -> Outcome | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.ulg"
        path.write_bytes(content)
        try:
            recording = ulog.read(path)
        except UnreadableLogError:
            return None
    counts = {s.name: s.count for s in recording.streams if s.name != ulog.LOGGED_TEXTS}
    return Outcome(
        counts,
        sum(counts.values()),
        sum(p.bytes_lost or 0 for p in recording.problems),
        all(problem.note for problem in recording.problems),
    )


def missing_bytes(got: Outcome) -> int:
    """Bytes of the data records that are not there any more."""
    return sum(max(n - got.counts.get(name, 0), 0) * SIZES[name] for name, n in COUNTS.items())


def test_the_log_that_is_damaged_here_is_whole() -> None:
    assert read(CLEAN) == Outcome(dict(COUNTS), N_DATA, 0, is_whole=True)


@given(at=st.integers(BEGIN, len(CLEAN)), length=st.integers(1, 5000), seed=st.integers(-1, 9))
def test_a_hole_costs_what_it_touches_and_at_most_one_record_more(
    at: int, length: int, seed: int
) -> None:
    end = min(at + length, len(CLEAN))
    damaged = bytearray(CLEAN)
    damaged[at:end] = bytes(end - at) if seed < 0 else np.random.default_rng(seed).bytes(end - at)
    got = read(bytes(damaged))
    assert got is not None
    untouched = (at >= ENDS) | (end <= STARTS)
    least = int((untouched & IS_DATA).sum())
    most = least + int((~untouched).sum())
    # A hole inside one record cannot be seen: that record counts as read. The record before a hole
    # may end in what the hole begins with; and one beyond the damage may be needed to believe it.
    assert least - 2 <= got.n_data <= most
    assert got.lost >= missing_bytes(got)


@given(cut=st.integers(0, len(CLEAN)))
def test_a_cut_log_gives_all_that_is_left_and_the_rest_is_no_loss(cut: int) -> None:
    got = read(CLEAN[:cut])
    if got is None:
        assert cut < BEGIN
        return
    whole = cut >= ENDS
    end = max([BEGIN, *ENDS[whole].tolist()])
    assert (got.n_data, got.is_whole) == (int((whole & IS_DATA).sum()), True)
    if cut >= BEGIN:
        assert got.lost == cut - end


@given(
    flips=st.lists(st.tuples(st.integers(BEGIN, len(CLEAN) - 1), st.integers(0, 7)), max_size=20)
)
def test_a_flipped_bit_costs_two_records_at_most(flips: list[tuple[int, int]]) -> None:
    damaged = bytearray(CLEAN)
    for at, bit in flips:
        damaged[at] ^= 1 << bit
    got = read(bytes(damaged))
    assert got is not None
    assert got.n_data >= N_DATA - 2 * len(flips)
    assert got.lost >= missing_bytes(got)


@given(
    head=st.binary(max_size=50),
    at=st.integers(BEGIN, len(CLEAN)),
    middle=st.binary(max_size=300),
    tail=st.binary(max_size=50),
)
def test_garbage_costs_two_records_at_most_where_it_stands(
    head: bytes, at: int, middle: bytes, tail: bytes
) -> None:
    got = read(head + CLEAN[:at] + middle + CLEAN[at:] + tail)
    assert got is not None
    assert got.n_data >= N_DATA - 3
    assert got.lost >= len(head) + missing_bytes(got)


@given(at=st.integers(0, BEGIN), length=st.integers(1, 400), seed=st.integers(-1, 5))
def test_damaged_definitions_are_read_or_refused(at: int, length: int, seed: int) -> None:
    damaged = bytearray(CLEAN)
    damaged[at : at + length] = (
        bytes(length) if seed < 0 else np.random.default_rng(seed).bytes(length)
    )
    read(bytes(damaged))


@given(content=st.binary(max_size=3000), header=st.booleans())
def test_any_bytes_are_read_or_refused(content: bytes, header: bool) -> None:
    read((HEADER if header else b"") + content)
    ulog.sniff(content)


@given(seed=st.integers(0, 2**32), size=st.integers(0, 100_000))
def test_random_bytes_behind_a_header_are_refused(seed: int, size: int) -> None:
    got = read(HEADER + np.random.default_rng(seed).bytes(size))
    assert got is None
