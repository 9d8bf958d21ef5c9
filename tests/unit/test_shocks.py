"""A gyro that jumps together with the accelerometer of its device has felt a blow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream

BLOW_S = 31.0


def struck(sources: int, *, jolt_m_s2: float, jump_deg_s: float, apart: int = 0) -> Recording:
    """A flight in which one gyro jumps, and its accelerometer some readings later."""
    recording = simulate(60.0, 50.0, sources=sources, seed=4).recording(attitude=False)

    def changed(stream: Stream) -> Stream:
        if not stream.name.endswith("1" if sources > 1 else "0") or not stream.gyro:
            return stream
        at = int(np.searchsorted(stream.time_ns, stream.time_ns[0] + int(BLOW_S * 1e9)))
        columns = dict(stream.columns)
        for field, size, row in (
            (stream.gyro[0], np.radians(jump_deg_s), at),
            (stream.accelerometer[2], jolt_m_s2, at + apart),
        ):
            columns[field] = np.array(columns[field], float)
            columns[field][row] += size
        return replace(stream, columns=columns)

    return replace(recording, streams=tuple(changed(stream) for stream in recording.streams))


def kinds(recording: Recording) -> list[tuple[str, tuple[str, ...]]]:
    found = analyse_recording(recording, Config()).findings
    return [(finding.kind, finding.suspects) for finding in found]


@pytest.mark.parametrize("sources", [1, 3])
def test_a_jump_that_the_accelerometer_feels_is_a_blow(sources: int) -> None:
    name = ("imu1.x",) if sources > 1 else ("imu0.x",)
    alone = struck(sources, jolt_m_s2=0.0, jump_deg_s=100.0)
    assert kinds(alone) == [("impulse", name)]
    assert kinds(struck(sources, jolt_m_s2=15.0, jump_deg_s=100.0)) == []
    # Gyro and accelerometer may be logged one reading apart.
    assert kinds(struck(sources, jolt_m_s2=15.0, jump_deg_s=100.0, apart=1)) == []


def test_a_jolt_at_another_moment_excuses_nothing() -> None:
    assert kinds(struck(3, jolt_m_s2=15.0, jump_deg_s=100.0, apart=10)) == [
        ("impulse", ("imu1.x",))
    ]
