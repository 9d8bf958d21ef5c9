"""An offset that follows a temperature is told with its figure, and left in."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.sources.assembly import assemble
from fdilog.sources.temperature import temperature_notes

OWN_FINDINGS = Config().replace("detectors", use=("parity",))


def warmed(deg_s_per_k: float, *, seed: int = 1, constant: bool = False) -> Recording:
    """A flight of two IMUs in which imu1.x follows its temperature."""
    recording = simulate(160.0, 25.0, sources=2, seed=seed).recording()

    def changed(stream: Stream) -> Stream:
        if stream.sensor != 1:
            return stream
        celsius = np.asarray(stream.columns["temperature"], float)
        follows = np.radians(deg_s_per_k) * (celsius - celsius.mean())
        rate = stream.columns[stream.gyro[0]] + follows
        if constant:
            celsius = np.zeros(len(celsius))
        columns = {**stream.columns, stream.gyro[0]: rate, "temperature": celsius}
        return replace(stream, columns=columns)

    return replace(recording, streams=tuple(changed(stream) for stream in recording.streams))


def note(analysis: Analysis) -> str:
    return next(one.note or "" for one in analysis.calibration if one.source == "imu1")


def test_the_slope_is_told_with_an_interval_that_holds_it() -> None:
    said = note(analyse_recording(warmed(0.05), OWN_FINDINGS))
    told = re.search(
        r"follows the temperature of imu1 over 7.\d K: x \+(\S+) deg/s per kelvin"
        r" \(\+(\S+) to \+(\S+)\); left in",
        said,
    )
    assert told is not None, said
    estimate, low, high = map(float, told.groups())
    assert low < 0.05 < high
    assert estimate == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_where_nothing_follows_a_temperature_nothing_is_said(seed: int) -> None:
    assert "temperature" not in note(analyse_recording(warmed(0.0, seed=seed), OWN_FINDINGS))


def test_a_device_whose_temperature_is_a_placeholder_is_not_compared_with_it() -> None:
    said = note(analyse_recording(warmed(0.05, constant=True), OWN_FINDINGS))
    assert "temperature of imu1" not in said


def test_an_offset_beyond_tolerance_is_a_finding_though_its_temperature_explains_it() -> None:
    found = analyse_recording(warmed(0.6), OWN_FINDINGS)
    assert found.findings
    assert all({"imu0.x", "imu1.x"} >= set(f.suspects) for f in found.findings)
    assert "deg/s per kelvin" in note(found)


def test_a_flight_too_short_for_a_slope_has_none() -> None:
    table = assemble(simulate(20.0, 25.0, sources=2).recording(attitude=False), Config()).table
    warming = {"imu1": (np.array([0.0, 20.0]), np.array([20.0, 60.0]))}
    assert temperature_notes(table, warming, 0.999) == {}


def test_the_slope_of_a_device_in_another_unit_is_that_of_its_rates_as_compared() -> None:
    recording = warmed(0.05)

    def in_degrees(stream: Stream) -> Stream:
        if stream.sensor != 1:
            return stream
        rates = {name: np.degrees(stream.columns[name]) for name in stream.gyro}
        return replace(stream, columns={**stream.columns, **rates})

    streams = tuple(in_degrees(stream) for stream in recording.streams)
    analysis = analyse_recording(replace(recording, streams=streams), OWN_FINDINGS)
    assert any("degrees and radians" in finding.detail for finding in analysis.findings)
    told = re.search(r"x \+(\S+) deg/s per kelvin", note(analysis))
    assert told is not None, note(analysis)
    assert float(told[1]) == pytest.approx(0.05, abs=0.015)
