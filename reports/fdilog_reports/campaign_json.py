"""A campaign as JSON: counts, every log, vehicles by channel, and every series with its trend."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

from fdilog.campaign.summary import SCHEMA, Campaign, LogEntry, Series
from fdilog_reports.json import finding_result, plain

file_name = "audit.json"


def render(campaign: Campaign) -> str:
    """Return the whole file; the same results give the same bytes."""
    text = json.dumps(plain(result(campaign)), allow_nan=False, indent=1)
    return text + "\n"


def result(campaign: Campaign) -> dict[str, Any]:
    """Return the campaign as nested dictionaries."""
    return {
        "schema": SCHEMA,
        "fdilog_version": campaign.version,
        "config_sha256": campaign.config.sha256,
        "counts": campaign.counts,
        "logs": [_log(log) for log in campaign.logs],
        "vehicle_channels": [dataclasses.asdict(cell) for cell in campaign.cells],
        "series": [_series(series) for series in campaign.series],
    }


def _log(log: LogEntry) -> dict[str, Any]:
    return {
        "path": log.path,
        "bytes": log.bytes,
        "sha256": log.sha256,
        "verdict": log.verdict,
        "error": None if log.verdict else {"kind": log.error_kind, "reason": log.error},
        "vehicle": {"name": log.vehicle, "from": log.vehicle_from},
        "format": log.format,
        "start_utc": log.start_utc,
        "duration_s": log.duration_s,
        "completeness": {
            "whole": log.whole,
            "bytes_lost": log.bytes_lost,
            "seconds_lost": log.seconds_lost,
        },
        "channels": dict(log.channels),
        "findings": [finding_result(finding) for finding in log.findings],
        "reports": log.reports,
    }


def _series(series: Series) -> dict[str, Any]:
    trend = series.trend
    return {
        "vehicle": series.vehicle,
        "sensor": series.sensor,
        "device_id": series.device_id,
        "channel": series.channel,
        "quantity": series.quantity,
        "unit": "rad/s",
        "ordered_by": "start_utc" if series.dated else "path",
        "undated_left_out": series.undated,
        "trend": None
        if trend is None
        else {
            "drifts": trend.drifts,
            "per": "day" if series.dated else "flight",
            **dataclasses.asdict(trend),
        },
        "flights": [
            [point.path, point.start_utc, point.estimate, point.low, point.high]
            for point in series.points
        ],
    }
