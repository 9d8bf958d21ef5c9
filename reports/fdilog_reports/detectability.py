"""What this log could not have shown: who checks a channel, and how large an error must be."""

from __future__ import annotations

from dataclasses import dataclass

from fdilog.analysis import Analysis
from fdilog.decision.revealed import FULL_SCALE_RAD_S, shown_from
from fdilog.finding import Evidence
from fdilog_reports.residuals import leading
from fdilog_reports.words import DEG_PER_RAD, figure, listed, shown


@dataclass(frozen=True, kw_only=True)
class DetectabilityRow:
    """One gyro channel: whether it is checked, told apart, and what would have shown of it.

    ``smallest`` holds, for each window length, the constant error that half of the windows would
    have shown to be outside the tolerance [deg/s], "none" if only one beyond full scale, or "not
    tested".
    """

    name: str
    checked: bool
    apart: str
    smallest: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Detectability:
    """The gyro channels, and the window lengths their smallest visible errors are given for."""

    lengths: tuple[str, ...]
    rows: tuple[DetectabilityRow, ...]


def detectability(analysis: Analysis) -> Detectability:
    """Say of every gyro channel what this log could have shown."""
    evidence = sorted(leading(analysis.evidence), key=lambda item: item.windows.length_s)
    compared = set(analysis.isolability.detectable)
    groups = {name: group for group in analysis.isolability.groups for name in group}
    rows = []
    for column, channel in enumerate(analysis.table.channels):
        if channel.derived:
            continue
        checked = channel.name in compared
        alike = [shown(name) for name in groups.get(channel.name, ()) if name != channel.name]
        apart = f"not from {listed(alike, 'or')}" if alike else "yes"
        rows.append(
            DetectabilityRow(
                name=shown(channel.name),
                checked=checked,
                apart=apart if checked else "never checked",
                smallest=tuple(_smallest(item, column) for item in evidence),
            )
        )
    return Detectability(
        lengths=tuple(f"{figure(item.windows.length_s)} s" for item in evidence), rows=tuple(rows)
    )


def _smallest(item: Evidence, column: int) -> str:
    least = shown_from(item, column)
    if least is None:
        return "not tested"
    return figure(DEG_PER_RAD * least, 2) if least <= FULL_SCALE_RAD_S else "none"
