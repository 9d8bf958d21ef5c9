"""A fault that regular windows have found costs no further windows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fdilog.config import Config
from fdilog.decision.alignment import aligned_windows
from fdilog.detectors.parity import ParityDetector
from fdilog.finding import Evidence
from fdilog.windows.survey import Survey, cut
from tests.tables import DEG, changed, triads


def doubting(evidence: Evidence) -> Evidence:
    """Let every window say that the first channel may be off by 4 to 6 deg/s, and accuse nobody."""
    low, high = np.full_like(evidence.low, -np.inf), np.full_like(evidence.high, np.inf)
    low[:, 0], high[:, 0] = 4.0 * DEG, 6.0 * DEG
    return replace(evidence, accused=np.zeros_like(evidence.accused), low=low, high=high)


def test_windows_in_doubt_are_no_hints_where_others_have_found_the_fault() -> None:
    table = triads(2, seconds=60.0, rate_hz=200.0)
    table = changed(table, "imu0.x", 0.0, 60.0, add=5.0 * DEG)
    found = [
        ParityDetector().detect(Survey(table=table, windows=windows, config=Config()))[0]
        for windows in cut(table, Config())
    ]
    long = found[2]
    assert (long.accused[:, table.names.index("imu0.x")] > 0).all()
    in_doubt = doubting(long)
    assert aligned_windows(table, [in_doubt]) is not None
    assert aligned_windows(table, [in_doubt, long]) is None


def test_windows_shorter_than_the_wander_of_vibration_are_no_hints() -> None:
    table = changed(triads(2, seconds=20.0), "imu0.x", 5.0, 15.0, add=5.0 * DEG)
    windows = cut(table, Config())[1]
    (second,) = ParityDetector().detect(Survey(table=table, windows=windows, config=Config()))
    assert aligned_windows(table, [doubting(second)]) is None
