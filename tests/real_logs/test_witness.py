"""On recorded flights the attitude tells which of two IMUs is off, and checks a single one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.recording import Recording
from fdilog.registry import read

# The other detectors corroborate, and take their time.
CONFIG = replace(Config(), detectors=replace(Config().detectors, use=("parity",)))
QUAD = "dataflash/quad_2imu_50hz_b.bin"
HEXA = "dataflash/hexa_2imu_25hz.bin"


@cache
def recorded(path: Path) -> Recording:
    return read(path)


def biased(recording: Recording, channel: str, start_s: float) -> Recording:
    """Put a bias of 3 deg/s for 30 s into one channel."""
    fault = Fault(
        kind="bias",
        channel=channel,
        start_s=start_s,
        end_s=start_s + 30.0,
        size=float(np.radians(3.0)),
    )
    return inject(recording, [fault]).recording


def one_imu(recording: Recording) -> Recording:
    streams = tuple(s for s in recording.streams if s.sensor in (None, 0))
    return replace(recording, streams=streams)


@pytest.mark.parametrize(
    ("log", "channel", "start_s"),
    [
        (QUAD, "imu0.x", 10.0),
        (QUAD, "imu1.y", 30.0),
        (QUAD, "imu0.z", 25.0),
        (HEXA, "imu1.x", 40.0),
        (HEXA, "imu0.y", 60.0),
        (HEXA, "imu1.z", 100.0),
    ],
)
def test_the_attitude_pins_the_gyro_that_is_off(
    real_logs: Path, log: str, channel: str, start_s: float
) -> None:
    recording = biased(recorded(real_logs / log), channel, start_s)
    analysis = analyse_recording(recording, CONFIG)
    (finding,) = analysis.findings
    assert finding.suspects == (channel,)
    assert finding.witness == "att"
    assert finding.size is not None
    assert finding.size.estimate == pytest.approx(np.radians(3.0), abs=np.radians(0.6))


@pytest.mark.parametrize(("log", "channel"), [(QUAD, "imu0.y"), (HEXA, "imu0.x")])
def test_a_single_imu_is_held_against_the_attitude(real_logs: Path, log: str, channel: str) -> None:
    single = one_imu(recorded(real_logs / log))
    assert analyse_recording(single, CONFIG).findings == ()
    (finding,) = analyse_recording(biased(single, channel, 20.0), CONFIG).findings
    assert finding.suspects == (channel,)
    assert finding.witness == "att"


@pytest.mark.parametrize("log", [QUAD, HEXA])
def test_healthy_flights_stay_healthy(real_logs: Path, log: str) -> None:
    analysis = analyse_recording(recorded(real_logs / log), CONFIG)
    assert analysis.verdict == "healthy"
    assert [channel.name for channel in analysis.table.channels if channel.derived] == [
        "att.x",
        "att.y",
        "att.z",
    ]


def test_the_attitude_of_a_rover_at_rest_that_tumbles_is_lost(real_logs: Path) -> None:
    # Its gyros read -24 deg/s while the accelerometer says that it stands still; the filter
    # believed them, so there is nothing to hold them against.
    analysis = analyse_recording(recorded(real_logs / "dataflash/rover_1imu_rcout.bin"), CONFIG)
    (about,) = [info for info in analysis.sources if info.name == "att"]
    assert not about.used
    assert "lost" in about.reason
    assert analysis.verdict == "insufficient"


@pytest.mark.parametrize("size_deg_s", [3.0, 50.0])
@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("log", ["ulog/quad_250hz.ulg", "tlog/sub_zero_imu2.tlog"])
def test_vehicles_of_one_imu_and_a_compass_are_held_against_their_attitude(
    real_logs: Path, log: str, axis: str, size_deg_s: float
) -> None:
    fault = Fault(
        kind="bias",
        channel=f"imu0.{axis}",
        start_s=20.0,
        end_s=50.0,
        size=float(np.radians(size_deg_s)),
    )
    recording = recorded(real_logs / log)
    assert analyse_recording(recording, CONFIG).findings == ()
    (finding,) = analyse_recording(inject(recording, [fault]).recording, CONFIG).findings
    assert (finding.kind, finding.suspects, finding.witness) == ("bias", (fault.channel,), "att")
    assert finding.size is not None
    assert finding.size.estimate == pytest.approx(fault.size, abs=np.radians(1.0))
