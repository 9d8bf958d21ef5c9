"""Which vehicle and which sensor a log is of: from the log where it says, else from its folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import PurePath

from fdilog.campaign.discovery import is_url

FACTORY_SYSTEM = "1"
"""System id of every autopilot that nobody has given another: it tells no vehicle from the next."""
GYRO_ID = re.compile(r"INS_GYR(?P<number>[2-9]?)_?ID")


def vehicle_of(facts: Mapping[str, str], path: str, root: str) -> tuple[str, str]:
    """Name the vehicle, and say what the name is.

    Parameters
    ----------
    facts
        What the log says of the vehicle.
    root
        The argument under which the log was found.

    Returns
    -------
    name, origin
        ``origin`` is ``board serial``, ``unique id``, ``system id`` or ``folder``.
    """
    if facts.get("board"):
        return facts["board"], "board serial"
    for key in ("uid", "sys_uuid", "ver_sw_uid", "uuid"):
        if facts.get(key):
            return facts[key], "unique id"
    system = facts.get("system", "")
    if system and system.partition(".")[0] != FACTORY_SYSTEM:
        return f"system {system}", "system id"
    return _folder(path, root), "folder"


def _folder(path: str, root: str) -> str:
    """Return the first folder below the argument, else the folder that the log is in."""
    if is_url(path):
        path, root = path.partition("://")[2], root.partition("://")[2]
    pure = PurePath(path)
    try:
        below = pure.relative_to(root).parts
    except ValueError:
        below = ()
    if len(below) > 1:
        return below[0]
    return pure.parent.name or "."


def sensor_ids(facts: Mapping[str, str]) -> dict[str, str]:
    """Device ids of the gyros by source name, where the parameters have them.

    ArduPilot's INS_GYR_ID is the first IMU's, INS_GYR2_ID the second's.
    """
    ids = {}
    for key, value in facts.items():
        match = GYRO_ID.fullmatch(key)
        if match and value not in {"", "0"}:
            ids[f"imu{int(match['number'] or 1) - 1}"] = value
    return ids
