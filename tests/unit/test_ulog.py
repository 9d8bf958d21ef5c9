"""PX4 logs are read as the official library would, with what is wrong told, not hidden."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import choose
from fdilog_readers import ulog
from tests.ulog_oracle import (
    GYRO_0,
    GYRO_1,
    HEADER,
    LOAD,
    SYNC,
    data,
    definitions,
    flight,
    gyro,
    keyed,
    log,
    official,
    record,
    subscription,
)


def file(folder: Path, content: bytes) -> Path:
    path = folder / "flight.ulg"
    path.write_bytes(content)
    return path


def stream(recording: Recording, name: str) -> Stream:
    return next(s for s in recording.streams if s.name == name)


def losses(recording: Recording) -> list[tuple[int | None, int | None]]:
    return [(p.offset, p.bytes_lost) for p in recording.problems if not p.note]


def said(recording: Recording, what: str) -> bool:
    return any(what in problem.what for problem in recording.problems)


def test_every_topic_is_what_the_official_library_gives(tmp_path: Path) -> None:
    path = file(tmp_path, log())
    theirs = official(path)
    recording = ulog.read(path, also=["cpuload", "vehicle_status"])
    assert losses(recording) == []
    ours = {s.name: s for s in recording.streams if s.columns}
    names = {("sensor_gyro", 0): "sensor_gyro[0]", ("sensor_gyro", 1): "sensor_gyro[1]"}
    for (name, instance), columns in theirs.items():
        mine = ours.pop(names.get((name, instance), name))
        for field, column in columns.items():
            if field != mine.clock:
                assert np.array_equal(mine.columns[field], column)
        assert (mine.time_ns // 1000).tolist() == columns[mine.clock].tolist()
    assert not ours


def test_sensors_are_numbered_by_instance_and_stamped_when_sampled(tmp_path: Path) -> None:
    recording = ulog.read(file(tmp_path, log()))
    for k in range(2):
        one = stream(recording, f"sensor_gyro[{k}]")
        assert (one.sensor, one.gyro, one.origin) == (k, ("x", "y", "z"), "sensor")
        assert one.units["x"] == "rad/s"
        assert one.clock == "timestamp_sample"
        assert int(one.time_ns[0]) == (5_000_000 - 300 + 40 * k) * 1000
    gyros, _ = choose(recording, Config())
    assert [source.name for source in gyros] == ["imu0", "imu1"]


def test_records_know_where_they_are_in_the_file(tmp_path: Path) -> None:
    content = log()
    offsets = stream(ulog.read(file(tmp_path, content)), "sensor_gyro[1]").offsets
    assert offsets is not None
    assert len(offsets) == 200
    assert all(content[at + 2 : at + 5] == b"D" + bytes([GYRO_1, 0]) for at in offsets.tolist())


def test_the_time_of_sampling_is_left_where_it_stands_still(tmp_path: Path) -> None:
    records = [
        data(GYRO_0, "QQIffffI", 10**6 + 1000 * k, 7, 11, 1.0, 2.0, 3.0, 40.0, 0) for k in range(9)
    ]
    one = stream(ulog.read(file(tmp_path, log(records))), "sensor_gyro[0]")
    assert one.clock == "timestamp (timestamp_sample stands still)"
    assert one.time_ns.tolist() == [(10**6 + 1000 * k) * 1000 for k in range(9)]


def test_the_fifo_is_laid_out_sample_by_sample(tmp_path: Path) -> None:
    fifo = (
        "sensor_gyro_fifo:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;"
        "float dt;float scale;uint8_t samples;int16_t[4] x;int16_t[4] y;int16_t[4] z;"
    )
    first = [*definitions(), record("F", fifo.encode()), subscription(9, "sensor_gyro_fifo")]
    rows = [(2000, 3), (2400, 2), (2800, 4), (3200, 0)]
    records = [
        data(9, "QQIffB12h", t + 50, t, 5, 125.0, 0.5, n, *range(t, t + 4), *range(4), *[-1] * 4)
        for t, n in rows
    ]
    one = stream(ulog.read(file(tmp_path, log(records, first))), "sensor_gyro_fifo")
    assert one.time_ns.tolist() == [
        1000 * t for t in (1750, 1875, 2000, 2275, 2400, 2425, 2550, 2675, 2800)
    ]
    raw = [2000, 2001, 2002, 2400, 2401, 2800, 2801, 2802, 2803]
    assert one.columns["x"].tolist() == [0.5 * value for value in raw]
    assert one.columns["y"].tolist() == [0.0, 0.5, 1.0, 0.0, 0.5, 0.0, 0.5, 1.0, 1.5]
    assert (one.sensor, one.gyro, one.count) == (0, ("x", "y", "z"), 9)


def test_integrated_angles_become_mean_rates(tmp_path: Path) -> None:
    imu = (
        "vehicle_imu:uint64_t timestamp;uint64_t timestamp_sample;uint32_t accel_device_id;"
        "uint32_t gyro_device_id;float[3] delta_angle;float[3] delta_velocity;"
        "uint16_t delta_angle_dt;uint16_t delta_velocity_dt;"
    )
    first = [*definitions(), record("F", imu.encode())]
    first += [subscription(9, "vehicle_imu", 0), subscription(10, "vehicle_imu", 1)]
    records = flight(1.0)
    for k in range(20):
        now = 5_000_000 + 5000 * k
        step = 0 if k == 3 else 5000
        # The second instance says that it is the first device, and the other way round.
        for message_id, device in ((9, 11 + GYRO_1), (10, 11 + GYRO_0)):
            values = (0.005, -0.01, 0.0, 0.05, 0.0, -0.049, step, 5000)
            records.append(data(message_id, "QQII6fHH", now + 100, now, 77, device, *values))
    recording = ulog.read(file(tmp_path, log(records, first)))
    imu_0 = stream(recording, "vehicle_imu[0]")
    assert imu_0.sensor == 1
    assert stream(recording, "vehicle_imu[1]").sensor == 0
    assert imu_0.gyro == ("gyro_x", "gyro_y", "gyro_z")
    assert imu_0.columns["gyro_y"][0] == float(np.float32(-0.01)) / 0.005
    assert imu_0.columns["acceleration_z"][0] == float(np.float32(-0.049)) / 0.005
    assert np.flatnonzero(np.isnan(imu_0.columns["gyro_x"])).tolist() == [3]
    assert np.isfinite(imu_0.columns["acceleration_x"]).all()


def test_selected_rates_and_attitude_are_no_sensors(tmp_path: Path) -> None:
    combined = (
        "sensor_combined:uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
        "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;"
    )
    rates = "vehicle_angular_velocity:uint64_t timestamp;uint64_t timestamp_sample;float[3] xyz;"
    first = [*definitions(), record("F", combined.encode()), record("F", rates.encode())]
    first += [subscription(9, "sensor_combined"), subscription(10, "vehicle_angular_velocity")]
    records = flight(1.0)
    for k in range(9):
        records.append(data(9, "Q3fIi3f", 10**7 + k, 1, 2, 3, 5000, 0, 4, 5, 6))
        records.append(data(10, "QQ3f", 10**7 + k, 10**7 + k - 5, 1, 2, 3))
    recording = ulog.read(file(tmp_path, log(records, first)))
    one = stream(recording, "sensor_combined")
    assert (one.origin, one.gyro[2], one.accelerometer[0]) == (
        "selected",
        "gyro_rad[2]",
        "accelerometer_m_s2[0]",
    )
    assert stream(recording, "vehicle_angular_velocity").origin == "selected"
    attitude = stream(recording, "vehicle_attitude")
    assert (attitude.origin, attitude.gyro) == ("derived", ())
    assert np.array_equal(attitude.columns["qw"], attitude.columns["q[0]"])


def test_nested_formats_and_arrays_are_unfolded_as_the_official_library_does(
    tmp_path: Path,
) -> None:
    first = [*definitions(), subscription(9, "outer", 3)]
    first[1:1] = [
        record("F", b"inner:uint16_t a;float[2] b;uint8_t[2] _padding0;"),
        record("F", b"outer:uint64_t timestamp;inner one;inner[2] many;bool ok;char[3] text;"),
    ]
    body = "HffBB"
    values = [1, 0.5, 1.5, 0, 0, 2, 2.5, 3.5, 0, 0, 4, 4.5, 5.5, 0, 0, 1, b"a", b"b", b"c"]
    records = [data(9, "Q" + 3 * body + "B3c", 10**6 + k, *values) for k in range(4)]
    path = file(tmp_path, log(records, first))
    theirs = official(path)["outer", 3]
    ours = stream(ulog.read(path, also=["outer"]), "outer").columns
    assert {*ours} == {*theirs} - {"timestamp"}
    assert all(np.array_equal(ours[name], theirs[name]) for name in ours)
    assert ours["many[1].b[0]"].tolist() == [4.5] * 4


def test_padding_at_the_end_may_be_logged_or_not(tmp_path: Path) -> None:
    records = []
    for k in range(6):
        padding = "4x" if k % 2 else ""
        records.append(data(2, "Q4f" + padding, 10**6 + k, 1.0, 0.0, 0.0, float(k)))
    path = file(tmp_path, log(records))
    ours = stream(ulog.read(path), "vehicle_attitude")
    assert ours.columns["q[3]"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert losses(ulog.read(path)) == []


def test_a_topic_may_be_subscribed_to_late(tmp_path: Path) -> None:
    records = flight(2.0)
    late = [subscription(50, "cpuload", 1)]
    late += [data(50, "Qff", 8_000_000 + k, 0.5, float(k)) for k in range(7)]
    late.append(record("R", struct.pack("<H", 50)))
    path = file(tmp_path, log([*records[:150], *late, *records[150:]]))
    recording = ulog.read(path, also=["cpuload[1]"])
    assert losses(recording) == []
    assert stream(recording, "cpuload[1]").columns["ram_usage"].tolist() == list(range(7))
    assert stream(recording, "cpuload[0]").count == 10


def test_dropouts_are_lost_time(tmp_path: Path) -> None:
    records = flight()
    records.insert(60, record("O", struct.pack("<H", 120)))
    recording = ulog.read(file(tmp_path, log(records)))
    dropouts = [p for p in recording.problems if p.seconds_lost]
    assert [(p.seconds_lost, p.note) for p in dropouts] == [(0.12, False)]
    at = len(log(records[:60]))
    assert dropouts[0].offset == at


def test_data_appended_after_the_log_was_closed_is_read(tmp_path: Path) -> None:
    records = flight()
    size = len(log(records[:200], definitions(1)))
    cut = records[200][:-9]
    place = size + len(cut)
    appended = [record("L", b"3" + struct.pack("<Q", 9) + b"crash dump"), *records[300:]]
    path = file(tmp_path, log([*records[:200], cut, *appended], definitions(place)))
    recording = ulog.read(path)
    for k in range(2):
        head = struct.pack("<HBH", 42, ord("D"), k)
        kept = [r for r in (*records[:200], *appended) if r.startswith(head)]
        x = [struct.unpack_from("<f", r, 25)[0] for r in kept]
        assert stream(recording, f"sensor_gyro[{k}]").columns["x"].tolist() == x
    assert losses(recording) == []
    notes = [(p.offset, p.bytes_lost) for p in recording.problems if "appended" in p.what]
    assert notes == [(size, len(cut))]


def test_the_last_record_may_be_cut_off_without_a_loss(tmp_path: Path) -> None:
    content = log([*flight(), gyro(GYRO_0, 10**8, 1.0, 2.0, 3.0)])
    for cut in (1, 20, 40, 44, 46):
        recording = ulog.read(file(tmp_path, content[:-cut]))
        assert losses(recording) == []
        notes = [p for p in recording.problems if "incomplete" in p.what]
        assert [(p.offset or 0) + (p.bytes_lost or 0) for p in notes] == [len(content) - cut]
        assert stream(recording, "sensor_gyro[0]").count == 200


def test_zeros_after_the_last_record_are_padding(tmp_path: Path) -> None:
    text = record("L", b"6" + struct.pack("<Q", 9) + b"landed")
    content = log([*flight(), text])
    recording = ulog.read(file(tmp_path, content + bytes(3000)))
    assert losses(recording) == []
    assert said(recording, "padding after the last record: 3000 bytes 0x00")
    assert stream(recording, "sensor_gyro[1]").count == 200


def test_a_hole_costs_the_records_it_touches_and_the_one_it_begins_in(tmp_path: Path) -> None:
    records = flight()
    content = bytearray(log(records))
    start = len(log(records[:100])) + 20
    end = len(log(records[:120])) + 10
    content[start:end] = bytes(end - start)
    recording = ulog.read(file(tmp_path, bytes(content)))
    begin, finish = len(log(records[:100])), len(log(records[:121]))
    assert losses(recording) == [(begin, finish - begin)]
    kept = b"".join(records[:100] + records[121:])
    for k in range(2):
        head = struct.pack("<HBH", 42, ord("D"), k)
        assert stream(recording, f"sensor_gyro[{k}]").count == kept.count(head)


def test_garbage_at_both_ends_costs_nothing_but_itself(tmp_path: Path) -> None:
    content = log()
    garbage = bytes(range(1, 251))
    recording = ulog.read(file(tmp_path, garbage + content + garbage))
    n = len(garbage)
    assert losses(recording)[0] == (0, n)
    assert sum(lost or 0 for _, lost in losses(recording)) <= 2 * n + 50
    assert stream(recording, "sensor_gyro[0]").count >= 199


def test_a_lost_subscription_does_not_take_other_topics_along(tmp_path: Path) -> None:
    first = [r for r in definitions() if r != subscription(LOAD, "cpuload")]
    path = file(tmp_path, log(None, first))
    recording = ulog.read(path)
    assert stream(recording, "sensor_gyro[0]").count == 200
    assert stream(recording, "vehicle_attitude").count == 40
    assert said(recording, "the 20 records of message id 4 cannot be read: no subscription")
    assert sum(lost or 0 for _, lost in losses(recording)) == 20 * 21


def test_a_lost_format_is_told(tmp_path: Path) -> None:
    first = [r for r in definitions() if b"sensor_gyro:" not in r]
    recording = ulog.read(file(tmp_path, log(None, first)))
    assert said(recording, "records of sensor_gyro cannot be read: format sensor_gyro is missing")
    assert not all(problem.note for problem in recording.problems)
    assert stream(recording, "vehicle_attitude").count == 40


@pytest.mark.parametrize(
    "text",
    [
        b"loop:uint64_t timestamp;loop again;",
        b"huge:uint64_t timestamp;float[65535] a;",
        b"deep:uint64_t timestamp;huge[9999] a;",
        b"twice:uint64_t timestamp;float a;float a;",
        b"timeless:float a;",
    ],
)
def test_a_format_that_cannot_be_is_no_danger(tmp_path: Path, text: bytes) -> None:
    name = text.partition(b":")[0].decode()
    first = [*definitions(), record("F", text), subscription(9, name)]
    records = [*flight(1.0), *[data(9, "Qf", 10**7 + k, 1.0) for k in range(5)]]
    recording = ulog.read(file(tmp_path, log(records, first)), also=[name])
    assert stream(recording, name).count == 5
    assert said(recording, f"records of {name} cannot be read")


def test_records_of_a_type_of_the_future_are_stepped_over(tmp_path: Path) -> None:
    records = flight()
    records.insert(90, record("Z", b"something new"))
    recording = ulog.read(file(tmp_path, log(records)))
    assert losses(recording) == []
    assert said(recording, "1 records of types that are not known (Z)")
    assert stream(recording, "sensor_gyro[0]").count == 200


def test_flags_that_a_reader_must_know_are_told(tmp_path: Path) -> None:
    first = definitions()
    first[0] = record("B", bytes(8) + b"\x02" + bytes(7) + bytes(24))
    recording = ulog.read(file(tmp_path, log(None, first)))
    assert said(recording, "it may be misread")
    assert not all(problem.note for problem in recording.problems)


def test_the_vehicle_says_what_it_is(tmp_path: Path) -> None:
    assert ulog.read(file(tmp_path, log())).vehicle == {
        "sys_name": "PX4",
        "ver_hw": "MY_FMU",
        "firmware": "1.14.3",
        "CAL_GYRO0_ID": "1310988",
    }


def test_armed_spans_and_utc_come_from_the_log(tmp_path: Path) -> None:
    gps = b"vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;"
    first = [*definitions(), record("F", gps), subscription(9, "vehicle_gps_position")]
    utc = 1_700_000_000_000_000
    told = [data(9, "QQ", 6_000_000, 0), data(9, "QQ", 7_000_000, utc + 7_000_000)]
    recording = ulog.read(file(tmp_path, log(flight() + told, first)))
    assert recording.armed == ((6_000_000_000, 8_000_000_000),)
    assert recording.utc_at_zero_ns == utc * 1000
    silent = ulog.read(file(tmp_path, log([gyro(0, 10**6 + k, 1, 2, 3) for k in range(5)])))
    assert silent.armed is None
    assert silent.utc_at_zero_ns is None


def test_other_topics_and_logged_texts_are_listed(tmp_path: Path) -> None:
    recording = ulog.read(file(tmp_path, log()))
    listed = {s.name: s.count for s in recording.streams if not s.columns}
    assert listed == {"cpuload": 20, "vehicle_status": 20, "logged messages": 8}
    assert said(recording, "no checksums")


def test_the_answer_does_not_depend_on_how_the_file_is_cut_into_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fdilog_readers import columns

    content = bytearray(log(flight(20.0)))
    content[9000:9600] = b"D" * 600
    content[30000:30400] = np.random.default_rng(0).bytes(400)
    path = file(tmp_path, bytes(content))
    entire = ulog.read(path)
    for size in (70_000, 80_001):
        blocks = lambda path, size=size: columns.Blocks(path, size)  # noqa: E731
        monkeypatch.setattr(ulog, "Blocks", blocks)
        pieces = ulog.read(path)
        assert pieces.problems == entire.problems
        for one, other in zip(pieces.streams, entire.streams, strict=True):
            assert (one.name, one.count) == (other.name, other.count)
            assert all(np.array_equal(one.columns[f], other.columns[f]) for f in other.columns)


def test_a_log_is_known_by_its_magic() -> None:
    assert ulog.sniff(log()[:4096])
    assert ulog.sniff(b"junk" + log()[:4000])
    assert not ulog.sniff(b"")
    assert not ulog.sniff(b"ULog is a format")


@pytest.mark.parametrize(
    "content", [b"", HEADER[:9], HEADER, HEADER + bytes(5000), b"text\n" * 900, SYNC * 100]
)
def test_what_holds_no_topics_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(UnreadableLogError, match=r"flight\.ulg: no topic is described in its \d+"):
        ulog.read(file(tmp_path, content))


def test_a_value_of_odd_type_does_no_harm(tmp_path: Path) -> None:
    first = [
        *definitions(),
        keyed("I", "uint8_t[4] blob", b"\x01\x02\x03\x04"),
        keyed("I", "nonsense", b""),
        keyed("I", "strange_t thing", b"xy"),
        record("M", b"\x00" + bytes([12]) + b"char[2] perf" + b"ab"),
        record("Q", b"\x01" + bytes([9]) + b"float A_B" + struct.pack("<f", 1.0)),
        record("F", b"no format at all"),
    ]
    recording = ulog.read(file(tmp_path, log(None, first)))
    assert stream(recording, "sensor_gyro[0]").count == 200
    assert said(recording, "a record of type F that cannot be read")


def test_the_compass_and_the_velocity_of_gps_are_told(tmp_path: Path) -> None:
    magnetometer, gps = 7, 8
    extra = [
        record("F", b"vehicle_magnetometer:uint64_t timestamp;float[3] magnetometer_ga;"),
        record(
            "F",
            b"vehicle_gps_position:uint64_t timestamp;float vel_n_m_s;float vel_e_m_s;"
            b"uint8_t fix_type;",
        ),
        subscription(magnetometer, "vehicle_magnetometer"),
        subscription(gps, "vehicle_gps_position"),
    ]
    records = [data(magnetometer, "Q3f", 10**6, 0.25, 0.0, 0.5)]
    records += [data(gps, "QffB", 10**6, 3.0, -4.0, 3), data(gps, "QffB", 2 * 10**6, 3.0, -4.0, 2)]
    recording = ulog.read(file(tmp_path, log(records, definitions() + extra)))
    compass = stream(recording, "vehicle_magnetometer")
    assert [compass.columns[f].tolist() for f in compass.compass] == [[0.25], [0.0], [0.5]]
    ground = stream(recording, "vehicle_gps_position")
    north, east = (ground.columns[f] for f in ground.velocity)
    assert (north[0], east[0]) == (3.0, -4.0)
    assert np.isnan([north[1], east[1]]).all()  # no fix in three dimensions
