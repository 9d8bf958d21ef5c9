"""One source silent while others go on.

A channel accuses itself here: its source stopped, and the others show that the log did not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.registry import Stage
from fdilog.sources.clocks import hole_threshold_s
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, spans


@dataclass(frozen=True, kw_only=True)
class DropoutDetector:
    """Silences of one source, after its first reading, while another source is recorded."""

    description: ClassVar[str] = "one source silent while others go on"
    stage: ClassVar[Stage] = "alone"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give one window for every silence longer than ``dropout_s`` and five of its periods."""
        table = survey.table
        shortest_s = survey.config.tolerance.dropout_s
        found: list[tuple[int, int, list[int]]] = []
        for source in dict.fromkeys(channel.source for channel in table.channels):
            columns = [k for k, c in enumerate(table.channels) if c.source == source]
            others = [k for k in range(len(table.channels)) if k not in columns]
            if others and not table.channels[columns[0]].batched:
                # A slow source loses a record now and then; that is no silence yet.
                rate_hz = table.channels[columns[0]].rate_hz
                limit_s = hole_threshold_s(1.0 / rate_hz if rate_hz else 0.0, shortest_s)
                found += [
                    (start, stop, columns)
                    for start, stop in silences(table, columns, others, limit_s)
                ]
        return [_evidence(table, found, shortest_s)] if found else []


def silences(
    table: ChannelTable, columns: list[int], others: list[int], limit_s: float
) -> list[tuple[int, int]]:
    """Find where none of the columns is recorded for long though some other is.

    Returns
    -------
    list of (first sample, one past the last)
        The samples of the silence; those of the others recorded in it span more than ``limit_s``.
    """
    here = table.valid[:, columns].any(axis=1)
    silent = ~here & table.valid[:, others].any(axis=1)
    rows = np.flatnonzero(here)
    if not len(rows):
        return []
    # From each reading to the next, or to the end of the log: a source may never come back.
    stops = np.append(rows[1:], len(table.time_s))
    apart = np.flatnonzero(stops - rows > 1)
    missed = np.concatenate([[0], np.cumsum(silent)])
    found = []
    for first, stop in zip(rows[apart] + 1, stops[apart], strict=True):
        if (missed[stop] - missed[first] + 1) * table.period_s > limit_s:
            found.append((int(first), int(stop)))
    return found


def _evidence(
    table: ChannelTable, found: list[tuple[int, int, list[int]]], limit_s: float
) -> Evidence:
    shape = (len(found), len(table.channels))
    accused = np.zeros(shape, np.int8)
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    for row, (start, stop, columns) in enumerate(found):
        accused[row, columns] = np.arange(1, len(columns) + 1)
        # The source fell silent after its last reading and was back before its next one.
        inner_s = float(table.time_s[stop - 1] - table.time_s[start])
        after_s = float(table.time_s[min(stop, len(table.time_s) - 1)])
        low[row, columns] = inner_s
        high[row, columns] = after_s - float(table.time_s[start - 1])
    start_stop: NDArray[np.int64] = np.array([(start, stop) for start, stop, _ in found])
    return Evidence(
        detector="dropout",
        kind="dropout",
        windows=spans(table, start_stop[:, 0], start_stop[:, 1]),
        tested=accused > 0,
        low=low,
        high=high,
        tolerance=np.full(shape, limit_s),
        accused=accused,
        confidence=1.0,
    )
