"""A device that tells what the others told a while ago is one finding, and says by how much."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.experiments.simulate import simulate
from fdilog.finding import Finding
from fdilog_reports.sentences import finding_sentence

CONFIG = Config().replace("detectors", use=("parity", "impulse", "dropout", "flatline", "noise"))
START_S, END_S = 40.0, 90.0


def late(by_s: float, *, sources: int = 3, axes: int = 3, stamps: bool = False) -> Analysis:
    """Analyse a flight in which the last device is late by so much for a while."""
    recording = simulate(120.0, 50.0, sources=sources, seed=4).recording(attitude=False)
    *others, stream = recording.streams
    time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
    meanwhile = (time_s >= START_S) & (time_s < END_S)
    columns = dict(stream.columns)
    time_ns = stream.time_ns
    if stamps:
        time_ns = time_ns + np.where(time_s >= START_S, round(by_s * 1e9), 0)
    else:
        for name in stream.gyro[:axes]:
            before = np.interp(time_s - by_s, time_s, columns[name])
            columns[name] = np.where(meanwhile, before, columns[name])
    changed = replace(stream, columns=columns, time_ns=time_ns)
    return analyse_recording(replace(recording, streams=(*others, changed)), CONFIG)


def only(analysis: Analysis) -> Finding:
    (finding,) = analysis.findings
    return finding


@pytest.mark.parametrize(("by_s", "way"), [(0.3, "late"), (-0.25, "early")])
def test_a_device_among_three_that_is_late_is_one_finding_of_it(by_s: float, way: str) -> None:
    analysis = late(by_s)
    finding = only(analysis)
    assert finding.kind == "disagreement"
    assert finding.suspects == ("imu2.x", "imu2.y", "imu2.z")
    assert finding.isolated
    assert finding.start_s == pytest.approx(START_S, abs=2.0)
    assert finding.end_s == pytest.approx(END_S, abs=2.0)
    said = re.match(r"imu2 runs (\S+) ± (\S+) s", finding.detail)
    assert said is not None
    assert float(said[1]) == pytest.approx(abs(by_s), abs=max(float(said[2]), 0.005))
    assert float(said[2]) < 0.05
    assert f" s {way}, by its stamps or its readings" in finding_sentence(finding, analysis)


def test_a_clock_that_is_set_in_flight_is_one_finding_too() -> None:
    analysis = late(0.3, stamps=True)
    finding = only(analysis)
    assert finding.suspects == ("imu2.x", "imu2.y", "imu2.z")
    # The clock of most of the flight is that of the device: before, it was early by that.
    (clock,) = [clock for clock in analysis.clocks if clock.source == "imu2"]
    assert clock.offset_s == pytest.approx(0.3, abs=0.02)
    assert finding.end_s == pytest.approx(START_S, abs=2.0)
    assert "s early" in finding.detail


def test_of_two_devices_both_are_suspects() -> None:
    finding = only(late(0.3, sources=2))
    assert {name.partition(".")[0] for name in finding.suspects} == {"imu0", "imu1"}
    assert not finding.isolated


def test_a_single_channel_that_is_late_is_no_device() -> None:
    assert only(late(0.3, axes=1)).suspects == ("imu2.x",)
