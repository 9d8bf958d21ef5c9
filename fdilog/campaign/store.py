"""The results of a campaign: one SQLite file, written by the parent alone.

Every outcome is one transaction in a write-ahead log, so that an audit which is killed loses what
was in flight and nothing else. A result is kept by its content, configuration and version; no
number in the file depends on the order in which logs were done.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from importlib.resources import files
from pathlib import Path
from typing import Any

import fdilog
from fdilog.campaign.discovery import RESULTS, Candidate
from fdilog.campaign.identity import sensor_ids
from fdilog.campaign.measures import Measure
from fdilog.campaign.work import Outcome
from fdilog.errors import FdilogError

FILE = RESULTS
SCHEMA_NUMBER = 1
APPLICATION_ID = 0x66646C67  # "fdlg": tells our files from other databases
LOCK = ".lock"


class Store:
    """The results store of one output folder; nobody else writes while it is open.

    Raises
    ------
    FdilogError
        If the folder cannot be written, the file is not one of ours, or another audit is at work.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FdilogError(f"{folder}: {(error.strerror or str(error)).lower()}") from error
        with self._one_line():
            self._lock = _locked(folder)
            self._db = sqlite3.connect(folder / FILE, isolation_level=None)
            self._db.execute("PRAGMA foreign_keys = ON")
            self._db.execute("PRAGMA journal_mode = WAL")
            # A killed process loses nothing; a power cut may lose the last results, never the file.
            self._db.execute("PRAGMA synchronous = NORMAL")
            self._create()
        self.run = 0

    def _create(self) -> None:
        number = self._db.execute("PRAGMA user_version").fetchone()[0]
        if number == SCHEMA_NUMBER:
            return
        if number or self._db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            raise FdilogError(
                f"{self.folder / FILE}: not a store of this version of fdilog; choose another -o"
            )
        text = files("fdilog.campaign").joinpath("schema.sql").read_text("utf-8")
        self._db.executescript(
            f"BEGIN; {text} PRAGMA application_id = {APPLICATION_ID};"
            f" PRAGMA user_version = {SCHEMA_NUMBER}; COMMIT;"
        )

    @contextmanager
    def _one_line(self) -> Iterator[None]:
        """Say in one line what is wrong with the file or its disk."""
        try:
            yield
        except sqlite3.Error as error:
            raise FdilogError(f"{self.folder / FILE}: {error}") from error

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._one_line():
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
            except BaseException:
                self._db.execute("ROLLBACK")
                raise
            self._db.execute("COMMIT")

    def close(self) -> None:
        """Fold the write-ahead log into the file, and let others write."""
        with self._one_line():
            self._db.execute("PRAGMA optimize")
            self._db.close()
            self._lock.close()

    def begin(self, targets: Sequence[str], config_sha256: str) -> None:
        """Open a run."""
        with self._transaction() as db:
            cursor = db.execute(
                "INSERT INTO runs (started_utc, fdilog_version, config_sha256, targets, logs,"
                " analysed, reused) VALUES (?, ?, ?, ?, 0, 0, 0)",
                (_now(), fdilog.__version__, config_sha256, json.dumps(list(targets))),
            )
            self.run = cursor.lastrowid or 0

    def count(self, **counts: int) -> None:
        """Add to the counts of this run."""
        with self._transaction() as db:
            self._count(db, **counts)

    def _count(self, db: sqlite3.Connection, **counts: int) -> None:
        for name, number in counts.items():
            db.execute(
                f"UPDATE runs SET {name} = {name} + ? WHERE run = ?",  # noqa: S608  our names
                (number, self.run),
            )

    def finish(self) -> None:
        """Close the run."""
        with self._transaction() as db:
            db.execute("UPDATE runs SET finished_utc = ? WHERE run = ?", (_now(), self.run))

    def known(self) -> dict[bytes, sqlite3.Row]:
        """Return the rows of logs by their paths, as they stand."""
        with self._one_line():
            cursor = self._db.execute("SELECT * FROM logs")
            cursor.row_factory = sqlite3.Row
            return {row["path_raw"]: row for row in cursor}

    def sizes(self) -> set[int]:
        """Return the sizes of the logs that have a result of any configuration."""
        with self._one_line():
            return {row[0] for row in self._db.execute("SELECT DISTINCT bytes FROM results")}

    def reports(self) -> dict[str, list[str]]:
        """Return the report files of every result that there is."""
        with self._one_line():
            rows = self._db.execute("SELECT result, reports FROM results").fetchall()
        return {result: json.loads(reports or "[]") for result, reports in rows}

    def facts(self, result: str) -> dict[str, str]:
        """Return what the log of a result says of the vehicle."""
        with self._one_line():
            rows = self._db.execute("SELECT name, value FROM facts WHERE result = ?", (result,))
            return dict(rows.fetchall())

    def list_only(self, candidates: Iterable[Candidate]) -> None:
        """Make these the logs of the campaign; those that were not before have no result yet."""
        with self._transaction() as db:
            db.execute("UPDATE logs SET listed = 0")
            self._list(db, candidates)

    def list_more(self, candidates: Iterable[Candidate]) -> None:
        """Add logs to the campaign."""
        with self._transaction() as db:
            self._list(db, candidates)

    @staticmethod
    def _list(db: sqlite3.Connection, candidates: Iterable[Candidate]) -> None:
        db.executemany(
            "INSERT INTO logs (path_raw, path, listed, bytes, stamp) VALUES (?, ?, 1, ?, '')"
            " ON CONFLICT (path_raw) DO UPDATE SET listed = 1",
            [(each.key, text_of(each.path), each.size) for each in candidates],
        )

    def assign(
        self, candidate: Candidate, sha256: str, result: str, vehicle: tuple[str, str]
    ) -> None:
        """Point a log at a result that is known already."""
        with self._transaction() as db:
            _assign(db, candidate, sha256=sha256, result=result, vehicle=vehicle)

    def refuse(
        self,
        owners: Sequence[tuple[Candidate, tuple[str, str]]],
        kind: str,
        reason: str,
        *,
        analysed: int = 0,
    ) -> None:
        """Give logs their reason in place of a result, all or none; and count the analyses."""
        with self._transaction() as db:
            for candidate, vehicle in owners:
                _assign(db, candidate, error_kind=kind, error=reason, vehicle=vehicle)
            self._count(db, analysed=analysed)

    def record(
        self,
        outcome: Outcome,
        config_sha256: str,
        owners: Sequence[tuple[Candidate, tuple[str, str]]],
        reports: Sequence[str],
    ) -> str:
        """Keep the result of a content, point the logs that hold it at it, and count it.

        All or nothing.
        """
        result = result_id(outcome.sha256, config_sha256)
        with self._transaction() as db:
            for table in _CHILDREN:
                db.execute(f"DELETE FROM {table} WHERE result = ?", (result,))  # noqa: S608
            row = {
                "result": result,
                "log_sha256": outcome.sha256,
                "config_sha256": config_sha256,
                "fdilog_version": fdilog.__version__,
                "bytes": owners[0][0].size,
                "reports": json.dumps(list(reports)),
            }
            _insert_result(db, row, outcome)
            for candidate, vehicle in owners:
                _assign(db, candidate, sha256=outcome.sha256, result=result, vehicle=vehicle)
            self._count(db, analysed=1)
        return result

    def rows(self, query: str) -> list[sqlite3.Row]:
        """Return the rows of a query."""
        with self._one_line():
            cursor = self._db.execute(query)
            cursor.row_factory = sqlite3.Row
            return cursor.fetchall()


def result_id(log_sha256: str, config_sha256: str) -> str:
    """Name a result by what it depends on: content, configuration, version."""
    text = f"{log_sha256} {config_sha256} {fdilog.__version__}"
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def text_of(path: str) -> str:
    r"""Return a path as text that any database can hold; a byte that is not UTF-8 as ``\xff``."""
    return os.fsencode(path).decode("utf-8", "backslashreplace")


def _locked(folder: Path) -> sqlite3.Connection:
    """Take what only one process can hold, and which its death gives back, on any system."""
    lock = sqlite3.connect(folder / LOCK, timeout=0.0, isolation_level=None)
    try:
        lock.execute("BEGIN EXCLUSIVE")
    except sqlite3.OperationalError as error:
        lock.close()
        if "locked" not in str(error):
            raise
        raise FdilogError(f"{folder}: another audit is at work in it") from None
    return lock


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def _assign(
    db: sqlite3.Connection,
    candidate: Candidate,
    *,
    vehicle: tuple[str, str],
    sha256: str | None = None,
    result: str | None = None,
    error_kind: str | None = None,
    error: str | None = None,
) -> None:
    db.execute(
        "UPDATE logs SET bytes = ?, stamp = ?, sha256 = ?, result = ?, error_kind = ?, error = ?,"
        " vehicle = ?, vehicle_from = ? WHERE path_raw = ?",
        (
            candidate.size,
            candidate.stamp,
            sha256,
            result,
            error_kind,
            None if error is None else text_of(error),
            text_of(vehicle[0]),
            vehicle[1],
            candidate.key,
        ),
    )


_CHILDREN = ("facts", "sources", "channels", "measures", "findings", "problems")


def _insert_result(db: sqlite3.Connection, row: Mapping[str, Any], outcome: Outcome) -> None:
    found: Mapping[str, Any] = json.loads(outcome.json) if outcome.json else {}
    log, lost = found.get("log", {}), found.get("completeness", {})
    table = found.get("table", {})
    own = {
        "verdict": found.get("verdict"),
        "error_kind": outcome.error_kind,
        "error": outcome.error or None,
        "format": log.get("format"),
        "start_utc": log.get("start_utc"),
        "duration_s": log.get("duration_s"),
        "samples": table.get("samples"),
        "rate_hz": table.get("rate_hz"),
        "whole": lost.get("whole"),
        "bytes_lost": lost.get("bytes_lost"),
        "seconds_lost": lost.get("seconds_lost"),
    }
    _insert(db, "results", {**row, **own})
    key = {"result": row["result"]}
    facts = {str(name): str(value) for name, value in (log.get("vehicle") or {}).items()}
    for name, value in facts.items():
        _insert(db, "facts", {**key, "name": name, "value": value})
    for measure in outcome.measures:
        _insert(db, "measures", {**key, **_measure(measure)})
    ids = sensor_ids(facts)
    children: dict[str, list[dict[str, Any]]] = {
        "sources": [
            _chosen(source, _SOURCE) | {"device_id": ids.get(source["name"])}
            for source in found.get("sources", ())
        ],
        "channels": [_chosen(channel, _CHANNEL) for channel in table.get("channels", ())],
        "findings": [_finding(finding) for finding in found.get("findings", ())],
        "problems": [_chosen(problem, _PROBLEM) for problem in lost.get("problems", ())],
    }
    for name, rows in children.items():
        for position, values in enumerate(rows):
            _insert(db, name, {**key, "position": position, **values})


_SOURCE = ("name", "topic", "used", "reason", "rate_hz", "samples", "derived")
_CHANNEL = ("name", "source", "status", "rate_hz", "samples", "sigma_rad_s", "derived")
_PROBLEM = ("offset", "what", "bytes", "seconds", "note")


def _chosen(values: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    return {key: values.get(key) for key in keys}


def _measure(measure: Measure) -> dict[str, Any]:
    return {
        "channel": measure.channel,
        "quantity": measure.quantity,
        "estimate_rad_s": measure.estimate,
        "low_rad_s": measure.low,
        "high_rad_s": measure.high,
    }


def _finding(finding: Mapping[str, Any]) -> dict[str, Any]:
    size = finding.get("size") or {}
    guaranteed = finding.get("guaranteed") or {}
    return {
        "kind": finding["kind"],
        "suspects": json.dumps(finding["suspects"]),
        "isolated": finding["isolated"],
        "start_s": finding["start_s"],
        "end_s": finding["end_s"],
        "size": size.get("estimate"),
        "size_low": size.get("low"),
        "size_high": size.get("high"),
        "confidence": size.get("confidence"),
        "unit": size.get("unit"),
        "guaranteed_low_rad_s": guaranteed.get("low"),
        "guaranteed_high_rad_s": guaranteed.get("high"),
        "detectors": json.dumps(finding["detectors"]),
        "dissent": json.dumps(finding["dissent"]),
        "witness": finding["witness"],
        "detail": finding["detail"],
    }


def _insert(db: sqlite3.Connection, table: str, values: Mapping[str, Any]) -> None:
    places = ", ".join("?" * len(values))
    db.execute(
        f"INSERT OR REPLACE INTO {table} ({', '.join(values)}) VALUES ({places})",  # noqa: S608
        [_storable(value) for value in values.values()],
    )


def _storable(value: Any) -> Any:
    """Text that SQLite can hold; an offset beyond 64 bits is none."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        return None
    return value
