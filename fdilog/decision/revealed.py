"""How large a constant error must be, and how long it must last, for this log to show it.

A log of one reading a second shows no fault of a tenth of a second, however large, and a log whose
gyros disagree by half a degree per second anyway shows no tenth of a degree. What it would have
shown follows from the intervals that its windows gave: an error is called a failure where its whole
interval lies beyond the tolerance, and where chance gives it in no window of a flight. A fault must
fill a window, wherever it begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fdilog.finding import Evidence
from fdilog.maths.geometry import blocks
from fdilog.table import ChannelTable

FEWEST_READINGS = 2
"""An error that leaves one reading is an outlier, and no constant error yet."""
FULL_SCALE_RAD_S = float(np.radians(2000.0))
"""Of usual gyros: an error beyond it cannot be read, whatever windows would show of it."""


@dataclass(frozen=True, kw_only=True)
class RevealedBias:
    """What windows of one length show.

    Parameters
    ----------
    bias_rad_s
        Tolerance plus half-width of the intervals, or what chance gives if that is more, the median
        of them, of the worst of the group's channels; None where most windows do not bound them,
        or beyond full scale only. [rad/s]
    """

    length_s: float
    bias_rad_s: float | None


@dataclass(frozen=True, kw_only=True)
class Revealed:
    """What the log could have shown of channels that check one another.

    Parameters
    ----------
    rate_hz
        Of the slowest of them. [Hz]
    shortest_s
        What lasts less can pass unseen: two readings, or the shortest window that bounds an error.
        None where no window does. [s]
    windows
        One for each length of windows, the shortest first.
    """

    channels: tuple[str, ...]
    rate_hz: float
    shortest_s: float | None
    windows: tuple[RevealedBias, ...]


def revealed(table: ChannelTable, evidence: Sequence[Evidence]) -> tuple[Revealed, ...]:
    """Say for each group of channels that check one another what would have shown of them.

    Parameters
    ----------
    evidence
        Of all detectors; the first that compares windows decides, as it does in the verdict.
    """
    compared = [item for item in evidence if item.kind == "bias" and item.windows.length_s > 0.0]
    leading = [item for item in compared if item.detector == compared[0].detector]
    leading.sort(key=lambda item: item.windows.length_s)
    return tuple(
        _of_group(table, [item for item in leading if len(item.windows)], list(block))
        for block in (blocks(table.axes) if table.channels else ())
    )


def _of_group(table: ChannelTable, evidence: Sequence[Evidence], columns: list[int]) -> Revealed:
    gyros = [k for k in columns if not table.channels[k].derived] or columns
    windows = tuple(
        RevealedBias(length_s=item.windows.length_s, bias_rad_s=_bias(item, gyros))
        for item in evidence
    )
    rate_hz = min(table.channels[k].rate_hz for k in gyros)
    bounded = [one.length_s for one in windows if one.bias_rad_s is not None]
    shortest_s = max(bounded[0], FEWEST_READINGS / rate_hz) if bounded and rate_hz else None
    return Revealed(
        channels=tuple(table.channels[k].name for k in gyros),
        rate_hz=rate_hz,
        shortest_s=shortest_s,
        windows=windows,
    )


def _bias(item: Evidence, columns: list[int]) -> float | None:
    """Return the error that half of the tested windows would have shown, of the worst channel."""
    least = [shown for k in columns if (shown := shown_from(item, k)) is not None]
    return max(least) if least and max(least) <= FULL_SCALE_RAD_S else None


def shown_from(item: Evidence, column: int) -> float | None:
    """Return the constant error that half of the tested windows would have shown of a channel.

    It is infinite where these do not bound any, and None where none was tested. [rad/s]
    """
    rows = item.tested[:, column]
    if not rows.any():
        return None
    half = (item.high[rows, column] - item.low[rows, column]) / 2.0
    shown = item.tolerance[rows, column] + np.where(np.isfinite(half), half, np.inf)
    if item.least is not None:
        shown = np.maximum(shown, item.least[rows, column])
    return float(np.median(shown))
