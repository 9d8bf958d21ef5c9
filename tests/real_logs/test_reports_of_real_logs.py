"""Reports of recorded flights: all three formats, from the file to the page."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fdilog import analyse, read
from fdilog_reports import html, markdown
from fdilog_reports import json as json_report
from tests.unit.test_report_json import validate


@pytest.mark.parametrize(
    "name",
    ["copter_3imu_vibration_crash.bin", "rover_dead_gyro.bin", "rover_1imu_rcout.bin",
     "truncated_64k.bin"],
)  # fmt: skip
def test_a_recorded_flight_gives_all_three_reports(real_logs: Path, name: str) -> None:
    made = analyse(real_logs / "dataflash" / name)
    validate(json.loads(json_report.render(made)))
    page = html.render(made)
    assert name in page
    assert len(page.encode()) < 2_000_000
    assert f"**{page.partition('<title>')[2].partition(':')[0]}.**" in markdown.render(made)


@pytest.mark.parametrize("name", ["quad_2imu_50hz_b.bin", "truncated_64k.bin"])
def test_no_report_tells_where_the_aircraft_was(real_logs: Path, name: str) -> None:
    log = real_logs / "dataflash" / name
    gps = next(stream for stream in read(log, ["GPS"]).streams if stream.name == "GPS")
    made = analyse(log)
    said = [
        markdown.render(made), json_report.render(made), made.to_text(), made._repr_html_(),
        html.render(made).partition("<script")[0],
    ]  # fmt: skip
    for field in ("Lat", "Lng"):
        degrees = np.unique(np.round(np.abs(gps.columns[field]), 3))
        known = [f"{value:.3f}" for value in degrees if value > 1.0]
        assert known
        assert not [value for value in known for text in said if value in text]


def test_the_crash_is_drawn_with_its_peak_and_its_hole(real_logs: Path) -> None:
    from fdilog_reports.residual_picture import residual_picture
    from fdilog_reports.timeline import timeline

    made = analyse(real_logs / "dataflash" / "copter_3imu_vibration_crash.bin")
    panels = [panel for group in residual_picture(made).groups for panel in group.panels]
    assert len(panels) == 9
    # The log's README: peaks of 34 to 41 rad/s at 227.7 s.
    assert any("at 227.7" in panel.peak for panel in panels)
    assert all("no-data" in {span.state for span in lane.spans} for lane in timeline(made).lanes)
