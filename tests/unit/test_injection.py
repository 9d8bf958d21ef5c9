"""A fault that is put into a recorded log is there, and nothing else has changed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.errors import UsageError
from fdilog.experiments.faults import Fault, noise_sigma
from fdilog.experiments.injection import Injection, inject
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.registry import plugin, read
from fdilog.writing import write, write_injected


@pytest.fixture
def log(tmp_path: Path) -> Path:
    write(simulate(20.0, 25.0, seed=3).recording(), tmp_path / "flight.bin")
    return tmp_path / "flight.bin"


def injected(log: Path, *faults: Fault) -> tuple[Path, Injection]:
    injection = inject(read(log), faults, seed=1)
    copy = log.with_name("copy.bin")
    write_injected(injection, log, copy)
    return copy, injection


def gyro(recording: Recording, name: str) -> Stream:
    return next(stream for stream in recording.streams if stream.name == name)


def time_s(stream: Stream, recording: Recording) -> Any:
    first = min(int(s.time_ns[0]) for s in recording.streams if s.gyro)
    return (stream.time_ns - first) / 1e9


def test_a_bias_changes_its_field_and_no_other_byte(log: Path) -> None:
    copy, injection = injected(
        log, Fault(kind="bias", channel="imu1.y", start_s=8.0, end_s=12.0, size=0.1)
    )
    before, after = read(log), read(copy)
    stream, changed = gyro(before, "IMU[1]"), gyro(after, "IMU[1]")
    inside = (time_s(stream, before) >= 8.0) & (time_s(stream, before) <= 12.0)
    expected = (stream.columns["GyrY"].astype(float) + np.where(inside, 0.1, 0.0)).astype("f4")
    assert changed.columns["GyrY"].tobytes() == expected.tobytes()
    assert stream.offsets is not None
    old, new = (np.frombuffer(path.read_bytes(), np.uint8) for path in (log, copy))
    different = np.flatnonzero(old != new)
    # GyrY stands behind the header (3), TimeUS (8), I (1) and GyrX (4).
    fields = stream.offsets[inside][:, None] + 16 + np.arange(4)
    assert len(old) == len(new)
    assert len(different)
    assert np.isin(different, fields).all()
    assert injection.truth["faults"][0]["size"] == 0.1


def test_the_injected_recording_is_what_a_reader_finds_in_the_copy(log: Path) -> None:
    copy, injection = injected(
        log,
        Fault(kind="stuck", channel="imu0.z", start_s=5.0),
        Fault(kind="noise", channel="imu2.x", start_s=2.0, end_s=9.0, size=4.0),
        Fault(kind="dropout", channel="imu1", start_s=8.0, end_s=9.0),
    )
    again = read(copy)
    for name in ("IMU[0]", "IMU[1]", "IMU[2]"):
        expected, found = gyro(injection.recording, name), gyro(again, name)
        assert np.array_equal(found.time_ns, expected.time_ns)
        for field in expected.columns:
            assert np.array_equal(found.columns[field], expected.columns[field]), (name, field)
    assert gyro(again, "IMU[1]").count in (474, 475)
    assert not [problem for problem in again.problems if not problem.note]


def test_a_dropout_removes_whole_records(log: Path) -> None:
    copy, injection = injected(log, Fault(kind="dropout", channel="imu1", start_s=8.0, end_s=9.0))
    removed = int(injection.changes[0].removed.sum())
    assert removed in (25, 26)
    assert copy.stat().st_size == log.stat().st_size - 54 * removed


def test_bytes_that_belong_to_no_record_stay_where_they_are(log: Path) -> None:
    whole = log.read_bytes()
    middle = len(whole) // 2
    log.write_bytes(whole[:middle] + b"\0" * 100 + whole[middle:-20])
    copy, _ = injected(log, Fault(kind="bias", channel="imu0.x", size=0.1))
    old, new = log.read_bytes(), copy.read_bytes()
    assert len(old) == len(new)
    assert new[middle : middle + 100] == b"\0" * 100
    assert new[-34:] == old[-34:]


def test_a_noise_fault_multiplies_the_noise_that_the_channel_has(log: Path) -> None:
    before = gyro(read(log), "IMU[2]").columns["GyrX"]
    _, injection = injected(log, Fault(kind="noise", channel="imu2.x", size=4.0))
    after = gyro(injection.recording, "IMU[2]").columns["GyrX"]
    assert injection.truth["noise_rad_s"] == {"imu2.x": noise_sigma(before)}
    assert np.std(after - before) == pytest.approx(np.sqrt(15) * noise_sigma(before), rel=0.1)


def test_the_same_seed_gives_the_same_copy(log: Path) -> None:
    noisy = Fault(kind="noise", channel="imu2.x", size=4.0)
    one = injected(log, noisy)[0].read_bytes()
    assert one == injected(log, noisy)[0].read_bytes()
    assert one != log.read_bytes()


def test_the_truth_is_plain_json(log: Path) -> None:
    _, injection = injected(log, Fault(kind="dead", channel="imu2.x", start_s=4.0))
    assert json.loads(json.dumps(injection.truth, allow_nan=False)) == injection.truth


def test_readings_in_other_units_and_whole_numbers_get_their_fault_in_those() -> None:
    raw = np.array([0, 100, -200, 300], np.int16)
    stream = Stream(
        name="RAW_IMU",
        time_ns=np.arange(4) * 10**9,
        columns={"xgyro": raw, "ygyro": raw, "zgyro": raw},
        units=dict.fromkeys(("xgyro", "ygyro", "zgyro"), "mrad/s"),
        gyro=("xgyro", "ygyro", "zgyro"),
        sensor=0,
    )
    recording = Recording(path="x", format="x", bytes=0, streams=(stream,))
    bias = Fault(kind="bias", channel="imu0.y", start_s=1.0, end_s=2.0, size=0.0104)
    far = Fault(kind="impulse", channel="imu0.z", start_s=3.0, size=1e3)
    (changed,) = inject(recording, [bias, far]).recording.streams
    assert changed.columns["ygyro"].tolist() == [0, 110, -190, 300]
    assert changed.columns["zgyro"].tolist() == [0, 100, -200, 32767]
    assert changed.columns["ygyro"].dtype == np.int16
    assert changed.columns["xgyro"] is raw or np.array_equal(changed.columns["xgyro"], raw)


def test_a_fault_that_fits_no_channel_or_time_is_refused(log: Path) -> None:
    with pytest.raises(UsageError, match=r"no channel .imu7\.y."):
        injected(log, Fault(kind="dead", channel="imu7.y"))
    with pytest.raises(UsageError, match=r"the flight lasts 19\.9"):
        injected(log, Fault(kind="dead", channel="imu1.y", start_s=21.0))


def test_a_copy_in_another_format_is_written_anew(log: Path) -> None:
    injection = inject(read(log), [Fault(kind="dead", channel="imu2.z", start_s=4.0)])
    table = log.with_name("copy.csv")
    write_injected(injection, log, table)
    rows = np.genfromtxt(table, delimiter=",", skip_header=1)
    late = rows[:, 0] >= 4.0
    assert not rows[late, 9].any()
    assert rows[late, 8].any()
    assert rows[~late, 9].any()


def test_a_log_is_never_overwritten(log: Path) -> None:
    before = log.read_bytes()
    injection = inject(read(log), [Fault(kind="dead", channel="imu2.z")])
    with pytest.raises(UsageError, match="is the log itself"):
        write_injected(injection, log, log)
    assert log.read_bytes() == before


def test_a_copy_that_cannot_be_written_is_one_line(log: Path) -> None:
    injection = inject(read(log), [Fault(kind="dead", channel="imu2.z")])
    with pytest.raises(UsageError, match="no such file"):
        write_injected(injection, log, log.parent / "missing" / "copy.bin")


def test_a_stream_without_offsets_cannot_be_patched(log: Path) -> None:
    recording = read(log)
    streams = tuple(replace(stream, offsets=None) for stream in recording.streams)
    injection = inject(replace(recording, streams=streams), [Fault(kind="dead", channel="imu0.x")])
    with pytest.raises(UsageError, match=r"records of IMU\[0\] are is not known"):
        plugin("writers", "dataflash").patch(log, log.with_name("copy.bin"), injection.changes)


def test_a_scaled_field_is_not_rewritten_in_its_place(log: Path) -> None:
    recording = read(log, also=("ATT",))
    attitude = gyro(recording, "ATT")
    (change,) = inject(recording, [Fault(kind="dead", channel="imu0.x")]).changes
    wrong = replace(
        change,
        stream=attitude,
        columns={"Roll": attitude.columns["Roll"]},
        removed=np.zeros(attitude.count, bool),
    )
    with pytest.raises(UsageError, match="Roll of ATT cannot be rewritten"):
        plugin("writers", "dataflash").patch(log, log.with_name("copy.bin"), [wrong])
