"""Telemetry logs are read as the official library would, with what is wrong told, not hidden."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import all as protocol

from fdilog.config import Config
from fdilog.errors import NoGyroError, UnreadableLogError
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import choose
from fdilog_readers import mavlink
from fdilog_readers.mavlink_dialect import checksums, dialect
from tests.mavlink_oracle import (
    UTC_US,
    flight,
    heartbeat,
    official,
    packet,
    raw_imu,
    scaled_imu2,
    stamped,
)

G = 9.80665


def log(folder: Path, data: bytes, name: str = "flight.tlog") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def stream(recording: Recording, name: str) -> Stream:
    return next(s for s in recording.streams if s.name == name)


def losses(recording: Recording) -> list[tuple[int | None, int | None]]:
    return [(p.offset, p.bytes_lost) for p in recording.problems if not p.note]


def said(recording: Recording, what: str) -> bool:
    return any(what in problem.what for problem in recording.problems)


@pytest.mark.parametrize("how", [{"version": 1}, {"version": 2}, {"signed": True}])
def test_both_versions_and_signed_packets_give_what_the_official_library_gives(
    tmp_path: Path, how: dict[str, Any]
) -> None:
    path = log(tmp_path, stamped(flight(**how)))
    recording = mavlink.read(path, also=["VFR_HUD"])
    assert losses(recording) == []
    found = official(path)
    for name in ("RAW_IMU", "SCALED_IMU2"):
        theirs = found[1, 1, name]
        ours = stream(recording, name)
        assert ours.count == len(theirs) == 100
        for axis in "xyz":
            gyro = np.array([getattr(m, f"{axis}gyro") for m in theirs])
            force = np.array([getattr(m, f"{axis}acc") for m in theirs])
            assert np.array_equal(ours.columns[f"{axis}gyro"], gyro / 1000)
            assert np.array_equal(ours.columns[f"{axis}acc"], force * G / 1000)
    hud = stream(recording, "VFR_HUD")
    assert hud.columns["throttle"].tolist() == [m.throttle for m in found[1, 1, "VFR_HUD"]]
    assert hud.units["groundspeed"] == "m/s"


def test_the_checksum_is_that_of_the_official_library() -> None:
    rng = np.random.default_rng(0)
    lengths = np.sort(rng.integers(1, 80, 200))[::-1]
    rows = rng.integers(0, 256, (200, 80), dtype=np.uint8)
    extra = rng.integers(0, 256, 200).astype(np.uint16)
    theirs = [
        protocol.x25crc(row[:n].tobytes() + bytes([seed])).crc
        for row, n, seed in zip(rows, lengths, extra, strict=True)
    ]
    assert checksums(rows, lengths, extra).tolist() == theirs


def test_the_part_of_a_message_that_version_1_has_is_that_of_the_version_1_dialect() -> None:
    from pymavlink.dialects.v10 import all as version_1

    known = dialect()
    sizes = {k: int(known.base[known.row_of(k)]) for k in version_1.mavlink_map}
    assert sizes == {k: m.unpacker.size for k, m in version_1.mavlink_map.items()}


def test_zeros_that_the_sender_left_out_are_put_back(tmp_path: Path) -> None:
    sent = [raw_imu(1_000_000 + k, 0, 0, 0) for k in range(4)]
    for message in sent:
        message.xmag = message.ymag = message.zmag = 0
    packets = [packet(heartbeat()), *map(packet, sent)]
    assert len(packets[1]) == 12 + 14
    imu = stream(mavlink.read(log(tmp_path, stamped(packets))), "RAW_IMU")
    assert imu.columns["zgyro"].tolist() == [0.0] * 4
    assert imu.columns["zacc"].tolist() == [-G] * 4
    assert imu.time_ns.tolist() == [1_000_000_000 + k * 1000 for k in range(4)]


def test_packets_of_a_newer_dialect_with_more_fields_are_read_by_the_fields_known(
    tmp_path: Path,
) -> None:
    known = packet(raw_imu(5_000_000, 7, 8, 9))
    body = known[1:10] + known[10:-2].ljust(29, b"\0") + b"\x01\x02\x03"
    body = bytes([len(body) - 9]) + body[1:]
    crc = protocol.x25crc(body + bytes([144])).crc
    newer = b"\xfd" + body + struct.pack("<H", crc)
    path = log(tmp_path, stamped([packet(heartbeat()), newer, known]))
    imu = stream(mavlink.read(path), "RAW_IMU")
    assert imu.columns["ygyro"].tolist() == [0.008, 0.008]


def test_garbage_before_between_and_after_packets_costs_nothing_but_itself(tmp_path: Path) -> None:
    packets = flight()
    clean = stamped(packets)
    middle = len(stamped(packets[:200]))
    garbage = b"\xfd\xfe\x07" + bytes(range(200)) + b"\xfe"
    data = garbage + clean[:middle] + garbage + clean[middle:] + garbage
    recording = mavlink.read(log(tmp_path, data))
    n = len(garbage)
    assert losses(recording) == [(0, n), (n + middle, n), (2 * n + len(clean), n)]
    assert stream(recording, "RAW_IMU").count == 100
    stamps = stream(recording, "RAW_IMU").columns["tlog_time_ns"]
    assert np.diff(stamps).min() > 0


def test_a_packet_that_fails_its_checksum_is_left_out_and_told(tmp_path: Path) -> None:
    packets = flight()
    data = bytearray(stamped(packets))
    at = len(stamped(packets[:5]))
    data[at + 8 + 20] ^= 0x10
    recording = mavlink.read(log(tmp_path, bytes(data)))
    assert losses(recording) == [(at, len(packets[5]) + 8)]
    assert said(recording, "wrong checksum")
    assert stream(recording, "RAW_IMU").count == 99


def test_the_last_packet_may_be_cut_off_without_a_loss(tmp_path: Path) -> None:
    data = stamped(flight())
    for cut in (1, 9, 20, len(data) - len(stamped(flight()[:-1])) - 1):
        recording = mavlink.read(log(tmp_path, data[:-cut]))
        assert losses(recording) == []
        notes = [p for p in recording.problems if "incomplete" in p.what]
        assert [p.offset + p.bytes_lost for p in notes] == [len(data) - cut]  # type: ignore[operator]


def test_unknown_messages_are_framed_by_their_length_and_counted(tmp_path: Path) -> None:
    strange = packet(heartbeat())
    strange = strange[:7] + (54_321).to_bytes(3, "little") + strange[10:]
    packets = flight()
    data = stamped([*packets[:50], strange, strange, *packets[50:], strange])
    recording = mavlink.read(log(tmp_path, data))
    assert losses(recording) == []
    assert stream(recording, "UNKNOWN_54321").count == 3
    assert said(recording, "3 packets of messages that are not known (id 54321)")
    assert all(p.note for p in recording.problems)


def test_every_byte_is_a_packet_or_a_loss_wherever_the_file_is_cut_into_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fdilog_readers import columns, mavlink_packets

    packets = flight()
    data = bytearray(stamped(packets))
    data[3000:3700] = b"\xfe" * 700
    path = log(tmp_path, b"junk" + bytes(data))
    whole = mavlink.read(path)
    for size in (700, 1111, 4096):
        blocks = lambda path, _, size=size: columns.Blocks(path, size)  # noqa: E731
        monkeypatch.setattr(mavlink_packets, "Blocks", blocks)
        pieces = mavlink.read(path)
        assert pieces.problems == whole.problems
        for one, other in zip(pieces.streams, whole.streams, strict=True):
            assert (one.name, one.count) == (other.name, other.count)
            assert np.array_equal(one.time_ns, other.time_ns)
            assert all(np.array_equal(one.columns[f], other.columns[f]) for f in other.columns)


def test_gyros_of_several_vehicles_are_told_apart_and_never_compared(tmp_path: Path) -> None:
    one, two = flight(3.0), flight(2.0, sender=(2, 1))
    mixed = [p for pair in zip(one[: len(two)], two, strict=True) for p in pair] + one[len(two) :]
    recording = mavlink.read(log(tmp_path, stamped(mixed)))
    names = {s.name for s in recording.streams if s.gyro}
    assert names == {"1.1/RAW_IMU", "1.1/SCALED_IMU2", "1.1/ATTITUDE"}
    assert stream(recording, "2.1/RAW_IMU").count == 40
    assert stream(recording, "2.1/HEARTBEAT").count == 2
    assert said(recording, "those of 1.1 are used, not those of 2.1")
    assert (recording.vehicle or {})["system"] == "1.1"


def test_a_ground_station_does_not_make_a_second_vehicle(tmp_path: Path) -> None:
    station = packet(protocol.MAVLink_heartbeat_message(6, 8, 128, 0, 4, 3), sender=(255, 190))
    clock = packet(protocol.MAVLink_system_time_message(UTC_US, 0), sender=(255, 190))
    recording = mavlink.read(log(tmp_path, stamped([station, clock, *flight(), station])))
    assert stream(recording, "RAW_IMU").sensor == 0
    assert stream(recording, "255.190/HEARTBEAT").count == 2
    assert recording.armed == ((61_040_000_000, 64_950_000_000),)


def test_raw_imu_has_a_unit_only_if_the_autopilot_is_known_to_use_it(tmp_path: Path) -> None:
    packets = [packet(raw_imu(1_000_000 + 1000 * k, 10, 20, 30)) for k in range(20)]
    known = mavlink.read(log(tmp_path, stamped([packet(heartbeat()), *packets])))
    assert stream(known, "RAW_IMU").columns["zgyro"][0] == 0.03
    assert said(known, "RAW_IMU is taken to be in mrad/s")
    for beats in ([packet(heartbeat(autopilot=12))], []):
        other = mavlink.read(log(tmp_path, stamped([*beats, *packets])))
        assert stream(other, "RAW_IMU").gyro == ()
        assert stream(other, "RAW_IMU").columns["zgyro"][0] == 30
        assert "zgyro" not in stream(other, "RAW_IMU").units
        assert said(other, "RAW_IMU is left out")
        with pytest.raises(NoGyroError):
            choose(other, Config())


def test_sensors_are_numbered_by_message_and_by_id(tmp_path: Path) -> None:
    sent = []
    for k in range(30):
        for number in range(3):
            m = protocol.MAVLink_highres_imu_message(
                10**6 + 10**4 * k, 0, 0, -9.8, 0.1, number, 0.3, 0, 0, 0, 0, 0, 0, 20, 63, number
            )
            sent.append(packet(m))
    recording = mavlink.read(log(tmp_path, stamped(sent)))
    for number in range(3):
        imu = stream(recording, f"HIGHRES_IMU[{number}]")
        assert imu.sensor == number
        assert imu.columns["ygyro"].tolist() == [float(number)] * 30
        assert imu.units["ygyro"] == "rad/s"
    recording = mavlink.read(log(tmp_path, stamped(flight())))
    assert stream(recording, "RAW_IMU").sensor == 0
    assert stream(recording, "SCALED_IMU2").sensor == 1
    assert stream(recording, "ATTITUDE").origin == "selected"


def test_time_is_since_boot_and_the_receive_stamps_are_there_too(tmp_path: Path) -> None:
    recording = mavlink.read(log(tmp_path, stamped(flight())))
    for name in ("RAW_IMU", "SCALED_IMU2", "ATTITUDE"):
        imu = stream(recording, name)
        assert imu.clock == "time since boot"
        assert imu.time_ns.tolist() == [60_000_000_000 + k * 50_000_000 for k in range(100)]
        assert imu.columns["tlog_time_ns"][0] // 10**9 == UTC_US // 10**6
    assert recording.utc_at_zero_ns is not None
    assert abs(recording.utc_at_zero_ns - (UTC_US * 1000 - 60_000_000_000)) < 10**9


def test_utc_is_the_vehicles_own_where_it_says_it(tmp_path: Path) -> None:
    told = packet(protocol.MAVLink_system_time_message(UTC_US + 123_456_789, 60_500))
    ignorant = packet(protocol.MAVLink_system_time_message(0, 60_000))
    recording = mavlink.read(log(tmp_path, stamped([ignorant, told, *flight()])))
    assert recording.utc_at_zero_ns == (UTC_US + 123_456_789) * 1000 - 60_500_000_000


def test_receive_stamps_are_the_clock_where_time_since_boot_stands_still(tmp_path: Path) -> None:
    sent = [packet(heartbeat())]
    for k in range(50):
        sent += [
            packet(raw_imu(7_000_000, k, 0, 0)),
            packet(scaled_imu2(10**6 + 10**5 * k, k, 0, 0)),
        ]
    recording = mavlink.read(log(tmp_path, stamped(sent)))
    for name in ("RAW_IMU", "SCALED_IMU2"):
        imu = stream(recording, name)
        assert imu.clock == "receive stamp (time since boot stands still in RAW_IMU)"
        assert np.array_equal(imu.time_ns, imu.columns["tlog_time_ns"])
    assert recording.utc_at_zero_ns == 0


def test_messages_whose_clocks_do_not_agree_are_put_on_the_receive_stamps(tmp_path: Path) -> None:
    sent = [packet(heartbeat())]
    for k in range(50):
        sent += [
            packet(raw_imu(UTC_US + 10**5 * k, k, 0, 0)),
            packet(scaled_imu2(10**5 * k, k, 0, 0)),
        ]
    recording = mavlink.read(log(tmp_path, stamped(sent)))
    assert "is not that in RAW_IMU" in stream(recording, "SCALED_IMU2").clock
    apart = stream(recording, "SCALED_IMU2").time_ns - stream(recording, "RAW_IMU").time_ns
    assert set(apart.tolist()) == {10_000_000}


def test_a_restart_is_kept_and_told(tmp_path: Path) -> None:
    sent = [packet(heartbeat())]
    sent += [packet(raw_imu(90_000_000 + 10**5 * k, k, 0, 0)) for k in range(30)]
    again = len(stamped(sent))
    sent += [packet(raw_imu(2_000_000 + 10**5 * k, k, 0, 0)) for k in range(20)]
    recording = mavlink.read(log(tmp_path, stamped(sent)))
    assert stream(recording, "RAW_IMU").count == 50
    assert stream(recording, "RAW_IMU").time_ns.min() == 2_000_000_000
    notes = [p for p in recording.problems if "restarted" in p.what]
    assert [p.offset for p in notes] == [again + 8]


def test_microseconds_of_32_bits_go_on_counting(tmp_path: Path) -> None:
    first = 2**32 - 1_000_000
    sent = [packet(heartbeat())]
    for k in range(20):
        now = first + 100_000 * k
        sent += [packet(raw_imu(now % 2**32, k, 0, 0)), packet(scaled_imu2(now, k, 0, 0))]
    recording = mavlink.read(log(tmp_path, stamped(sent, step_us=50_000)))
    imu = stream(recording, "RAW_IMU")
    assert imu.time_ns.tolist() == [(first + 100_000 * k) * 1000 for k in range(20)]
    assert imu.clock == "time since boot"
    assert not said(recording, "restarted")


def test_a_packet_without_its_stamp_has_that_of_the_packet_before(tmp_path: Path) -> None:
    packets = flight()
    data = stamped(packets)
    at = len(stamped(packets[:9]))
    recording = mavlink.read(log(tmp_path, data[:at] + data[at + 3 :]))
    assert losses(recording) == [(at, 5)]
    imu = stream(recording, "RAW_IMU")
    assert imu.count == 100
    assert np.diff(imu.columns["tlog_time_ns"]).min() > 0
    assert said(recording, "1 packets have no receive stamp")


def test_a_stamp_that_is_days_off_is_not_believed(tmp_path: Path) -> None:
    packets = flight()
    data = bytearray(stamped(packets))
    data[len(stamped(packets[:5])) + 1] ^= 0x08
    imu = stream(mavlink.read(log(tmp_path, bytes(data))), "RAW_IMU")
    stamps = imu.columns["tlog_time_ns"]
    assert stamps.max() - stamps.min() < 10**11


def test_armed_spans_come_from_the_heartbeats_of_the_vehicle(tmp_path: Path) -> None:
    sent = []
    for k in range(100):
        sent.append(packet(scaled_imu2(10**6 + 10**5 * k, k, 0, 0)))
        if k % 10 == 5:
            sent.append(packet(heartbeat(armed=30 <= k < 60)))
    recording = mavlink.read(log(tmp_path, stamped(sent, step_us=50_000)))
    assert recording.armed == ((1_000_000_000 + 3_550_000_000, 1_000_000_000 + 6_550_000_000),)
    silent = mavlink.read(log(tmp_path, stamped([p for p in sent if p[7] != 0])))
    assert silent.armed is None


def test_a_plain_stream_without_stamps_is_read_too(tmp_path: Path) -> None:
    path = log(tmp_path, b"".join(flight()), "flight.raw")
    recording = mavlink.read(path)
    assert recording.format == "tlog"
    assert losses(recording) == []
    imu = stream(recording, "RAW_IMU")
    assert "tlog_time_ns" not in imu.columns
    theirs = official(path, notimestamps=True)[1, 1, "RAW_IMU"]
    assert (imu.time_ns // 1000).tolist() == [m.time_usec for m in theirs]
    assert recording.armed == ((61_000_000_000, 64_950_000_000),)
    assert recording.utc_at_zero_ns is None


def test_other_messages_are_listed_and_read_on_demand(tmp_path: Path) -> None:
    path = log(tmp_path, stamped(flight()))
    listed = stream(mavlink.read(path), "VFR_HUD")
    assert (listed.count, len(listed.time_ns), dict(listed.columns)) == (100, 0, {})
    loaded = stream(mavlink.read(path, also=["1.1/VFR_HUD", "NO_SUCH_MESSAGE"]), "VFR_HUD")
    assert loaded.columns["heading"].tolist() == [3] * 100
    imu = stream(mavlink.read(path), "RAW_IMU")
    assert np.abs(loaded.time_ns - imu.time_ns).max() <= 30_000_000


def test_arrays_and_texts_of_other_messages_are_columns_too(tmp_path: Path) -> None:
    text = protocol.MAVLink_statustext_message(6, b"hello there")
    cells = protocol.MAVLink_battery_status_message(
        0, 1, 2, 300, [4100, 4090, *[65535] * 8], 5, 6, 7, 80
    )
    path = log(tmp_path, stamped([*flight(), packet(text), packet(cells)]))
    recording = mavlink.read(path, also=["STATUSTEXT", "BATTERY_STATUS"])
    assert stream(recording, "STATUSTEXT").columns["text"].tolist() == [b"hello there"]
    battery = stream(recording, "BATTERY_STATUS")
    assert battery.columns["voltages[1]"].tolist() == [4090]
    assert battery.units["voltages[1]"] == "mV"


def test_the_vehicle_says_what_it_is(tmp_path: Path) -> None:
    version = protocol.MAVLink_autopilot_version_message(
        0, 0x04_03_07_FF, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0x1234
    )
    recording = mavlink.read(log(tmp_path, stamped([packet(version), *flight()])))
    assert recording.vehicle == {
        "system": "1.1",
        "autopilot": "ardupilotmega",
        "type": "quadrotor",
        "firmware": "4.3.7",
        "uid": "0000000000001234",
    }


def test_a_log_is_known_by_its_first_bytes() -> None:
    for how in ({"version": 1}, {"version": 2}, {"signed": True}):
        packets = flight(**how)
        assert mavlink.sniff(stamped(packets)[:4096])
        assert mavlink.sniff(b"".join(packets)[:4096])
        assert mavlink.sniff(b"\xfe\xfd garbage" + stamped(packets)[:4000])
    assert not mavlink.sniff(b"")
    assert not mavlink.sniff(b"\xa3\x95\x80" * 1000)
    assert not mavlink.sniff(bytes(4096))
    rng = np.random.default_rng(1)
    assert not any(mavlink.sniff(rng.bytes(4096)) for _ in range(20))


@pytest.mark.parametrize("data", [b"", b"\xfd", b"\xfe" * 5000, bytes(5000), b"text\n" * 900])
def test_what_is_no_telemetry_log_is_refused_in_one_line(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(UnreadableLogError, match=r"flight\.tlog: .*bytes\)$"):
        mavlink.read(log(tmp_path, data))


def test_a_log_without_gyros_is_read_and_says_so(tmp_path: Path) -> None:
    recording = mavlink.read(log(tmp_path, stamped([packet(heartbeat())] * 5)))
    assert [(s.name, s.count) for s in recording.streams] == [("HEARTBEAT", 5)]
    with pytest.raises(NoGyroError, match="HEARTBEAT"):
        choose(recording, Config())


def test_the_compass_and_the_velocity_of_gps_are_told(tmp_path: Path) -> None:
    def gps(now_us: int, fix: int, speed_cm_s: int, course_cdeg: int) -> bytes:
        told = (100, 200, speed_cm_s, course_cdeg, 9)
        return packet(protocol.MAVLink_gps_raw_int_message(now_us, fix, 0, 0, 0, *told))

    packets = [packet(heartbeat()), packet(raw_imu(60_000_000, 1, 2, 3))]
    packets += [gps(60_000_000, 3, 500, 9000), gps(60_200_000, 2, 500, 9000)]
    packets += [gps(60_400_000, 3, 65535, 9000)]
    recording = mavlink.read(log(tmp_path, stamped(packets)))
    imu = stream(recording, "RAW_IMU")
    assert [imu.columns[f].tolist() for f in imu.compass] == [[1e-7], [2e-7], [3e-7]]  # milligauss
    ground = stream(recording, "GPS_RAW_INT")
    north, east = (ground.columns[f] for f in ground.velocity)
    assert (north[0], east[0]) == pytest.approx((0.0, 5.0))
    assert np.isnan([north[1:], east[1:]]).all()  # no fix in three dimensions; no speed
