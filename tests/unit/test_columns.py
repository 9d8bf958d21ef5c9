"""Bytes, offsets and a layout make columns, and nothing outside the bytes is ever touched."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fdilog.errors import UnreadableLogError
from fdilog_readers.columns import Blocks, Chain, choose_time, columns, plain_text, rows, whole

LAYOUT = np.dtype(
    {
        "names": ["time", "rate", "pair", "name"],
        "formats": ["<u8", ">f4", ("<i2", (2,)), "S4"],
        "offsets": [1, 9, 13, 17],
        "itemsize": 21,
    }
)


def record(time: int, rate: float) -> bytes:
    return (
        b"#" + struct.pack("<Q", time) + struct.pack(">f", rate) + struct.pack("<hh", 1, -2) + b"ab"
    )


def test_fields_at_odd_places_and_in_any_byte_order_become_contiguous_native_columns() -> None:
    data = b"x" + record(7, 0.5) + b"\0\0" + b"yy" + record(2**60, -3.25) + b"cd"
    got = columns(np.frombuffer(data, np.uint8), np.array([1, 24]), LAYOUT)
    assert got["time"].tolist() == [7, 2**60]
    assert got["rate"].tolist() == [0.5, -3.25]
    assert got["rate"].dtype == np.dtype("=f4")
    assert got["pair"].tolist() == [[1, -2], [1, -2]]
    assert got["name"].tolist() == [b"ab", b"abcd"]
    assert all(column.flags.c_contiguous for column in got.values())


def test_only_the_wanted_fields_are_copied() -> None:
    buffer = np.zeros(30, np.uint8)
    assert list(columns(buffer, np.array([0]), LAYOUT, ["rate"])) == ["rate"]


def test_whole_rows_hold_what_the_columns_hold() -> None:
    data = np.frombuffer(b"..." + record(9, 1.5) + b"zz", np.uint8)
    got = rows(data, np.array([3]), LAYOUT)
    assert got["time"][0] == 9
    assert got["rate"][0] == 1.5
    assert got["name"][0] == b"abzz"


@pytest.mark.parametrize("offset", [-1, 10])
def test_a_record_that_reaches_outside_the_buffer_is_an_error_and_not_a_read(offset: int) -> None:
    for gather in (rows, columns):
        with pytest.raises(IndexError, match="of 30"):
            gather(np.zeros(30, np.uint8), np.array([0, offset]), LAYOUT)


def test_no_records_make_empty_columns_even_of_an_empty_buffer() -> None:
    got = columns(np.empty(0, np.uint8), np.empty(0, np.int64), LAYOUT)
    assert got["pair"].shape == (0, 2)
    assert got["time"].dtype == np.uint64
    assert len(rows(np.empty(0, np.uint8), np.empty(0, np.int64), LAYOUT)) == 0


def test_a_chain_leaves_out_what_only_looks_like_a_record() -> None:
    # 0-10, 10-25 with a false start at 17, 25-30, then nothing begins at 30.
    starts = np.array([0, 10, 17, 25, 33])
    ends = np.array([10, 25, 40, 30, 40])
    found, stopped = Chain(starts, ends).follow(0)
    assert found.tolist() == [0, 1, 3]
    assert stopped == 30
    assert Chain(starts, ends).follow(33)[0].tolist() == [4]
    assert Chain(starts, ends).follow(5)[0].tolist() == []
    assert Chain(starts[:0], ends[:0]).follow(5)[1] == 5


def test_blocks_hand_out_every_byte_once_and_keep_what_is_not_done_with(tmp_path: Path) -> None:
    path = tmp_path / "log"
    content = np.random.default_rng(1).integers(0, 256, 1000, dtype=np.uint8)
    content.tofile(path)
    seen: list[int] = []
    with Blocks(path, 100) as blocks:
        piece, done = blocks.advance(0), 0
        while True:
            assert piece.tolist() == content[blocks.start : blocks.end].tolist()
            done = max(len(piece) - 7, 0) if not blocks.at_end else len(piece)
            seen += piece[:done].tolist()
            if blocks.at_end:
                break
            piece = blocks.advance(done)
    assert seen == content.tolist()


def test_a_block_grows_for_something_longer_than_itself(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(bytes(1000))
    with Blocks(path, 100) as blocks:
        lengths = [len(blocks.advance(0)) for _ in range(5)]
    assert lengths == [100, 200, 400, 800, 1000]


def test_a_medium_that_fails_ends_the_file_there_and_says_why(tmp_path: Path) -> None:
    path = tmp_path / "log"
    path.write_bytes(bytes(300))

    class Failing:
        def readinto(self, _view: memoryview) -> int:
            raise OSError(5, "Input/output error")

    with Blocks(path, 100) as blocks:
        blocks.advance(0)
        file, blocks._file = blocks._file, Failing()  # type: ignore[assignment]
        piece = blocks.advance(60)
        blocks._file = file
    assert (blocks.start, len(piece), blocks.at_end, blocks.size) == (60, 40, True, 300)
    assert blocks.failure == "input/output error"


def test_a_file_that_cannot_be_opened_is_one_clear_line(tmp_path: Path) -> None:
    for opened in (Blocks, whole):
        with pytest.raises(UnreadableLogError, match="absent: no such file or directory"):
            opened(tmp_path / "absent")


def test_the_stamp_is_taken_only_if_it_tells_the_recorders_time() -> None:
    record_ns = np.arange(10) * 1_000_000
    stamp_ns = record_ns - 300
    constant = np.full(10, 5)
    elsewhere = stamp_ns + 10**18
    assert choose_time(stamp_ns, record_ns, "stamp", "log time")[1] == "stamp"
    assert (
        choose_time(constant, record_ns, "stamp", "log time")[1] == "log time (stamp stands still)"
    )
    assert "another clock" in choose_time(elsewhere, record_ns, "stamp", "log time")[1]
    assert len(choose_time(stamp_ns[:0], record_ns[:0], "stamp", "log time")[0]) == 0


def test_text_of_a_log_can_neither_hide_nor_command_anything() -> None:
    assert plain_text(b"IMU\0rest") == "IMU"
    assert plain_text(b"caf\xc3\xa9 \xb5") == "cafÃ© µ"
    assert plain_text("µ\x1b[2J\n") == "µ\\x1b[2J\\n"
