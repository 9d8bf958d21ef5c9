"""The audit of a campaign: find, skip what is known, analyse the rest, keep it, sum up."""

from __future__ import annotations

import json
import os
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePath
from typing import Any, Protocol

from fdilog.campaign.discovery import Candidate, discover
from fdilog.campaign.execution import Lost, run
from fdilog.campaign.following import follow_logs
from fdilog.campaign.identity import vehicle_of
from fdilog.campaign.lanes import Lane, WorkerLane, machine_memory_bytes
from fdilog.campaign.store import Store, result_id
from fdilog.campaign.summary import Campaign, summarise
from fdilog.campaign.work import LASTING, Outcome, Task, analyse_log, digest
from fdilog.config import Config
from fdilog.errors import FdilogError, UsageError

LOGS = "logs"
"""Folder of the reports of single logs, in the folder of the audit."""
TIMEOUT_S = 600.0
"""The largest logs are read within a minute; ten leave room for a slow disk."""
MEMORY_SHARE = 0.8
"""Of the machine's memory, divided among the workers; the rest is the parent's and the system's."""
LONGEST_STEM = 60


class Progress(Protocol):
    """Somebody who is told how far it has come."""

    def begin(self, logs: int, reused: int, where: str) -> None:
        """Be told how many logs are to be done now, how many were done before, and by whom."""

    def done(self, path: str, state: str, words: str) -> None:
        """Be told of one log."""

    def end(self) -> None:
        """Be told that this was all."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """How an audit is done.

    Parameters
    ----------
    jobs
        Worker processes; 0 for as many as there are cores to use.
    memory_bytes
        What a worker may take; None for its share of the machine's, 0 for no limit.
    formats
        Which reports to make of each log.
    """

    config: Config = field(default_factory=Config)
    jobs: int = 0
    cluster: str = ""
    timeout_s: float = TIMEOUT_S
    memory_bytes: int | None = None
    fresh: bool = False
    formats: tuple[str, ...] = ("html", "md", "json")

    @property
    def workers(self) -> int:
        """Worker processes on this machine."""
        if self.jobs:
            return self.jobs
        try:
            return len(os.sched_getaffinity(0))
        except AttributeError:  # systems that do not tell
            return os.cpu_count() or 1

    @property
    def worker_bytes(self) -> int:
        """What the data of one worker on this machine may take; 0 for no limit."""
        if self.memory_bytes is not None:
            return self.memory_bytes
        return int(MEMORY_SHARE * machine_memory_bytes() / self.workers)

    @property
    def where(self) -> str:
        """Who does the work, and what each may take."""
        if self.cluster:
            return f"on {self.cluster}"
        number = f"{self.workers} worker{'s' * (self.workers != 1)}"
        if not self.worker_bytes:
            return f"{number} with no limit of memory"
        return f"{number} of at most {self.worker_bytes / 1e9:.3g} GB"


def audit(
    targets: Sequence[str],
    output: str | Path,
    settings: Settings | None = None,
    progress: Progress | None = None,
    *,
    follow: Callable[[], bool] | None = None,
) -> Campaign:
    """Analyse every log that the arguments name, and write the campaign's reports.

    What is known from an earlier audit in the same folder is not done again.

    Parameters
    ----------
    targets
        Folders, patterns, files or URLs.
    output
        Folder of ``audit.sqlite``, of the campaign's reports and of those of single logs.
    follow
        Asked again and again whether to go on looking for new logs; None: look once.

    Raises
    ------
    UsageError
        If an argument names nothing, or no log is found.
    FdilogError
        If the output cannot be written, or no worker can be had. What was done is kept.
    """
    output, settings = Path(output), settings or Settings()
    candidates = discover(targets, output)
    if not candidates and follow is None:
        raise UsageError(f"{', '.join(targets)}: no log found")
    store = Store(output)
    try:
        store.begin(targets, settings.config.sha256)
        work = _Work(store, settings, progress)
        share(output / LOGS, settings.formats)
        if follow is None:
            store.list_only(candidates)
            work.do(candidates)
        else:
            follow_logs(
                targets, store, work.do, lambda: write_reports(store, settings.config), follow
            )
        store.finish()
        return write_reports(store, settings.config)
    finally:
        store.close()


class _Work:
    """Does candidates, and keeps what becomes of them."""

    def __init__(self, store: Store, settings: Settings, progress: Progress | None) -> None:
        self.store = store
        self.settings = settings
        self.progress = progress
        self.config_sha256 = settings.config.sha256

    def do(self, candidates: Sequence[Candidate]) -> None:
        """Give every candidate its row: from before, from its content, or from a worker."""
        self.store.count(logs=len(candidates))
        pending = self._not_known_by_path(candidates)
        groups = self._by_content(pending)
        refused = sum(candidate.error is not None for candidate in candidates)
        reused = len(candidates) - len(pending) - refused
        shared: dict[str, list[Candidate]] = {}
        for key, group in groups.items():
            known = key if self._whole_result(key) else ""
            if known:
                for candidate in group:
                    self._assign(candidate, known)
                reused += len(group)
            else:
                shared[key] = group
        self.store.count(reused=reused)
        leaders = sorted(shared.values(), key=lambda group: (-group[0].size, group[0].key))
        if self.progress is not None:
            self.progress.begin(sum(map(len, leaders)), reused, self.settings.where)
        self._analyse(leaders)
        if self.progress is not None:
            self.progress.end()

    def _not_known_by_path(self, candidates: Sequence[Candidate]) -> list[Candidate]:
        """Leave out logs whose file is as it was when it was analysed."""
        known = self.store.known()
        self._reports = self.store.reports()
        self._sha256: dict[str, str] = {}
        pending = []
        for candidate in candidates:
            row = known.get(candidate.key)
            if candidate.error is not None:
                vehicle = vehicle_of({}, candidate.path, candidate.root)
                self.store.refuse([(candidate, vehicle)], "unreachable", candidate.error)
                continue
            state = (candidate.size, candidate.stamp)
            # Without a stamp nobody can tell: some servers say neither a tag nor a time.
            told = bool(candidate.stamp)
            as_it_was = row is not None and told and (row["bytes"], row["stamp"]) == state
            if row is not None and as_it_was and row["sha256"]:
                self._sha256[candidate.path] = row["sha256"]
                result = result_id(row["sha256"], self.config_sha256)
                if row["result"] == result and self._whole_result(result):
                    if row["vehicle_from"] == "folder":
                        self._assign(candidate, result)
                    continue
            pending.append(candidate)
        return pending

    def _whole_result(self, result: str) -> bool:
        """Whether a result is known, with all reports that are asked for, and these are there."""
        if self.settings.fresh or result not in self._reports:
            return False
        made = self._reports[result]
        # What could not be analysed has none.
        if made and not all(any(name.endswith(s) for name in made) for s in self._suffixes):
            return False
        return all((self.store.folder / name).is_file() for name in made)

    @cached_property
    def _suffixes(self) -> list[str]:
        """How the names of the reports end that are asked for."""
        from fdilog.registry import plugin

        return [plugin("reports", name).suffix for name in self.settings.formats]

    def _by_content(self, pending: Sequence[Candidate]) -> dict[str, list[Candidate]]:
        """Group logs by the result that they will have; what may be unique is not hashed here."""
        sizes: dict[int, int] = defaultdict(int)
        for candidate in pending:
            sizes[candidate.size] += 1
        for size in self.store.sizes():
            sizes[size] += 1
        doubtful = [
            each
            for each in pending
            if each.path not in self._sha256 and not each.remote and sizes[each.size] > 1
        ]
        with ThreadPoolExecutor(self.settings.workers) as pool:
            for candidate, sha256 in zip(doubtful, pool.map(_digest, doubtful), strict=True):
                if sha256:
                    self._sha256[candidate.path] = sha256
        groups: dict[str, list[Candidate]] = defaultdict(list)
        for candidate in pending:
            known = self._sha256.get(candidate.path)
            key = result_id(known, self.config_sha256) if known else candidate.path
            groups[key].append(candidate)
        return groups

    def _assign(self, candidate: Candidate, result: str) -> None:
        vehicle = vehicle_of(self.store.facts(result), candidate.path, candidate.root)
        self.store.assign(candidate, self._sha256[candidate.path], result, vehicle)

    def _analyse(self, groups: Sequence[Sequence[Candidate]]) -> None:
        """Hand the first of each group to a worker; the others share its outcome."""
        if not groups:
            return
        tasks = [
            Task(path=group[0].path, config=self.settings.config, formats=self.settings.formats)
            for group in groups
        ]
        of = {task.path: group for task, group in zip(tasks, groups, strict=True)}
        with self._lanes(len(tasks)) as lanes:
            for task, outcome in run(analyse_log, tasks, lanes, self.settings.timeout_s):
                self._keep(of[task.path], outcome)

    @contextmanager
    def _lanes(self, tasks: int) -> Iterator[Sequence[Lane]]:
        settings = self.settings
        lanes: list[Lane] = []
        now = True
        try:
            if settings.cluster:
                lanes.append(_cluster(settings.cluster))
            else:
                memory = settings.worker_bytes
                lanes += [WorkerLane(memory) for _ in range(min(settings.workers, tasks))]
            yield lanes
            now = False
        finally:
            for lane in lanes:
                lane.close(now=now)

    def _keep(self, group: Sequence[Candidate], outcome: Outcome | Lost) -> None:
        """Keep what became of a content for all logs that hold it."""
        if isinstance(outcome, Lost):
            kind = "timeout" if outcome.timeout else "died"
            outcome = Outcome(error_kind=kind, error=outcome.reason)  # type: ignore[arg-type]
        found: Mapping[str, Any] = json.loads(outcome.json) if outcome.json else {}
        facts = found.get("log", {}).get("vehicle") or {}
        owners = [(each, vehicle_of(facts, each.path, each.root)) for each in group]
        if outcome.error_kind is not None and outcome.error_kind not in LASTING:
            self.store.refuse(owners, outcome.error_kind, outcome.error, analysed=1)
        else:
            result = result_id(outcome.sha256, self.config_sha256)
            names = self._write(group[0].path, result, outcome)
            self.store.record(outcome, self.config_sha256, owners, names)
        if self.progress is not None:
            state, words = _words(outcome)
            for candidate in group:
                self.progress.done(candidate.path, state, words)

    def _write(self, path: str, result: str, outcome: Outcome) -> list[str]:
        """Write the reports of one log, before the row that names them."""
        stem = re.sub(r"[^A-Za-z0-9._-]+", "_", PurePath(path).stem).strip("._")
        names = []
        for suffix, content in outcome.reports:
            name = f"{LOGS}/{stem[:LONGEST_STEM] or 'log'}-{result[:10]}{suffix}"
            write_whole(self.store.folder / name, content)
            names.append(name)
        return names


def _cluster(address: str) -> Lane:
    try:
        from fdilog.campaign.cluster import ClusterLane
    except ImportError:
        raise UsageError(
            "--cluster needs dask.distributed: pip install 'fdilog[cluster]'"
        ) from None
    return ClusterLane(address)


def _digest(candidate: Candidate) -> str:
    try:
        return digest(candidate.path)
    except OSError:
        return ""  # the worker will say why


def _words(outcome: Outcome) -> tuple[str, str]:
    """Say in a few words what became of a log."""
    if outcome.error_kind is not None:
        return "not analysed", f"{outcome.error_kind}: {outcome.error}"
    found = json.loads(outcome.json)
    kinds: dict[str, set[str]] = defaultdict(set)
    for finding in found["findings"]:
        kinds[finding["kind"]].update(finding["suspects"])
    return found["verdict"], "; ".join(
        f"{kind} of {', '.join(sorted(names))}" for kind, names in sorted(kinds.items())
    )


def write_reports(store: Store, config: Config) -> Campaign:
    """Write every installed campaign report; a reader never sees half of one."""
    from fdilog.registry import plugins

    campaign = summarise(store, config)
    for report in plugins("campaign_reports").values():
        write_whole(store.folder / report.file_name, report.render(campaign).encode("utf-8"))
    return campaign


def share(folder: Path, formats: Sequence[str]) -> None:
    """Write the files that the reports of many logs share, once for all of them."""
    from fdilog.registry import plugin

    for name in formats:
        for file_name, text in getattr(plugin("reports", name), "shared_files", dict)().items():
            content = text.encode("utf-8")
            path = folder / file_name
            if not path.is_file() or path.read_bytes() != content:
                write_whole(path, content)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is there whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FdilogError(f"{path}: cannot write: {reason}") from error
