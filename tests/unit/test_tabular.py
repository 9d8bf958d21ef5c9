"""Tables of gyro channels: headers are names and units, and every cell that is none is told."""

from __future__ import annotations

import builtins
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording, Stream
from fdilog_readers import tabular
from fdilog_readers.tabular import nanoseconds

DEG = np.pi / 180.0


def read(folder: Path, text: str | bytes, name: str = "log.csv") -> Recording:
    path = folder / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return tabular.read(path)


def only(recording: Recording) -> Stream:
    (stream,) = recording.streams
    return stream


def losses(recording: Recording) -> list[str]:
    return [problem.what for problem in recording.problems if not problem.note]


def notes(recording: Recording) -> list[str]:
    return [problem.what for problem in recording.problems if problem.note]


@pytest.mark.parametrize(
    "head",
    [b"time_s,g1\n", b"\xef\xbb\xbftime_s;g1\r\n", b"g1\ttime_s\n", b'"time_s","g"\n', b"PAR1"],
)
def test_a_column_time_s_or_the_magic_of_parquet_makes_a_table(head: bytes) -> None:
    assert tabular.sniff(head)


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"time,g1\n",
        b"the time_s is\n",
        b"\xa3\x95\x80\x80",
        b"ULog\x01\x12\x35",
        b"\x89MCAP0\r\n",
    ],
)
def test_anything_else_is_not_claimed(head: bytes) -> None:
    assert not tabular.sniff(head)


def test_a_header_is_a_name_and_a_unit_and_rad_s_without_one(tmp_path: Path) -> None:
    header = "time_s,g1,g2 [deg/s],g3[mrad/s],g4 (deg/s),ax [m/s^2],T [degC]\n"
    stream = only(read(tmp_path, header + "0.5,1,180,500,90,9.8,20\n"))
    assert stream.gyro == stream.channel_names == ("g1", "g2", "g3", "g4")
    assert [stream.columns[g].tolist() for g in stream.gyro] == [
        [1.0],
        [180 * DEG],
        [0.5],
        [90 * DEG],
    ]
    assert stream.accelerometer == ("ax",)
    assert stream.units == {
        **dict.fromkeys(stream.gyro, "rad/s"),
        "ax": "m/s^2",
        "T": "degC",
    }
    assert (stream.name, stream.clock, stream.time_ns.tolist()) == (
        "table",
        "time_s",
        [500_000_000],
    )


def test_names_with_a_dot_belong_to_the_source_before_it(tmp_path: Path) -> None:
    text = "imu0.x,time_s,imu0.y,left.front.x,g\n1,0,2,3,4\n"
    recording = read(tmp_path, text)
    assert {s.name: (s.gyro, s.channel_names) for s in recording.streams} == {
        "imu0": (("x", "y"), ("imu0.x", "imu0.y")),
        "left.front": (("x",), ("left.front.x",)),
        "table": (("g",), ("g",)),
    }


@pytest.mark.parametrize(
    ("header", "sources"),
    [
        ("gyro1_x,gyro1_y,gyro1_z,gyro2_x,gyro2_y,gyro2_z", ["gyro1"] * 3 + ["gyro2"] * 3),
        ("gx1,gy1,gz1,gx2,gy2,gz2", ["g1"] * 3 + ["g2"] * 3),
        ("aX,aY,aZ,bX,bY,bZ", ["a"] * 3 + ["b"] * 3),
        ("gx,gy,gz,t [degC]", ["table"] * 4),
        ("ax,bx,ay,by,az,bz", ["table"] * 6),
        ("gx1,gy1,gz1,gx2,gy2,gx3", ["table"] * 6),
        ("gx1,gy1,gz1,gx2,gy2,gz2,more", ["g1"] * 3 + ["g2"] * 3 + ["table"]),
    ],
)
def test_several_triads_beside_each_other_are_a_source_each(
    tmp_path: Path, header: str, sources: list[str]
) -> None:
    names = [name.partition(" ")[0] for name in header.split(",")]
    recording = read(tmp_path, f"time_s,{header}\n0.1{',1' * len(names)}\n")
    found = {name: stream.name for stream in recording.streams for name in stream.columns}
    assert found == dict(zip(names, sources, strict=True))
    assert [k for s in recording.streams for k in s.channel_names] == [
        name for name in names if name != "t"
    ]


def test_a_row_without_a_reading_of_a_source_is_no_record_of_it(tmp_path: Path) -> None:
    text = "time_s,a.x,a.y,b.x\n0,1,2,3\n1,,,4\n2,5,,\n3,nan,NaN,6\n"
    first, second = read(tmp_path, text).streams
    assert first.time_ns.tolist() == [0, 2 * 10**9]
    assert first.columns["x"].tolist() == [1.0, 5.0]
    assert np.isnan(first.columns["y"][1])
    assert second.time_ns.tolist() == [0, 10**9, 3 * 10**9]


def test_a_row_in_which_only_the_thermometer_speaks_is_no_record_of_a_gyro(tmp_path: Path) -> None:
    stream = only(read(tmp_path, "time_s,g1,T [degC]\n0,1,20\n1,,21\n2,3,\n"))
    assert stream.time_ns.tolist() == [0, 2 * 10**9]
    assert stream.columns["T"][0] == 20.0


def test_separators_at_the_end_of_lines_are_no_cells(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,g1\n0,1,\n1,2,\n")
    assert only(recording).columns["g1"].tolist() == [1.0, 2.0]
    assert recording.problems == ()


def test_a_line_of_blanks_is_told_and_shifts_no_other(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s\n1\n  \n2\n")
    assert losses(recording) == ["line 3: no number in 'time_s'"]


def test_semicolons_tabs_and_decimal_commas_are_understood(tmp_path: Path) -> None:
    recording = read(tmp_path, "\ufefftime_s;g1\r\n0,5;-1,25e-3\r\n\r\n1,5;2\r\n\r\n")
    assert recording.problems == ()
    stream = only(recording)
    assert stream.time_ns.tolist() == [500_000_000, 1_500_000_000]
    assert stream.columns["g1"].tolist() == [-1.25e-3, 2.0]
    assert only(read(tmp_path, "time_s\tg1\n1\t2.5\n")).columns["g1"].tolist() == [2.5]


def test_quoted_cells_and_what_savetxt_writes_are_understood(tmp_path: Path) -> None:
    quoted = only(read(tmp_path, '"time_s","g, left [deg/s]"\n"0","180"\n"1","90"\n'))
    assert quoted.channel_names == ("g, left",)
    assert quoted.columns["g, left"].tolist() == [np.pi, np.pi / 2]
    with (tmp_path / "numpy.csv").open("w") as file:
        np.savetxt(file, [[0.0, 1.5], [0.1, np.nan]], delimiter=",", header="time_s,g1")
    assert only(tabular.read(tmp_path / "numpy.csv")).columns["g1"].tolist() == [1.5]


def test_numbers_are_read_to_the_last_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    values = rng.integers(0, 2**64, 2000, dtype=np.uint64).view(np.float64)
    values = values[np.isfinite(values)]
    text = "time_s,g1\n" + "".join(f"{k},{v!r}\n" for k, v in enumerate(values.tolist()))
    assert only(read(tmp_path, text)).columns["g1"].tolist() == values.tolist()


def test_every_row_and_cell_that_is_none_is_told_with_its_line(tmp_path: Path) -> None:
    text = "time_s,g1,g2\n0,1,2\n1,abc,2\n2,1\n\n3,1,2,3\nx,1,2\n,1,2\n4,1,2\ninf,1,2\n"
    recording = read(tmp_path, text)
    assert losses(recording) == [
        "line 3, column 'g1': 'abc' is no number",
        "line 4: 2 cells where the header has 3",
        "line 6: 4 cells where the header has 3",
        "line 7: no number in 'time_s'",
        "line 8: no number in 'time_s'",
        "line 10: no number in 'time_s'",
    ]
    places = [text.index(line) for line in ("1,abc", "2,1\n", "3,1,2,3")]
    assert [p.offset for p in recording.problems][:3] == places
    assert [p.bytes_lost for p in recording.problems][:3] == [3, 4, 8]
    stream = only(recording)
    assert stream.time_ns.tolist() == [0, 10**9, 4 * 10**9]
    assert stream.columns["g2"].tolist() == [2.0, 2.0, 2.0]
    assert np.isnan(stream.columns["g1"][1])


def test_a_bad_cell_outside_the_gyros_is_a_note(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,g1,T [degC]\n0,1,20\n1,2,warm\n")
    assert losses(recording) == []
    assert notes(recording) == ["line 3, column 'T [degC]': 'warm' is no number"]


def test_a_column_of_words_is_left_out_and_costs_nothing(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,mode,g1\n0,AUTO,1\n1,LAND,2\n")
    assert losses(recording) == []
    assert notes(recording) == ["column 'mode' holds words, no numbers: left out"]
    assert list(only(recording).columns) == ["g1"]


def test_columns_without_a_name_or_with_the_same_name_are_told(tmp_path: Path) -> None:
    recording = read(tmp_path, ",time_s,g1,g1\n0,0,1,2\n")
    assert notes(recording) == [
        "column 1 has no name: left out",
        "column 'g1' is there more than once; the later one is not compared",
    ]
    assert only(recording).channel_names == ("g1",)
    assert only(recording).columns["g1#4"].tolist() == [2.0]


@pytest.mark.parametrize(
    ("unit", "rad_s"),
    [
        ("Deg/sec", np.pi / 180.0), ("degrees / s", np.pi / 180.0), ("DPS", np.pi / 180.0),
        ("mdps", np.pi / 180e3), ("radians/sec", 1.0), ("rpm", np.pi / 30.0),
        ("deg/hr", np.pi / 648e3),
    ],
)  # fmt: skip
def test_units_are_known_as_people_write_them(tmp_path: Path, unit: str, rad_s: float) -> None:
    recording = read(tmp_path, f"time_s,g1 [{unit}]\n0,1\n")
    assert only(recording).columns["g1"].tolist() == pytest.approx([rad_s])


def test_a_rate_in_a_unit_that_is_not_known_is_named_and_not_compared(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,g1 [rev/min],ax [m/s^2],yaw [deg]\n0,1,2,3\n")
    (note,) = notes(recording)
    assert note.startswith("column 'g1' is in rev/min, none of rad/s, ")
    assert only(recording).gyro == ()


@pytest.mark.parametrize("cut", ["1,2", "1,2,", "1,2,3e-", "1"])
def test_a_last_row_that_was_cut_is_a_note(tmp_path: Path, cut: str) -> None:
    recording = read(tmp_path, "time_s,g1,g2\n0,1,2\n" + cut)
    missing = cut.endswith(",")  # a whole row whose last cell is empty, as far as anyone can tell
    assert losses(recording) == []
    assert len(only(recording).time_ns) == 1 + missing
    assert notes(recording) == [
        "line 3 has no end: its last cell may be cut short, left out"
        if missing
        else "line 3, the last one, is incomplete: writing stopped there"
    ]


def test_a_last_number_that_no_newline_ends_is_not_believed(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,g1,g2\n0,1,2\n1,3,-9.2")  # of -9.2e-05, maybe
    columns = only(recording).columns
    assert columns["g1"].tolist() == [1.0, 3.0]
    assert np.array_equal(columns["g2"], [2.0, np.nan], equal_nan=True)
    assert notes(recording) == ["line 3 has no end: its last cell may be cut short, left out"]
    assert losses(recording) == []


def test_a_table_without_rows_has_channels_without_samples(tmp_path: Path) -> None:
    stream = only(read(tmp_path, "time_s,g1\n"))
    assert (stream.channel_names, stream.count) == (("g1",), 0)


@pytest.mark.parametrize("text", ["a,b,c\n1,2,3\n", "0,1\n2,3\n", "\n\n", "no table at all"])
def test_a_table_without_time_is_one_line_that_names_its_columns(tmp_path: Path, text: str) -> None:
    columns = text.split("\n", maxsplit=1)[0].replace(",", ", ") or "none"
    with pytest.raises(UnreadableLogError, match=f"no column 'time_s'.* are: {columns}$"):
        read(tmp_path, text)


def test_utf_16_and_absent_files_are_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(UnreadableLogError, match="UTF-16; save it as UTF-8"):
        read(tmp_path, "time_s,g1\n".encode("utf-16"))
    with pytest.raises(UnreadableLogError, match="no such file"):
        tabular.read(tmp_path / "absent.csv")


def test_times_are_rounded_to_the_nanosecond_even_in_seconds_since_1970() -> None:
    time_s = np.array([0.1, 1e-9, 1_700_000_000.1234567, -0.25, 123456789.000000015])
    expected = [round(float(t) * 10**9) if abs(t) < 1 else None for t in time_s]
    ours = nanoseconds(time_s).tolist()
    assert ours[0], ours[1] == (expected[0], expected[1])
    assert ours[3] == -250_000_000
    for t, ns in zip(time_s.tolist(), ours, strict=True):
        numerator, denominator = t.as_integer_ratio()
        exact = numerator * 10**9 / denominator
        assert abs(ns * denominator - numerator * 10**9) * 2 <= denominator, (t, ns, exact)


def test_a_time_that_no_clock_shows_is_told(tmp_path: Path) -> None:
    recording = read(tmp_path, "time_s,g1\n1e300,1\n1,2\n")
    assert losses(recording) == ["1 rows have a time_s that cannot be"]
    assert only(recording).time_ns.tolist() == [10**9]


# Parquet


def table(path: Path, rows_per_group: int = 100) -> dict[str, np.ndarray[Any, Any]]:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {
        "time_s": np.arange(300) / 100,
        "imu0.x": np.random.default_rng(1).normal(size=300),
        "g1 [deg/s]": np.arange(300, dtype=np.int32),
        "mode": ["AUTO"] * 300,
    }
    pq.write_table(pa.table(columns), path, row_group_size=rows_per_group, compression="zstd")
    return columns


def test_parquet_is_read_by_the_same_rules(tmp_path: Path) -> None:
    columns = table(tmp_path / "log.parquet")
    recording = tabular.read(tmp_path / "log.parquet")
    streams = {s.name: s for s in recording.streams}
    assert streams["imu0"].columns["x"].tolist() == columns["imu0.x"].tolist()
    assert streams["table"].columns["g1"].tolist() == (columns["g1 [deg/s]"] * DEG).tolist()
    assert streams["imu0"].time_ns.tolist() == [k * 10**7 for k in range(300)]
    assert notes(recording) == ["column 'mode' holds words, no numbers: left out"]
    assert losses(recording) == []


def test_nulls_are_no_readings_and_a_row_without_time_is_lost(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq

    data = {"time_s": [0.0, None, 2.0, 3.0], "a.x": [1, 2, None, 4]}
    pq.write_table(pa.table(data), tmp_path / "log.parquet")
    recording = tabular.read(tmp_path / "log.parquet")
    assert only(recording).time_ns.tolist() == [0, 3 * 10**9]
    assert losses(recording) == ["1 rows have no number in 'time_s'"]


def test_a_damaged_row_group_costs_itself_only(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    path = tmp_path / "log.parquet"
    columns = table(path)
    chunk = pq.ParquetFile(path).metadata.row_group(1).column(1)
    data = bytearray(path.read_bytes())
    start = chunk.data_page_offset
    data[start : start + chunk.total_compressed_size // 2] = b"\x55" * (
        chunk.total_compressed_size // 2
    )
    path.write_bytes(bytes(data))
    recording = tabular.read(path)
    (what,) = losses(recording)
    assert what.startswith("row group 1: its 100 rows are damaged")
    stream = next(s for s in recording.streams if s.name == "imu0")
    expected = np.delete(columns["imu0.x"], slice(100, 200))
    assert stream.columns["x"].tolist() == expected.tolist()


def test_a_parquet_file_without_its_index_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "log.parquet"
    table(path)
    path.write_bytes(path.read_bytes()[:-20])
    with pytest.raises(
        UnreadableLogError, match="the index at the end of this Parquet file is lost"
    ):
        tabular.read(path)


def test_parquet_without_pyarrow_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "log.parquet"
    table(path)
    original = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.startswith("pyarrow"):
            raise ImportError(name)
        return original(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(UnreadableLogError, match=r"pip install 'fdilog\[parquet\]'"):
        tabular.read(path)


def test_what_is_called_as_no_gyro_is_and_has_no_unit_is_compared_with_nothing(
    tmp_path: Path,
) -> None:
    header = "time_s,imu0.x,imu0.y,imu0.z,imu0.ax,imu0.acc_y,imu0.mag_z,imu0.temp\n"
    recording = read(tmp_path, header + "".join(f"{k},1,2,3,4,5,6,7\n" for k in range(3)))
    assert only(recording).channel_names == ("imu0.x", "imu0.y", "imu0.z")
    assert [note.split("'")[1] for note in notes(recording)] == [
        "imu0.ax", "imu0.acc_y", "imu0.mag_z", "imu0.temp",
    ]  # fmt: skip
    named = read(tmp_path, "time_s,ax [deg/s]\n0,1\n1,2\n")
    assert only(named).channel_names == ("ax",)
