"""On recorded flights whose gyros were sound, no voting detector names anybody."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdilog.analysis import analyse

FLIGHTS = (
    "quad_3imu_good_prop_hover_1.bin",
    "quad_3imu_25_mm_cut_hover_1.bin",
    "quad_2imu_50hz_b.bin",
)


@pytest.mark.parametrize("flight", FLIGHTS)
@pytest.mark.filterwarnings("ignore:.*does not import.*")
def test_vibration_of_sound_gyros_is_nobodys_failure(real_logs: Path, flight: str) -> None:
    evidence = analyse(real_logs / "dataflash" / flight).evidence
    voting = [e for e in evidence if e.kind == "bias" and e.windows.length_s > 0]
    assert {"joint", "least-squares", "mean-square", "one-norm", "parity"} <= {
        e.detector for e in voting
    }
    for found in voting:
        assert not found.accused.any(), (found.detector, found.windows.length_s)
