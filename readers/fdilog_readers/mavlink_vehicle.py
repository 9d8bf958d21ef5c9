"""What a MAVLink log says of the vehicle: who sent what, when it was armed, and UTC."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fdilog_readers import reported
from fdilog_readers.mavlink_messages import LATEST_NS, SINCE_BOOT, Messages

ARMED_FLAG = 128  # MAV_MODE_FLAG_SAFETY_ARMED
# FIRMWARE_VERSION_TYPE: the least number of each kind of release.
RELEASES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))


def name_of(sender: int) -> str:
    """System and component, as in 1.1."""
    return f"{sender >> 8}.{sender & 0xFF}"


def autopilot_of(own: Mapping[str, Messages]) -> int | None:
    """Which autopilot a sender says it is, in most of its heartbeats."""
    beats = own.get("HEARTBEAT")
    return int(np.bincount(beats.columns["autopilot"]).argmax()) if beats else None


def vehicle(sender: int, own: Mapping[str, Messages]) -> dict[str, str]:
    """Say what flew, in the protocol's words, from HEARTBEAT and AUTOPILOT_VERSION."""
    from pymavlink.dialects.v20 import all as generated

    facts = {"system": name_of(sender)}
    if beats := own.get("HEARTBEAT"):
        for fact, enum in (("autopilot", "MAV_AUTOPILOT"), ("type", "MAV_TYPE")):
            number = int(np.bincount(beats.columns[fact]).argmax())
            entry = generated.enums[enum].get(number)
            facts[fact] = entry.name.removeprefix(f"{enum}_").lower() if entry else str(number)
    if version := own.get("AUTOPILOT_VERSION"):
        packed = int(version.columns["flight_sw_version"][-1])
        release = next(word for least, word in RELEASES if packed & 0xFF >= least)
        facts["firmware"] = ".".join(str(packed >> k & 0xFF) for k in (24, 16, 8)) + release
        if uid := int(version.columns["uid"][-1]):
            facts["uid"] = f"{uid:016x}"
    return facts


def armed(own: Mapping[str, Messages], reference: Messages) -> tuple[tuple[int, int], ...] | None:
    """Spans in which the heartbeats say that the vehicle was armed. [ns]

    Parameters
    ----------
    reference
        The messages that tell time; a span that no heartbeat ends, ends with them.
    """
    beats = own.get("HEARTBEAT")
    if beats is None:
        return None
    flag = beats.columns["base_mode"] & ARMED_FLAG != 0
    return reported.spans(beats.time_ns, flag, int(reference.time_ns[-1]))


def utc_at_zero(own: Mapping[str, Messages], reference: Messages) -> int | None:
    """UTC at zero of the reference's clock, or None if the log does not say. [ns]

    SYSTEM_TIME is the vehicle's own word; the receive stamps add the delay of the link.
    """
    if reference.clock != SINCE_BOOT:
        return 0 if (reference.stamp_ns > reported.YEAR_2000_NS).all() else None
    told = own.get("SYSTEM_TIME")
    if told is not None and told.clock == SINCE_BOOT:
        utc_us = np.minimum(told.columns["time_unix_usec"], LATEST_NS // 1000).astype(np.int64)
        zero_ns = reported.utc_at_zero(utc_us * 1000, told.time_ns)
        if zero_ns is not None:
            return zero_ns
    return reported.utc_at_zero(reference.stamp_ns, reference.time_ns)
