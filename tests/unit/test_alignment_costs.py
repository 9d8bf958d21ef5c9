"""A fault that regular windows have found costs no further windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fdilog.alignment import aligned_windows
from fdilog.config import Config
from fdilog.detectors.parity import ParityDetector
from fdilog.windows import Survey, cut
from tests.tables import DEG, changed, triads


def test_windows_in_doubt_are_no_hints_where_others_have_found_the_fault() -> None:
    table = triads(2, seconds=60.0, rate_hz=200.0)
    table = changed(table, "imu0.x", 0.0, 60.0, add=5.0 * DEG)
    found = [
        ParityDetector().detect(Survey(table=table, windows=windows, config=Config()))[0]
        for windows in cut(table, Config())
    ]
    long = found[2]
    assert (long.accused[:, table.names.index("imu0.x")] > 0).all()
    in_doubt = replace(long, accused=np.zeros_like(long.accused))
    assert aligned_windows(table, [in_doubt]) is not None
    assert aligned_windows(table, [in_doubt, long]) is None


def test_windows_shorter_than_the_wander_of_vibration_are_no_hints() -> None:
    table = changed(triads(2, seconds=20.0), "imu0.x", 5.0, 15.0, add=5.0 * DEG)
    windows = cut(table, Config())[1]
    (second,) = ParityDetector().detect(Survey(table=table, windows=windows, config=Config()))
    in_doubt = replace(second, accused=np.zeros_like(second.accused))
    assert aligned_windows(table, [in_doubt]) is None
