"""What the pictures show must be what the numbers say."""

from __future__ import annotations

import dataclasses
import re
import time

import numpy as np
import pytest

from fdilog.analysis import Analysis
from fdilog.finding import Evidence
from fdilog.maths.geometry import named_axes
from fdilog.table import Channel, ChannelTable
from fdilog_reports import html
from fdilog_reports.figures import RateAxis, TimeAxis, envelope, outline
from fdilog_reports.residual_picture import residual_picture
from fdilog_reports.residuals import Intervals, drawn_evidence, intervals, residuals
from fdilog_reports.timeline import channel_state, timeline
from tests.reports_factory import (
    DEG,
    analysis,
    bias,
    evidence,
    failed_analysis,
    pair_analysis,
    status_of,
    table,
    windows,
    with_error,
    without,
)


def test_a_single_peak_survives_any_decimation() -> None:
    value = np.zeros(1_000_000)
    value[123_456], value[123_457] = 7.0, -9.0
    line = envelope(np.arange(1e6), value, np.linspace(0.0, 1e6, 301))
    assert line.shape == (2, 300)
    assert line[1].max() == 7.0
    assert line[0].min() == -9.0


def test_an_envelope_agrees_with_a_loop_over_its_bins() -> None:
    random = np.random.default_rng(3)
    time_s = np.sort(random.uniform(0.0, 10.0, 200))
    value = np.where(random.random(200) < 0.3, np.nan, random.normal(size=200))
    edges = np.linspace(time_s[0], time_s[-1], 40)
    line = envelope(time_s, value, edges)
    for k in range(39):
        last = k == 38
        inside = (time_s >= edges[k]) & (
            (time_s <= edges[k + 1]) if last else (time_s < edges[k + 1])
        )
        known = value[inside & ~np.isnan(value)]
        if len(known):
            assert tuple(line[:, k]) == (known.min(), known.max())
        else:
            assert np.isnan(line[:, k]).all()


def test_a_gap_breaks_the_outline() -> None:
    y = np.array([[1.0, 2.0, np.nan, 3.0], [0.0, 1.0, np.nan, 2.0]])
    assert outline(np.arange(4.0), y) == "M0 0.0L1 1.0L1 2.0L0 1.0ZM3 2.0L3 3.0Z"


def test_the_rate_scale_is_odd_monotonic_and_reaches_both_ends() -> None:
    for top in (3.0, 4.0, 5.0, 1950.0):
        axis = RateAxis(tolerance=1.0, top=top)
        rates = np.linspace(-top, top, 2001)
        y = axis.y(rates)
        assert y[0] == pytest.approx(100.0)
        assert y[-1] == pytest.approx(0.0)
        assert (np.diff(y) < 0).all()
        np.testing.assert_allclose(y + y[::-1], 100.0, atol=1e-9)


def test_the_tolerance_keeps_its_place_beside_a_huge_peak() -> None:
    assert float(RateAxis(tolerance=1.0, top=2e6).y(1.0)) == pytest.approx(37.5)
    labels = [tick.label for tick in RateAxis(tolerance=1.0, top=2000.0).ticks()]
    assert {"0", "1", "2", "\u22121", "\u22122", "100"} <= set(labels)


def test_time_ticks_are_round_and_few() -> None:
    ticks = TimeAxis(start_s=0.0, end_s=243.0).ticks()
    assert [tick.label for tick in ticks] == ["0", "50", "100", "150", "200"]
    assert ticks[1].at == f"{100 * 50 / 243:.2f}"
    assert [t.label for t in TimeAxis(start_s=10.0, end_s=10.5).ticks()][:2] == ["10.0", "10.1"]


def test_the_residual_of_a_failed_channel_is_its_error() -> None:
    quiet = with_error(table(noise_deg_s=0.0), "imu1.y", 40.0, 60.0, 2.0)
    made = analysis(quiet, status=status_of(quiet, imu1_y="failed"), verdict="failed")
    found = {quiet.names[r.channel]: r for r in residuals(made)}
    inside = (quiet.time_s >= 40.0) & (quiet.time_s <= 60.0)
    np.testing.assert_allclose(found["imu1.y"].value[inside], 2.0 * DEG, atol=1e-12)
    np.testing.assert_allclose(found["imu1.y"].value[~inside], 0.0, atol=1e-12)
    # The failed channel predicts nothing, so its error does not show in the others.
    np.testing.assert_allclose(found["imu0.y"].value, 0.0, atol=1e-12)
    assert [quiet.names[i] for i in found["imu0.y"].peers] == ["imu2.y"]


def test_a_source_that_falls_silent_leaves_the_others_compared() -> None:
    made = analysis(without(table(), ["imu2.x", "imu2.y", "imu2.z"], 30.0, 40.0))
    found = {made.table.names[r.channel]: r.value for r in residuals(made)}
    silent = (made.table.time_s >= 30.0) & (made.table.time_s <= 40.0)
    assert np.isnan(found["imu2.x"][silent]).all()
    assert np.isfinite(found["imu0.x"]).all()
    z = made.table.rate_rad_s
    np.testing.assert_allclose(found["imu0.x"][silent], (z[:, 0] - z[:, 3])[silent])
    np.testing.assert_allclose(
        found["imu0.x"][~silent], (z[:, 0] - (z[:, 3] + z[:, 6]) / 2.0)[~silent]
    )


def test_residuals_of_skewed_axes_do_not_see_the_motion() -> None:
    axes = named_axes("matasov")
    time_s = np.arange(0.0, 10.0, 0.02)
    motion = np.sin(time_s[:, None] * np.array([1.0, 2.0, 3.0]))
    skewed = ChannelTable(
        time_s=time_s,
        rate_rad_s=motion @ axes.T,
        valid=np.ones((500, 6), bool),
        channels=tuple(
            Channel(name=f"g{k}", source="unit", axis=tuple(axes[k]), rate_hz=50.0, samples=500)
            for k in range(6)
        ),
    )
    found = residuals(analysis(skewed))
    assert len(found) == 6
    for residual in found:
        np.testing.assert_allclose(residual.value, 0.0, atol=1e-12)


def test_a_witness_predicts_only_where_no_gyro_does() -> None:
    made = table(sources=2)
    channels = tuple(
        dataclasses.replace(c, name=c.name.replace("imu1", "att"), source="att", derived=True)
        if c.source == "imu1"
        else c
        for c in made.channels
    )
    found = residuals(analysis(dataclasses.replace(made, channels=channels)))
    assert [(r.channel, r.peers) for r in found] == [(0, (3,)), (1, (4,)), (2, (5,))]
    three = table(sources=3)
    channels = tuple(dataclasses.replace(c, derived=c.source == "imu2") for c in three.channels)
    found = residuals(analysis(dataclasses.replace(three, channels=channels)))
    assert {r.peers for r in found if r.channel == 0} == {(3,)}


def test_a_pair_is_drawn_once_and_names_both() -> None:
    picture = residual_picture(pair_analysis())
    assert [len(group.panels) for group in picture.groups] == [1, 1, 1]
    panel = picture.groups[0].panels[0]
    assert panel.channels == (("imu0.x", "suspect"), ("imu1.x", "suspect"))
    assert [span.anchor for span in panel.spans] == ["finding-1"]


def test_the_largest_difference_is_named_with_its_time() -> None:
    made = with_error(table(noise_deg_s=0.0), "imu0.x", 77.0, 77.001, -250.0)
    panel = residual_picture(analysis(made)).groups[0].panels[0]
    assert panel.peak == "-250 deg/s at 77.00 s"


def drawn_bars(made: Analysis, channel: int = 0) -> Intervals:
    bars = intervals(drawn_evidence(made), channel)
    assert bars is not None
    return bars


def test_bars_are_the_deciding_detectors_intervals() -> None:
    made = table()
    first, second = evidence(made, detector="parity"), evidence(made, detector="difference")
    bars = drawn_bars(analysis(made, evidence=(first, second)), 4)
    assert bars.detector == "parity"
    np.testing.assert_array_equal(bars.low, first.low[:, 4])


def test_what_is_said_of_single_samples_decides_no_picture() -> None:
    made = table()
    each = dataclasses.replace(
        evidence(made, detector="guaranteed"),
        windows=dataclasses.replace(windows(made, 5.0), length_s=0.0),
    )
    bars = drawn_bars(analysis(made, evidence=(each, evidence(made, detector="parity"))))
    assert (bars.detector, bars.length_s) == ("parity", 5.0)


def test_bars_come_from_the_shortest_windows_that_mostly_decide() -> None:
    made = table(noise_deg_s=1.0)
    lengths = {length: evidence(made, length) for length in (0.2, 1.0, 5.0, 30.0)}
    assert [len(e.windows) for e in lengths.values()] == [1199, 239, 47, 7]
    low, high, limit = lengths[1.0].low, lengths[1.0].high, lengths[1.0].tolerance
    assert ((low > -limit) & (high < limit)).mean() < 0.5
    assert drawn_bars(analysis(made, evidence=tuple(lengths.values()))).length_s == 5.0
    # Where no length decides, the longest says at least how little is known.
    few = (lengths[0.2], lengths[1.0])
    assert drawn_bars(analysis(made, evidence=few)).length_s == 1.0


def test_every_bar_stands_in_one_path_of_its_answer() -> None:
    made = failed_analysis()
    column = made.table.names.index("imu1.y")
    panel = next(
        panel
        for group in residual_picture(made).groups
        for panel in group.panels
        if panel.channels[0][0] == "imu1.y"
    )
    drawn = {state: len(re.findall("M", path)) for state, path in panel.bars}
    item = made.evidence[0]
    low, high = item.low[:, column], item.high[:, column]
    known = np.isfinite(low)
    assert sum(drawn.values()) == int(known.sum())
    assert drawn["failed"] == int(((low > DEG) | (high < -DEG))[known].sum())
    assert drawn["healthy"] == int(((low > -DEG) & (high < DEG))[known].sum())


def states(made: Analysis, channel: str, at_s: list[float]) -> list[int]:
    axis = TimeAxis.of(made)
    edges = axis.edges(made, 500)
    state = channel_state(made, made.table.names.index(channel), edges)
    return [int(state[np.searchsorted(edges, t) - 1]) for t in at_s]


def test_the_timeline_tells_no_data_from_never_compared_from_healthy() -> None:
    made = without(table(), ["imu2.x", "imu2.y", "imu2.z"], 80.0, 90.0)
    seen = evidence(made)
    overlaps = (seen.windows.end_s > 20.0) & (seen.windows.start_s < 40.0)
    tested = seen.tested & ~overlaps[:, None]
    made_analysis = analysis(made, evidence=(dataclasses.replace(seen, tested=tested),))
    assert states(made_analysis, "imu2.x", [10.0, 30.0, 85.0]) == [3, 1, 0]


def one_window(made: ChannelTable, length_s: float, low: float, high: float) -> Evidence:
    cut = windows(made, length_s)
    shape = (len(cut), len(made.channels))
    return dataclasses.replace(
        evidence(made, length_s),
        tested=np.ones(shape, bool),
        low=np.full(shape, low * DEG),
        high=np.full(shape, high * DEG),
    )


def test_the_longest_windows_decide_the_timeline() -> None:
    made = table()
    long_unsure = one_window(made, 60.0, 0.5, 1.1)
    short_healthy = one_window(made, 5.0, -0.2, 0.2)
    both = analysis(made, evidence=(short_healthy, long_unsure))
    assert states(both, "imu0.x", [10.0, 60.0]) == [2, 2]
    assert states(analysis(made, evidence=(short_healthy,)), "imu0.x", [60.0]) == [3]


def test_windows_that_hold_a_known_fault_leave_the_rest_to_shorter_ones() -> None:
    made = table()
    found = bias(("imu0.x",), start_s=59.0, end_s=64.0)
    items = (one_window(made, 5.0, -0.2, 0.2), one_window(made, 60.0, 0.5, 1.1))
    failed = analysis(
        made, evidence=items, findings=(found,), status=status_of(made, imu0_x="failed")
    )
    assert states(failed, "imu0.x", [10.0, 80.0]) == [3, 3]
    lane = timeline(failed).lanes[0]
    (span,) = lane.findings
    assert span.state == "failed"
    assert float(span.left) == pytest.approx(1000 * 59.0 / 119.98, abs=0.1)
    assert float(span.width) == pytest.approx(1000 * 5.0 / 119.98, abs=0.1)


def test_an_impulse_can_be_seen_and_stays_within_the_picture() -> None:
    found = bias(("imu0.x",), start_s=119.98, end_s=119.98)
    (span,) = timeline(failed_analysis(findings=(found,))).lanes[0].findings
    assert float(span.width) >= 3.0
    assert float(span.left) + float(span.width) <= 1000.0


def test_slow_samples_leave_no_false_gaps() -> None:
    slow = table(duration_s=3000.0, rate_hz=1.0)
    seen = {span.state for lane in timeline(analysis(slow)).lanes for span in lane.spans}
    assert seen <= {"healthy", "undecided"}


def test_the_page_of_one_hour_at_200_hz_stays_below_a_megabyte() -> None:
    made = table(sources=2, duration_s=3600.0, rate_hz=200.0)
    assert made.rate_rad_s.shape == (720_000, 6)
    hour = analysis(made, evidence=(evidence(made, 60.0),))
    started = time.process_time()
    text = html.render(hour)
    took_s = time.process_time() - started
    assert len(text.encode()) < 1_000_000
    assert took_s < 3.0  # about 1 s, a quarter of it to compress the plotting library once
