"""Logs behind URLs, workers on a cluster, and a folder into which logs are still being copied."""

from __future__ import annotations

import functools
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from fdilog.campaign import following
from fdilog.campaign.audit import Settings, audit
from fdilog.campaign.discovery import discover
from fdilog.campaign.following import SETTLED_S
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


class _Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def web(tmp_path: Path) -> Iterator[tuple[Path, str]]:
    """A folder, and the address at which a web server shows it."""
    pytest.importorskip("fsspec")
    pytest.importorskip("aiohttp")
    folder = tmp_path / "web"
    folder.mkdir()
    handler = functools.partial(_Quiet, directory=str(folder))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_logs_on_a_web_server_are_found_by_its_pages_and_fetched_by_workers(
    tmp_path: Path, web: tuple[Path, str]
) -> None:
    folder, address = web
    for vehicle, name in (("ann", "f0.bin"), ("ann", "a name.bin"), ("bob", "f1.tlog")):
        flight(folder / vehicle / name, len(name))
    (folder / "readme.txt").write_text("no log")
    (folder / "bob" / "f2.bin.part").write_bytes(b"half of a log")
    by_path = audit([str(folder)], tmp_path / "by-path", Settings(jobs=1))
    by_url = audit([address], tmp_path / "by-url", Settings(jobs=1))
    assert [log.error for log in by_url.logs] == [None] * 3
    assert [log.path for log in by_url.logs] == [
        f"{address}/{name}" for name in ("ann/a%20name.bin", "ann/f0.bin", "bob/f1.tlog")
    ]
    for one, other in zip(by_path.logs, by_url.logs, strict=True):
        assert (one.verdict, one.sha256, one.channels) == (
            other.verdict,
            other.sha256,
            other.channels,
        )
    flight(folder / "ann" / "f0.bin", 77)  # another flight in its place
    os.utime(folder / "ann" / "f0.bin", (1e9, 1e9))
    again = audit([address], tmp_path / "by-url", Settings(jobs=1))
    assert query(tmp_path / "by-url", "SELECT analysed FROM runs ORDER BY run") == [(3,), (1,)]
    assert again.logs[1].sha256 != by_url.logs[1].sha256


def test_a_web_address_with_a_query_is_one_file_and_one_that_is_nowhere_is_one_line(
    web: tuple[Path, str],
) -> None:
    folder, address = web
    log = flight(folder / "f.bin", 1)
    (signed,) = discover([f"{address}/f.bin?signature=a[b]*c"])
    assert (signed.size, signed.stamp) == (log.stat().st_size, signed.stamp or "none")
    outcome = analyse_log(Task(path=signed.path, config=Config(), formats=()))
    assert outcome.sha256 == hashlib.sha256(log.read_bytes()).hexdigest()
    assert [found.path for found in discover([f"{address}/*.bin"])] == [f"{address}/f.bin"]
    with pytest.raises(FdilogError, match=r"nothing\.bin: no such file"):
        discover([f"{address}/nothing.bin"])
    gone = analyse_log(Task(path=f"{address}/gone.bin", config=Config(), formats=()))
    assert (gone.error_kind, gone.error.partition(",")[0]) == (
        "unreachable",
        "no such file or folder",
    )


@pytest.mark.filterwarnings("ignore")  # of the imitation's own libraries
def test_logs_in_an_object_store_are_known_again_by_their_tags(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    s3fs = pytest.importorskip("s3fs")
    moto = pytest.importorskip("moto.server")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    variables = {"ACCESS_KEY_ID": "any", "SECRET_ACCESS_KEY": "any", "DEFAULT_REGION": "us-east-1"}
    for name, value in (variables | {"ENDPOINT_URL": f"http://{host}:{port}"}).items():
        monkeypatch.setenv(f"AWS_{name}", value)
    store = s3fs.S3FileSystem()
    store.mkdir("fleet")
    logs = [flight(tmp_path / f"{k}.bin", k) for k in range(3)]
    for log, name in zip(logs, ("ann/f0.bin", "ann/f1.bin"), strict=False):
        store.put(str(log), f"fleet/{name}")
    store.pipe("fleet/readme.txt", b"no log")
    output = tmp_path / "out"
    for _ in range(2):
        done = run_audit("s3://fleet", "-o", output, "-j", "1")
        assert (done.returncode in {0, 1, 3}, "Traceback" in done.stderr) == (True, False)
    store.put(str(logs[2]), "fleet/ann/f0.bin")
    run_audit("s3://fleet/*/*.bin", "-o", output, "-j", "1")
    server.stop()
    expected = [hashlib.sha256(logs[k].read_bytes()).hexdigest() for k in (2, 1)]
    assert query(output, "SELECT path, sha256 FROM logs ORDER BY path") == [
        (f"s3://fleet/ann/f{k}.bin", sha256) for k, sha256 in enumerate(expected)
    ]
    assert query(output, "SELECT DISTINCT vehicle FROM logs") == [("ann",)]
    assert query(output, "SELECT analysed FROM runs ORDER BY run") == [(2,), (0,), (1,)]


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


def test_following_survives_whatever_is_done_to_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(following, "SETTLED_S", 0.2)
    monkeypatch.setattr(following, "POLL_S", 0.05)
    logs, output, away = tmp_path / "logs", tmp_path / "out", tmp_path / "away"
    contents = [flight(tmp_path / f"{k}.bin", k).read_bytes() for k in range(5)]
    logs.mkdir()
    (logs / "a.bin").write_bytes(contents[0])

    def hashes() -> dict[str, str]:
        rows = query(output, "SELECT path, sha256 FROM logs WHERE result IS NOT NULL")
        return {Path(path).name: sha256 for path, sha256 in rows}

    def until(name: str, content: bytes) -> Iterator[None]:
        while hashes().get(name) != hashlib.sha256(content).hexdigest():
            yield

    def script() -> Iterator[None]:
        yield from until("a.bin", contents[0])
        (logs / "b.bin.tmp").write_bytes(contents[1])  # a copy that is not complete yet
        yield from [None] * 10
        (logs / "b.bin.tmp").rename(logs / "b.bin")
        yield from until("b.bin", contents[1])
        (tmp_path / "2.bin").replace(logs / "a.bin")  # another in its place
        yield from until("a.bin", contents[2])
        with (logs / "b.bin").open("ab") as file:  # it goes on to grow
            file.write(contents[1][:5000])
        yield from until("b.bin", contents[1] + contents[1][:5000])
        logs.rename(away)  # the disk is away for a while
        yield from [None] * 5
        away.rename(logs)
        (logs / "a.bin").unlink()
        (logs / "c.bin").write_bytes(contents[3])
        yield from until("c.bin", contents[3])

    steps, deadline = script(), time.monotonic() + 60.0
    ended = object()

    def go_on() -> bool:
        return next(steps, ended) is not ended and time.monotonic() < deadline

    campaign = audit([str(logs)], output, Settings(jobs=1, formats=()), follow=go_on)
    assert next(steps, ended) is ended, "it did not get to the end"
    # What was seen stays in the campaign though it is gone: its answer was true of the flight.
    assert [Path(log.path).name for log in campaign.logs] == ["a.bin", "b.bin", "c.bin"]
    assert all(log.verdict for log in campaign.logs)
    assert query(output, "SELECT analysed FROM runs") == [(5,)]
