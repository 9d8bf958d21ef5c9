"""Gyros of recorded flights made to disagree in ways that no known kind explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.registry import read

Floats = NDArray[np.float64]
OWN_FINDINGS = Config().replace(
    "detectors", use=("parity", "impulse", "dropout", "flatline", "noise")
)


def late(rate: Floats, time_s: Floats) -> Floats:
    return np.interp(time_s - 0.3, time_s, rate)


def oscillating(rate: Floats, time_s: Floats, amplitude_deg_s: float = 5.0) -> Floats:
    swing = np.radians(amplitude_deg_s) * np.sin(2.0 * np.pi * 0.7 * time_s)
    return np.asarray(rate + swing, float)


def oscillating_hard(rate: Floats, time_s: Floats) -> Floats:
    """Oscillate by more than the gyros of a hovering quadrotor differ by vibration."""
    return oscillating(rate, time_s, 8.0)


def made_wrong(
    recording: Recording, sensor: int, wrong: Callable[[Floats, Floats], Floats]
) -> Recording:
    def changed(stream: Stream) -> Stream:
        if not stream.gyro or stream.sensor != sensor:
            return stream
        time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
        rate = np.asarray(stream.columns[stream.gyro[0]], float)
        rate = np.where((time_s >= 20.0) & (time_s <= 80.0), wrong(rate, time_s), rate)
        return replace(stream, columns={**stream.columns, stream.gyro[0]: rate})

    return replace(recording, streams=tuple(changed(stream) for stream in recording.streams))


@pytest.mark.parametrize(
    ("log", "sensor", "wrong", "suspects"),
    [
        ("quad_2imu_50hz_a", 1, late, ("imu0.x", "imu1.x")),
        ("copter_2imu_50hz", 1, oscillating, ("imu0.x", "imu1.x")),
        ("quad_3imu_10_mm_cut_straight_line_2", 2, oscillating_hard, ("imu2.x",)),
    ],
)
def test_they_are_one_finding_of_that_axis(
    real_logs: Path,
    log: str,
    sensor: int,
    wrong: Callable[[Floats, Floats], Floats],
    suspects: tuple[str, ...],
) -> None:
    recording = made_wrong(read(real_logs / "dataflash" / f"{log}.bin"), sensor, wrong)
    (finding,) = analyse_recording(recording, OWN_FINDINGS).findings
    assert finding.kind == "disagreement"
    assert finding.suspects == suspects
    assert finding.end_s == pytest.approx(80.0, abs=5.0)
