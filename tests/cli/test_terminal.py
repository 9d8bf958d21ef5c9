"""What the command line writes on a terminal, where there is one."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")

COLOUR = re.compile(r"\x1b\[[0-9;]*3[0-7]")


def on_a_terminal(*arguments: object, **environment: str) -> tuple[int, str]:
    """Run with standard output and standard error on a terminal of 80 columns."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "fdilog", *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=theirs,
        stderr=theirs,
        env={
            **{key: value for key, value in os.environ.items() if key != "NO_COLOR"},
            "TERM": "xterm-256color",
            "COLUMNS": "80",
            **environment,
        },
    )
    os.close(theirs)
    said = b""
    try:
        while block := os.read(ours, 65536):
            said += block
    except OSError:  # how Linux says that the other end is closed
        pass
    os.close(ours)
    return process.wait(timeout=60), said.decode()


def test_a_terminal_gets_a_summary_in_colour(sample_logs: Path) -> None:
    code, said = on_a_terminal("analyse", sample_logs / "three_imus_bias.bin")
    assert code == 1
    assert COLOUR.search(said)
    assert "FAILED" in said
    assert "one_imu" not in said


def test_no_color_takes_the_colours_away_and_nothing_else(sample_logs: Path) -> None:
    code, said = on_a_terminal("analyse", sample_logs / "three_imus_bias.bin", NO_COLOR="1")
    assert code == 1
    assert not COLOUR.search(said)
    assert "█" in said


def test_quiet_is_one_line_without_progress(sample_logs: Path) -> None:
    code, said = on_a_terminal("analyse", "-q", sample_logs / "three_imus_bias.bin")
    assert code == 1
    assert said.count("\n") == 1
    assert said.startswith("three_imus_bias.bin: Failed. imu1.y read ")
    assert "\x1b" not in said


def test_of_many_logs_each_gets_a_line(sample_logs: Path) -> None:
    logs = [sample_logs / "one_imu.bin"] * 5
    code, said = on_a_terminal("analyse", *logs, NO_COLOR="1")
    assert code == 3
    assert said.count("one_imu.bin: Insufficient.") == 5
    assert "INSUFFICIENT" not in said


def test_the_present_step_is_shown_while_it_lasts(sample_logs: Path) -> None:
    _, said = on_a_terminal("analyse", sample_logs / "three_imus_bias.bin", "--json")
    assert "three_imus_bias.bin: " in said


def test_a_hostile_file_name_is_not_obeyed(tmp_path: Path) -> None:
    path = tmp_path / "\x1b[2Jx\x07.bin"
    path.write_bytes(b"\x00" * 100)
    code, said = on_a_terminal("analyse", "-q", path)
    assert code == 2
    assert "\x1b" not in said
    assert "\\x1b[2Jx\\x07.bin" in said
