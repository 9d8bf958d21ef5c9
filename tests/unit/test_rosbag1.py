"""ROS 1 bags of every kind, written by the official library and read back."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import chunks, rosbag1
from fdilog_readers.rosbag1_records import MAGIC, parse_record
from tests import bags
from tests.bags import IMU, assert_part, assert_same, by_time, losses, readings, stream

# More than one chunk: rosbags begins a new one at a megabyte.
LEFT, RIGHT = readings(4000, seed=1), readings(3990, seed=2)
TWO = {"/imu/left": IMU, "/imu/right": IMU}
COMPRESSIONS = ("none", "lz4", "bz2")


def two() -> list[bags.Message]:
    return by_time(
        bags.imu_messages("/imu/left", LEFT, ros=1),
        bags.imu_messages("/imu/right", RIGHT, ["base", "a longer frame id"], ros=1),
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder, messages = tmp_path_factory.mktemp("bags"), two()
    return {
        compression: bags.write_rosbag1(folder / f"{compression}.bag", messages, TWO, compression)
        for compression in COMPRESSIONS
    }


def assert_both(recording: Recording) -> None:
    assert_same(stream(recording, "/imu/left"), LEFT)
    assert_same(stream(recording, "/imu/right"), RIGHT)
    assert [s.count for s in recording.streams] == [len(LEFT), len(RIGHT)]


def both(recording: Recording) -> int:
    """Check that what is left of both topics is as written; return how many samples that is."""
    left, right = stream(recording, "/imu/left"), stream(recording, "/imu/right")
    return assert_part(left, LEFT) + assert_part(right, RIGHT)


def index_position(raw: bytes) -> int:
    at = raw.index(b"index_pos=") + len(b"index_pos=")
    return int(struct.unpack_from("<Q", raw, at)[0])


def not_closed(raw: bytes) -> bytearray:
    """Make the bag what it was a moment before it was closed."""
    cut = bytearray(raw[: index_position(raw)])
    for name, size in ((b"index_pos=", 8), (b"conn_count=", 4), (b"chunk_count=", 4)):
        at = raw.index(name) + len(name)
        cut[at : at + size] = bytes(size)
    return cut


def chunk_starts(path: Path) -> list[int]:
    from rosbags.rosbag1 import Reader

    with Reader(path) as reader:
        return [info.pos for info in reader.chunk_infos]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_two_imus_are_read_bit_for_bit(whole: dict[str, Path], compression: str) -> None:
    recording = rosbag1.read(whole[compression])
    assert_both(recording)
    assert losses(recording) == []
    assert [p.what for p in recording.problems] == [
        "this format has no checksums: damage inside messages cannot be seen"
    ]
    assert stream(recording, "/imu/left").clock == "header.stamp"
    assert recording.utc_at_zero_ns == 0


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_bag_that_was_not_closed_is_read_whole(
    whole: dict[str, Path], compression: str, tmp_path: Path
) -> None:
    path = tmp_path / "x.bag.active"
    path.write_bytes(not_closed(whole[compression].read_bytes()))
    recording = rosbag1.read(path)
    assert_both(recording)
    assert losses(recording) == ["the recording was not closed: it has no index"]


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_chunk_whose_lengths_were_never_filled_in_is_read(
    whole: dict[str, Path], compression: str, tmp_path: Path
) -> None:
    raw = not_closed(whole[compression].read_bytes())
    last = chunk_starts(whole[compression])[-1]
    head = parse_record(bytes(raw), last)
    size_at = raw.index(b"size=", last) + 5
    raw[size_at : size_at + 4] = bytes(4)
    raw[head.data_at - 4 : head.data_at] = bytes(4)
    path = tmp_path / "x.bag.active"
    path.write_bytes(raw[: head.end])
    assert_both(rosbag1.read(path))


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_a_cut_bag_gives_what_is_before_the_cut(
    whole: dict[str, Path], compression: str, tmp_path: Path
) -> None:
    raw = whole[compression].read_bytes()
    path = tmp_path / "cut.bag"
    counts = []
    for part in (0.9, 0.6, 0.3):
        path.write_bytes(raw[: int(len(raw) * part)])
        recording = rosbag1.read(path)
        counts.append(both(recording) if recording.streams else 0)
        assert any("index cannot be used" in what for what in losses(recording))
    # bzip2 gives nothing of a block of 900 kB that is cut
    fewest = [0.8, 0.5, 0.2] if compression != "bz2" else [0.6, 0.3, 0.0]
    total = len(LEFT) + len(RIGHT)
    assert all(n >= f * total for n, f in zip(counts, fewest, strict=True))


def test_two_connections_of_one_topic_are_one_stream_in_file_order(tmp_path: Path) -> None:
    messages = [
        ("/imu" if (k // 3) % 2 else "/imu#2", time_ns, data)
        for k, (_, time_ns, data) in enumerate(bags.imu_messages("/imu", LEFT, ros=1))
    ]
    path = bags.write_rosbag1(tmp_path / "c.bag", messages, {"/imu": IMU, "/imu#2": IMU})
    assert_same(stream(rosbag1.read(path), "/imu"), LEFT)
    path.write_bytes(not_closed(path.read_bytes()))
    assert_same(stream(rosbag1.read(path), "/imu"), LEFT)


@pytest.mark.parametrize("closed", [True, False])
def test_a_hole_in_an_uncompressed_bag_costs_a_few_messages(
    whole: dict[str, Path], tmp_path: Path, closed: bool
) -> None:
    raw = whole["none"].read_bytes()
    holed = bytearray(raw) if closed else not_closed(raw)
    holed[700_000:704_096] = bytes(4096)
    path = tmp_path / "hole.bag"
    path.write_bytes(holed)
    recording = rosbag1.read(path)
    total = len(LEFT) + len(RIGHT)
    assert total - 20 <= both_but_the_hole(recording) <= total
    (damage,) = [p for p in recording.problems if "damaged" in p.what]
    assert damage.bytes_lost is not None
    assert 3000 < damage.bytes_lost < 6000


def both_but_the_hole(recording: Recording) -> int:
    """Count samples; without checksums one whose message the hole cut into may be changed."""
    count = 0
    for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT)):
        found = stream(recording, name)
        places = np.flatnonzero(np.isin(imus.stamp_ns, found.time_ns))
        same = found.columns[bags.GYRO[0]] == imus.gyro[places, 0]
        assert np.count_nonzero(~same) <= 1
        count += len(places)
    return count


@pytest.mark.parametrize("closed", [True, False])
def test_a_hole_over_a_chunks_head_costs_no_more_than_the_chunk(
    whole: dict[str, Path], tmp_path: Path, closed: bool
) -> None:
    for compression in COMPRESSIONS:
        raw = whole[compression].read_bytes()
        start = chunk_starts(whole[compression])[1]
        holed = bytearray(raw) if closed else not_closed(raw)
        holed[start - 40 : start + 60] = bytes(100)
        path = tmp_path / "hole.bag"
        path.write_bytes(holed)
        recording = rosbag1.read(path)
        assert both(recording) > 0.5 * (len(LEFT) + len(RIGHT))
        assert losses(recording)


def test_a_damaged_lz4_chunk_is_left_out(whole: dict[str, Path], tmp_path: Path) -> None:
    raw = bytearray(whole["lz4"].read_bytes())
    start = chunk_starts(whole["lz4"])[1]
    record = parse_record(bytes(raw), start)
    raw[record.data_at + 20 : record.data_at + 40] = b"\xff" * 20
    path = tmp_path / "d.bag"
    path.write_bytes(raw)
    recording = rosbag1.read(path)
    assert 0 < both(recording) < len(LEFT) + len(RIGHT)
    (problem,) = [p for p in recording.problems if not p.note]
    assert problem.offset == start
    assert problem.what.startswith("a chunk is damaged")
    assert problem.seconds_lost is not None
    assert problem.seconds_lost > 5


def test_a_damaged_message_index_is_not_believed(whole: dict[str, Path], tmp_path: Path) -> None:
    raw = whole["none"].read_bytes()
    record = parse_record(raw, chunk_starts(whole["none"])[0])
    index = parse_record(raw, record.end)
    for at in (0, 4, 8, 9, 12 * 50 + 8):
        broken = bytearray(raw)
        broken[index.data_at + at] ^= 0x10
        path = tmp_path / "i.bag"
        path.write_bytes(broken)
        assert_both(rosbag1.read(path))


def test_large_chunks_are_taken_in_windows(
    whole: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunks, "LARGE_BYTES", 200_000)
    monkeypatch.setattr(chunks, "WINDOW_BYTES", 70_000)
    for compression in COMPRESSIONS:
        recording = rosbag1.read(whole[compression])
        assert_both(recording)
        assert losses(recording) == []


def test_a_header_in_another_order_is_read(tmp_path: Path) -> None:
    """Fields of a header have no fixed order; each recorder has its own."""

    def record(fields: dict[str, bytes], data: bytes) -> bytes:
        parts = [name.encode() + b"=" + value for name, value in fields.items()]
        head = b"".join(struct.pack("<I", len(part)) + part for part in parts)
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    definition = bags.definition(IMU, 1)
    parts = [b"topic=/imu", b"type=sensor_msgs/Imu", b"message_definition=" + definition]
    described = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    zero = struct.pack("<I", 0)
    raw = MAGIC
    raw += record(
        {"op": b"\3", "index_pos": bytes(8), "conn_count": zero, "chunk_count": zero}, b""
    )
    raw += record({"topic": b"/imu", "op": b"\7", "conn": zero}, described)
    for k, (_, time_ns, data) in enumerate(bags.imu_messages("/imu", readings(9), ros=1)):
        stamp = struct.pack("<II", *divmod(time_ns, 10**9))
        fields: dict[str, Any] = {"time": stamp, "note": b"x" * (k % 2), "conn": zero, "op": b"\2"}
        raw += record(fields, data)
    path = tmp_path / "o.bag"
    path.write_bytes(raw)
    assert_same(stream(rosbag1.read(path), "/imu"), readings(9))


def test_a_type_that_is_not_known_and_other_topics_are_listed(tmp_path: Path) -> None:
    types = bags.store(1).types
    text = types["std_msgs/msg/String"]("hello")
    raw = bags.serialise(text, "std_msgs/msg/String", 1)
    messages = [("/s", 10**9 + k, raw) for k in range(5)]
    path = bags.write_rosbag1(tmp_path / "s.bag", messages, {"/s": "std_msgs/msg/String"})
    found = stream(rosbag1.read(path), "/s")
    assert (found.count, dict(found.columns), found.gyro) == (5, {}, ())
    assert rosbag1.read(path).utc_at_zero_ns is None


def test_what_is_no_bag_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "x.bag"
    path.write_bytes(b"#ROSBAG V1.2\nrest")
    with pytest.raises(UnreadableLogError, match="another version"):
        rosbag1.read(path)
    path.write_bytes(b"no")
    with pytest.raises(UnreadableLogError, match="no ROS 1 bag"):
        rosbag1.read(path)
    assert rosbag1.sniff(b"#ROSBAG V2.0\n")
    assert not rosbag1.sniff(b"\x89MCAP0\r\n")
