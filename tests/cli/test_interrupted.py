"""Ctrl-C: one line, exit code 130, and nothing is left behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


@pytest.mark.parametrize("command", [["analyse"], ["analyse", "--json", "-q"], ["inspect"]])
def test_ctrl_c_is_one_line_and_exit_code_130(command: list[str], tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "fdilog", *command, "-"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(tmp_path)},
    )
    # What comes from standard input is copied first; then the command waits for more.
    deadline = time.monotonic() + 60.0
    while not list(tmp_path.glob("fdilog-*/stdin")):
        assert time.monotonic() < deadline
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err == b"fdilog: interrupted\n"
    assert out == b""
    assert list(tmp_path.iterdir()) == []
