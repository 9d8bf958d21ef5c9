"""A device or gyro that reads a multiple of what the others do, all along: one finding."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.simulate import simulate
from fdilog.finding import Finding
from fdilog.sources.gains import gain_findings, gains, rescaled
from fdilog.table import ChannelTable
from tests.tables import DEG, changed, table_of, triads

OWN_FINDINGS = Config().replace(
    "detectors", use=("parity", "impulse", "dropout", "flatline", "noise")
)
AXES = ("x", "y", "z")


@lru_cache(maxsize=16)
def analysis(
    factor: float, axes: tuple[str, ...] = AXES, *, sources: int = 3, attitude: bool = False
) -> Analysis:
    """Analyse a flight in which the last device reads a multiple about some axes."""
    fault = Fault(kind="bias", channel="imu0.x", start_s=30.0, end_s=50.0, size=5.0 * DEG)
    flight = simulate(80.0, 25.0, sources=sources, seed=3, faults=[fault] if sources > 2 else [])
    recording = flight.recording()
    last = f"imu{sources - 1}"
    streams = []
    for stream in recording.streams:
        columns = dict(stream.columns)
        for name, axis in zip(stream.gyro, AXES, strict=False):
            if stream.name == last and axis in axes:
                columns[name] = columns[name] * factor
        if stream.gyro or attitude:
            streams.append(replace(stream, columns=columns))
    return analyse_recording(replace(recording, streams=tuple(streams)), OWN_FINDINGS)


def scale(found: Analysis) -> Finding:
    (one,) = [finding for finding in found.findings if finding.kind == "scale"]
    return one


@pytest.mark.parametrize("factor", [0.5, 2.0, 8.0, 180.0 / np.pi, np.pi / 180.0])
def test_a_device_among_three_is_one_finding_and_other_faults_are_found_beside_it(
    factor: float,
) -> None:
    found = analysis(factor)
    assert [finding.kind for finding in found.findings] == ["scale", "bias"]
    one, bias = found.findings
    suspects = one.suspects
    assert suspects == ("imu2.x", "imu2.y", "imu2.z")
    assert one.isolated
    assert one.size is not None
    assert one.size.low < factor < one.size.high
    assert one.size.high / one.size.low < 1.1
    assert bias.suspects == ("imu0.x",)
    failed = {
        k for k, status in zip(found.table.names, found.status, strict=True) if status == "failed"
    }
    assert failed == {*suspects, "imu0.x"}
    assert ("degrees and radians" in one.detail) == (max(factor, 1.0 / factor) > 50.0)


def test_a_single_gyro_is_one_finding_of_that_channel() -> None:
    found = analysis(8.0, ("y",))
    assert scale(found).suspects == ("imu2.y",)
    assert {finding.suspects for finding in found.findings} == {("imu2.y",), ("imu0.x",)}


def test_of_two_devices_both_are_suspects_and_the_size_is_the_firsts() -> None:
    one = scale(analysis(4.0, sources=2))
    assert one.suspects == tuple(f"imu{k}.{axis}" for k in range(2) for axis in AXES)
    assert not one.isolated
    assert one.size is not None
    assert one.size.low < 0.25 < one.size.high


def test_a_single_device_is_held_against_the_attitude() -> None:
    found = analysis(180.0 / np.pi, sources=1, attitude=True)
    assert [finding.kind for finding in found.findings] == ["scale"]
    assert found.findings[0].suspects == ("imu0.x", "imu0.y", "imu0.z")


def noisy(table: ChannelTable) -> ChannelTable:
    rate = table.rate_rad_s.copy()
    rate[:, 4] += np.random.default_rng(2).normal(0.0, 20.0 * DEG, len(rate))
    return table_of(table.time_s, rate)


def late(table: ChannelTable) -> ChannelTable:
    rate = table.rate_rad_s.copy()
    rate[:, 3:6] = np.roll(rate[:, 3:6], 50, axis=0)
    return table_of(table.time_s, rate)


@pytest.mark.parametrize(
    "table",
    [
        triads(2),
        triads(3),
        changed(triads(3), "imu1.y", 10.0, 40.0, add=60.0 * DEG),
        changed(triads(3), "imu1.y", 0.0, 60.0, put=0.0),
        changed(triads(2), "imu1.y", 20.0, 60.0, put=0.3),
        noisy(triads(3)),
        late(triads(3)),
        triads(3, seconds=1.0),
        triads(1),
    ],
)
def test_other_faults_and_short_logs_are_no_gain(table: ChannelTable) -> None:
    assert gains(table) == ()


def test_a_gain_of_a_part_of_the_flight_is_for_the_windows() -> None:
    table = triads(3)
    rate = table.rate_rad_s.copy()
    rate[table.time_s > 30.0, 4] *= 4.0
    assert gains(table_of(table.time_s, rate)) == ()


@given(factor=st.one_of(st.floats(0.01, 0.6), st.floats(1.7, 100.0)), axis=st.integers(0, 2))
def test_rescaling_takes_out_what_was_put_in(factor: float, axis: int) -> None:
    table = triads(3, sigma_deg_s=0.05)
    rate = table.rate_rad_s.copy()
    rate[:, 3 + axis] *= factor
    multiplied = table_of(table.time_s, rate)
    found = gains(multiplied)
    assert [(one.source, one.axes) for one in found] == [("imu1", (axis,))]
    assert found[0].factor.low <= factor <= found[0].factor.high
    back = rescaled(multiplied, found)
    np.testing.assert_allclose(back.rate_rad_s, table.rate_rad_s, rtol=0.05, atol=0.01 * DEG)
    (finding,) = gain_findings(multiplied, found)
    assert finding.suspects == (f"imu1.{AXES[axis]}",)
