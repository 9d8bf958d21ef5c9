"""What a log is said to reveal at its rate, it reveals when such a fault is put into it."""

from __future__ import annotations

from dataclasses import replace
from math import degrees

import numpy as np
import pytest

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.decision.revealed import Revealed, revealed
from fdilog.experiments.faults import Fault
from fdilog.experiments.simulate import simulate
from fdilog_reports import markdown
from fdilog_reports.detectability import detectability
from fdilog_reports.sentences import limits
from fdilog_reports.text import render

SLOW_HZ = 2.0
FAULT_S = 60.0


def analysed(rate_hz: float, *faults: Fault, seconds: float = 300.0) -> Analysis:
    flight = simulate(seconds, rate_hz, sources=2, faults=faults, seed=11)
    return analyse_recording(flight.recording(), Config())


@pytest.fixture(scope="module")
def slow() -> Analysis:
    return analysed(SLOW_HZ)


def group_of(analysis: Analysis, channel: str) -> Revealed:
    (found,) = [
        group for group in revealed(analysis.table, analysis.evidence) if channel in group.channels
    ]
    return found


def size_at(group: Revealed, length_s: float) -> float:
    (size,) = [one.bias_rad_s for one in group.windows if one.length_s == length_s]
    assert size is not None
    return size


def test_a_slow_log_reveals_less_in_short_windows_than_in_long_ones(slow: Analysis) -> None:
    for group in revealed(slow.table, slow.evidence):
        sizes = [one.bias_rad_s for one in group.windows if one.bias_rad_s is not None]
        assert len(sizes) >= 2
        assert sizes == sorted(sizes, reverse=True)
        assert min(sizes) > np.radians(slow.config.tolerance.bias_deg_s)


def test_windows_of_one_reading_reveal_nothing(slow: Analysis) -> None:
    group = group_of(slow, "imu0.x")
    assert group.windows[0].length_s * SLOW_HZ < 1
    assert group.windows[0].bias_rad_s is None
    assert group.shortest_s is not None
    assert group.shortest_s >= 2 / SLOW_HZ


@pytest.mark.parametrize(("factor", "shows"), [(1.5, True), (0.5, False)])
def test_a_bias_shows_beyond_the_size_that_is_told_and_not_well_below(
    slow: Analysis, factor: float, shows: bool
) -> None:
    size = factor * size_at(group_of(slow, "imu1.y"), FAULT_S)
    fault = Fault(
        kind="bias", channel="imu1.y", start_s=100.0, end_s=100.0 + 2 * FAULT_S, size=size
    )
    found = analysed(SLOW_HZ, fault).findings
    named = [f for f in found if "imu1.y" in f.suspects and f.kind == "bias"]
    assert bool(named) == shows


def test_the_report_of_a_slow_log_says_what_its_rate_can_reveal(slow: Analysis) -> None:
    (sentence,) = limits(slow)
    largest = max(degrees(size_at(group, FAULT_S)) for group in revealed(slow.table, slow.evidence))
    assert sentence.startswith("Logged at 2 Hz, a constant error shows from ")
    assert f"{largest:.2g} deg/s on if it lasts 90 s" in sentence
    assert sentence in render(slow)
    assert sentence not in render(analysed(100.0, seconds=20.0))


def test_a_single_gyro_without_a_witness_reveals_nothing_by_comparison() -> None:
    recording = simulate(60.0, SLOW_HZ, sources=1, seed=11).recording()
    gyros = tuple(s for s in recording.streams if s.gyro and s.origin == "sensor")
    alone = analyse_recording(replace(recording, streams=gyros), Config())
    assert revealed(alone.table, alone.evidence) == ()
    assert limits(alone) == []
    assert "None: there was nothing to compare." in markdown.render(alone)


def test_the_table_of_what_would_have_shown_tells_what_the_sentence_does() -> None:
    brief = analysed(50.0, seconds=40.0)
    group = group_of(brief, "imu0.x")
    table = detectability(brief)
    of_group = [row for row in table.rows if row.name in group.channels]
    for k, one in enumerate(group.windows):
        told = [float(row.smallest[k]) for row in of_group if row.smallest[k] != "none"]
        if one.bias_rad_s is not None:
            assert max(told) == pytest.approx(degrees(one.bias_rad_s), rel=0.06)


def test_no_error_lasts_longer_than_the_flight() -> None:
    (sentence,) = limits(analysed(50.0, seconds=40.0))
    assert "on if it lasts all along; what lasts less than" in sentence
    assert "90 s" not in sentence
