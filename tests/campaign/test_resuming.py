"""An audit that is killed loses what was in flight, and nothing else."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from fdilog.campaign.audit import Settings, audit
from fdilog.errors import FdilogError
from tests.campaign_logs import audit_command, environment, flight, query, run_audit, tables

KILLS = 5
IN_FLIGHT = 2 * 2
"""Two workers, each with a log that it analyses and one that waits."""


def children_of(pid: int) -> set[int]:
    """Process ids of all that descend from a process, by /proc."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            after = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        parents[int(entry.parent.name)] = int(after[1])
    found, more = {pid}, True
    while more:
        new = {child for child, parent in parents.items() if parent in found} - found
        found |= new
        more = bool(new)
    return found - {pid}


def alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def killed_after(lines: int, delay_s: float, *arguments: str | Path) -> None:
    """Start an audit, and kill -9 it some time after it has told of so many logs."""
    with subprocess.Popen(
        audit_command(*arguments), env=environment(), stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        for line in process.stderr:
            lines -= line.startswith("[")
            if lines <= 0:
                break
        time.sleep(delay_s)
        family = children_of(process.pid)
        process.send_signal(signal.SIGKILL)
        process.wait()
    deadline = time.monotonic() + 10.0
    while any(map(alive, family)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in family if alive(pid)], "workers outlive the audit"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
def test_kill_9_at_any_moment_loses_only_what_was_in_flight(
    tmp_path: Path, good_logs: Path
) -> None:
    logs = tmp_path / "logs"
    shutil.copytree(good_logs, logs)
    for number in range(4):
        flight(logs / "carl" / f"c{number}.bin", 50 + number)
    shutil.copy(logs / "carl" / "c0.bin", logs / "carl" / "again.bin")
    undisturbed = run_audit(logs, "-o", tmp_path / "whole", "-j", "2")
    rng = np.random.default_rng(1)
    for _ in range(KILLS):
        lines, delay_s = int(rng.integers(0, 3)), float(rng.uniform(0.0, 0.6))
        killed_after(lines, delay_s, logs, "-o", tmp_path / "killed", "-j", "2")
        tables(tmp_path / "killed")  # it opens, and is sound
    last = run_audit(logs, "-o", tmp_path / "killed", "-j", "2")
    assert last.returncode == undisturbed.returncode
    assert tables(tmp_path / "killed") == tables(tmp_path / "whole")
    contents = len(list(logs.rglob("*.*"))) - 1
    (told,) = query(tmp_path / "killed", "SELECT sum(analysed) FROM runs")[0]
    assert told == contents  # each is counted when it is kept, and none was kept twice
    for name in ("audit.json", "audit.md", "audit.xml", "index.html"):
        whole = (tmp_path / "whole" / name).read_bytes()
        assert (tmp_path / "killed" / name).read_bytes() == whole


def test_ctrl_c_is_one_line_and_130_and_the_rest_is_done_next_time(
    tmp_path: Path, good_logs: Path
) -> None:
    with subprocess.Popen(
        audit_command(good_logs, "-o", tmp_path / "out", "-j", "1"),
        env=environment(),
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        lines = [process.stderr.readline() for _ in range(3)]
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to workers too
        rest = process.stderr.read()
        assert process.wait(20) == 130
    assert lines[1].startswith("[")
    assert rest.splitlines()[-1].startswith("fdilog: interrupted")
    assert "Traceback" not in rest
    (done,) = query(tmp_path / "out", "SELECT analysed FROM runs")[0]
    assert 0 < done < 8
    audit([str(good_logs)], tmp_path / "out", Settings(jobs=2))
    assert query(tmp_path / "out", "SELECT count(*) FROM logs WHERE result IS NULL") == [(0,)]
    assert analysed(tmp_path / "out") == [done, 8 - done]


@pytest.fixture
def small(tmp_path: Path) -> Path:
    folder = tmp_path / "small"
    for number in range(3):
        flight(folder / f"f{number}.bin", number)
    return folder


def analysed(output: Path) -> list[int]:
    return [number for (number,) in query(output, "SELECT analysed FROM runs ORDER BY run")]


def test_only_what_is_new_changed_or_moved_is_looked_at_again(tmp_path: Path, small: Path) -> None:
    output, settings = tmp_path / "out", Settings(jobs=1)
    audit([str(small)], output, settings)
    audit([str(small)], output, settings)
    flight(small / "f3.bin", 3)  # new
    flight(small / "f1.bin", 11)  # changed
    (small / "f2.bin").rename(small / "moved.bin")
    campaign = audit([str(small)], output, settings)
    assert analysed(output) == [3, 0, 2]
    assert [Path(log.path).name for log in campaign.logs] == [
        "f0.bin", "f1.bin", "f3.bin", "moved.bin",
    ]  # fmt: skip
    assert all(log.verdict for log in campaign.logs)


def test_fresh_does_all_again_and_another_configuration_has_results_of_its_own(
    tmp_path: Path, small: Path
) -> None:
    output = tmp_path / "out"
    loose = Settings(jobs=1).config.replace("tolerance", bias_deg_s=5.0)
    audit([str(small)], output, Settings(jobs=1))
    audit([str(small)], output, Settings(jobs=1, config=loose))
    audit([str(small)], output, Settings(jobs=1))
    before = tables(output)
    audit([str(small)], output, Settings(jobs=1, fresh=True))
    assert analysed(output) == [3, 3, 0, 3]
    assert tables(output) == before


def test_a_report_that_was_deleted_is_made_again(tmp_path: Path, small: Path) -> None:
    output = tmp_path / "out"
    audit([str(small)], output, Settings(jobs=1))
    next((output / "logs").glob("f0-*.html")).unlink()
    audit([str(small)], output, Settings(jobs=1))
    assert analysed(output) == [3, 1]
    assert len(list((output / "logs").glob("f0-*.html"))) == 1


def test_reports_of_another_format_are_made_of_known_logs(tmp_path: Path, small: Path) -> None:
    output = tmp_path / "out"
    audit([str(small)], output, Settings(jobs=1, formats=("json",)))
    assert not list((output / "logs").glob("*.html"))
    audit([str(small)], output, Settings(jobs=1, formats=("html",)))
    assert analysed(output) == [3, 3]
    assert len(list((output / "logs").glob("f*.html"))) == 3
    audit([str(small)], output, Settings(jobs=1, formats=("html",)))
    assert analysed(output) == [3, 3, 0]


def test_what_could_not_be_kept_is_not_counted(
    tmp_path: Path, small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, _: bytes) -> None:
        raise FdilogError(f"{path}: cannot write: no space left on device")

    output = tmp_path / "out"
    with monkeypatch.context() as disk:
        disk.setattr("fdilog.campaign.audit.write_whole", full)
        with pytest.raises(FdilogError, match="no space left"):
            audit([str(small)], output, Settings(jobs=1, formats=("json",)))
    audit([str(small)], output, Settings(jobs=1, formats=("json",)))
    assert analysed(output) == [0, 3]


def test_two_audits_do_not_write_one_store(tmp_path: Path, small: Path) -> None:
    from fdilog.campaign.store import Store

    store = Store(tmp_path / "out")
    with pytest.raises(FdilogError, match="another audit is at work"):
        audit([str(small)], tmp_path / "out", Settings(jobs=1))
    store.close()
    audit([str(small)], tmp_path / "out", Settings(jobs=1))


def test_a_file_that_is_no_store_is_left_alone(tmp_path: Path, small: Path) -> None:
    output = tmp_path / "out"
    output.mkdir()
    (output / "audit.sqlite").write_text(
        "somebody's notes, long enough to be no empty database" * 9
    )
    with pytest.raises(FdilogError, match=r"audit\.sqlite"):
        audit([str(small)], output, Settings(jobs=1))
    assert (output / "audit.sqlite").read_text().startswith("somebody's notes")
