"""A gyro that surely disagrees with the others, in a way that no known kind explains."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.decision.disagreement import with_disagreement
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.experiments.simulate import simulate
from fdilog.recording import Recording, Stream
from fdilog.sources.assembly import assemble
from fdilog.sources.mounting import mountings
from fdilog.table import ChannelTable

OWN_FINDINGS = Config().replace(
    "detectors", use=("parity", "impulse", "dropout", "flatline", "noise")
)
Floats = NDArray[np.float64]
Wrong = Callable[[Floats, Floats], Floats]
START_S, END_S = 20.0, 60.0


def low_pass(rate: Floats, time_s: Floats) -> Floats:
    """A filter of first order with a time constant of 0.3 s."""
    lag = np.arange(0.0, 2.0, float(np.median(np.diff(time_s))))
    kernel = np.exp(-lag / 0.3)
    passed: Floats = np.convolve(rate, kernel / kernel.sum())[: len(rate)]
    return passed


def random_walk(rate: Floats, time_s: Floats) -> Floats:
    steps = np.random.default_rng(7).standard_normal(len(time_s))
    return np.asarray(rate + np.radians(8.0) * np.cumsum(steps) * np.sqrt(0.004), float)


WRONG: dict[str, Wrong] = {
    "a sign that is wrong every other second": lambda z, t: np.where(t % 2.0 < 1.0, z, -z),
    "a sign that is wrong every other five seconds": lambda z, t: np.where(t % 10.0 < 5.0, z, -z),
    "a delay of 0.3 s": lambda z, t: np.interp(t - 0.3, t, z),
    "a low-pass filter": low_pass,
    "an oscillation": lambda z, t: z + np.radians(5.0) * np.sin(2.0 * np.pi * 0.7 * t),
    "a response that is not linear": lambda z, _: z * np.abs(z) / np.radians(30.0),
}


@lru_cache(maxsize=4)
def flight(sources: int = 3, seed: int = 1) -> Recording:
    return simulate(80.0, 25.0, sources=sources, seed=seed).recording(attitude=False)


def with_wrong(recording: Recording, wrong: Wrong, *, sensor: int = 1) -> Recording:
    def changed(stream: Stream) -> Stream:
        if stream.sensor != sensor:
            return stream
        time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
        rate = np.asarray(stream.columns[stream.gyro[0]], float)
        inside = (time_s >= START_S) & (time_s <= END_S)
        rate = np.where(inside, wrong(rate, time_s), rate)
        return replace(stream, columns={**stream.columns, stream.gyro[0]: rate})

    return replace(recording, streams=tuple(changed(stream) for stream in recording.streams))


def kinds(analysis: Analysis) -> list[tuple[str, tuple[str, ...]]]:
    return [(finding.kind, finding.suspects) for finding in analysis.findings]


@pytest.mark.parametrize("what", WRONG)
def test_of_three_gyros_the_one_that_disagrees_is_one_finding(what: str) -> None:
    found = analyse_recording(with_wrong(flight(), WRONG[what]), OWN_FINDINGS)
    assert kinds(found) == [("disagreement", ("imu1.x",))]
    (finding,) = found.findings
    assert finding.size is None
    assert finding.start_s == pytest.approx(START_S, abs=6.0)
    assert finding.end_s == pytest.approx(END_S, abs=6.0)
    assert found.verdict == "failed"


CHANGING: dict[str, Wrong] = {
    "a drift that ends": lambda z, t: z + np.radians(np.clip(0.3 * (t - START_S), 0.0, 4.0)),
    "two steps": lambda z, t: z - np.radians(np.where(t < 35.0, 2.0, 6.0)),
}


@pytest.mark.parametrize("what", CHANGING)
def test_a_bias_that_changes_is_a_bias_whose_interval_holds_its_mean(what: str) -> None:
    changing = with_wrong(flight(), CHANGING[what])
    (finding,) = analyse_recording(changing, OWN_FINDINGS).findings
    assert (finding.kind, finding.suspects) == ("bias", ("imu1.x",))
    assert finding.start_s == pytest.approx(START_S, abs=8.0)
    assert finding.end_s == pytest.approx(END_S, abs=1.0)
    time_s = np.linspace(finding.start_s, finding.end_s, 1000)
    assert finding.size is not None
    mean = float(CHANGING[what](np.zeros(1000), time_s).mean())
    assert finding.size.low < mean < finding.size.high


def test_a_walk_that_stays_on_one_side_is_a_bias_and_says_from_what_to_what() -> None:
    walking = with_wrong(flight(), random_walk)
    (finding,) = analyse_recording(walking, OWN_FINDINGS).findings
    assert (finding.kind, finding.suspects) == ("bias", ("imu1.x",))
    assert finding.detail.startswith("it changed, from -45 to -35 deg/s;")


def test_what_swings_to_both_sides_is_no_bias_of_any_one_size() -> None:
    def wrong(rate: Floats, time_s: Floats) -> Floats:
        return np.asarray(rate + np.radians(6.0) * np.sin(0.42 * (time_s - START_S)), float)

    found = analyse_recording(with_wrong(flight(), wrong), OWN_FINDINGS)
    assert kinds(found) == [("disagreement", ("imu1.x",))]


def test_a_bias_far_above_what_a_gyro_disagrees_by_is_a_finding_beside_it() -> None:
    def wrong(rate: Floats, time_s: Floats) -> Floats:
        failed = np.where((time_s > 35.0) & (time_s < 45.0), np.radians(60.0), 0.0)
        return WRONG["an oscillation"](rate, time_s) + failed

    swings, failed = analyse_recording(with_wrong(flight(), wrong), OWN_FINDINGS).findings
    assert (swings.kind, swings.suspects) == ("disagreement", ("imu1.x",))
    assert (failed.kind, failed.suspects) == ("bias", ("imu1.x",))
    assert failed.size is not None
    assert failed.size.estimate == pytest.approx(np.radians(60.0), rel=0.15)
    assert (failed.start_s, failed.end_s) == pytest.approx((35.0, 45.0), abs=0.3)


def test_the_attitude_tells_of_a_bias_that_changes_whose_it_is() -> None:
    recording = simulate(80.0, 25.0, sources=2, seed=1).recording()
    changing = with_wrong(recording, CHANGING["a drift that ends"])
    (finding,) = analyse_recording(changing, OWN_FINDINGS).findings
    assert (finding.kind, finding.suspects) == ("bias", ("imu1.x",))
    assert finding.witness == "att"


def test_of_two_gyros_both_are_suspects() -> None:
    delayed = with_wrong(flight(2), WRONG["a delay of 0.3 s"])
    found = analyse_recording(delayed, OWN_FINDINGS)
    assert kinds(found) == [("disagreement", ("imu0.x", "imu1.x"))]


def test_a_scale_error_that_no_window_shows_as_a_bias_is_a_scale_error() -> None:
    fault = Fault(kind="scale", channel="imu1.x", start_s=START_S, end_s=END_S, size=1.6)
    found = analyse_recording(inject(flight(2), [fault]).recording, OWN_FINDINGS)
    assert kinds(found) == [("scale", ("imu0.x", "imu1.x"))]


@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "bias", "size": np.radians(5.0)},
        {"kind": "bias", "size": np.radians(50.0)},
        {"kind": "drift", "size": np.radians(0.3)},
        {"kind": "noise", "size": 10.0},
        {"kind": "stuck"},
        {"kind": "dead"},
        {"kind": "saturated", "size": np.radians(5.0)},
    ],
    ids=lambda fault: f"{fault['kind']}",
)
def test_a_fault_of_a_known_kind_is_no_disagreement(fault: dict[str, Any]) -> None:
    put = Fault(channel="imu1.x", start_s=START_S, end_s=END_S, **fault)
    found = analyse_recording(inject(flight(), [put]).recording, OWN_FINDINGS)
    assert found.findings
    assert "disagreement" not in [finding.kind for finding in found.findings]


@pytest.mark.parametrize("seed", range(5))
def test_a_healthy_flight_has_no_disagreement(seed: int) -> None:
    assert analyse_recording(flight(2, seed), OWN_FINDINGS).findings == ()


@pytest.mark.parametrize("samples", [0, 1, 2, 30])
def test_a_flight_of_a_few_samples_tells_nothing(samples: int) -> None:
    channels = assemble(flight(2), Config()).table.channels
    table = ChannelTable(
        time_s=np.linspace(0.0, 1.0, samples),
        rate_rad_s=np.zeros((samples, 6)),
        valid=np.ones((samples, 6), bool),
        channels=channels,
    )
    assert with_disagreement(table, table, [], Config()) == []
    assert mountings(table).found == ()


@pytest.mark.parametrize(("sources", "suspects"), [(3, {"imu1.x"}), (2, {"imu0.x", "imu1.x"})])
def test_a_bias_that_no_window_told_of_is_a_bias_over_its_own_span(
    sources: int, suspects: set[str]
) -> None:
    fault = Fault(kind="bias", channel="imu1.x", start_s=31.0, end_s=49.0, size=np.radians(-3.0))
    table = assemble(inject(flight(sources), [fault]).recording, Config()).table
    (finding,) = with_disagreement(table, table, [], Config())
    assert (finding.kind, set(finding.suspects)) == ("bias", suspects)
    assert (finding.start_s, finding.end_s) == pytest.approx((31.0, 49.0), abs=0.2)
    assert finding.size is not None
    off = np.radians(-3.0 if finding.suspects[0] == "imu1.x" else 3.0)
    assert finding.size.low < off < finding.size.high
    assert "half seconds" in finding.detail
    assert "explains" not in finding.detail
