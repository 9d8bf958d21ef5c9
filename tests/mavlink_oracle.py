"""MAVLink as the official library writes and reads it, for the tests to compare with."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import all as protocol

UTC_US = 1_700_000_000_000_000
KEY = bytes(range(32))


def packet(
    message: Any,
    *,
    sender: tuple[int, int] = (1, 1),
    version: int = 2,
    signed: bool = False,
    number: int = 0,
) -> bytes:
    """One message as the official library packs it."""
    link = protocol.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    link.seq = number & 0xFF
    if signed:
        link.signing.secret_key = KEY
        link.signing.sign_outgoing = True
        link.signing.timestamp = 1000 + number
    return bytes(message.pack(link, force_mavlink1=version == 1))


def stamped(packets: Iterable[bytes], step_us: int = 10_000, first_us: int = UTC_US) -> bytes:
    """A tlog of packets received at an even rate."""
    return b"".join(
        struct.pack(">Q", first_us + k * step_us) + one for k, one in enumerate(packets)
    )


def heartbeat(*, armed: bool = False, autopilot: int = 3) -> Any:
    return protocol.MAVLink_heartbeat_message(2, autopilot, 128 * armed, 0, 4, 3)


def raw_imu(time_us: int, *gyro: int) -> Any:
    return protocol.MAVLink_raw_imu_message(time_us, 10, -20, -1000, *gyro, 1, 2, 3)


def scaled_imu2(time_us: int, *gyro: int) -> Any:
    return protocol.MAVLink_scaled_imu2_message(time_us // 1000, 10, -20, -1000, *gyro, 1, 2, 3)


def flight(seconds: float = 5.0, rate_hz: int = 20, **how: Any) -> list[bytes]:
    """Packets of a vehicle with two IMUs, attitude and a heartbeat a second."""
    rng = np.random.default_rng(5)
    packets: list[bytes] = []
    for k in range(int(seconds * rate_hz)):
        now_us = 60_000_000 + k * 1_000_000 // rate_hz
        one, two = rng.integers(-300, 300, (2, 3)).tolist()
        angles = rng.normal(0.0, 1.0, 6).tolist()
        sent = [
            raw_imu(now_us, *one),
            scaled_imu2(now_us, *two),
            protocol.MAVLink_attitude_message(now_us // 1000, *angles),
            protocol.MAVLink_vfr_hud_message(1.0, 2.0, 3, 4, 5.0, 6.0),
        ]
        if k % rate_hz == 0:
            sent.append(heartbeat(armed=k >= rate_hz))
        packets += [packet(one, number=len(packets) + j, **how) for j, one in enumerate(sent)]
    return packets


def official(path: Path, *, notimestamps: bool = False) -> dict[tuple[int, int, str], list[Any]]:
    """All messages that the official library finds, by system, component and name.

    Where it breaks off with an exception, what it found before counts.
    """
    from pymavlink import mavutil

    found: dict[tuple[int, int, str], list[Any]] = {}
    log = mavutil.mavlogfile(str(path), notimestamps=notimestamps)
    with suppress(AttributeError, TypeError, ValueError), redirect_stdout(StringIO()):
        while (message := log.recv_msg()) is not None:
            if message.get_type() != "BAD_DATA":
                sender = (message.get_srcSystem(), message.get_srcComponent())
                found.setdefault((*sender, message.get_type()), []).append(message)
    log.close()
    return found
