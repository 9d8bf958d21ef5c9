"""ROS 2 bags of every kind, written by the official library and read back."""

from __future__ import annotations

import os
import shutil
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog.registry import is_log_directory, read
from fdilog_readers import rosbag2, rosbag2_sqlite
from fdilog_readers.rosbag2_last_page import TABLE_LEAF
from tests import bags
from tests.bags import IMU, assert_part, assert_same, by_time, losses, readings, stream

LEFT, RIGHT = readings(500, seed=1), readings(497, seed=2)
TWO = {"/imu/left": IMU, "/imu/right": IMU}
KINDS = [
    ("sqlite3", ""),
    ("sqlite3", "message"),
    ("sqlite3", "file"),
    ("mcap", ""),
    ("mcap", "message"),
    ("mcap", "file"),
    ("mcap", "storage"),
]


def two() -> list[bags.Message]:
    return by_time(
        bags.imu_messages("/imu/left", LEFT),
        bags.imu_messages("/imu/right", RIGHT, ["base", "a longer frame id"]),
    )


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return bags.write_rosbag2(tmp_path / "bag", two(), TWO)


def assert_both(recording: Recording) -> None:
    assert_same(stream(recording, "/imu/left"), LEFT)
    assert_same(stream(recording, "/imu/right"), RIGHT)
    assert [s.count for s in recording.streams] == [len(LEFT), len(RIGHT)]


def state(folder: Path) -> dict[str, Any]:
    return {
        file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in sorted(folder.iterdir())
    }


@pytest.mark.parametrize(("storage", "compression"), KINDS)
def test_two_imus_are_read_bit_for_bit(storage: str, compression: str, tmp_path: Path) -> None:
    path = bags.write_rosbag2(
        tmp_path / "bag", two(), TWO, storage=storage, compression=compression
    )
    before = state(path)
    recording = read(path)
    assert recording.format == "rosbag2"
    assert_both(recording)
    assert losses(recording) == []
    assert recording.utc_at_zero_ns == 0
    assert any("no checksum" in problem.what for problem in recording.problems)
    assert state(path) == before


def test_a_folder_that_may_not_be_written_is_read(bag: Path) -> None:
    bag.chmod(0o500)
    (bag / "bag.db3").chmod(0o400)
    try:
        assert_both(rosbag2.read(bag))
    finally:
        bag.chmod(0o700)


def test_a_folder_without_a_description_is_read_and_was_not_closed(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    recording = read(bag)
    assert_both(recording)
    assert losses(recording) == ["the recording was not closed: it has no metadata.yaml"]


def test_a_bare_file_is_read(bag: Path) -> None:
    recording = read(bag / "bag.db3")
    assert_both(recording)
    assert losses(recording) == []


@pytest.mark.parametrize("described", [True, False])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_split_files_are_one_recording_in_their_order(
    storage: str, described: bool, tmp_path: Path
) -> None:
    messages = two()
    suffix = {"sqlite3": "db3", "mcap": "mcap"}[storage]
    folder = tmp_path / "split"
    folder.mkdir()
    names = [f"split_{k}.{suffix}" for k in (0, 1, 2, 10)]
    for k, name in enumerate(names):
        part = bags.write_rosbag2(
            tmp_path / f"p{k}", messages[k * 250 : (k + 1) * 250], TWO, storage=storage
        )
        (part / f"p{k}.{suffix}").rename(folder / name)
        if described:
            text = (part / "metadata.yaml").read_text()
            listed = "".join(f"\n  - split/{name}" for name in names)
            text = text.replace(f"\n  - p{k}.{suffix}", listed)
            assert listed in text
            (folder / "metadata.yaml").write_text(text)
    assert_both(read(folder))


def test_a_description_leads_nowhere_but_into_its_folder(bag: Path, tmp_path: Path) -> None:
    other = bags.write_rosbag2(tmp_path / "other", two()[:10], TWO)
    description = bag / "metadata.yaml"
    text = description.read_text()
    for outside in ("../other/other.db3", str(other / "other.db3"), "..\\\\other\\\\other.db3"):
        description.write_text(text.replace("- bag.db3", f"- '{outside}'"))
        with pytest.raises(UnreadableLogError, match=r"other.db3 is named in metadata.yaml"):
            rosbag2.read(bag)


def test_files_that_are_missing_or_not_named_are_told(bag: Path) -> None:
    description = bag / "metadata.yaml"
    text = description.read_text()
    description.write_text(text.replace("- bag.db3", "- bag.db3\n  - bag_1.db3"))
    (bag / "bag_2.db3").write_bytes(b"")
    recording = rosbag2.read(bag)
    assert_both(recording)
    assert losses(recording) == ["bag_1.db3 is named in metadata.yaml, but is not there"]
    assert any("bag_2.db3 is not named" in p.what for p in recording.problems)


@pytest.mark.parametrize("text", ["", "{", "a: [", "- 1", "rosbag2_bagfile_information: 3", "\0"])
def test_a_description_that_makes_no_sense_is_told(bag: Path, text: str) -> None:
    (bag / "metadata.yaml").write_text(text)
    recording = rosbag2.read(bag)
    assert_both(recording)
    (what,) = losses(recording)
    assert what.startswith("metadata.yaml cannot be used")


def with_wal(bag: Path) -> Path:
    """Leave a write-ahead log beside the file, as a recorder does that lost power."""
    path = bag / "bag.db3"
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA wal_autocheckpoint=0")
    rows = connection.execute("SELECT id FROM messages WHERE id > 900").fetchall()
    messages = connection.execute("SELECT * FROM messages WHERE id > 900").fetchall()
    connection.execute("DELETE FROM messages WHERE id > 900")
    connection.commit()
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", messages)
    connection.commit()
    assert rows
    copies = {name: (bag / name).read_bytes() for name in ("bag.db3", "bag.db3-wal")}
    connection.close()
    for name, content in copies.items():
        (bag / name).write_bytes(content)
    return path


def test_a_write_ahead_log_is_read_too_and_left_as_it_is(bag: Path) -> None:
    path = with_wal(bag)
    before = state(bag)
    recording = read(bag)
    assert_both(recording)
    assert any("bag.db3-wal was read too" in p.what for p in recording.problems)
    assert state(bag) == before
    (bag / "bag.db3-wal").unlink()
    assert sum(s.count for s in rosbag2.read(path).streams) == 900


def test_a_damaged_file_gives_what_can_be_read(bag: Path) -> None:
    path = bag / "bag.db3"
    raw = bytearray(path.read_bytes())
    for page in (30, 31, 50):
        raw[page * 4096 : page * 4096 + 8] = b"\xee" * 8
    path.write_bytes(raw)
    recording = rosbag2.read(bag)
    counts = [
        assert_part(stream(recording, name), imus)
        for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT))
    ]
    lost = len(LEFT) + len(RIGHT) - sum(counts)
    assert 2 * 8 <= lost <= 2 * 12  # the page between them holds a part of an index
    told = [what for what in losses(recording) if "messages are lost" in what]
    assert sum(int(what.split("; ")[1].split()[0]) for what in told) == lost


def test_a_cut_file_gives_what_is_before_the_cut(bag: Path) -> None:
    path = bag / "bag.db3"
    raw = path.read_bytes()
    path.write_bytes(raw[: len(raw) // 2])
    recording = rosbag2.read(bag)
    count = sum(
        assert_part(stream(recording, name), imus)
        for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT))
    )
    assert count > 0.4 * (len(LEFT) + len(RIGHT))
    assert any("so is the rest" in what for what in losses(recording))
    cut = next(problem for problem in recording.problems if problem.what == "bag.db3 is cut")
    assert (cut.offset, cut.bytes_lost) == (len(raw) // 2, len(raw) - len(raw) // 2)


def test_rows_of_wrong_types_do_not_stop_the_reader(bag: Path) -> None:
    connection = sqlite3.connect(bag / "bag.db3")
    connection.execute("UPDATE messages SET data = 'text' WHERE id = 3")
    connection.execute("UPDATE messages SET data = 5, timestamp = 'x' WHERE id = 5")
    connection.execute("UPDATE messages SET topic_id = 77 WHERE id = 7")
    connection.execute("UPDATE topics SET name = CAST(x'2f696d752fff' AS TEXT) WHERE id = 2")
    connection.commit()
    connection.close()
    recording = rosbag2.read(bag)
    assert [s.name for s in recording.streams] == ["/imu/left", "/imu/\ufffd"]
    assert sum("do not fit" in what for what in losses(recording)) >= 1
    assert "1 messages are of topics that are defined nowhere" in losses(recording)
    assert sum(len(s.time_ns) for s in recording.streams) == len(LEFT) + len(RIGHT) - 3


def test_a_message_that_does_not_decompress_does_not_fit(tmp_path: Path) -> None:
    path = bags.write_rosbag2(tmp_path / "bag", two(), TWO, compression="message")
    connection = sqlite3.connect(path / "bag.db3")
    rows = connection.execute("SELECT id, data FROM messages WHERE id IN (4, 6)").fetchall()
    for number, data in rows:
        broken = data[:4] + bytes(len(data) - 4)
        connection.execute("UPDATE messages SET data = ? WHERE id = ?", (broken, number))
    connection.commit()
    connection.close()
    recording = rosbag2.read(path)
    count = sum(
        assert_part(stream(recording, name), imus)
        for name, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT))
    )
    assert count == len(LEFT) + len(RIGHT) - 2


def test_older_schemas_without_definitions_are_read(bag: Path) -> None:
    connection = sqlite3.connect(bag / "bag.db3")
    connection.execute("DROP TABLE message_definitions")
    connection.execute("DROP TABLE schema")
    connection.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
    connection.execute("ALTER TABLE topics DROP COLUMN offered_qos_profiles")
    connection.commit()
    connection.close()
    assert_both(rosbag2.read(bag))


def test_many_messages_are_fetched_piece_by_piece(
    bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rosbag2_sqlite, "ROWS_AT_ONCE", 7)
    assert_both(rosbag2.read(bag))


def test_a_cut_within_the_last_page_costs_only_the_rows_that_it_touches(bag: Path) -> None:
    database = bag / "bag.db3"
    content = database.read_bytes()
    page_bytes = 4096
    begin = max(at for at in range(0, len(content), page_bytes) if content[at] == TABLE_LEAF)
    rows = int.from_bytes(content[begin + 3 : begin + 5], "big")
    pointers = content[begin + 8 : begin + 8 + 2 * rows]
    starts = [int.from_bytes(pointers[k : k + 2], "big") for k in range(0, 2 * rows, 2)]
    assert starts == sorted(starts, reverse=True)
    assert rows > 3

    def count(size: int) -> int:
        database.write_bytes(content[:size])
        recording = rosbag2.read(bag)
        return sum(
            assert_part(stream(recording, topic), imus)
            for topic, imus in (("/imu/left", LEFT), ("/imu/right", RIGHT))
        )

    fewest = count(begin)
    assert count(begin + 5) == fewest
    assert count(begin + page_bytes) == fewest + rows
    for k, start in enumerate(starts[:-1]):
        assert count(begin + start) == fewest + rows - k - 1
        assert count(begin + start - 1) == fewest + rows - k - 2


def test_a_folder_of_several_recordings_is_not_one_bag(tmp_path: Path, bag: Path) -> None:
    flights = tmp_path / "flights"
    flights.mkdir()
    for name in ("rec_0.db3", "rec_1.db3", "rec_10.db3"):
        shutil.copyfile(bag / "bag.db3", flights / name)
    assert is_log_directory(flights)
    shutil.copyfile(bag / "bag.db3", flights / "other.db3")
    assert not is_log_directory(flights)
    with pytest.raises(UnreadableLogError, match="is a directory, not a log; name the file in it"):
        read(flights)


def test_what_is_no_bag_is_one_clear_line(tmp_path: Path, bag: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    assert not is_log_directory(empty)
    assert is_log_directory(bag)
    with pytest.raises(UnreadableLogError, match="is a directory, not a log"):
        read(empty)
    database = tmp_path / "other.db3"
    connection = sqlite3.connect(database)
    connection.execute("CREATE TABLE t (a)")
    connection.commit()
    connection.close()
    with pytest.raises(UnreadableLogError, match="no ROS 2 bag can be read from it: no such table"):
        read(database)
    database.write_bytes(b"nothing")
    with pytest.raises(UnreadableLogError, match="no SQLite file: it begins with b'nothing'"):
        rosbag2.read(database)
    with pytest.raises(UnreadableLogError, match="no such file"):
        rosbag2.read(tmp_path / "absent.db3")
    (bag / "bag.db3").unlink()
    with pytest.raises(UnreadableLogError, match=r"bag.db3 is named in metadata.yaml, but is not"):
        read(bag)
    os.mkfifo(bag / "x.db3")
    assert not rosbag2._files_in(bag)
