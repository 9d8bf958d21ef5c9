"""Whatever the readings and the fault: the rest of the flight keeps every bit."""

from __future__ import annotations

import json
import math
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from fdilog.experiments.faults import KINDS, SIZE_UNITS, Fault, apply, touched
from fdilog.experiments.injection import inject
from fdilog.recording import Recording, Stream
from fdilog.registry import plugin, read
from fdilog.writing import write

TIMES = st.floats(0.0, 50.0)
GYRO = ("gx", "gy", "gz")
READINGS = st.floats(-40.0, 40.0, width=32)


@st.composite
def faults(draw: st.DrawFn, channels: tuple[str, ...] = ("imu0.x",)) -> Fault:
    kind: Any = draw(st.sampled_from(KINDS))
    start_s, end_s = sorted((draw(TIMES), draw(st.one_of(TIMES, st.just(math.inf)))))
    return Fault(
        kind=kind,
        channel=draw(st.sampled_from(channels)),
        start_s=start_s,
        end_s=end_s,
        size=draw(st.floats(1.0, 30.0)) if kind in SIZE_UNITS else None,
        count=draw(st.integers(1, 9)) if kind == "impulse" else 1,
    )


@given(fault=faults())
def test_the_truth_survives_json(fault: Fault) -> None:
    assert Fault.from_dict(json.loads(json.dumps(fault.to_dict(), allow_nan=False))) == fault


@given(
    fault=faults(),
    rate=arrays.arrays(np.float32, st.integers(1, 60), elements=READINGS),
    seed=st.integers(0, 9),
)
def test_only_touched_readings_change(fault: Fault, rate: Any, seed: int) -> None:
    time_s = np.arange(len(rate), dtype=np.float64) * 0.9
    after = apply(fault, time_s, rate, np.random.default_rng(seed), noise_rad_s=0.1)
    rest = ~touched(fault, time_s)
    assert np.array_equal(after[rest], rate[rest])
    inside = (time_s >= fault.start_s) & (time_s <= fault.end_s)
    assert not (touched(fault, time_s) & ~inside).any()
    assert touched(fault, time_s).any() == inside.any()
    assert after.shape == rate.shape


@st.composite
def recordings(draw: st.DrawFn) -> Recording:
    streams = []
    for number in draw(st.sets(st.integers(0, 4), min_size=1, max_size=3)):
        n = draw(st.integers(2, 30))
        steps = draw(arrays.arrays(np.int64, n, elements=st.integers(1, 10**6)))
        rate = draw(arrays.arrays(np.float32, (n, 3), elements=READINGS))
        rate[0] = 1.0 + number  # not absent, and no copy of another
        streams.append(
            Stream(
                name=f"imu{number}",
                time_ns=10**9 + 1000 * np.cumsum(steps),
                columns=dict(zip(GYRO, rate.T, strict=True)),
                units=dict.fromkeys(GYRO, "rad/s"),
                gyro=GYRO,
                sensor=number,
            )
        )
    return Recording(path="", format="simulated", bytes=0, streams=tuple(streams))


@settings(max_examples=25)
@given(recording=recordings(), data=st.data())
def test_any_recording_survives_dataflash_and_a_fault_in_its_bytes(
    recording: Recording, data: st.DataObject
) -> None:
    channels = tuple(f"{stream.name}.{axis}" for stream in recording.streams for axis in "xyz")
    fault = data.draw(faults(channels).filter(lambda one: one.kind != "noise"))
    fault = Fault.from_dict(fault.to_dict() | {"start_s": 0.0, "end_s": None})
    with tempfile.TemporaryDirectory() as folder:
        log, copy = Path(folder, "log.bin"), Path(folder, "copy.bin")
        write(recording, log)
        found = read(log)
        same_gyros(found, recording)
        injection = inject(found, [fault])
        plugin("writers", "dataflash").patch(log, copy, injection.changes)
        same_gyros(read(copy), injection.recording)


def same_gyros(found: Recording, expected: Recording) -> None:
    wanted = {stream.sensor: stream for stream in expected.streams if stream.gyro and stream.count}
    gyros = {stream.sensor: stream for stream in found.streams if stream.gyro}
    assert set(gyros) == set(wanted)
    for number, stream in gyros.items():
        other = wanted[number]
        assert np.array_equal(stream.time_ns, other.time_ns)
        for name, other_name in zip(stream.gyro, other.gyro, strict=True):
            assert stream.columns[name].tobytes() == other.columns[other_name].tobytes()
