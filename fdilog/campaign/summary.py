"""The campaign's answer, read from the store: logs, vehicles by channel, sensors over time."""

from __future__ import annotations

import dataclasses
import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np

import fdilog
from fdilog.campaign.trend import Trend, holm, trend
from fdilog.config import Config
from fdilog.finding import Finding, Interval, Size

if TYPE_CHECKING:
    from fdilog.campaign.store import Store

SCHEMA = "fdilog-audit/1"
VERDICTS = ("failed", "undecided", "insufficient", "healthy")
NOT_ANALYSED = "not analysed"
SECONDS_PER_DAY = 86400.0


@dataclass(frozen=True, kw_only=True)
class LogEntry:
    """One log of the campaign; without a verdict it has its reason.

    Parameters
    ----------
    channels
        Names and what became of them.
    derived
        Names of those that are no gyro's, but witnesses.
    """

    path: str
    bytes: int
    sha256: str | None
    vehicle: str
    vehicle_from: str
    verdict: str | None
    error_kind: str | None = None
    error: str | None = None
    format: str | None = None
    start_utc: str | None = None
    duration_s: float | None = None
    whole: bool = True
    bytes_lost: int = 0
    seconds_lost: float = 0.0
    channels: tuple[tuple[str, str], ...] = ()
    derived: frozenset[str] = frozenset()
    findings: tuple[Finding, ...] = ()
    reports: tuple[str, ...] = ()

    @property
    def state(self) -> str:
        """The verdict, or that there is none."""
        return self.verdict or NOT_ANALYSED


@dataclass(frozen=True, kw_only=True)
class Cell:
    """How one channel of one vehicle did, in numbers of flights."""

    vehicle: str
    channel: str
    flights: int
    failed: int
    suspect: int
    undecided: int
    healthy: int
    insufficient: int


@dataclass(frozen=True, kw_only=True)
class Point:
    """One flight in a series. [rad/s]"""

    path: str
    start_utc: str | None
    estimate: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Series:
    """Bias or noise of one channel over the flights of a vehicle.

    Parameters
    ----------
    dated
        Whether the flights are in the order of their dates; else in the order of their paths, since
        the logs tell no date, and the trend is per flight, not per day.
    undated
        Flights left out because they alone tell no date.
    """

    vehicle: str
    sensor: str
    device_id: str | None
    channel: str
    quantity: str
    dated: bool
    undated: int
    points: tuple[Point, ...]
    trend: Trend | None


@dataclass(frozen=True, kw_only=True)
class Campaign:
    """Everything that a campaign report prints; logs in the order of their paths."""

    config: Config
    logs: tuple[LogEntry, ...]
    cells: tuple[Cell, ...]
    series: tuple[Series, ...]
    version: str = fdilog.__version__

    @property
    def counts(self) -> dict[str, int]:
        """Logs by verdict, and those without."""
        found = Counter(log.state for log in self.logs)
        return {state: found[state] for state in (*VERDICTS, NOT_ANALYSED)}

    @property
    def flights(self) -> tuple[LogEntry, ...]:
        """Logs with a verdict; what a vehicle has twice, under two names, is there once."""
        once = {(log.vehicle, log.sha256 or log.path): log for log in self.logs if log.verdict}
        return tuple(once.values())

    @property
    def drifting(self) -> tuple[Series, ...]:
        """Series that move in one direction more than chance explains, the surest first."""
        moving = [series for series in self.series if series.trend and series.trend.drifts]
        return tuple(sorted(moving, key=lambda series: series.trend.p_value if series.trend else 1))


def summarise(store: Store, config: Config) -> Campaign:
    """Read the campaign of the latest run."""
    return Campaign(
        config=config,
        logs=tuple(_logs(store)),
        cells=tuple(Cell(**dict(row)) for row in store.rows("SELECT * FROM vehicle_channels")),
        series=_series(store),
    )


def _logs(store: Store) -> Iterator[LogEntry]:
    channels: dict[str, list[tuple[str, str]]] = defaultdict(list)
    derived: dict[str, set[str]] = defaultdict(set)
    for row in store.rows("SELECT * FROM channels ORDER BY result, position"):
        channels[row["result"]].append((row["name"], row["status"]))
        if row["derived"]:
            derived[row["result"]].add(row["name"])
    findings: dict[str, list[Finding]] = defaultdict(list)
    for row in store.rows("SELECT * FROM findings ORDER BY result, position"):
        findings[row["result"]].append(_finding(row))
    for row in store.rows("SELECT * FROM flights ORDER BY CAST(path AS BLOB)"):
        result = row["result"]
        yield LogEntry(
            path=row["path"],
            bytes=row["bytes"],
            sha256=row["sha256"],
            vehicle=row["vehicle"] or "",
            vehicle_from=row["vehicle_from"] or "",
            verdict=row["verdict"],
            error_kind=row["error_kind"],
            error=row["error"],
            format=row["format"],
            start_utc=row["start_utc"],
            duration_s=row["duration_s"],
            whole=bool(row["whole"]) if row["whole"] is not None else True,
            bytes_lost=row["bytes_lost"] or 0,
            seconds_lost=row["seconds_lost"] or 0.0,
            channels=tuple(channels.get(result, ())),
            derived=frozenset(derived.get(result, ())),
            findings=tuple(findings.get(result, ())),
            reports=tuple(json.loads(row["reports"] or "[]")),
        )


def _finding(row: Any) -> Finding:
    size = guaranteed = None
    if row["size"] is not None:
        size = Size(
            estimate=row["size"],
            low=-math.inf if row["size_low"] is None else row["size_low"],
            high=math.inf if row["size_high"] is None else row["size_high"],
            confidence=row["confidence"],
            unit=row["unit"],
        )
    if row["guaranteed_low_rad_s"] is not None or row["guaranteed_high_rad_s"] is not None:
        low, high = row["guaranteed_low_rad_s"], row["guaranteed_high_rad_s"]
        guaranteed = Interval(
            low=-math.inf if low is None else low, high=math.inf if high is None else high
        )
    return Finding(
        kind=row["kind"],
        suspects=tuple(json.loads(row["suspects"])),
        start_s=row["start_s"],
        end_s=row["end_s"],
        size=size,
        guaranteed=guaranteed,
        detectors=tuple(json.loads(row["detectors"])),
        dissent=tuple(json.loads(row["dissent"])),
        witness=row["witness"],
        detail=row["detail"] or "",
    )


def _series(store: Store) -> tuple[Series, ...]:
    """Every channel's bias and noise over the flights, tested together."""
    groups: dict[tuple[str, ...], list[Point]] = defaultdict(list)
    for row in store.rows("SELECT * FROM sensor_history ORDER BY CAST(path AS BLOB)"):
        key = ("vehicle", "sensor", "device_id", "channel", "quantity")
        groups[tuple(row[name] or "" for name in key)].append(
            Point(
                path=row["path"],
                start_utc=row["start_utc"],
                estimate=row["estimate_rad_s"],
                low=row["low_rad_s"],
                high=row["high_rad_s"],
            )
        )
    return tested([_one_series(key, points) for key, points in sorted(groups.items())])


def tested(series: Sequence[Series]) -> tuple[Series, ...]:
    """Correct the tests of all series for their number."""
    trends = [each.trend for each in series if each.trend is not None]
    adjusted = iter(holm([each.p_value for each in trends]))
    return tuple(
        each
        if each.trend is None
        else dataclasses.replace(
            each, trend=dataclasses.replace(each.trend, p_adjusted=next(adjusted))
        )
        for each in series
    )


def _one_series(key: Sequence[str], points: Sequence[Point]) -> Series:
    vehicle, sensor, device_id, channel, quantity = key
    days = {point.path: _days(point.start_utc) for point in points}
    dated = sorted(
        (point for point in points if days[point.path] is not None),
        key=lambda point: (days[point.path] or 0.0, point.path),
    )
    kept = dated or list(points)
    x = [days[point.path] or 0.0 for point in dated] or list(range(len(points)))
    return Series(
        vehicle=vehicle,
        sensor=sensor,
        device_id=device_id or None,
        channel=channel,
        quantity=quantity,
        dated=bool(dated),
        undated=len(points) - len(kept),
        points=tuple(kept),
        trend=trend(np.array(x, float), np.array([point.estimate for point in kept])),
    )


def _days(start_utc: str | None) -> float | None:
    try:
        moment = datetime.fromisoformat(start_utc or "")
    except ValueError:
        return None
    moment = moment if moment.tzinfo else moment.replace(tzinfo=UTC)
    return moment.timestamp() / SECONDS_PER_DAY
