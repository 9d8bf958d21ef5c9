"""`fdilog audit` as a shell sees it: exit codes, streams, one line per error."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdilog.experiments.simulate import Airframe, simulate
from fdilog.writing import write
from tests.campaign_logs import run_audit


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes of three quiet gyros: enough to decide."""
    folder = tmp_path_factory.mktemp("healthy")
    flight = simulate(100.0, 25.0, sources=3, seed=5, airframe=Airframe(vibration_rad_s=0.0))
    write(flight.recording(), folder / "f.bin")
    return folder


def test_healthy_logs_are_0_and_a_bad_one_among_them_is_3(healthy: Path, tmp_path: Path) -> None:
    logs = [healthy / "f.bin"]
    done = run_audit(*logs, "-o", tmp_path / "out", "-j", "1", "-q")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[0] == "1 log: 1 healthy"
    assert str(tmp_path / "out" / "index.html") in done.stdout
    empty = tmp_path / "empty.bin"
    empty.touch()
    assert run_audit(*logs, empty, "-o", tmp_path / "out", "-j", "1").returncode == 3
    assert run_audit(empty, "-o", tmp_path / "out", "-j", "1").returncode == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere", "-o", "out"], "nowhere: no such file or folder"),
        ([".", "-o", "out"], "no log found"),
        ([".", "-o", "out", "--format", "pdf"], "no report named 'pdf'"),
        ([".", "-o", "file/out"], "no log found"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_2(
    tmp_path: Path, arguments: list[str], words: str
) -> None:
    done = run_audit(*arguments, cwd=tmp_path)
    assert done.returncode == 2
    assert words in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_an_output_that_cannot_be_written_is_one_line_and_2(healthy: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = run_audit(healthy, "-o", tmp_path / "file" / "out")
    assert done.returncode == 2
    assert "not a directory" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_reports_of_an_audit_share_one_script_file(healthy: Path, tmp_path: Path) -> None:
    done = run_audit(healthy, "-o", tmp_path / "out", "-j", "1", "--format", "html", "-q")
    assert done.returncode == 0
    (script,) = (tmp_path / "out" / "logs").glob("*.js")
    (page,) = (tmp_path / "out" / "logs").glob("*.html")
    assert f'<script src="{script.name}"></script>' in page.read_text("utf-8")
    assert page.stat().st_size < 500_000 < script.stat().st_size
    script.write_text("cut short", "utf-8")
    run_audit(healthy, "-o", tmp_path / "out", "-j", "1", "--format", "html", "-q")
    assert script.stat().st_size > 500_000
