"""Misalignment, scale and time offset put into recorded flights come back as they were put in."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.sources.assembly import assemble
from fdilog.windows.calibration import Calibration, calibrate

TURN_DEG, SCALE, LATE_S = 2.0, 0.01, 0.030
TELLING = ("quad_2imu_50hz_a", "quad_2imu_50hz_b", "hexa_2imu_25hz", "copter_2imu_50hz")
HOVERING = "quad_3imu_good_prop_hover_1"


def changed(recording: Recording, device: int, turn_axis: int, scale_axis: int) -> Recording:
    """Turn one device, make one of its axes too large, and stamp it late, all along."""
    angle = np.radians(TURN_DEG)
    first, second = (turn_axis + 1) % 3, (turn_axis + 2) % 3
    matrix = np.eye(3)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[first, second], matrix[second, first] = np.sin(angle), -np.sin(angle)
    matrix[scale_axis] *= 1.0 + SCALE

    def of(stream: Stream) -> Stream:
        if not stream.gyro or stream.sensor != device:
            return stream
        rate = np.column_stack([np.asarray(stream.columns[name], float) for name in stream.gyro])
        columns = dict(zip(stream.gyro, (rate @ matrix.T).T, strict=True))
        time_ns = stream.time_ns + round(LATE_S * 1e9)
        return replace(stream, time_ns=time_ns, columns={**stream.columns, **columns})

    return replace(recording, streams=tuple(of(stream) for stream in recording.streams))


def told(recording: Recording) -> tuple[Calibration, float]:
    """What is said of the second device against the first, and how late it is."""
    assembly = assemble(recording, Config())
    _, found = calibrate(assembly.table.gyros, Config())
    one = next(c for c in found if c.source == "imu1")
    return one, next(c.offset_s for c in assembly.clocks if c.source == "imu1")


@pytest.mark.parametrize("name", TELLING)
@pytest.mark.parametrize(("device", "turn_axis", "scale_axis"), [(0, 2, 2), (1, 0, 1), (1, 1, 0)])
def test_all_three_are_reported_within_a_fifth(
    real_logs: Path, name: str, device: int, turn_axis: int, scale_axis: int
) -> None:
    recording = read(real_logs / "dataflash" / f"{name}.bin")
    (was, was_late), (now, now_late) = (
        told(one) for one in (recording, changed(recording, device, turn_axis, scale_axis))
    )
    sign = 1.0 if device else -1.0  # the first device is what the second is held against
    turned = sign * (np.array(now.rotation_deg) - np.array(was.rotation_deg))
    assert turned[turn_axis] == pytest.approx(TURN_DEG, rel=0.2)
    assert np.abs(np.delete(turned, turn_axis)).max() < 0.2 * TURN_DEG
    scaled = sign * (np.array(now.scale) - np.array(was.scale))
    assert scaled[scale_axis] == pytest.approx(SCALE, rel=0.2)
    assert sign * (now_late - was_late) == pytest.approx(LATE_S, rel=0.2)


def test_they_are_no_failure(real_logs: Path) -> None:
    recording = read(real_logs / "dataflash" / "quad_2imu_50hz_b.bin")
    assert analyse_recording(changed(recording, 1, 0, 1), Config()).verdict == "healthy"


def test_a_flight_that_hovers_says_that_it_cannot_tell(real_logs: Path) -> None:
    recording = read(real_logs / "dataflash" / f"{HOVERING}.bin")
    one, late_s = told(recording)
    assert "turns too little, for its noise, about x, y, z" in (one.note or "")
    assert told(changed(recording, 1, 0, 1))[1] - late_s == pytest.approx(LATE_S, rel=0.2)
