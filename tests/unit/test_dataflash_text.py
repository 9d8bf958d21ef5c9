"""DataFlash logs as text say what the binary ones say, and lines that are none are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording, Stream
from fdilog_readers import dataflash_text

HEAD = (
    "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n"
    "FMT, 131, 35, IMU, Qffffff, TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ\n"
    "FMT, 132, 12, EV, QB, TimeUS,Id\n"
    "FMT, 133, 75, MSG, QZ, TimeUS,Message\n"
    "FMT, 134, 14, MODE, QMB, TimeUS,Mode,ModeNum\n"
    "FMT, 135, 15, ATT, Qcc, TimeUS,Roll,Pitch\n"
)


def imu(k: int) -> str:
    return f"IMU, {1000 * k}, {k}.5, -0.25, 1e-3, 0.5, 0, -9.81\n"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("text") / "flight.log"


def read(path: Path, *lines: str, also: tuple[str, ...] = ()) -> Recording:
    path.write_bytes("".join(lines).encode())
    return dataflash_text.read(path, also)


def stream(recording: Recording, name: str) -> Stream:
    return next(s for s in recording.streams if s.name == name)


def losses(recording: Recording) -> list[str]:
    return [problem.what for problem in recording.problems if not problem.note]


def test_a_line_that_defines_a_message_makes_a_log() -> None:
    assert dataflash_text.sniff(HEAD.encode())
    assert dataflash_text.sniff(b" 1\n\nArduCopter V2.9\nFMT,131,35,IMU,Qfff,TimeUS,GyrX\n")
    assert not dataflash_text.sniff(b"time_s,FMT, 1\n")
    assert not dataflash_text.sniff(b"\xa3\x95\x80FMT, 1, 2, A, B, C")


def test_lines_are_gyros_attitude_and_what_is_said_of_the_vehicle(path: Path) -> None:
    recording = read(
        path,
        HEAD,
        "MSG, 5, ArduCopter V4.1.3 (2fb939a1)\n",
        "EV, 1500, 10\n",
        imu(2),
        "ATT, 2500, 180.00, -90.00\n",
        imu(3),
        "EV, 3500, 11\n",
    )
    gyro = stream(recording, "IMU")
    assert (gyro.gyro, gyro.sensor, gyro.units["GyrX"]) == (("GyrX", "GyrY", "GyrZ"), 0, "rad/s")
    assert gyro.columns["GyrX"].tolist() == [2.5, 3.5]
    assert gyro.time_ns.tolist() == [2_000_000, 3_000_000]
    assert stream(recording, "ATT").columns["Roll"].tolist() == [np.pi]
    assert recording.armed == ((1_500_000, 3_500_000),)
    assert recording.vehicle == {"firmware": "ArduCopter V4.1.3 (2fb939a1)"}
    assert losses(recording) == []


def test_one_message_with_an_instance_field_is_one_stream_for_each_sensor(path: Path) -> None:
    head = "FMT,131,24,IMU,QBfff,TimeUS,I,GyrX,GyrY,GyrZ\n"
    recording = read(path, head, *[f"IMU,{k},{k % 2},{k},0,0\n" for k in range(5)])
    assert [
        (s.name, s.sensor, s.columns["GyrX"].tolist()) for s in recording.streams if s.gyro
    ] == [
        ("IMU[0]", 0, [0.0, 2.0, 4.0]),
        ("IMU[1]", 1, [1.0, 3.0]),
    ]


def test_words_may_stand_where_the_format_has_them(path: Path) -> None:
    lines = ["MODE, 1, STABILIZE, 0\n", "MODE, 2, 5, 5\n", "MSG, 3, one, two\n"]
    recording = read(path, HEAD, *lines, also=("MODE",))
    assert stream(recording, "MODE").columns["Mode"].tolist() == ["STABILIZE", "5"]
    assert stream(recording, "MSG").columns["Message"].tolist() == ["one, two"]


def test_lines_that_are_none_are_told_and_cost_only_themselves(path: Path) -> None:
    bad = ["IMU, 5, 1.0\n", "IMU, 6, x, 0, 0, 0, 0, 0\n", "IMU, -7, 0, 0, 0, 0, 0, 0\n"]
    recording = read(path, HEAD, imu(1), *bad, "\n", "WHAT, 1\n", "no message at all\n", imu(2))
    assert stream(recording, "IMU").time_ns.tolist() == [1_000_000, 2_000_000]
    assert sorted(losses(recording)) == [
        "line 10: no whole IMU",
        "line 12: WHAT: no FMT line describes it",
        "line 13: no message",
        "line 8: no whole IMU",
        "line 9: no whole IMU",
    ]


@pytest.mark.parametrize("cut", ["IMU, 5, 1.0", "IM", "IMU, 5, 1, 2, 3, 4, 5, -"])
def test_a_last_line_that_was_cut_is_a_note(path: Path, cut: str) -> None:
    recording = read(path, HEAD, imu(1), cut)
    assert losses(recording) == []
    assert recording.problems[0].note
    assert recording.problems[0].bytes_lost == len(cut)
    assert stream(recording, "IMU").count == 1


def test_a_text_without_formats_is_one_clear_line(path: Path) -> None:
    with pytest.raises(UnreadableLogError, match="no line that begins with 'FMT,'"):
        read(path, imu(1))


@given(
    st.lists(st.sampled_from([imu(1), imu(2), "EV, 1, 10\n", "IMU,\n", ",\n", "\n", "\0\xe9\n"]))
)
def test_however_lines_are_mixed_every_whole_one_is_read(path: Path, lines: list[str]) -> None:
    recording = read(path, HEAD, *lines)
    whole = [line for line in lines if line in (imu(1), imu(2))]
    gyros = [s for s in recording.streams if s.gyro]
    rates = gyros[0].columns["GyrX"].tolist() if gyros else []
    assert rates == [float(line.split(",")[2]) for line in whole]
    told = sum(problem.bytes_lost or 0 for problem in recording.problems)
    assert told == sum(
        len(line.encode()) for line in lines if line in ("IMU,\n", ",\n", "\0\xe9\n")
    )


@given(st.text(max_size=200), st.booleans())
def test_text_of_any_kind_is_read_or_refused_in_one_line(
    path: Path, text: str, headed: bool
) -> None:
    data = (HEAD if headed else "") + text.encode("utf-8", "replace").decode()
    try:
        line = read(path, data).path
    except UnreadableLogError as error:
        line = str(error)
    assert line.startswith(str(path))
    assert line.isprintable()


def test_a_recorded_flight_is_the_same_as_text(real_logs: Path, path: Path) -> None:
    from pymavlink import DFReader

    source = real_logs / "dataflash" / "rover_dead_gyro.bin"
    with DFReader.DFReader_binary(str(source), zero_time_base=True) as log, path.open("w") as file:
        while (m := log.recv_msg()) is not None:
            values = [getattr(m, name) for name in m._fieldnames]
            file.write(", ".join([m.get_type(), *map(str, values)]) + "\n")
    recording = dataflash_text.read(path)
    theirs: dict[str, list[list[float]]] = {"IMU": []}
    with DFReader.DFReader_text(str(path), zero_time_base=True) as log:
        while (m := log.recv_match(type=list(theirs))) is not None:
            theirs[m.get_type()].append([m.TimeMS, m.GyrX, m.GyrY, m.GyrZ])
    for name, rows in theirs.items():
        ours = stream(recording, name)
        columns = [ours.time_ns / 1e6, *(ours.columns[axis] for axis in ours.gyro)]
        assert np.array_equal(np.column_stack(columns), np.array(rows))
    assert losses(recording) == []
