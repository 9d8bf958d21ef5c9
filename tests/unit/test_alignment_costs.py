"""A fault that regular windows have found costs no further windows."""

from __future__ import annotations

from fdilog.alignment import aligned_windows
from fdilog.config import Config
from fdilog.detectors.parity import ParityDetector
from fdilog.windows import Survey, cut
from tests.tables import DEG, changed, triads


def test_short_windows_that_cannot_decide_are_no_hints_where_long_ones_have() -> None:
    table = triads(2, seconds=60.0, rate_hz=200.0)
    table = changed(table, "imu0.x", 0.0, 60.0, add=5.0 * DEG)
    evidence = [
        ParityDetector().detect(Survey(table=table, windows=windows, config=Config()))[0]
        for windows in cut(table, Config())
    ]
    short, long = evidence[0], evidence[2]
    # Windows of 0.1 s are off by more than the tolerance and accuse nobody; those of 5 s do.
    assert not short.accused.all(axis=1).any()
    assert (long.accused[:, table.names.index("imu0.x")] > 0).all()
    assert aligned_windows(table, [short]) is not None
    assert aligned_windows(table, evidence) is None
