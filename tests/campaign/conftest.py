"""Small campaigns of generated logs, and a reader that misbehaves as logs tell it to."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdilog.experiments.faults import Fault
from tests.campaign_logs import ENTRY_POINT, READER, flight


@pytest.fixture(scope="session")
def misbehaving(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that, on the path of Python, installs the reader that misbehaves."""
    folder = tmp_path_factory.mktemp("plugin")
    (folder / "misbehave.py").write_text(READER)
    info = folder / "misbehave-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: misbehave\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINT)
    return folder


@pytest.fixture(scope="session")
def good_logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight flights of two vehicles in three formats, one with a dead gyro."""
    folder = tmp_path_factory.mktemp("good")
    dead = Fault(kind="dead", channel="imu1.y", start_s=2.0)
    for number in range(4):
        flight(folder / "ann" / f"f{number}.bin", number, board="Board 00000001 00000002 00000003")
    flight(folder / "ann" / "dead.bin", 9, faults=[dead], board="Board 00000001 00000002 00000003")
    for number in range(2):
        flight(folder / "bob" / f"f{number}.tlog", 20 + number)
    flight(folder / "bob" / "f.csv", 30)
    return folder
