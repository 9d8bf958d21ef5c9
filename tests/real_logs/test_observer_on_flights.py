"""The observer on recorded vehicles: mostly there is no model, and that is what it says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.recording import Recording
from fdilog.registry import read

HEXACOPTER = "dataflash/hexa_2imu_25hz.bin"
ROVER = "dataflash/rover_1imu_rcout.bin"


def configured(inputs: list[str], healthy_s: tuple[float, float]) -> Config:
    observed = Config().replace(
        "observer",
        outputs=("imu0.z",),
        inputs=tuple(inputs),
        identify=True,
        healthy_s=healthy_s,
        eigenvalues_per_s=(-0.5,),
    )
    return observed.replace("sources", use=("imu0",)).replace(
        "detectors", use=("parity", "observer")
    )


def note(analysis: Analysis) -> str:
    (said,) = (p for p in analysis.completeness.problems if p.what.startswith("observer"))
    assert said.note
    return said.what


def biased(recording: Recording, size_deg_s: float, start_s: float, end_s: float) -> Recording:
    """Add a bias to the yaw rate of the first IMU."""
    first = min(s.time_ns[0] for s in recording.streams if s.gyro)

    def changed(
        columns: dict[str, np.ndarray], time_ns: np.ndarray, name: str
    ) -> dict[str, object]:
        time_s = (time_ns - first) / 1e9
        off = np.radians(size_deg_s) * ((time_s >= start_s) & (time_s < end_s))
        return {**columns, name: columns[name] + off}

    streams = tuple(
        replace(s, columns=changed(dict(s.columns), s.time_ns, s.gyro[2]))
        if s.gyro and s.sensor == 0
        else s
        for s in recording.streams
    )
    return replace(recording, streams=streams)


@pytest.mark.parametrize("healthy_s", [(30.0, 90.0), (210.0, 330.0)])
def test_a_rover_whose_outputs_do_not_steer_it_has_no_model(
    real_logs: Path, healthy_s: tuple[float, float]
) -> None:
    config = configured(["RCOU.Ch1"], healthy_s)
    analysis = analyse_recording(read(real_logs / ROVER, ["RCOU"]), config)
    assert note(analysis).startswith("observer: not asked: no model from the healthy stretch")
    assert not any("observer" in finding.detectors for finding in analysis.findings)


@pytest.mark.parametrize(("size_deg_s", "found"), [(0.0, False), (20.0, False), (100.0, True)])
def test_motors_tell_what_a_hexacopter_turns_and_so_a_very_large_bias(
    real_logs: Path, size_deg_s: float, *, found: bool
) -> None:
    recording = read(real_logs / HEXACOPTER, ["RCOU"])
    config = configured([f"RCOU.C{k}" for k in range(1, 7)], (40.0, 140.0))
    analysis = analyse_recording(biased(recording, size_deg_s, 150.0, 170.0), config)
    assert "a constant error raises an alarm beyond" in note(analysis)
    findings = [f for f in analysis.findings if "observer" in f.detectors]
    assert bool(findings) is found
    if found:
        (finding,) = findings
        assert finding.suspects == ("imu0.z",)
        assert finding.size is not None
        assert finding.size.low < np.radians(size_deg_s) < finding.size.high
        assert (finding.start_s, finding.end_s) == pytest.approx((150.0, 170.0), abs=1.0)
