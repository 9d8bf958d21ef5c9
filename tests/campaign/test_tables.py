"""The tables of an audit are what the guide says, for whoever opens them with other tools."""

from __future__ import annotations

import json
import re
import sqlite3
import textwrap
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fdilog.campaign.audit import Settings, audit
from fdilog.campaign.discovery import Candidate
from fdilog.campaign.measures import Measure
from fdilog.campaign.store import Store
from fdilog.campaign.work import Outcome
from tests.campaign_logs import ROOT, query

GUIDE = ROOT / "docs" / "audit.md"


@pytest.fixture(scope="module")
def audited(tmp_path_factory: pytest.TempPathFactory, good_logs: Path) -> Path:
    folder = tmp_path_factory.mktemp("tables")
    logs = folder / "flights"
    logs.symlink_to(good_logs)
    (folder / "empty.bin").touch()
    audit([str(logs), str(folder / "empty.bin")], folder / "audit", Settings(jobs=1, formats=()))
    return folder / "audit"


def test_every_view_of_the_guide_opens_in_pandas(audited: Path) -> None:
    table = GUIDE.read_text("utf-8").split("| view |")[1].split("\n\n")[0]
    views = re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)
    with sqlite3.connect(audited / "audit.sqlite") as db:
        frames = {view: pd.read_sql(f"SELECT * FROM {view}", db) for view in views}  # noqa: S608
    assert set(frames) == {"flights", "accusations", "vehicle_channels", "sensor_history"}
    flights = frames["flights"].set_index("path")
    assert len(flights) == 9
    assert flights.verdict.notna().sum() == 8
    assert flights.error.dropna().tolist() == ["the file is empty"]
    assert flights.duration_s.dtype == float
    accused = frames["accusations"]
    assert set(accused.channel) == {"imu1.y"}
    assert accused.path.str.endswith("dead.bin").all()
    failures = frames["vehicle_channels"].query("failed > 0")
    assert failures.channel.tolist() == ["imu1.y"]
    assert failures.vehicle.str.startswith("Board ").all()
    history = frames["sensor_history"]
    assert (history.low_rad_s <= history.estimate_rad_s).all()
    assert (history.estimate_rad_s <= history.high_rad_s).all()
    assert not history.duplicated(["vehicle", "channel", "quantity", "path"]).any()


def test_the_lines_for_pandas_run(audited: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(audited.parent)
    seen: dict[str, Any] = {}
    exec(lines_after("With pandas:"), seen)  # noqa: S102  our own guide
    assert len(seen["history"])
    assert set(seen["history"].quantity) == {"bias"}


def test_the_lines_for_duckdb_run(audited: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("duckdb")
    monkeypatch.chdir(audited.parent)
    seen: dict[str, Any] = {"sqlite3": sqlite3, "pd": pd}
    code = lines_after("With DuckDB, over the same frames:")
    exec(code.replace("duckdb.sql", "failures = duckdb.sql"), seen)  # noqa: S102
    ((_, channel, failed, _),) = seen["failures"].fetchall()
    assert (channel, failed) == ("imu1.y", 1)


def lines_after(words: str) -> str:
    """Return the example of the guide that follows these words."""
    example = GUIDE.read_text("utf-8").split(f"{words}\n\n")[1]
    return textwrap.dedent(re.split(r"\n\n(?! )", example)[0])


def test_the_query_for_an_attached_file_is_one_that_the_tables_answer(audited: Path) -> None:
    select = re.search(r"SELECT .*::INTEGER > 0;", GUIDE.read_text("utf-8"))
    assert select is not None
    plain = select[0].replace("a.vehicle_channels", "vehicle_channels").replace("::INTEGER", "")
    assert [row[1:] for row in query(audited, plain)] == [("imu1.y", 1)]


def test_a_sensor_that_is_logged_twice_has_one_history(tmp_path: Path) -> None:
    source = {"topic": "t", "reason": "", "rate_hz": 1.0, "samples": 9, "derived": False}
    channel = {"name": "imu0.x", "source": "imu0", "status": "healthy", "derived": False}
    found = {
        "log": {"vehicle": {"INS_GYR_ID": "7"}, "start_utc": "2024-01-01T00:00:00Z"},
        "sources": [{**source, "name": "imu0", "used": used} for used in (False, True)],
        "table": {"channels": [channel]},
        "verdict": "healthy",
        "findings": [],
    }
    measure = Measure(channel="imu0.x", quantity="bias", estimate=0.1, low=0.0, high=0.2)
    store = Store(tmp_path)
    candidate = Candidate(path="a.ulg", root=".")
    store.begin(["."], "0" * 64)
    store.list_only([candidate])
    outcome = Outcome(sha256="1" * 64, json=json.dumps(found), measures=(measure,))
    store.record(outcome, "0" * 64, [(candidate, ("ann", "folder"))], [])
    rows = store.rows("SELECT device_id, path, estimate_rad_s FROM sensor_history")
    store.close()
    assert [tuple(row) for row in rows] == [("7", "a.ulg", 0.1)]
