"""Logs behind URLs, workers on a cluster, and a folder into which logs are still being copied."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fdilog.campaign.audit import SETTLED_S, Settings, audit
from fdilog.campaign.discovery import discover
from fdilog.campaign.work import Task, analyse_log
from fdilog.config import Config
from fdilog.errors import FdilogError
from tests.campaign_logs import environment, flight, query, run_audit, tables


def test_logs_in_memory_are_found_and_fetched_by_the_worker(tmp_path: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    log = flight(tmp_path / "f.bin", 1)
    with fsspec.open("memory://fleet/ann/f.bin", "wb") as file:
        file.write(log.read_bytes())
    with fsspec.open("memory://fleet/readme.txt", "wb") as file:
        file.write(b"no log")
    (found,) = discover(["memory://fleet"])
    assert (found.size, found.remote) == (log.stat().st_size, True)
    outcome = analyse_log(Task(path=found.path, config=Config(), formats=()))
    local = analyse_log(Task(path=str(log), config=Config(), formats=()))
    assert outcome.sha256 == local.sha256
    assert outcome.json == local.json.replace(str(log), found.path)
    gone = analyse_log(Task(path="memory://fleet/gone.bin", config=Config(), formats=()))
    assert gone.error_kind == "unreachable"


def test_an_audit_by_url_gives_what_one_by_path_gives(tmp_path: Path) -> None:
    pytest.importorskip("fsspec")
    logs = tmp_path / "logs"
    for number in range(2):
        flight(logs / "ann" / f"f{number}.bin", number)
    by_path = audit([str(logs)], tmp_path / "by-path", Settings(jobs=1))
    by_url = audit([f"file://{logs}"], tmp_path / "by-url", Settings(jobs=1))
    again = audit([f"file://{logs}"], tmp_path / "by-url", Settings(jobs=1))
    assert [log.path.removeprefix("file://") for log in by_url.logs] == [
        log.path for log in by_path.logs
    ]
    for one, other in zip(by_path.logs, by_url.logs, strict=True):
        assert (one.verdict, one.sha256, one.channels) == (
            other.verdict,
            other.sha256,
            other.channels,
        )
        assert one.vehicle == other.vehicle == "ann"
    assert again.logs == by_url.logs
    assert query(tmp_path / "by-url", "SELECT analysed FROM runs") == [(2,), (0,)]


@pytest.fixture
def scheduler(misbehaving: Path, tmp_path: Path) -> Iterator[str]:
    """A Dask scheduler with two worker processes of their own, on loopback."""
    pytest.importorskip("distributed")
    env = {**environment(misbehaving), "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1"}
    place = ["--host", "127.0.0.1", "--no-dashboard"]
    with (tmp_path / "scheduler.log").open("w+") as log:
        scheduler = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_scheduler", *place, "--port", "0"],
            env=env, stderr=log, stdout=log,
        )  # fmt: skip
        address = ""
        deadline = time.monotonic() + 30.0
        while not address and time.monotonic() < deadline:
            time.sleep(0.1)
            match = re.search(r"tcp://127\.0\.0\.1:\d+", (tmp_path / "scheduler.log").read_text())
            address = match[0] if match else ""
        workers = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli.dask_worker", address, *place,
             "--nworkers", "2", "--nthreads", "1", "--local-directory", str(tmp_path)],
            env=env, stderr=log, stdout=log,
        )  # fmt: skip
        yield address
        for process in (workers, scheduler):
            process.send_signal(signal.SIGINT)
            process.wait(30)


def _wait_for_workers(address: str) -> None:
    import distributed

    with distributed.Client(address, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=30)


@pytest.mark.filterwarnings("ignore")  # dask's own
def test_a_cluster_gives_what_the_local_pool_gives(
    scheduler: str, tmp_path: Path, misbehaving: Path, good_logs: Path
) -> None:
    _wait_for_workers(scheduler)
    logs = tmp_path / "logs"
    shutil.copytree(good_logs / "bob", logs / "bob")
    (logs / "bob" / "empty.bin").touch()
    for what in ("SIGKILL", "hang"):
        (logs / "bob" / f"{what}.misbehave").write_text(f"MISBEHAVE {what}")
    here = run_audit(logs, "-o", tmp_path / "here", "--timeout", "6", plugins=[misbehaving])
    there = run_audit(
        *(logs, "-o", tmp_path / "there", "--timeout", "6", "--cluster", scheduler),
        plugins=[misbehaving],
    )
    assert here.returncode == there.returncode == 3, there.stderr
    one, other = tables(tmp_path / "here"), tables(tmp_path / "there")
    error = 8
    assert [row[:error] for row in one["logs"]] == [row[:error] for row in other["logs"]]
    for name in set(one) - {"logs"}:
        assert one[name] == other[name], name
    reasons = dict(query(tmp_path / "there", "SELECT error_kind, error FROM logs"))
    assert "Dask worker" in reasons["died"]
    assert "longer than 6 s" in reasons["timeout"]


def test_a_cluster_that_does_not_answer_is_one_line(tmp_path: Path, good_logs: Path) -> None:
    pytest.importorskip("distributed")
    from fdilog.campaign import cluster

    before, cluster.CONNECT_S = cluster.CONNECT_S, 1.0
    try:
        with pytest.raises(FdilogError, match="no Dask scheduler answers"):
            audit([str(good_logs)], tmp_path / "out", Settings(cluster="tcp://127.0.0.1:1"))
    finally:
        cluster.CONNECT_S = before


def test_a_log_that_is_copied_in_is_analysed_once_it_has_stopped_growing(tmp_path: Path) -> None:
    logs, output = tmp_path / "logs", tmp_path / "out"
    flight(logs / "first.bin", 1)
    os.utime(logs / "first.bin", (1e9, 1e9))
    whole = flight(tmp_path / "elsewhere.bin", 2).read_bytes()
    copied = threading.Event()

    def copy_slowly() -> None:
        with (logs / "second.bin").open("wb") as file:
            for k in range(8):
                file.write(whole[k * len(whole) // 8 : (k + 1) * len(whole) // 8])
                file.flush()
                time.sleep(SETTLED_S / 4)
        copied.set()

    copier = threading.Thread(target=copy_slowly)
    deadline = time.monotonic() + 60.0

    def go_on() -> bool:
        if (output / "index.html").exists() and copier.ident is None:
            copier.start()
        page = output / "audit.json"
        complete = copied.is_set() and page.exists() and "second.bin" in page.read_text()
        return not complete and time.monotonic() < deadline

    campaign = audit([str(logs)], output, Settings(jobs=1), follow=go_on)
    copier.join()
    assert [Path(log.path).name for log in campaign.logs] == ["first.bin", "second.bin"]
    assert query(output, "SELECT analysed FROM runs") == [(2,)]
    lost = query(output, "SELECT what FROM problems WHERE what LIKE '%incomplete%'")
    assert lost == []  # the whole second log was seen, not a part of it
