"""Mountings in recorded flights: none where there is none, else the one that was put in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import NoGyroError, UnreadableLogError
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.registry import read
from fdilog.sources.assembly import assemble
from fdilog.sources.mounting import mounting_findings, mountings

SUFFIXES = {".bin", ".tlog", ".ulg", ".bag", ".mcap"}


def test_no_recorded_flight_has_a_mounting_to_report(real_logs: Path) -> None:
    looked = 0
    for path in sorted(real_logs.glob("*/*")):
        if path.suffix not in SUFFIXES:
            continue
        try:
            table = assemble(read(path), Config()).table
        except (NoGyroError, UnreadableLogError):
            continue
        assert mountings(table).found == (), path.name
        looked += 1
    assert looked >= 15


@pytest.mark.parametrize(
    "log", ["quad_3imu_good_prop_hover_1", "hexa_2imu_25hz", "quad_2imu_50hz_b"]
)
@pytest.mark.parametrize(("axis", "degrees"), [("z", 90.0), ("x", 180.0), ("y", None)])
def test_a_mounting_put_into_a_recorded_flight_is_found_in_the_right_device(
    real_logs: Path, log: str, axis: str, degrees: float | None
) -> None:
    size = None if degrees is None else float(np.radians(degrees))
    fault = Fault(kind="mounting", channel=f"imu1.{axis}", start_s=30.0, end_s=60.0, size=size)
    recording = inject(read(real_logs / "dataflash" / f"{log}.bin"), [fault]).recording
    table = assemble(recording, Config()).table
    (finding,) = mounting_findings(table, mountings(table).found)
    assert set(finding.suspects) <= {"imu1.x", "imu1.y", "imu1.z"}
    assert (f"turned by {degrees:.0f} deg about {axis}" if degrees else "y inverted") in (
        finding.detail
    )
    assert finding.start_s == pytest.approx(30.0, abs=1.0)
    assert finding.end_s == pytest.approx(60.0, abs=1.0)
