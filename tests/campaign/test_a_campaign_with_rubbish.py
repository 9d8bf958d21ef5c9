"""One audit of good logs among everything that can be wrong with a log."""

from __future__ import annotations

import json
import os
import re
import shutil
import stat
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import pytest

import fdilog
from fdilog.errors import FdilogError
from tests.campaign_logs import query, run_audit, tables

TIMEOUT_S = 15  # far longer than any of these logs takes, on a busy machine too
MEMORY_GB = 0.7


@dataclass(frozen=True)
class Audited:
    logs: Path
    output: Path
    code: int
    stdout: str
    stderr: str

    def row(self, name: bytes) -> tuple[str | None, str | None, str | None]:
        """Verdict, kind of error and reason of the log of that name."""
        rows = {
            Path(os.fsdecode(raw)).name: rest
            for raw, *rest in query(
                self.output,
                "SELECT l.path_raw, r.verdict, coalesce(l.error_kind, r.error_kind),"
                " coalesce(l.error, r.error) FROM logs l LEFT JOIN results r USING (result)",
            )
        }
        verdict, kind, reason = rows[os.fsdecode(name)]
        return verdict, kind, reason


@pytest.fixture(scope="module")
def audited(
    tmp_path_factory: pytest.TempPathFactory, good_logs: Path, misbehaving: Path
) -> Audited:
    folder = tmp_path_factory.mktemp("campaign")
    logs = folder / "logs"
    shutil.copytree(good_logs, logs)
    bad = logs / "bad"
    bad.mkdir()
    whole = (good_logs / "ann" / "f0.bin").read_bytes()
    (bad / "empty.bin").touch()
    (bad / "cut.bin").write_bytes(whole[: len(whole) // 2])
    (bad / "random.bin").write_bytes(bytes((k * 7919 + 13) % 251 for k in range(5000)))
    (bad / "gone.bin").symlink_to(bad / "nowhere.bin")
    (bad / "itself.bin").symlink_to(bad / "itself.bin")
    (bad / "loop").symlink_to(logs)
    (bad / "x.mcap").mkdir()
    (bad / "copy.bin").write_bytes(whole)
    (bad / "two\nlines.bin").write_bytes(whole[: len(whole) // 3])
    (bad / os.fsdecode(b"no-utf8-\xff.bin")).write_bytes(whole[: len(whole) // 4])
    (bad / "<img src=x onerror=alert(1)>.bin").write_bytes(b"nonsense")
    (bad / "readme.txt").write_text("not a log, and not named like one")
    os.mkfifo(bad / "pipe.bin")
    for what in ("hang", "eat", "SIGKILL", "SIGSEGV", "exit", "bug"):
        (bad / f"{what}.misbehave").write_text(f"MISBEHAVE {what}")
    output = logs / "audit"  # inside of what is searched: the audit must not find itself
    done = run_audit(
        *(logs, "-o", output, "-j", "2", "--timeout", str(TIMEOUT_S), "--memory", str(MEMORY_GB)),
        plugins=[misbehaving],
    )
    return Audited(logs, output, done.returncode, done.stdout, done.stderr)


def test_every_log_has_its_row_and_nothing_else_has(audited: Audited) -> None:
    names = {
        Path(os.fsdecode(raw)).name for (raw,) in query(audited.output, "SELECT path_raw FROM logs")
    }
    on_disk = {p.name for p in audited.logs.rglob("*") if audited.output not in p.parents}
    folders = {"ann", "bob", "bad", "loop", "audit"}
    assert names == on_disk - folders - {"readme.txt"}


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        (b"empty.bin", "unreadable", "empty"),
        (b"random.bin", "unreadable", "no DataFlash log"),
        (b"gone.bin", "unreachable", "no such file"),
        (b"itself.bin", "unreachable", "symbolic links"),
        (b"x.mcap", "unreachable", "directory"),
        (b"pipe.bin", "unreachable", "pipe"),
        (b"hang.misbehave", "timeout", f"longer than {TIMEOUT_S} s"),
        (b"eat.misbehave", "memory", "memory"),
        (b"SIGKILL.misbehave", "died", "SIGKILL"),
        (b"SIGSEGV.misbehave", "died", "SIGSEGV"),
        (b"exit.misbehave", "died", "exit code 7"),
        (b"bug.misbehave", "unreadable", "ZeroDivisionError"),
    ],
)
def test_a_bad_log_has_its_reason(audited: Audited, name: bytes, kind: str, words: str) -> None:
    verdict, found, reason = audited.row(name)
    assert verdict is None
    assert (found, words in (reason or "")) == (kind, True), (found, reason)


@pytest.mark.parametrize("name", [b"two\nlines.bin", b"no-utf8-\xff.bin", b"cut.bin", b"copy.bin"])
def test_a_log_with_an_odd_name_or_cut_short_is_analysed(audited: Audited, name: bytes) -> None:
    assert audited.row(name)[0] is not None


def test_verdicts_are_those_of_analyse(audited: Audited) -> None:
    for raw, verdict in query(
        audited.output,
        "SELECT path_raw, verdict FROM logs JOIN results USING (result) WHERE verdict NOT NULL",
    ):
        assert fdilog.analyse(os.fsdecode(raw)).verdict == verdict
    for name in (b"empty.bin", b"random.bin"):
        with pytest.raises(FdilogError):
            fdilog.analyse(audited.logs / "bad" / os.fsdecode(name))


def test_two_paths_with_one_content_share_one_result(audited: Audited) -> None:
    rows = query(
        audited.output,
        "SELECT path, result FROM logs WHERE path LIKE '%/copy.bin' OR path LIKE '%ann/f0.bin'",
    )
    assert len(rows) == 2
    assert len({result for _, result in rows}) == 1


def test_the_exit_code_says_that_a_gyro_failed(audited: Audited) -> None:
    assert audited.code == 1, audited.stderr
    assert audited.row(b"dead.bin")[0] == "failed"


def test_a_pipe_gets_one_line_a_log(audited: Audited) -> None:
    lines = [line for line in audited.stderr.splitlines() if line.startswith("[")]
    unreachable = 4 + 1  # those never reach a worker: gone, itself, x.mcap, pipe; and no line
    (logs,) = query(audited.output, "SELECT count(*) FROM logs")[0]
    assert len(lines) == logs - unreachable + 1
    assert f"; 2 workers of at most {MEMORY_GB} GB" in audited.stderr.splitlines()[0]
    assert "Traceback" not in audited.stderr


def test_reports_of_single_logs_are_linked_and_there(audited: Audited) -> None:
    campaign = json.loads((audited.output / "audit.json").read_text())
    linked = [name for log in campaign["logs"] for name in log["reports"]]
    assert linked
    for name in linked:
        assert (audited.output / name).stat().st_size > 0
    page = (audited.output / "index.html").read_text()
    assert all(name in page for name in linked if name.endswith(".html"))


def test_hostile_names_are_text_in_every_report(audited: Audited) -> None:
    page = (audited.output / "index.html").read_text()
    assert "<img" not in page
    assert "alert(1)" in page
    suite = ET.parse(audited.output / "audit.xml").getroot()  # noqa: S314  our own file
    names = [case.get("name") or "" for case in suite.iter("testcase")]
    assert any("<img src=x onerror=alert(1)>.bin" in name for name in names)
    assert any("two\\nlines" in name for name in names)
    markdown = (audited.output / "audit.md").read_text()
    assert re.search(r"(?<!\\)<", markdown) is None


def test_junit_counts_failures_and_errors(audited: Audited) -> None:
    suite = ET.parse(audited.output / "audit.xml").getroot()  # noqa: S314  our own file
    counts = json.loads((audited.output / "audit.json").read_text())["counts"]
    assert int(suite.get("failures") or 0) == counts["failed"] == len(list(suite.iter("failure")))
    assert int(suite.get("errors") or 0) == counts["not analysed"] == len(list(suite.iter("error")))


def test_what_is_known_is_not_done_again_but_accidents_are(
    audited: Audited, misbehaving: Path
) -> None:
    before = tables(audited.output)
    again = run_audit(
        *(audited.logs, "-o", audited.output, "-j", "2", "--timeout", "1", "--memory", "1"),
        plugins=[misbehaving],
    )
    assert again.returncode == 1
    (analysed,) = query(audited.output, "SELECT analysed FROM runs ORDER BY run DESC LIMIT 1")[0]
    assert analysed == 5  # hang, eat, SIGKILL, SIGSEGV, exit: another day they may go well
    after = tables(audited.output)
    assert [row[:7] for row in after["logs"]] == [row[:7] for row in before["logs"]]
    assert after["results"] == before["results"]
    assert after["findings"] == before["findings"]


def test_a_log_that_may_not_be_read_has_a_row(tmp_path: Path, good_logs: Path) -> None:
    shutil.copy(good_logs / "ann" / "f0.bin", tmp_path / "f0.bin")
    secret = tmp_path / "secret.bin"
    shutil.copy(good_logs / "ann" / "f1.bin", secret)
    secret.chmod(0)
    if os.access(secret, os.R_OK):
        pytest.skip("this user may read everything")
    done = run_audit(tmp_path, "-o", tmp_path / "out", "-j", "1")
    secret.chmod(stat.S_IRUSR)
    assert done.returncode == 3
    (reason,) = query(tmp_path / "out", "SELECT error FROM logs WHERE path LIKE '%secret.bin'")[0]
    assert "permission denied" in reason
