"""What a worker does: one log in, one plain outcome out, whatever the log is.

Nothing here knows of the store, the other logs or how many workers there are.
"""

from __future__ import annotations

import dataclasses
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from fdilog.analysis import Analysis, analyse
from fdilog.campaign.discovery import is_url, state_of
from fdilog.campaign.measures import Measure, measure
from fdilog.config import Config
from fdilog.errors import FdilogError, NoGyroError, UsageError
from fdilog.opening import Opened

ErrorKind = Literal[
    "unreadable", "no-gyro", "configuration", "internal",
    "unreachable", "changed", "memory", "died", "timeout",
]  # fmt: skip

LASTING: frozenset[ErrorKind] = frozenset(["unreadable", "no-gyro", "configuration"])
"""What the content itself brings about, and would again; the rest is tried again next time."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """One log to analyse, and which reports to make of it."""

    path: str
    config: Config
    formats: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one log.

    Parameters
    ----------
    json
        The JSON result; empty if there is none.
    reports
        File suffix to content.
    """

    sha256: str = ""
    error_kind: ErrorKind | None = None
    error: str = ""
    json: str = ""
    measures: tuple[Measure, ...] = ()
    reports: tuple[tuple[str, bytes], ...] = ()


def analyse_log(task: Task) -> Outcome:
    """Analyse one log; every failure that Python can see is an outcome, not an exception."""
    try:
        if is_url(task.path):
            from fdilog.campaign.remote import fetched

            with fetched(task.path) as local:
                return _outcome(task, local)
        return _outcome(task, Path(task.path))
    except MemoryError:
        return Outcome(error_kind="memory", error="not enough memory in a worker")
    except FdilogError as error:
        return Outcome(error_kind="unreachable", error=_plain(str(error), task.path))


def _outcome(task: Task, local: Path) -> Outcome:
    before = _state(local)
    sha256 = ""
    try:
        analysis = _renamed(analyse(local, task.config), task.path)
        sha256 = analysis.log.sha256 or digest(local)
        outcome = Outcome(
            sha256=sha256,
            json=analysis.to_json(),
            measures=measure(analysis),
            reports=_reports(analysis, task.formats),
        )
    except MemoryError:
        raise
    except OSError as error:
        return Outcome(error_kind="unreachable", error=(error.strerror or str(error)).lower())
    except Exception as error:  # noqa: BLE001  a log must not end the campaign
        try:
            sha256 = digest(local)
        except OSError as refused:
            reason = (refused.strerror or str(refused)).lower()
            return Outcome(error_kind="unreachable", error=reason)
        outcome = Outcome(
            sha256=sha256,
            error_kind=_kind(error),
            error=_plain(_plain(_words(error), str(local)), task.path),
        )
    if _state(local) != before:
        return Outcome(error_kind="changed", error="changed while it was read")
    return outcome


def _state(path: Path) -> tuple[int, str] | None:
    try:
        return state_of(path)
    except OSError:
        return None


def _renamed(analysis: Analysis, path: str) -> Analysis:
    if analysis.log.path == path:
        return analysis
    return dataclasses.replace(analysis, log=dataclasses.replace(analysis.log, path=path))


def _reports(analysis: Analysis, formats: tuple[str, ...]) -> tuple[tuple[str, bytes], ...]:
    from fdilog.registry import plugin

    made = []
    for name in formats:
        report: Any = plugin("reports", name)
        render = getattr(report, "render_shared", report.render)
        made.append((report.suffix, render(analysis).encode("utf-8")))
    return tuple(made)


def _kind(error: Exception) -> ErrorKind:
    if isinstance(error, NoGyroError):
        return "no-gyro"
    if isinstance(error, UsageError):
        return "configuration"
    return "unreadable" if isinstance(error, FdilogError) else "internal"


def _words(error: Exception) -> str:
    if isinstance(error, FdilogError):
        return str(error)
    last = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(last.filename).name}:{last.lineno}"
    return f"internal error, please report it: {type(error).__name__}: {error} ({place})"


def _plain(text: str, path: str) -> str:
    """Leave out the path that a reason begins with: the row that it stands in has it."""
    return text.removeprefix(f"{path}: ").replace(path, "the log")


def digest(path: str | Path) -> str:
    """SHA-256 of a log's content, as `analyse` gives it.

    Raises
    ------
    OSError
        If it cannot be read.
    """
    return Opened(named=Path(path), path=Path(path)).sha256
