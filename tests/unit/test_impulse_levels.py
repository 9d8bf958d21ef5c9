"""The level that readings about each stay below, against a loop over its definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.findings import self_evident_findings
from fdilog.decision.judgement import judge
from fdilog.detectors.impulse import (
    BESIDE,
    FEWEST_AROUND,
    LEVEL,
    MIDDLING_LEVELS,
    ImpulseDetector,
    _levels,
)
from fdilog.windows.survey import Survey, spans
from tests.tables import table_of, triads


@given(samples=st.integers(1, 600), seed=st.integers(0, 99))
def test_each_third_of_a_neighbourhood_has_the_quantile_of_all_of_it(
    samples: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=samples)
    rates = rng.normal(size=(samples, 3))
    rates[rng.random((samples, 3)) < 0.2] = np.nan
    # Ten readings a second: the fewest that are asked for are more than two seconds hold.
    found = _levels(table_of(np.arange(samples) / 10.0, rates), 0, values)
    rows = np.flatnonzero(np.isfinite(rates[:, 0]))
    third = FEWEST_AROUND // 3
    for place, row in enumerate(rows):
        first = place // third * third
        size = np.abs(values[rows])
        level = np.quantile(size[max(0, first - third) : first + 2 * third], LEVEL)
        if size[place] > MIDDLING_LEVELS * np.median(size):
            level = min(level, MIDDLING_LEVELS * middling(size, place))
        assert found[row] == level
    assert not found[np.setdiff1d(np.arange(samples), rows)].any()


def middling(size: NDArray[np.float64], place: int) -> float:
    """Of the ten before a reading and its neighbour, the ten after, and the flight."""
    medians = [float(np.median(size))]
    if len(size) >= 2 * (BESIDE + 2):
        before = max(0, place - 1 - BESIDE)
        after = min(place + 2, len(size) - BESIDE)
        medians += [float(np.median(size[k : k + BESIDE])) for k in (before, after)]
    return max(medians)


@pytest.mark.parametrize("share", [0.005, 0.02, 0.05, 0.1])
@pytest.mark.parametrize("sources", [2, 3])
def test_many_impulses_do_not_make_each_other_usual(share: float, sources: int) -> None:
    healthy = triads(sources, seconds=100.0)
    rng = np.random.default_rng(3)
    hit = rng.random(len(healthy.time_s)) < share
    hit[[0, -1]] = False
    rates = healthy.rate_rad_s.copy()
    rates[hit, 1] += rng.uniform(-9.0, 9.0, hit.sum())
    table = table_of(healthy.time_s, rates)
    survey = Survey(
        table=table, windows=spans(table, np.array([0]), np.array([len(hit)])), config=Config()
    )
    (evidence,) = ImpulseDetector().detect(survey)
    assert np.flatnonzero(evidence.accused.any(axis=0)).tolist() == [1]
    assert len(evidence.accused) > 0.6 * hit.sum()
    (finding,) = self_evident_findings(table, [evidence])
    assert (finding.kind, finding.suspects, finding.size) == ("impulse", ("imu0.y",), None)
    assert finding.start_s == table.time_s[evidence.windows.start.min()]
    assert finding.end_s == table.time_s[evidence.windows.stop.max() - 1]
    assert f"{len(evidence.accused)} times" in finding.detail


def test_a_few_impulses_have_each_their_instant_and_size_and_pauses_part_many() -> None:
    table = triads(3, seconds=600.0)
    rates = table.rate_rad_s.copy()
    rates[5000:5600:50, 1] += 1.0  # twelve of them
    rates[15000:15500:100, 1] += 1.0
    table = table_of(table.time_s, rates)
    findings = judge(table, Config()).findings
    assert {(f.kind, f.suspects) for f in findings} == {("impulse", ("imu0.y",))}
    many = [f for f in findings if f.size is None]
    assert [(f.start_s, f.end_s) for f in many] == [(100.0, 111.0)]
    assert [f.start_s for f in findings if f.size] == [300.0, 302.0, 304.0, 306.0, 308.0]
