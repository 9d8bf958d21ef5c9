"""The JSON result that scripts rely on: one object on one line."""

from __future__ import annotations

import json
import math
import re
from typing import Any

import numpy as np

import fdilog
from fdilog.analysis import SCHEMA, Analysis
from fdilog.finding import Finding, Interval, Size
from fdilog.recording import Problem

suffix = ".json"

# Lone surrogates, which UTF-8 cannot hold, and what a terminal would obey: delete, C1 controls
# and marks of direction. As escapes they are the same JSON.
_ESCAPED = re.compile("[\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")


def render(analysis: Analysis) -> str:
    r"""Return the result as one line of JSON that ends in a line feed.

    The same analysis gives the same text. A byte of a path that is not UTF-8 is kept as the escape
    ``\udcff``, from which Python's ``os.fsencode`` makes the byte again.
    """
    text = json.dumps(
        plain(result(analysis)), ensure_ascii=False, allow_nan=False, separators=(",", ":")
    )
    return _ESCAPED.sub(lambda found: f"\\u{ord(found[0]):04x}", text) + "\n"


def result(analysis: Analysis) -> dict[str, Any]:
    """Return the result as nested dictionaries, keys in the order of the contract."""
    log, lost, table = analysis.log, analysis.completeness, analysis.table
    return {
        "schema": SCHEMA,
        "fdilog_version": fdilog.__version__,
        "config_sha256": analysis.config.sha256,
        "log": {
            "path": log.path,
            "format": log.format,
            "bytes": log.bytes,
            "sha256": log.sha256,
            "start_utc": log.start_utc,
            "duration_s": log.duration_s,
            "vehicle": log.vehicle,
        },
        "completeness": {
            "whole": lost.whole,
            "bytes_lost": lost.bytes_lost,
            "seconds_lost": lost.seconds_lost,
            "problems": [_problem(problem) for problem in lost.problems],
        },
        "sources": [
            {
                "name": source.name,
                "topic": source.topic,
                "used": source.used,
                "reason": source.reason,
                "rate_hz": source.rate_hz,
                "samples": source.samples,
                "derived": source.derived,
            }
            for source in analysis.sources
        ],
        "table": {
            "samples": len(table.time_s),
            "duration_s": table.duration_s,
            "rate_hz": 1.0 / table.period_s if table.period_s > 0 else 0.0,
            "channels": [
                {
                    "name": channel.name,
                    "source": channel.source,
                    "axis": channel.axis,
                    "rate_hz": channel.rate_hz,
                    "samples": channel.samples,
                    "sigma_rad_s": sigma,
                    "derived": channel.derived,
                    "status": status,
                }
                for channel, sigma, status in zip(
                    table.channels, analysis.sigma_rad_s, analysis.status, strict=True
                )
            ],
        },
        "clocks": [
            {
                "source": clock.source,
                "offset_s": clock.offset_s,
                "low": clock.low,
                "high": clock.high,
            }
            for clock in analysis.clocks
        ],
        "calibration": [
            {
                "source": constant.source,
                "rotation_deg": constant.rotation_deg,
                "scale": constant.scale,
                "bias_rad_s": constant.bias_rad_s,
                "note": constant.note,
            }
            for constant in analysis.calibration
        ],
        "isolability": {
            "detectable": analysis.isolability.detectable,
            "groups": analysis.isolability.groups,
        },
        "revealed": [
            {
                "channels": group.channels,
                "rate_hz": group.rate_hz,
                "shortest_s": group.shortest_s,
                "windows": [
                    {"length_s": one.length_s, "bias_rad_s": one.bias_rad_s}
                    for one in group.windows
                ],
            }
            for group in analysis.revealed
        ],
        "verdict": analysis.verdict,
        "findings": [finding_result(finding) for finding in analysis.findings],
        "part": {
            "start_s": analysis.part.start_s,
            "end_s": analysis.part.end_s,
            "armed": analysis.part.armed,
        },
        "autopilot": [
            {
                "source": note.source,
                "gyro": note.gyro,
                "what": note.what,
                "start_s": note.start_s,
                "end_s": note.end_s,
            }
            for note in analysis.autopilot
        ],
    }


def _problem(problem: Problem) -> dict[str, Any]:
    return {
        "offset": problem.offset,
        "what": problem.what,
        "bytes": problem.bytes_lost,
        "seconds": problem.seconds_lost,
        "note": problem.note,
    }


def finding_result(finding: Finding) -> dict[str, Any]:
    """Return one finding as the contract words it."""
    return {
        "kind": finding.kind,
        "suspects": finding.suspects,
        "isolated": finding.isolated,
        "start_s": finding.start_s,
        "end_s": finding.end_s,
        "size": _size(finding.size),
        "guaranteed": _guaranteed(finding.guaranteed),
        "detectors": finding.detectors,
        "dissent": finding.dissent,
        "witness": finding.witness,
        "detail": finding.detail,
    }


def _size(size: Size | None) -> dict[str, Any] | None:
    if size is None:
        return None
    return {
        "estimate": size.estimate,
        "low": size.low,
        "high": size.high,
        "confidence": size.confidence,
        "unit": size.unit,
    }


def _guaranteed(interval: Interval | None) -> dict[str, Any] | None:
    return None if interval is None else {"low": interval.low, "high": interval.high}


def plain(value: Any) -> Any:
    """Turn NumPy scalars into Python's, and what is not finite into null."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
