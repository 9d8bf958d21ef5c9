"""A device that is mounted otherwise than assumed: found, named, and turned back."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.motion import Airframe
from fdilog.experiments.simulate import simulate
from fdilog.finding import Finding
from fdilog.sources.assembly import assemble
from fdilog.sources.mounting import mountings, turned_back
from fdilog.sources.turned import signed_permutations, turns

OWN_FINDINGS = Config().replace(
    "detectors", use=("parity", "impulse", "dropout", "flatline", "noise")
)
QUARTER, HALF = np.pi / 2, np.pi
STILL = Airframe(tilt_rad=0.0, heading_rad=0.0, doublet_rad=0.0)


@lru_cache(maxsize=32)
def analysis(
    *faults: Fault, sources: int = 3, attitude: bool = True, seed: int = 3, still: bool = False
) -> Analysis:
    flight = simulate(
        80.0, 25.0, sources=sources, faults=faults, seed=seed, airframe=STILL if still else None
    )
    recording = flight.recording()
    if not attitude:
        streams = tuple(s for s in recording.streams if s.gyro)
        recording = replace(recording, streams=streams)
    return analyse_recording(recording, OWN_FINDINGS)


def mounted(channel: str, size: float | None = None, **when: Any) -> Fault:
    return Fault(kind="mounting", channel=channel, size=size, **when)


def only(found: Analysis) -> Finding:
    assert [finding.kind for finding in found.findings] == ["mounting"], found.findings
    return found.findings[0]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (mounted("imu1.z", QUARTER), "imu1 is turned by 90 deg about z (x reads y, y reads -x"),
        (mounted("imu1.y", -QUARTER), "turned by 90 deg about -y"),
        (mounted("imu1.x", HALF), "turned by 180 deg about x (x reads x, y reads -y, z reads -z)"),
        (mounted("imu1.z", np.radians(45.0)), "turned by 45 deg about z"),
    ],
)
def test_a_turned_device_among_three_is_one_finding_of_the_device(fault: Fault, said: str) -> None:
    finding = only(analysis(fault, attitude=False))
    assert finding.suspects == ("imu1.x", "imu1.y", "imu1.z")
    assert finding.isolated
    assert said in finding.detail
    assert finding.start_s == 0.0
    assert finding.end_s > 79.0


def test_an_inverted_axis_is_the_fault_of_that_channel() -> None:
    found = analysis(mounted("imu2.y"), attitude=False)
    finding = only(found)
    assert finding.suspects == ("imu2.y",)
    assert "imu2 has y inverted" in finding.detail
    status = dict(zip(found.table.names, found.status, strict=True))
    assert [name for name, one in status.items() if one == "failed"] == ["imu2.y"]


def test_the_channels_of_a_turned_device_have_failed_and_no_other_has() -> None:
    found = analysis(mounted("imu1.z", QUARTER), attitude=False)
    failed = {n for n, s in zip(found.table.names, found.status, strict=True) if s == "failed"}
    assert failed == {"imu1.x", "imu1.y", "imu1.z"}
    assert found.verdict == "failed"


@pytest.mark.parametrize("size", [None, QUARTER, HALF])
def test_a_mounting_that_changes_in_flight_has_its_span(size: float | None) -> None:
    finding = only(analysis(mounted("imu0.z", size, start_s=30.0, end_s=55.0), attitude=False))
    assert {name.partition(".")[0] for name in finding.suspects} == {"imu0"}
    assert finding.start_s == pytest.approx(30.0, abs=0.5)
    assert finding.end_s == pytest.approx(55.0, abs=0.5)


def test_of_two_devices_both_are_suspects() -> None:
    finding = only(analysis(mounted("imu0.z", QUARTER), sources=2, attitude=False))
    assert len(finding.suspects) == 6
    assert not finding.isolated
    assert "as imu0 sees it, imu1 is turned" in finding.detail


@pytest.mark.parametrize("device", ["imu0", "imu1"])
def test_of_two_devices_the_attitude_tells_which(device: str) -> None:
    finding = only(analysis(mounted(f"{device}.x", HALF), sources=2))
    assert finding.suspects == tuple(f"{device}.{axis}" for axis in "xyz")
    assert finding.witness == "att"
    assert "180 deg about x" in finding.detail


def test_a_single_device_is_held_against_the_attitude() -> None:
    finding = only(analysis(mounted("imu0.z", HALF), sources=1))
    assert finding.suspects == ("imu0.x", "imu0.y", "imu0.z")
    assert finding.witness == "att"


@pytest.mark.parametrize(("start_s", "found"), [(0.0, 0), (30.0, 1)])
def test_an_attitude_of_an_unknown_frame_tells_changes_alone(start_s: float, found: int) -> None:
    fault = mounted("imu0.z", HALF, start_s=start_s)
    flight = simulate(80.0, 25.0, sources=1, seed=3, faults=[fault])
    table = assemble(flight.recording(), Config()).table
    assert len(mountings(table, one_frame=False).found) == found
    assert len(mountings(table).found) == 1


def test_a_single_device_that_turns_in_flight_is_held_against_the_attitude() -> None:
    finding = only(analysis(mounted("imu0.z", HALF, start_s=30.0, end_s=55.0), sources=1))
    assert finding.start_s == pytest.approx(30.0, abs=0.5)


@pytest.mark.parametrize(
    "fault",
    [
        mounted("imu0.z", HALF, start_s=30.0, end_s=42.0),
        mounted("imu0.z", np.radians(40.0), start_s=10.0),
    ],
)
def test_an_attitude_alone_tells_no_turn_that_one_led_astray_makes(fault: Fault) -> None:
    assert not [f for f in analysis(fault, sources=1).findings if f.kind == "mounting"]


def test_a_fault_of_a_turned_device_is_found_beside_its_mounting_and_named_as_logged() -> None:
    fault = Fault(kind="bias", channel="imu1.x", start_s=30.0, end_s=50.0, size=0.1)
    found = analysis(mounted("imu1.z", QUARTER), fault, attitude=False)
    assert [(f.kind, f.suspects) for f in found.findings if f.kind != "mounting"] == [
        ("bias", ("imu1.x",))
    ]
    assert found.findings[0].kind == "mounting"
    size = found.findings[1].size
    assert size is not None
    assert size.estimate == pytest.approx(0.1, abs=0.01)


def test_a_flight_without_motion_tells_no_mounting_and_says_so() -> None:
    found = analysis(mounted("imu1.z", QUARTER), attitude=False, still=True)
    assert not [f for f in found.findings if f.kind == "mounting"]
    notes = {one.source: one.note or "" for one in found.calibration}
    assert "turned too little about x, y, z to tell how it is mounted" in notes["imu1"]


def test_the_calibration_says_that_the_rates_were_turned_back() -> None:
    found = analysis(mounted("imu1.z", QUARTER), attitude=False)
    one = next(one for one in found.calibration if one.source == "imu1")
    assert "turned back" in (one.note or "")
    assert np.abs(one.rotation_deg).max() < 2.0


@pytest.mark.parametrize("seed", range(4))
def test_a_healthy_flight_has_no_mounting_to_report(seed: int) -> None:
    table = assemble(simulate(80.0, 25.0, sources=3, seed=seed).recording(), Config()).table
    told = mountings(table)
    assert told.found == ()
    assert told.untold == ()
    assert turned_back(table, told.found) is table


@pytest.mark.parametrize(
    "fault",
    [
        Fault(kind="bias", channel="imu1.x", start_s=20.0, end_s=60.0, size=1.0),
        Fault(kind="scale", channel="imu1.x", size=0.3),
        Fault(kind="stuck", channel="imu1.x", start_s=20.0),
        Fault(kind="dead", channel="imu1.x"),
        Fault(kind="noise", channel="imu1.x", size=20.0),
    ],
)
def test_another_fault_is_no_mounting(fault: Fault) -> None:
    assert not [f for f in analysis(fault, attitude=False).findings if f.kind == "mounting"]


def test_a_bias_of_twice_a_steady_turn_is_no_inverted_axis() -> None:
    rng = np.random.default_rng(5)
    rate = 0.3 * rng.standard_normal((400, 3))
    turning = slice(200, 260)
    rate[turning] = rng.normal([0.0, 0.5, 0.0], 0.12, (60, 3))
    reading = rate + 0.01 * rng.standard_normal((400, 3))
    reading[turning, 1] -= 1.0
    assert turns(rate, reading) == []
    inverted = reading.copy()
    inverted[turning, 1] = -rate[turning, 1]
    (turn,) = turns(rate, inverted)
    np.testing.assert_array_equal(turn.matrix, np.diag([1.0, -1.0, 1.0]))


@pytest.mark.parametrize("matrix", list(signed_permutations()[1:]))
def test_each_of_the_47_mountings_is_told_from_the_others(matrix: Any) -> None:
    rng = np.random.default_rng(5)
    rate = 0.3 * rng.standard_normal((100, 3))
    (turn,) = turns(rate, rate @ matrix.T + 0.01 * rng.standard_normal((100, 3)) + 0.2)
    np.testing.assert_array_equal(turn.matrix, matrix)
    assert len(turn.standing) == 1
    assert (turn.first, turn.last) == (0, 100)


def test_motion_about_one_axis_leaves_several_mountings_and_names_what_it_tells() -> None:
    rng = np.random.default_rng(5)
    rate = np.zeros((100, 3))
    rate[:, 2] = 0.3 * rng.standard_normal(100)
    (turn,) = turns(rate, -rate + 0.001 * rng.standard_normal((100, 3)))
    assert len(turn.standing) == 8
    assert turn.differs.tolist() == [False, False, True]
    assert turn.matrix[2, 2] == -1.0


@pytest.mark.parametrize("size", [None, QUARTER, HALF])
def test_the_time_offset_of_a_device_is_told_however_it_is_mounted(size: float | None) -> None:
    flight = simulate(80.0, 25.0, sources=2, seed=3, faults=[mounted("imu1.z", size)])
    recording = flight.recording(attitude=False)
    late = tuple(
        replace(stream, time_ns=stream.time_ns + 30_000_000) if stream.sensor == 1 else stream
        for stream in recording.streams
    )
    before, after = (
        assemble(replace(recording, streams=streams), Config()).clocks[0].offset_s
        for streams in (recording.streams, late)
    )
    assert after - before == pytest.approx(0.030, abs=0.003)
