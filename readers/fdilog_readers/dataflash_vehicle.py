"""What a DataFlash log says of the vehicle: firmware, board, sensors, armed spans, and UTC."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import plain_text
from fdilog_readers.dataflash_layout import is_number

# Event numbers of EV (ArduPilot's LogEvent). Auto-armed comes after armed, when throttle is raised.
EVENTS = ARMED, DISARMED, AUTO_ARMED = 10, 11, 15

# Parameters that tell which gyros there are and how they were mounted, used and filtered.
TELLING_PARAMETERS = re.compile(
    r"INS_(GYR\d?_?ID|USE\d?|ENABLE_MASK|GYRO_FILTER|GYRO_RATE|FAST_SAMPLE|PRODUCT_ID)"
    r"|AHRS_ORIENTATION|BRD_TYPE"
)
FIRMWARE = re.compile(r"[A-Za-z][\w: -]* [vV]\d+\.\d+")
BOARD = re.compile(r"\S+( [0-9A-Fa-f]{8}){3}$")

GPS_3D_FIX = 3
GPS_EPOCH_NS = int(datetime(1980, 1, 6, tzinfo=UTC).timestamp()) * 10**9
WEEK_NS = 7 * 86400 * 10**9
# Days from which GPS time was one second further ahead of UTC (IERS Bulletin C); the first logs of
# this format are from 2012.
LEAP_SECONDS_IN_2009 = 15
LEAPS = ("2012-07-01", "2015-07-01", "2017-01-01")


def vehicle(
    messages: Iterable[str], parameters: Mapping[str, float], version: str
) -> dict[str, str]:
    """Say what flew: firmware, board and frame as the log words them, and telling parameters.

    Parameters
    ----------
    messages
        Texts of MSG, in file order.
    parameters
        Last value of each parameter.
    version
        The firmware string of VER, else empty.
    """
    facts: dict[str, str] = {}
    if version:
        facts["firmware"] = plain_text(version)
    for message in messages:
        text = plain_text(message).strip()
        if FIRMWARE.match(text):
            facts.setdefault("firmware", text)
        elif BOARD.match(text):
            facts.setdefault("board", text)
        elif text.startswith("Frame: "):
            facts.setdefault("frame", text.removeprefix("Frame: "))
    for name, value in sorted(parameters.items()):
        if TELLING_PARAMETERS.fullmatch(name):
            facts[name] = str(int(value)) if float(value).is_integer() else f"{value:.9g}"
    return facts


def armed_spans(
    events: list[tuple[int, int]], first_ns: int, last_ns: int
) -> tuple[tuple[int, int], ...] | None:
    """Make spans of the events of arming and disarming; None if there are none.

    Where the first event is not ``ARMED``, arming came before the log and began it, as it does
    unless the firmware is told to log while disarmed.

    Parameters
    ----------
    events
        Time and number, in file order. [ns]
    first_ns, last_ns
        First and last record of the log. [ns]
    """
    if not events:
        return None
    spans = []
    since = first_ns if events[0][1] != ARMED else None
    for time_ns, number in events:
        if number == DISARMED and since is not None:
            spans.append((since, time_ns))
            since = None
        elif number != DISARMED and since is None:
            since = time_ns
    if since is not None:
        spans.append((since, max(last_ns, since)))
    return tuple(spans)


def utc_at_zero(gps: Mapping[str, NDArray[Any]], time_ns: NDArray[np.int64]) -> int | None:
    """Return UTC at zero of the log's clock, by the median of the fixes, or None without a 3D fix.

    Parameters
    ----------
    gps
        Columns of GPS.
    time_ns : (n_records,)
        Time of each of its records on the log's clock. [ns]
    """
    week = gps.get("GWk", gps.get("Week"))
    of_week = gps.get("GMS", gps.get("TimeMS"))
    status = gps.get("Status")
    if week is None or of_week is None or status is None:
        return None
    if not all(is_number(column, "iu") for column in (week, of_week, status)):
        return None
    fixed = (status >= GPS_3D_FIX) & (week > 0)
    if not fixed.any():
        return None
    gps_ns = week[fixed].astype(np.int64) * WEEK_NS + of_week[fixed].astype(np.int64) * 10**6
    # The middle one, not the mean of two: a double would lose the last digits.
    zero_ns = int(np.sort(gps_ns - time_ns[fixed])[int(fixed.sum()) // 2]) + GPS_EPOCH_NS
    day = datetime.fromtimestamp(zero_ns / 1e9, UTC).date().isoformat()
    return zero_ns - (LEAP_SECONDS_IN_2009 + sum(day >= leap for leap in LEAPS)) * 10**9
