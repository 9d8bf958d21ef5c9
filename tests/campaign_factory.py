"""Campaigns made by hand, of any size, so that their reports are tested without any audit."""

from __future__ import annotations

from collections import defaultdict
from datetime import UTC, datetime, timedelta

import numpy as np

from fdilog.campaign.summary import Campaign, Cell, LogEntry, Point, Series, tested
from fdilog.campaign.trend import trend
from fdilog.config import Config
from fdilog.finding import Finding, Size

DEG = np.pi / 180.0
CHANNELS = tuple(f"imu{k}.{axis}" for k in range(3) for axis in "xyz")
KINDS = ("bias", "noise", "drift", "stuck", "impulse")


def log(
    path: str, vehicle: str = "ann", verdict: str | None = "healthy", **more: object
) -> LogEntry:
    values: dict[str, object] = {
        "path": path, "bytes": 1000, "sha256": path.encode().hex(), "vehicle": vehicle,
        "vehicle_from": "folder", "verdict": verdict, "format": "dataflash", "duration_s": 60.0,
    }  # fmt: skip
    return LogEntry(**{**values, **more})  # type: ignore[arg-type]


def finding(kind: str = "bias", *suspects: str) -> Finding:
    size = Size(estimate=0.05, low=0.04, high=0.06, confidence=0.999, unit="rad/s")
    return Finding(kind=kind, suspects=suspects, start_s=1.0, end_s=9.0, size=size)  # type: ignore[arg-type]


def series(
    values_deg_s: np.ndarray, vehicle: str = "ann", channel: str = "imu0.x", quantity: str = "bias"
) -> Series:
    """Make one flight every third day."""
    days = 3.0 * np.arange(len(values_deg_s))
    values = values_deg_s * DEG
    first = datetime(2024, 1, 1, 12, tzinfo=UTC)
    points = tuple(
        Point(
            path=f"{vehicle}/{k:05d}.bin",
            start_utc=(first + timedelta(days=float(day))).isoformat(),
            estimate=float(value),
            low=float(value - 0.02 * DEG),
            high=float(value + 0.02 * DEG),
        )
        for k, (day, value) in enumerate(zip(days, values, strict=True))
    )
    return Series(
        vehicle=vehicle, sensor=channel.partition(".")[0], device_id="2621706", channel=channel,
        quantity=quantity, dated=True, undated=0, points=points, trend=trend(days, values),
    )  # fmt: skip


def campaign(*logs: LogEntry, all_series: tuple[Series, ...] = ()) -> Campaign:
    counted: dict[tuple[str, str], dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for each in logs:
        for channel, status in each.channels:
            counted[each.vehicle, channel][status] += 1
    cells = tuple(
        Cell(
            vehicle=vehicle, channel=channel, flights=sum(of.values()), failed=of["failed"],
            suspect=of["suspect"], undecided=of["undecided"], healthy=of["healthy"],
            insufficient=of["insufficient"],
        )
        for (vehicle, channel), of in sorted(counted.items())
    )  # fmt: skip
    return Campaign(config=Config(), logs=logs, cells=cells, series=tested(all_series))


def large(n_logs: int, n_vehicles: int = 40) -> Campaign:
    """Make a campaign with one log in ten failed, one in ten not analysed, and some that drift."""
    rng = np.random.default_rng(1)
    logs = []
    for k in range(n_logs):
        vehicle = f"vehicle {rng.integers(n_vehicles):03d}"
        draw = rng.random()
        more: dict[str, object] = {
            "start_utc": (datetime(2024, 1, 1, tzinfo=UTC) + timedelta(hours=k)).isoformat(),
            "duration_s": float(rng.uniform(30.0, 2000.0)),
            "bytes": int(rng.integers(1e5, 1e8)),
        }
        path = f"fleet/{vehicle}/2024-{1 + k % 12:02d}/{k:08d}.BIN"
        if draw < 0.1:
            reason = "no FMT record (a3 95 80) in 5000 bytes: this is no DataFlash log"
            logs.append(log(path, vehicle, None, error_kind="unreadable", error=reason, **more))
            continue
        status = dict.fromkeys(CHANNELS, "healthy")
        findings = []
        if draw < 0.2:
            channel = CHANNELS[rng.integers(9)]
            status[channel] = "failed"
            findings.append(finding(KINDS[rng.integers(5)], channel))
        verdict = "failed" if findings else "undecided" if draw < 0.3 else "healthy"
        reports = (f"logs/{k:08d}-0123456789.html",)
        logs.append(
            log(path, vehicle, verdict, channels=tuple(status.items()), findings=tuple(findings),
                reports=reports, **more)
        )  # fmt: skip
    moving = tuple(
        series(
            (0.004 * np.arange(n_logs // n_vehicles) if v < 3 and c == 0 else 0.0)
            + 0.1 * rng.normal(size=n_logs // n_vehicles),
            f"vehicle {v:03d}",
            CHANNELS[c],
        )
        for v in range(min(n_vehicles, 12))
        for c in range(9)
    )
    return campaign(*logs, all_series=moving)
