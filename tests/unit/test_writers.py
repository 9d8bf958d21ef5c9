"""What is written is read back: by the official library, and by our own readers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import NoGyroError, UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.flight import FIRMWARE, Flight
from fdilog.experiments.simulate import Timing, simulate
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.sources.assembly import assemble
from fdilog.sources.gyros import choose
from fdilog.writing import write


@pytest.fixture(scope="module")
def flight() -> Flight:
    silent = Fault(kind="dropout", channel="imu1", start_s=4.0, end_s=5.0)
    return simulate(12.0, 25.0, seed=3, faults=[silent])


def official(path: Path) -> dict[str, list[Any]]:
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(path))
    found: dict[str, list[Any]] = {}
    while (message := reader.recv_msg()) is not None:
        found.setdefault(message.get_type(), []).append(message)
    reader.close()
    return found


def test_the_official_library_reads_every_dataflash_value_back(
    flight: Flight, tmp_path: Path
) -> None:
    write(flight.recording(), tmp_path / "flight.bin")
    found = official(tmp_path / "flight.bin")
    for k, source in enumerate(flight.sources):
        records = [message for message in found["IMU"] if k == message.I]
        assert [r.TimeUS for r in records] == (source.time_ns // 1000).tolist()
        rate = np.array([(r.GyrX, r.GyrY, r.GyrZ) for r in records])
        assert np.array_equal(rate, source.rate_rad_s.astype(np.float32))
        force = np.array([(r.AccX, r.AccY, r.AccZ) for r in records])
        assert source.acceleration_m_s2 is not None
        assert np.array_equal(force, source.acceleration_m_s2.astype(np.float32))
        warmth = np.array([r.T for r in records])
        assert np.array_equal(warmth, source.temperature_c.astype(np.float32))
    angles = np.array([(r.Roll, r.Pitch, r.Yaw) for r in found["ATT"]])
    apart = np.radians(angles) - flight.logged_attitude_rad
    apart[:, 2] = (apart[:, 2] + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(apart).max() <= np.radians(0.0051)
    assert angles[:, 2].min() >= 0.0
    armed = flight.recording().armed
    assert armed is not None
    assert [(r.TimeUS * 1000, r.Id) for r in found["EV"]] == [(armed[0][0], 10), (armed[0][1], 11)]
    assert [r.Message for r in found["MSG"]] == [FIRMWARE]
    stamps = [m.TimeUS for kind in ("IMU", "ATT", "EV") for m in found[kind]]
    assert min(stamps) >= max(m.TimeUS for m in found["PARM"])


def test_dataflash_units_are_those_of_a_real_log(flight: Flight, tmp_path: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    write(flight.recording(), tmp_path / "flight.bin")
    reader = DFReader_binary(str(tmp_path / "flight.bin"))
    imu = next(form for form in reader.formats.values() if form.name == "IMU")
    reader.close()
    assert imu.instance_field == "I"
    assert imu.units[:9] == ["µs", "instance", *["rad/s"] * 3, *["m/s/s"] * 3, ""]


def test_dataflash_records_stand_in_the_order_of_their_stamps(
    flight: Flight, tmp_path: Path
) -> None:
    from pymavlink.DFReader import DFReader_binary

    write(flight.recording(), tmp_path / "flight.bin")
    reader = DFReader_binary(str(tmp_path / "flight.bin"))
    stamps = []
    while (message := reader.recv_match(type=["IMU", "ATT", "EV"])) is not None:
        stamps.append(message.TimeUS)
    reader.close()
    assert stamps == sorted(stamps)
    assert len(stamps) == sum(stream.count for stream in flight.recording().streams) + 2


def test_our_reader_reads_dataflash_back(flight: Flight, tmp_path: Path) -> None:
    write(flight.recording(), tmp_path / "flight.bin")
    recording = read(tmp_path / "flight.bin")
    gyros, _ = choose(recording, Config())
    assert tuple(name for gyro in gyros for name in gyro.channel_names) == flight.channels
    for gyro, source in zip(gyros, flight.sources, strict=True):
        assert np.array_equal(gyro.time_ns, source.time_ns)
        assert np.array_equal(gyro.rate_rad_s, source.rate_rad_s.astype(np.float32))
        assert gyro.alive
    assert recording.armed == flight.recording().armed
    assert (recording.vehicle or {}).get("firmware") == FIRMWARE
    assert not [problem for problem in recording.problems if not problem.note]


def test_a_log_without_attitude_has_no_att_records(flight: Flight, tmp_path: Path) -> None:
    write(flight.recording(attitude=False), tmp_path / "flight.bin")
    assert "ATT" not in official(tmp_path / "flight.bin")


def test_a_table_holds_every_reading_to_the_last_bit(flight: Flight, tmp_path: Path) -> None:
    write(flight.recording(), tmp_path / "flight.csv")
    table = assemble(flight.recording(), Config()).table.gyros
    header = (tmp_path / "flight.csv").read_text().partition("\n")[0]
    assert tuple(header.split(",")) == ("time_s", *flight.channels)
    rows = np.genfromtxt(tmp_path / "flight.csv", delimiter=",", skip_header=1)
    rate = rows[:, 1:]
    assert np.array_equal(rows[:, 0], table.time_s)
    assert np.array_equal(np.isfinite(rate), table.valid)
    assert np.array_equal(rate, table.rate_rad_s, equal_nan=True)
    assert not table.valid[:, 3:6].all()


def test_our_reader_reads_a_table_back(flight: Flight, tmp_path: Path) -> None:
    write(flight.recording(), tmp_path / "flight.csv")
    again = assemble(read(tmp_path / "flight.csv"), Config()).table
    table = assemble(flight.recording(), Config()).table.gyros
    assert again.names == table.names
    assert again.time_s.tobytes() == table.time_s.tobytes()
    assert np.array_equal(again.valid, table.valid)
    assert np.array_equal(again.rate_rad_s, table.rate_rad_s, equal_nan=True)


def test_a_table_holds_a_skewed_unit_that_dataflash_cannot(tmp_path: Path) -> None:
    flight = simulate(10.0, 25.0, geometry="dodecahedron", seed=3)
    write(flight.recording(), tmp_path / "flight.csv")
    header = (tmp_path / "flight.csv").read_text().partition("\n")[0]
    assert header == "time_s,g1,g2,g3,g4,g5,g6"
    with pytest.raises(UsageError, match="g1, g2, g3, g4, g5, g6"):
        write(flight.recording(), tmp_path / "flight.bin")
    assert not (tmp_path / "flight.bin").exists()


def test_sources_with_clocks_of_their_own_are_put_on_one_time_base(tmp_path: Path) -> None:
    import pandas as pd

    flight = simulate(10.0, [50.0, 20.0], sources=2, timing=Timing(shared=False), seed=1)
    write(flight.recording(), tmp_path / "flight.csv")
    frame = pd.read_csv(tmp_path / "flight.csv")
    assert len(frame) == 500
    assert 190 <= frame["imu1.x"].notna().sum() <= 420


@pytest.mark.parametrize("name", ["flight.bin", "flight.csv"])
def test_the_same_flight_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    for folder in ("one", "other"):
        (tmp_path / folder).mkdir()
        write(simulate(10.0, 25.0, seed=3).recording(), tmp_path / folder / name)
    assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "other" / name).read_bytes()


def test_what_cannot_be_written_is_said_in_one_line(flight: Flight, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"'\.bim'; did you mean '\.bin'"):
        write(flight.recording(), tmp_path / "flight.bim")
    with pytest.raises(UsageError, match="no such file"):
        write(flight.recording(), tmp_path / "missing" / "flight.bin")
    empty = Stream(name="ATT", time_ns=np.zeros(0, np.int64))
    nothing = Recording(path="x", format="simulated", bytes=0, streams=(empty,))
    with pytest.raises(NoGyroError):
        write(nothing, tmp_path / "flight.bin")
