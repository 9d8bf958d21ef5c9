"""What tests of campaigns share: short flights, an audit as a process, a look into its store."""

from __future__ import annotations

import dataclasses
import os
import sqlite3
import subprocess
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from fdilog.experiments.faults import Fault
from fdilog.experiments.simulate import simulate
from fdilog.writing import write

ROOT = Path(__file__).parents[1]

READER = """
import os, signal, time

suffixes = (".misbehave",)
description = "logs that say what reading them does"

def sniff(head):
    return head.startswith(b"MISBEHAVE ")

def read(path, also=()):
    what = path.read_bytes().split()[1].decode()
    if what == "hang":
        time.sleep(1e6)
    if what == "eat":
        hoard = []
        while True:
            hoard.append(bytearray(64 << 20))
    if what == "bug":
        raise ZeroDivisionError("a bug in a reader")
    if what == "exit":
        os._exit(7)
    os.kill(os.getpid(), getattr(signal, what))
"""

ENTRY_POINT = """
[fdilog.readers]
misbehave = misbehave
"""


def flight(path: Path, seed: int, *, faults: Sequence[Fault] = (), **vehicle: str) -> Path:
    """Write a short flight with two aligned IMUs; it takes a fraction of a second to analyse."""
    path.parent.mkdir(parents=True, exist_ok=True)
    recording = simulate(12.0, 25.0, sources=2, seed=seed, faults=faults).recording()
    if vehicle:
        recording = dataclasses.replace(recording, vehicle=vehicle)
    write(recording, path)
    return path


def audit_command(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "fdilog", "audit", *map(str, arguments)]


def environment(*folders: Path) -> dict[str, str]:
    places = [*map(str, folders), str(ROOT), str(ROOT / "readers"), str(ROOT / "reports")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(places)}


def run_audit(
    *arguments: str | Path, plugins: Sequence[Path] = (), cwd: Path | None = None
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        audit_command(*arguments),
        env=environment(*plugins),
        cwd=cwd,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=120,
        check=False,
    )


def tables(output: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Every table but that of runs, rows in an order of their own."""
    with sqlite3.connect(output / "audit.sqlite") as db:
        names = [
            row[0] for row in db.execute("SELECT name FROM sqlite_master WHERE type = 'table'")
        ]
        assert db.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return {
            name: sorted(db.execute(f"SELECT * FROM {name}").fetchall(), key=repr)  # noqa: S608
            for name in names
            if name != "runs"
        }


def query(output: Path, text: str) -> list[tuple[Any, ...]]:
    with sqlite3.connect(output / "audit.sqlite") as db:
        return db.execute(text).fetchall()


def stamp(path: Path, day: str) -> None:
    moment = datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp()
    os.utime(path, (moment, moment))
