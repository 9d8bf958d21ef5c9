"""What the DataFlash reader makes of messages, and what it says of bytes that are none."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording, Stream
from fdilog_readers import dataflash
from fdilog_readers.columns import Blocks
from tests.dataflash_bytes import (
    HEAD,
    HEADER,
    bat,
    flight,
    fmt,
    imu,
    record,
    sample,
    samples,
)

RECORDS = flight(9)
WHOLE = HEAD + b"".join(RECORDS)
GYRO = "GyrX,GyrY,GyrZ"
ACC = "AccX,AccY,AccZ"
OTHER_FORMATS = {
    "MCAP": b"\x89MCAP0\r\n",
    "ROS 1 bag": b"#ROSBAG V2.0\n",
    "ULog": b"ULog\x01\x12\x35\x01",
    "SQLite": b"SQLite format 3\x00",
    "tlog": struct.pack(">Q", 1_500_000_000_000_000) + b"\xfd\x09\x00\x00",
    "text": b"FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n",
    "CSV": b"time_s,gx [deg/s]\n0.0,1.0\n",
}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "log.bin"


def read(path: Path, *parts: bytes, also: tuple[str, ...] = ()) -> Recording:
    path.write_bytes(b"".join(parts))
    return dataflash.read(path, also)


def stream(recording: Recording, name: str) -> Stream:
    return next(s for s in recording.streams if s.name == name)


def losses(recording: Recording) -> list[tuple[int | None, int | None]]:
    return [(p.offset, p.bytes_lost) for p in recording.problems if not p.note]


def notes(recording: Recording) -> list[Problem]:
    return [p for p in recording.problems if p.note and "no checksums" not in p.what]


# What is claimed


def test_a_log_is_known_by_its_first_format_record() -> None:
    assert dataflash.sniff(WHOLE[:4096])


@pytest.mark.parametrize("name", OTHER_FORMATS)
def test_other_formats_are_not_claimed(name: str) -> None:
    assert not dataflash.sniff(OTHER_FORMATS[name] + bytes(500))
    assert not dataflash.sniff(OTHER_FORMATS[name] + b"..\xa3\x95\x80" + b"\x11" * 500)
    assert not dataflash.sniff(OTHER_FORMATS[name] + b".." + HEAD[:89] + b"one alone")


def test_a_first_record_with_anything_behind_the_end_of_its_strings_is_not_believed() -> None:
    spoiled = bytearray(WHOLE[:89])
    spoiled[8:9] = b"x"  # right behind the NUL of the name, which was "FMT"
    assert dataflash.sniff(bytes(spoiled))  # a name of four letters
    spoiled[7:9] = b"\0x"
    assert not dataflash.sniff(bytes(spoiled))


def test_a_log_whose_first_bytes_are_lost_is_still_claimed() -> None:
    assert dataflash.sniff(bytes(64) + WHOLE[64:4096])


# What the messages mean


def test_numbered_messages_are_sensors_from_nought(path: Path) -> None:
    form, fields = "Qffffff", f"TimeUS,{GYRO},{ACC}"
    parts = [HEAD]
    for kind, name in ((140, "IMU2"), (141, "IMU3")):
        parts += [fmt(kind, name, form, fields), record(kind, form, 5, 1, 2, 3, 4, 5, 6)]
    recording = read(path, *parts, imu(1))
    gyros = {s.name: s for s in recording.streams if s.gyro}
    assert {name: s.sensor for name, s in gyros.items()} == {"IMU": 0, "IMU2": 1, "IMU3": 2}
    assert gyros["IMU2"].gyro == ("GyrX", "GyrY", "GyrZ")
    assert gyros["IMU2"].accelerometer == ("AccX", "AccY", "AccZ")
    assert gyros["IMU2"].units["GyrX"] == "rad/s"
    assert gyros["IMU2"].units["AccX"] == "m/s^2"
    assert gyros["IMU2"].columns["GyrY"].tolist() == [2.0]


def test_one_message_with_an_instance_field_is_one_stream_for_each_sensor(path: Path) -> None:
    form, fields = "QBffffffBH", f"TimeUS,I,{GYRO},{ACC},GH,GHz"
    rows = [record(140, form, 100 * k, k % 3, k, 0, 0, 0, 0, 0, 1, 400) for k in range(7)]
    recording = read(path, fmt(128, "FMT", "BBnNZ", ""), fmt(140, "IMU", form, fields), *rows)
    gyros = [s for s in recording.streams if s.gyro]
    assert [(s.name, s.sensor, s.count) for s in gyros] == [
        ("IMU[0]", 0, 3),
        ("IMU[1]", 1, 2),
        ("IMU[2]", 2, 2),
    ]
    assert gyros[1].columns["GyrX"].tolist() == [1.0, 4.0]
    assert gyros[1].time_ns.tolist() == [100_000, 400_000]
    assert gyros[1].columns["GHz"].tolist() == [400, 400]
    assert not any(s.name == "IMU" for s in recording.streams)


def test_raw_gyros_are_stamped_by_their_samples_and_belong_to_the_same_sensors(path: Path) -> None:
    form, fields = "QBQfff", f"TimeUS,I,SampleUS,{GYRO}"
    rows = [record(140, form, 1000 * k + 300, 1, 1000 * k, k, 0, 0) for k in range(5)]
    old = [record(141, "QQfff", 1000 * k, 1000 * k - 9, k, 0, 0) for k in range(1, 4)]
    head = HEAD + fmt(140, "GYR", form, fields)
    recording = read(path, head, fmt(141, "GYR3", "QQfff", f"TimeUS,SampleUS,{GYRO}"), *rows, *old)
    raw = stream(recording, "GYR[1]")
    assert (raw.sensor, raw.clock, raw.accelerometer) == (1, "SampleUS", ())
    assert raw.time_ns.tolist() == [10**6 * k for k in range(5)]
    assert raw.columns["TimeUS"].tolist() == [1000 * k + 300 for k in range(5)]
    assert stream(recording, "GYR3").sensor == 2


def test_a_sample_stamp_of_another_clock_is_left_where_it_is(path: Path) -> None:
    form = "QQfff"
    rows = [record(141, form, 10**9 + 1000 * k, 1000 * k, k, 0, 0) for k in range(1, 4)]
    recording = read(path, HEAD, fmt(141, "GYR1", form, f"TimeUS,SampleUS,{GYRO}"), *rows)
    raw = stream(recording, "GYR1")
    assert raw.time_ns.tolist() == [10**12 + 10**6 * k for k in range(1, 4)]
    assert raw.clock == "TimeUS (SampleUS is another clock)"


def test_times_are_exact_to_the_nanosecond_even_where_a_double_is_not(path: Path) -> None:
    late_us = 10**15 + 1
    old = fmt(140, "IMU2", "Ifff", f"TimeMS,{GYRO}") + record(140, "Ifff", 2**32 - 1, 1, 2, 3)
    recording = read(path, HEAD, record(131, "Qffffff", late_us, *range(6)), old)
    assert stream(recording, "IMU").time_ns.tolist() == [1000 * late_us]
    assert stream(recording, "IMU2").time_ns.tolist() == [(2**32 - 1) * 10**6]
    assert stream(recording, "IMU2").clock == "TimeMS"


def test_a_stamp_that_cannot_be_is_told_and_does_not_run_over(path: Path) -> None:
    recording = read(path, HEAD, imu(1), record(131, "Qffffff", 2**64 - 1, *range(6)), imu(2))
    time_ns = stream(recording, "IMU").time_ns
    assert (time_ns >= 0).all()
    assert notes(recording)[0].what == "1 records of IMU have a stamp that cannot be"


def test_an_attitude_is_in_radians_and_no_gyro(path: Path) -> None:
    form, fields = "QcccCCC", "TimeUS,Roll,Pitch,DesRoll,Yaw,DesYaw,ErrRP"
    row = record(140, form, 5, -4500, 9000, 1, 27000, 36000, 12)
    attitude = stream(read(path, HEAD, fmt(140, "ATT", form, fields), row), "ATT")
    assert attitude.gyro == ()
    assert attitude.units["Roll"] == "rad"
    assert attitude.columns["Roll"].tolist() == [math.radians(-45.0)]
    assert attitude.columns["Yaw"].tolist() == [math.radians(270.0)]
    assert attitude.columns["ErrRP"].tolist() == [0.12]


def test_other_messages_are_only_counted_until_they_are_asked_for(path: Path) -> None:
    listed = stream(read(path, WHOLE), "BAT")
    assert (listed.count, dict(listed.columns), len(listed.time_ns)) == (3, {}, 0)
    asked = stream(read(path, WHOLE, also=("BAT",)), "BAT")
    assert asked.columns["Temp"].tolist() == [21.5] * 3
    assert asked.time_ns.tolist() == [30_007_000, 60_007_000, 90_007_000]
    assert asked.offsets is not None
    assert [WHOLE[o : o + 3] for o in asked.offsets] == [HEADER + bytes([133])] * 3


def test_units_are_what_the_log_tells_of_them(path: Path) -> None:
    tellings = [
        fmt(150, "UNIT", "QbZ", "TimeUS,Id,Label"),
        fmt(151, "MULT", "Qbd", "TimeUS,Id,Mult"),
        fmt(152, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        *(record(150, "QbZ", 0, ord(i), u) for i, u in (("s", b"s"), ("v", b"V"), ("A", b"A"))),
        record(150, "QbZ", 0, ord("O"), b"degC"),
        *(record(151, "Qbd", 0, ord(i), f) for i, f in (("F", 1e-6), ("0", 1), ("C", 1e-3))),
        record(151, "Qbd", 0, ord("B"), 1e-2),
        record(152, "QBNN", 0, 133, b"svAO", b"F0CB"),
    ]
    recording = read(path, HEAD, *tellings, bat(1), also=("BAT",))
    assert stream(recording, "BAT").units == {"Volt": "V", "Curr": "0.001 A", "Temp": "degC"}


def test_columns_keep_their_own_types_and_strings_end_at_nul(path: Path) -> None:
    form, fields = "QgiZnaM", "TimeUS,G,I,Z,N,A,M"
    numbers = struct.pack("<32h", *range(-16, 16))
    row = record(140, form, 1, 0.5, -7, b"caf\xe9\0rest", "µ".encode(), numbers, -3)
    columns = stream(read(path, HEAD, fmt(140, "X", form, fields), row, also=("X",)), "X").columns
    assert columns["G"].dtype == np.float32
    assert columns["Z"].tolist() == ["café"]
    assert columns["N"].tolist() == ["µ"]
    assert columns["A"].tolist() == [list(range(-16, 16))]
    assert columns["M"].tolist() == [-3]


def test_a_signalling_nan_is_a_nan_like_any_other(path: Path) -> None:
    spoiled = bytearray(imu(1))
    spoiled[11:15] = struct.pack("<I", 0x7FA00000)
    rate = stream(read(path, HEAD, bytes(spoiled), imu(2)), "IMU").columns["GyrX"]
    # Were it one that signals, this would be a warning, and warnings are errors here.
    assert np.isnan(rate.astype(np.float64)).tolist() == [True, False]


def test_fields_of_one_name_or_none_are_all_kept_apart(path: Path) -> None:
    data = fmt(140, "X", "QBBB", "TimeUS,A,A") + record(140, "QBBB", 1, 2, 3, 4)
    columns = stream(read(path, HEAD, data, also=("X",)), "X").columns
    assert {f: c.tolist() for f, c in columns.items()} == {"A": [2], "A#2": [3], "field#3": [4]}


# What the log tells of the flight


def event(time_us: int, number: int) -> bytes:
    return record(132, "QB", time_us, number)


def test_armed_spans_run_from_arming_to_disarming_or_to_the_end(path: Path) -> None:
    events = [event(20_000, 10), event(25_000, 15), event(40_000, 11), event(60_000, 10)]
    recording = read(path, HEAD, imu(1), *events, imu(9))
    assert recording.armed == ((20_000_000, 40_000_000), (60_000_000, 90_000_000))


@pytest.mark.parametrize("first", [11, 15])
def test_a_log_that_never_armed_but_flew_was_begun_by_arming(path: Path, first: int) -> None:
    recording = read(path, HEAD, imu(1), event(30_000, first), imu(5), event(55_000, 11), imu(6))
    end_ns = 30_000_000 if first == 11 else 55_000_000
    assert recording.armed == ((10_000_000, end_ns),)


def test_the_arm_message_counts_as_well_and_silence_is_no_answer(path: Path) -> None:
    arm = fmt(140, "ARM", "QBI", "TimeUS,ArmState,ArmChecks")
    rows = [imu(1), record(140, "QBI", 20_000, 1, 0), imu(3), record(140, "QBI", 40_000, 0, 0)]
    assert read(path, HEAD, arm, *rows).armed == ((20_000_000, 40_000_000),)
    assert read(path, WHOLE).armed is None


def test_an_event_without_a_time_has_that_of_the_record_before_it(path: Path) -> None:
    old = HEAD + fmt(132, "EV", "B", "Id")
    events = [record(132, "B", number) for number in (99, 10, 11)]
    parts = [events[0], imu(1), imu(2), events[1], imu(3), events[2], imu(4)]
    recording = read(path, old, *parts)
    # One that is before all others can only have the first time there is.
    assert stream(recording, "EV").time_ns.tolist() == [10_000_000, 20_000_000, 30_000_000]
    assert stream(recording, "EV").clock == "time of the record before it"
    assert recording.armed == ((20_000_000, 30_000_000),)


def test_the_vehicle_is_what_messages_and_parameters_say(path: Path) -> None:
    said = [
        fmt(140, "MSG", "QZ", "TimeUS,Message"),
        fmt(141, "PARM", "QNf", "TimeUS,Name,Value"),
        *(
            record(140, "QZ", 1, text)
            for text in (b"ArduCopter V4.1.3 (2fb939a1)", b"CUAVv5 001A002F 30395113 33333539")
        ),
        record(140, "QZ", 1, b"Frame: QUAD/X"),
        record(140, "QZ", 1, b"GPS 1: detected as u-blox at 230400 baud"),
        record(141, "QNf", 1, b"INS_GYR_ID", 2621706),
        record(141, "QNf", 1, b"INS_GYRO_FILTER", 0.1),
        record(141, "QNf", 1, b"WPNAV_SPEED", 500),
    ]
    assert read(path, HEAD, *said).vehicle == {
        "firmware": "ArduCopter V4.1.3 (2fb939a1)",
        "board": "CUAVv5 001A002F 30395113 33333539",
        "frame": "QUAD/X",
        "INS_GYR_ID": "2621706",
        "INS_GYRO_FILTER": "0.100000001",
    }
    assert read(path, WHOLE).vehicle is None


@pytest.mark.parametrize(("week", "leap_s"), [(1800, 16), (1900, 17), (2000, 18), (1690, 15)])
def test_utc_comes_from_fixes_less_the_leap_seconds_of_the_day(
    path: Path, week: int, leap_s: int
) -> None:
    form, fields = "QBIH", "TimeUS,Status,GMS,GWk"
    rows = [
        record(140, form, 1_000_000, 1, 77, week),  # no fix yet: its time is not believed
        record(140, form, 2_000_000, 3, 302_000, week),
        record(140, form, 3_000_000, 4, 303_000, week),
        record(140, form, 4_000_000, 3, 999_000_000, week),  # one that is far out
    ]
    recording = read(path, HEAD, fmt(140, "GPS", form, fields), *rows)
    gps_epoch_s = 315_964_800  # 1980-01-06
    expected_s = gps_epoch_s + week * 604_800 + 300 - leap_s
    assert recording.utc_at_zero_ns == expected_s * 10**9
    assert read(path, HEAD, fmt(140, "GPS", form, fields), rows[0]).utc_at_zero_ns is None


def test_in_old_gps_messages_the_time_of_week_is_not_taken_for_the_logs_clock(path: Path) -> None:
    form, fields = "BIHI", "Status,TimeMS,Week,T"
    row = record(140, form, 3, 302_000, 1800, 2_000)
    recording = read(path, HEAD, fmt(140, "GPS", form, fields), row)
    assert stream(recording, "GPS").time_ns.tolist() == [2_000_000_000]
    assert recording.utc_at_zero_ns == (315_964_800 + 1800 * 604_800 + 300 - 16) * 10**9


# Bytes that are no records


def test_a_format_without_checksums_says_so(path: Path) -> None:
    recording = read(path, WHOLE)
    assert [p.note for p in recording.problems] == [True]
    assert "no checksums" in recording.problems[0].what


def test_a_last_record_that_power_cut_is_a_note(path: Path) -> None:
    recording = read(path, WHOLE, imu(10)[:20])
    assert losses(recording) == []
    assert [(p.offset, p.bytes_lost) for p in notes(recording)] == [(len(WHOLE), 20)]
    assert sample(10) not in samples(recording)


@pytest.mark.parametrize("fill", [b"\xff", b"\0"])
def test_erased_flash_and_unwritten_clusters_after_the_end_are_padding(
    path: Path, fill: bytes
) -> None:
    recording = read(path, WHOLE, fill * 249)
    assert losses(recording) == []
    assert [(p.offset, p.bytes_lost) for p in notes(recording)] == [(len(WHOLE), 249)]
    assert f"padding after the last record: 249 bytes 0x{fill.hex().upper()}" in (
        notes(recording)[0].what
    )
    assert samples(recording) == {sample(k) for k in range(1, 10)}


def test_a_record_cut_in_erased_flash_is_incomplete_and_not_full_of_ones(path: Path) -> None:
    recording = read(path, WHOLE, imu(10)[:20], b"\xff" * 300)
    assert losses(recording) == []
    assert [(p.offset, p.bytes_lost) for p in notes(recording)] == [
        (len(WHOLE), 20),
        (len(WHOLE) + 20, 300),
    ]
    assert len(samples(recording)) == 9


def test_garbage_after_the_end_is_a_loss_because_it_may_have_been_records(path: Path) -> None:
    recording = read(path, WHOLE, b"\x11\x12\x13" * 30)
    ((offset, lost),) = losses(recording)
    assert (offset or 0) + (lost or 0) == len(WHOLE) + 90


def test_a_record_of_an_unknown_type_is_skipped_and_named(path: Path) -> None:
    recording = read(path, HEAD, imu(1), record(99, "Qf", 1, 2), imu(2), imu(3))
    assert samples(recording) == {sample(1), sample(2), sample(3)}
    assert losses(recording) == [(len(HEAD) + 35, 15)]
    assert recording.problems[0].what == "a record of type 99, which no FMT record describes"


def test_a_record_in_which_damage_begins_is_lost_and_not_half_believed(path: Path) -> None:
    whole = bytearray(HEAD + b"".join(imu(k) for k in range(1, 9)))
    start = len(HEAD) + 2 * 35 + 20  # within the third
    whole[start : start + 60] = b"\x77" * 60  # to within the fifth
    recording = read(path, bytes(whole))
    assert samples(recording) == {sample(k) for k in (1, 2, 6, 7, 8)}
    assert losses(recording) == [(len(HEAD) + 2 * 35, 3 * 35)]


def test_garbage_that_looks_like_a_record_is_none(path: Path) -> None:
    lookalikes = [
        imu(7) + b"\xa3\x11",
        HEADER + bytes([128]) + b"\x11" * 86,
        HEADER + bytes([128, 131, 0]) + b"\x11" * 84,
    ]
    noise = b"\x11" * 5 + b"\x11\x22".join(lookalikes) + b"\x11" * 5
    recording = read(path, HEAD, imu(1), bat(1), noise, imu(2), imu(3))
    assert samples(recording) == {sample(1), sample(2), sample(3)}
    start = len(HEAD) + 35
    assert losses(recording) == [(start, 21 + len(noise))]


def test_records_before_damage_and_before_a_new_format_are_all_kept(path: Path) -> None:
    again = fmt(131, "IMU", "Qfff", f"TimeUS,{GYRO}") + record(131, "Qfff", 30_000, 3.5, -3, 0.375)
    recording = read(path, HEAD, imu(1), record(99, "B", 1), imu(2), again)
    assert samples(recording) == {sample(1), sample(2), sample(3)}
    assert losses(recording) == [(len(HEAD) + 35, 4)]


def test_garbage_that_ends_in_a_zero_is_not_padding(path: Path) -> None:
    recording = read(path, HEAD, imu(1), imu(2), HEADER + b"\x63" + b"\x11" * 30 + b"\0")
    assert losses(recording) == [(len(HEAD) + 70, 34)]
    assert notes(recording) == []


def test_padding_is_one_stretch_however_long(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dataflash, "BLOCK_BYTES", 800)
    garbage = HEADER + b"\x63" + b"\x11" * 1000
    recording = read(path, WHOLE, garbage, b"\xff" * 5000)
    assert losses(recording) == [(len(WHOLE), len(garbage))]
    end = len(WHOLE) + len(garbage)
    assert [(p.offset, p.bytes_lost) for p in notes(recording)] == [(end, 5000)]


def test_bytes_at_the_end_that_only_begin_like_a_format_define_nothing(path: Path) -> None:
    junk = HEADER + bytes([128, 131, 50]) + b"\x11" * 84
    recording = read(path, HEAD, imu(1), junk, b"\x11" * 40)
    assert samples(recording) == {sample(1)}
    assert losses(recording)[0] == (len(HEAD) + 35, 89)
    assert "its text is none, and no record follows it" in recording.problems[0].what


def test_a_format_record_in_a_payload_defines_nothing(path: Path) -> None:
    head = HEAD + fmt(140, "FILE", "Za", "Data,More")
    inner = fmt(131, "IMU", "Qfff", f"TimeUS,{GYRO}")
    file = record(140, "Za", inner[:64], inner[64:])
    recording = read(path, head, file, imu(1), file, imu(2))
    assert samples(recording) == {sample(1), sample(2)}
    assert losses(recording) == []


def test_a_format_of_no_length_is_told_and_the_rest_is_read(path: Path) -> None:
    recording = read(path, HEAD, fmt(140, "ZERO", "", "", length=0), imu(1), imu(2))
    assert samples(recording) == {sample(1), sample(2)}
    assert losses(recording) == [(len(HEAD), 89)]
    assert recording.problems[0].what == ("an FMT record is bad: it gives ZERO a length of 0 bytes")


def test_a_format_that_contradicts_itself_loses_its_own_records_only(path: Path) -> None:
    bad = fmt(140, "IMU2", "Qfff", f"TimeUS,{GYRO}", length=25)
    rows = [HEADER + bytes([140]) + bytes(22), imu(1)] * 2
    recording = read(path, HEAD, bad, *rows)
    assert len(samples(recording)) == 1
    assert stream(recording, "IMU2").count == 2
    (problem,) = [p for p in recording.problems if not p.note]
    assert problem.bytes_lost == 50
    assert "its fields make 23 bytes, its length says 25" in problem.what


def test_a_type_defined_in_two_ways_keeps_what_both_have(path: Path) -> None:
    again = fmt(131, "IMU", "Qfff", f"TimeUS,{GYRO}") + record(131, "Qfff", 20_000, 2.5, -2, 0.25)
    recording = read(path, HEAD, imu(1), again)
    assert samples(recording) == {sample(1), sample(2)}
    assert "left out, as they are not alike in all: AccX, AccY, AccZ" in notes(recording)[0].what


def test_after_a_hundred_places_only_the_sum_is_told(path: Path) -> None:
    recording = read(path, HEAD, *[imu(k) + record(99, "B", 1) for k in range(150)], imu(150))
    problems = [p for p in recording.problems if not p.note]
    assert len(problems) == 101
    assert problems[-1].what == "50 more places like these"
    assert sum(p.bytes_lost or 0 for p in problems) == 150 * 4
    assert len(samples(recording)) == 151


def test_a_file_without_any_format_is_one_clear_line(path: Path) -> None:
    with pytest.raises(UnreadableLogError, match=r"log\.bin: no FMT record .* in 35 bytes"):
        read(path, imu(1))
    with pytest.raises(UnreadableLogError, match="no such file or directory"):
        dataflash.read(path.with_name("absent.bin"))


def test_what_a_failing_medium_keeps_back_is_lost_and_told(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dataflash, "BLOCK_BYTES", 700)
    original = Blocks.advance

    def failing(blocks: Blocks, done: int) -> NDArray[np.uint8]:
        piece = original(blocks, done)
        if blocks.start:
            blocks.at_end, blocks.failure = True, "input/output error"
        return piece

    monkeypatch.setattr(Blocks, "advance", failing)
    recording = read(path, HEAD, *[imu(k) for k in range(1, 100)])
    (problem,) = [p for p in recording.problems if not p.note]
    assert problem.what == "the file could not be read beyond this byte: input/output error"
    assert (problem.offset or 0) + (problem.bytes_lost or 0) == len(HEAD) + 99 * 35
    assert 10 < len(samples(recording)) < 50
    assert recording.bytes == len(HEAD) + 99 * 35


def test_formats_alone_are_a_log_without_records(path: Path) -> None:
    recording = read(path, HEAD[:200])
    assert [(s.name, s.count) for s in recording.streams] == [("FMT", 2)]
    assert [(p.offset, p.bytes_lost) for p in notes(recording)] == [(178, 22)]


def test_the_first_compass_and_the_velocity_of_the_first_gps_are_told(path: Path) -> None:
    head = fmt(140, "MAG", "QBhhh", "TimeUS,I,MagX,MagY,MagZ")
    head += fmt(141, "GPS", "QBBff", "TimeUS,I,Status,Spd,GCrs")
    mag = [record(140, "QBhhh", 10_000, k, 100 + k, 20, 400) for k in range(2)]
    gps = [
        record(141, "QBBff", 10_000 * k, instance, status, 5.0, 90.0)
        for k, (instance, status) in enumerate([(0, 3), (1, 3), (0, 1)])
    ]
    recording = read(path, WHOLE, head, *mag, *gps)
    compass = stream(recording, "MAG")
    x, y, z = (compass.columns[f] for f in compass.compass)
    assert (x[0], y[0], z[0]) == (100.0, 20.0, 400.0)
    assert np.isnan([x[1], y[1], z[1]]).all()
    assert compass.columns["MagX"].tolist() == [100, 101]
    ground = stream(recording, "GPS")
    north, east = (ground.columns[f] for f in ground.velocity)
    assert (north[0], east[0]) == pytest.approx((0.0, 5.0))
    assert np.isnan([north[1:], east[1:]]).all()  # of another GPS; no fix
