"""Shared fixtures: where the real logs are, and a Hypothesis profile that repeats itself."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile("repeatable")

ROOT = Path(__file__).parent.parent

# A shell starts background jobs deaf to Ctrl-C, and what they start stays so: these tests use it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def real_logs() -> Path:
    """Folder of recorded flights that are not ours to ship; FDILOG_REAL_LOGS names another."""
    folder = Path(os.environ.get("FDILOG_REAL_LOGS", ROOT.parent / "shared" / "logs"))
    if not folder.is_dir():
        pytest.skip("the folder of real logs is absent; FDILOG_REAL_LOGS can name it")
    return folder


@pytest.fixture(scope="session")
def sample_logs() -> Path:
    """Folder of the logs that the simulator made and the project ships."""
    return ROOT / "sample_logs"
