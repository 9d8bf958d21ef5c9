"""Cut, holed and flipped recordings: read without a traceback, and with no sample made up.

Where the format has checksums, every sample that comes out is one that was written, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import CompressionType

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import mcap, rosbag1, rosbag2
from tests import bags
from tests.bags import IMU, assert_part, by_time, readings

LEFT, RIGHT = readings(150, seed=1), readings(149, seed=2)
TWO = {"/imu/left": IMU, "/imu/right": IMU}
IMUS = {"/imu/left": LEFT, "/imu/right": RIGHT}
HOLE_BYTES = 4096
MOST_BYTES = 1 << 18  # none of the files is as long
DATA_END = b"\x0f\x04\0\0\0\0\0\0\0"

Damage = Callable[[bytes], bytes]


@st.composite
def damages(draw: st.DrawFn) -> Damage:
    """Draw a way to damage a file: a cut, a hole of zeros or noise, some flipped bits."""
    kind = draw(st.sampled_from(["cut", "zeros", "noise", "flips"]))
    at = draw(st.floats(0, 1, exclude_max=True))
    seed = draw(st.integers(0, 1 << 30))

    def damage(raw: bytes) -> bytes:
        random = np.random.default_rng(seed)
        start = int(at * len(raw))
        if kind == "cut":
            return raw[:start]
        broken = bytearray(raw)
        if kind == "flips":
            for place in random.integers(0, len(raw), 1 + seed % 4):
                broken[place] ^= 1 << (seed % 8)
            return bytes(broken)
        hole = broken[start : start + HOLE_BYTES]
        filling = bytes(len(hole)) if kind == "zeros" else random.bytes(len(hole))
        broken[start : start + HOLE_BYTES] = filling
        return bytes(broken)

    return damage


@pytest.fixture(scope="module")
def wholes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("whole")
    two = by_time(
        bags.imu_messages("/imu/left", LEFT), bags.imu_messages("/imu/right", RIGHT, ["a", "bcd"])
    )
    kinds: dict[str, dict[str, Any]] = {
        "zstd": {},
        "lz4": {"compression": CompressionType.LZ4},
        "uncompressed": {"compression": CompressionType.NONE},
        "unchunked": {"use_chunking": False},
        "without checksums": {"enable_crcs": False, "compression": CompressionType.LZ4},
    }
    found = {
        kind: bags.write_mcap(folder / f"{kind}.mcap", two, TWO, chunk_size=6000, **options)
        for kind, options in kinds.items()
    }
    raw = found["zstd"].read_bytes()
    found["not closed"] = folder / "not closed.mcap"
    found["not closed"].write_bytes(raw[: raw.rindex(DATA_END)])
    ones = by_time(*(bags.imu_messages(topic, imus, ros=1) for topic, imus in IMUS.items()))
    for compression in ("none", "lz4", "bz2"):
        kind = f"bag {compression}"
        found[kind] = bags.write_rosbag1(folder / f"{kind}.bag", ones, TWO, compression)
    found["db3"] = bags.write_rosbag2(folder / "bag", two, TWO) / "bag.db3"
    return found


def read_damaged(path: Path, kind: str, raw: bytes) -> Recording | None:
    reader: Any = rosbag1 if "bag" in kind else rosbag2 if kind == "db3" else mcap
    path.write_bytes(raw)
    message = ""
    try:
        recording: Recording = reader.read(path)
    except UnreadableLogError as error:
        message = str(error)
    if message:
        assert str(path) in message
        assert "\n" not in message
        return None
    size = len(raw)
    for problem in recording.problems:
        assert "\n" not in problem.what
        assert problem.bytes_lost is None or 0 <= problem.bytes_lost <= MOST_BYTES
        assert problem.offset is None or 0 <= problem.offset <= size
    return recording


def assert_told(recording: Recording) -> None:
    """Samples are missing only if a loss is told."""
    counts = [len(s.time_ns) for s in recording.streams if s.name in IMUS]
    missing = sum(map(len, IMUS.values())) - sum(counts)
    told = any(not problem.note for problem in recording.problems)
    assert told or missing == 0


@pytest.mark.parametrize("kind", ["zstd", "lz4", "uncompressed", "not closed"])
@given(damage=damages())
def test_what_comes_out_of_a_damaged_mcap_file_was_written(
    wholes: dict[str, Path],
    tmp_path_factory: pytest.TempPathFactory,
    kind: str,
    damage: Damage,
) -> None:
    raw = damage(wholes[kind].read_bytes())
    recording = read_damaged(tmp_path_factory.getbasetemp() / "d.log", kind, raw)
    if recording is not None:
        for stream in recording.streams:
            if stream.name in IMUS and stream.gyro:
                assert_part(stream, IMUS[stream.name])
        assert_told(recording)


@pytest.mark.parametrize(
    "kind", ["unchunked", "without checksums", "bag none", "bag lz4", "bag bz2", "db3"]
)
@given(damage=damages())
def test_damage_where_nothing_is_checked_brings_no_traceback_and_no_more_samples(
    wholes: dict[str, Path],
    tmp_path_factory: pytest.TempPathFactory,
    kind: str,
    damage: Damage,
) -> None:
    raw = damage(wholes[kind].read_bytes())
    recording = read_damaged(tmp_path_factory.getbasetemp() / "d.log", kind, raw)
    if recording is not None:
        for stream in recording.streams:
            assert len(stream.time_ns) <= 150
            assert all(len(column) == len(stream.time_ns) for column in stream.columns.values())


@given(at=st.floats(0, 1, exclude_max=True), kind=st.sampled_from(["unchunked", "bag none", "db3"]))
def test_what_is_before_a_cut_is_as_it_was_written(
    wholes: dict[str, Path], tmp_path_factory: pytest.TempPathFactory, at: float, kind: str
) -> None:
    whole = wholes[kind].read_bytes()
    raw = whole[: int(at * len(whole))]
    recording = read_damaged(tmp_path_factory.getbasetemp() / "c.log", kind, raw)
    if recording is not None:
        for stream in recording.streams:
            if stream.gyro and stream.clock == "header.stamp":
                assert_part(stream, IMUS[stream.name])
        assert_told(recording)


@given(raw=st.binary(max_size=300), kind=st.sampled_from(["zstd", "bag none", "db3"]))
def test_noise_behind_a_magic_is_no_traceback(
    tmp_path_factory: pytest.TempPathFactory, raw: bytes, kind: str
) -> None:
    magic = {"bag none": b"#ROSBAG V2.0\n", "db3": b"SQLite format 3\0"}.get(kind, b"\x89MCAP0\r\n")
    read_damaged(tmp_path_factory.getbasetemp() / "n.log", kind, magic + raw)
