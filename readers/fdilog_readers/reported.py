"""What several formats report again and again: a flag, and UTC beside a clock of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

VELOCITY = ("velocity_north", "velocity_east")
# Of all these formats' numbers of a fix, from this one on a velocity is known in three dimensions.
FIX_3D = 3
# Who does not know UTC says zero, or counts from 1970; none of these formats is older than this.
YEAR_2000_NS = 946_684_800 * 10**9


def spans(
    time_ns: NDArray[np.int64], flag: NDArray[np.bool_], last_ns: int
) -> tuple[tuple[int, int], ...]:
    """Make spans of a flag that is told again and again.

    Parameters
    ----------
    time_ns, flag : (n,)
        When each report came [ns], and what it said.
    last_ns
        End of a span that no report ends. [ns]
    """
    ends = [int(time_ns[k]) for k in np.flatnonzero(np.diff(flag, prepend=False))]
    if len(ends) % 2:
        ends.append(max(last_ns, ends[-1]))
    return tuple(zip(ends[::2], ends[1::2], strict=True))


def velocity(
    speed_m_s: NDArray[Any], course_deg: NDArray[Any], fix: NDArray[np.bool_]
) -> dict[str, NDArray[np.float64]]:
    """Velocity over ground as columns, not-a-number without a fix. [m/s]

    Parameters
    ----------
    speed_m_s, course_deg, fix : (n,)
        Speed over ground [m/s], course from north to east [deg], and whether they are known.
    """
    speed = np.where(fix, speed_m_s, np.nan).astype(np.float64)
    course = np.radians(course_deg.astype(np.float64))
    north, east = VELOCITY
    return {north: speed * np.cos(course), east: speed * np.sin(course)}


def utc_at_zero(utc_ns: NDArray[np.int64], time_ns: NDArray[np.int64]) -> int | None:
    """UTC at zero of a clock, the median of all that can be UTC; None if nothing can. [ns]

    Parameters
    ----------
    utc_ns, time_ns : (n,)
        UTC as it was told, and the clock at that instant. [ns]
    """
    zero_ns = np.sort((utc_ns - time_ns)[utc_ns > YEAR_2000_NS])
    # The middle value itself: as floating point it would be off by tens of nanoseconds.
    return int(zero_ns[len(zero_ns) // 2]) if len(zero_ns) else None
