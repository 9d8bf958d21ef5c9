"""The file beside a log that says what is true of it, for whoever checks what is found."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from fdilog.errors import UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import Injection
from fdilog.maths.geometry import leave_one_out
from fdilog.table import ChannelTable

SCHEMA = "fdilog-truth/1"

# A coefficient of a least-squares prediction below this is rounding.
ROUNDING = 1e-9


def injected_truth(injection: Injection, untouched: ChannelTable) -> dict[str, Any]:
    """Return what an injection put where, and what the untouched log had there by itself.

    Parameters
    ----------
    untouched
        The table of the log without the faults.
    """
    return {
        **injection.truth,
        "changed": [
            {
                "stream": change.stream.name,
                "fields": sorted(change.columns),
                "removed_records": int(change.removed.sum()),
            }
            for change in injection.changes
        ],
        "own_offset": [
            one
            for fault in injection.truth["faults"]
            for one in own_offsets(untouched, Fault.from_dict(fault))
        ],
    }


def own_offsets(table: ChannelTable, fault: Fault) -> list[dict[str, Any]]:
    """By how much a channel differs from the others over the span of a fault, before the fault.

    What is found is measured against the other gyros, so it is the fault and this together. With
    several sources along one axis, the others' mean is what it is held against; with skewed axes,
    their least-squares prediction.

    Returns
    -------
    offsets
        For each channel concerned: mean difference [rad/s], null where nothing compares with it,
        over so many samples, against these channels.
    """
    inside = (table.time_s >= fault.start_s) & (table.time_s <= fault.end_s)
    rows = leave_one_out(table.axes, [k for k, c in enumerate(table.channels) if c.derived])
    offsets = []
    for k, channel in enumerate(table.channels):
        if fault.channel not in (channel.name, channel.source):
            continue
        row = np.where(np.abs(rows[k]) > ROUNDING, rows[k], 0.0)
        needed = np.flatnonzero(row)
        complete = inside & np.asarray(table.valid[:, needed].all(axis=1), bool)
        known = bool(np.isfinite(rows[k]).all() and complete.any())
        apart = table.rate_rad_s[complete][:, needed] @ row[needed]
        offsets.append(
            {
                "channel": channel.name,
                "mean_rad_s": float(apart.mean()) if known else None,
                "samples": int(complete.sum()) if known else 0,
                "against": [table.names[other] for other in needed if other != k and known],
            }
        )
    return offsets


def truth_path(log: Path) -> Path:
    """Return where the truth about a log is written: beside it, FILE.truth.json."""
    return log.with_name(f"{log.name}.truth.json")


def write_truth(log: Path, truth: dict[str, Any]) -> Path:
    """Write what is true of a log beside it; the same truth gives the same bytes.

    Raises
    ------
    UsageError
        If the file cannot be written.
    """
    path = truth_path(log)
    text = json.dumps({"schema": SCHEMA, **truth}, indent=1, ensure_ascii=False) + "\n"
    try:
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    return path
