"""High-rate batches of a DataFlash log: the samples the official reader gives, as their own source.

The logs are made record by record: two IMUs at 50 Hz, or none, and batches of 64 samples.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.sources.assembly import assemble
from fdilog_readers import dataflash
from tests.dataflash_bytes import FMT_FIELDS, fmt, record

HEAD = fmt(128, "FMT", "BBnNZ", FMT_FIELDS)
IMU = fmt(131, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
ISBH = fmt(140, "ISBH", "QHBBHHQf", "TimeUS,N,type,instance,mul,smp_cnt,SampleUS,smp_rate")
ISBD = fmt(141, "ISBD", "QHHaaa", "TimeUS,N,seqno,x,y,z")
GYRO, ACCELEROMETER = 1, 0
MUL, RATE_HZ, SAMPLES = 938, 1000.0, 64
SECONDS = 20


def header(number: int, kind: int, instance: int, start_us: int) -> bytes:
    values = (start_us + 90_000, number, kind, instance, MUL, SAMPLES, start_us, RATE_HZ)
    return record(140, "QHBBHHQf", *values)


def block(number: int, seqno: int, start_us: int, seed: int) -> bytes:
    raw = np.random.default_rng(seed).integers(-300, 300, (3, 32)).astype("<i2")
    values = [axis.tobytes() for axis in raw]
    return record(141, "QHHaaa", start_us + 90_000, number, seqno, *values)


def batch(number: int, kind: int, instance: int, start_us: int) -> list[bytes]:
    blocks = [block(number, seqno, start_us, 10 * number + seqno) for seqno in range(2)]
    return [header(number, kind, instance, start_us), *blocks]


def log(path: Path, records: list[bytes], *, imus: int = 2) -> Recording:
    rng = np.random.default_rng(3)
    steady = [
        record(131, "QBffffff", 20_000 * k, one, *rng.normal(0, 0.02, 3), 0.1, 0.2, -9.8)
        for k in range(SECONDS * 50)
        for one in range(imus)
    ]
    head = HEAD + (IMU if imus else b"") + ISBH + ISBD
    path.write_bytes(head + b"".join(steady) + b"".join(records))
    return dataflash.read(path)


def every_second() -> list[bytes]:
    """One batch a second, of the gyros and accelerometers of two sensors in turn."""
    turns = [(GYRO, 0), (ACCELEROMETER, 0), (GYRO, 1), (ACCELEROMETER, 1)]
    records: list[bytes] = []
    for k in range(SECONDS - 1):
        records += batch(k, *turns[k % 4], 1_000_000 * (k + 1))
    return records


def stream(recording: Recording, name: str) -> Stream:
    (found,) = [s for s in recording.streams if s.name == name]
    return found


def test_batches_hold_the_samples_that_the_official_reader_gives(tmp_path: Path) -> None:
    from pymavlink import DFReader

    recording = log(tmp_path / "b.bin", every_second())
    official = DFReader.DFReader_binary(str(tmp_path / "b.bin"))
    times: dict[tuple[int, int], list[float]] = {}
    values: dict[tuple[int, int], list[tuple[float, ...]]] = {}
    head: Any = None
    while (message := official.recv_match(type=["ISBH", "ISBD"])) is not None:
        if message.get_type() == "ISBH":
            head = message
            continue
        key = (head.type, head.instance)
        for j in range(32):
            number = message.seqno * 32 + j
            times.setdefault(key, []).append(head.SampleUS * 1000 + number * 1e9 / head.smp_rate)
            raw = (message.x[j], message.y[j], message.z[j])
            values.setdefault(key, []).append(tuple(axis / head.mul for axis in raw))
    official.data_map.close()
    official.filehandle.close()
    assert len(values) == 4
    for (kind, instance), expected in values.items():
        name = f"ISBD[{instance}]" + (" accelerometer" if kind == ACCELEROMETER else "")
        found = stream(recording, name)
        assert found.time_ns.tolist() == times[kind, instance]
        got = np.column_stack([found.columns[axis] for axis in "xyz"])
        assert got.tobytes() == np.array(expected).tobytes()
        assert (found.sensor, found.batched) == (instance, True)
        assert set(found.units.values()) == {"m/s^2" if kind == ACCELEROMETER else "rad/s"}


def test_a_batch_is_never_redundancy_beside_the_imu_it_was_taken_from(tmp_path: Path) -> None:
    recording = log(tmp_path / "b.bin", every_second())
    assembly = assemble(recording, Config())
    used = {info.topic: info.used for info in assembly.sources}
    assert used == {"IMU[0]": True, "IMU[1]": True, "ISBD[0]": False, "ISBD[1]": False}
    assert len(assembly.table.channels) == 6
    reason = next(info.reason for info in assembly.sources if info.topic == "ISBD[0]")
    assert "the same sensor as IMU[0]" in reason


def test_where_there_are_only_batches_what_lies_between_them_is_no_loss(tmp_path: Path) -> None:
    recording = log(tmp_path / "b.bin", every_second(), imus=0)
    analysis = analyse_recording(recording, Config())
    assert {info.topic for info in analysis.sources if info.used} == {"ISBD[0]", "ISBD[1]"}
    assert analysis.completeness.whole
    assert analysis.completeness.seconds_lost == 0
    assert [finding.kind for finding in analysis.findings if finding.kind == "dropout"] == []
    assert analysis.verdict in {"insufficient", "undecided"}


def test_a_batch_number_that_comes_again_is_another_batch(tmp_path: Path) -> None:
    twice = batch(7, GYRO, 0, 1_000_000) + batch(7, GYRO, 1, 2_000_000)
    recording = log(tmp_path / "b.bin", twice)
    assert stream(recording, "ISBD[0]").time_ns[0] == 1_000_000_000
    assert stream(recording, "ISBD[1]").time_ns[0] == 2_000_000_000


def test_missing_and_unannounced_blocks_are_told(tmp_path: Path) -> None:
    one, two = batch(1, GYRO, 0, 1_000_000), batch(2, GYRO, 0, 2_000_000)
    records = [*one[:2], *two, block(9, 0, 3_000_000, 1), *batch(3, GYRO, 0, 3_000_000)[:2]]
    recording = log(tmp_path / "b.bin", records)
    told = [problem.what for problem in recording.problems]
    assert "1 batches of samples are incomplete: 1 ISBD missing" in told
    assert "1 ISBD records belong to no batch that was announced" in told
    assert len(stream(recording, "ISBD[0]").time_ns) == 32 + 64 + 32


def test_a_batch_without_a_scale_has_no_samples(tmp_path: Path) -> None:
    broken = record(140, "QHBBHHQf", 5, 1, GYRO, 0, 0, SAMPLES, 5, RATE_HZ)
    recording = log(tmp_path / "b.bin", [broken, block(1, 0, 5, 1), *batch(2, GYRO, 0, 10_000)])
    assert len(stream(recording, "ISBD[0]").time_ns) == SAMPLES


def test_raw_batches_are_there_when_they_are_asked_for(tmp_path: Path) -> None:
    path = tmp_path / "b.bin"
    log(path, every_second())
    assert dict(stream(dataflash.read(path), "ISBD").columns) == {}
    raw = stream(dataflash.read(path, also=["ISBD"]), "ISBD")
    assert raw.columns["x"].shape == (2 * (SECONDS - 1), 32)
