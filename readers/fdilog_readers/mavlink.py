"""MAVLink telemetry logs (.tlog), and plain MAVLink streams: gyros, attitude, outputs, armed spans.

RAW_IMU, SCALED_IMU and HIGHRES_IMU are gyros; the message, or its ``id``, is the sensor's number.
What sends gyros is a vehicle; where several do, every stream's name begins with its system and
component (``1.1/RAW_IMU``), and only the gyros of one of them are gyros of this recording. Every
other message is listed with its count, and read when it is asked for: its columns then hold the
numbers that the official reader gives, and ``units`` what the protocol says of them.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from fdilog.recording import Problem, Recording, Stream
from fdilog_readers import reported
from fdilog_readers.mavlink_dialect import (
    CHECKSUM_BYTES,
    HEADER_V1,
    HEADER_V2,
    SIGNATURE_BYTES,
    SIGNED,
    V1,
    dialect,
)
from fdilog_readers.mavlink_messages import (
    SENSORS,
    SINCE_BOOT,
    Messages,
    fleet,
    messages_of,
    set_clocks,
)
from fdilog_readers.mavlink_packets import MAGICS, STAMP_BYTES, read_packets
from fdilog_readers.mavlink_vehicle import (
    armed,
    autopilot_of,
    name_of,
    utc_at_zero,
    vehicle,
)

suffixes = (".tlog", ".mavlink", ".mav", ".raw")
description = "MAVLink telemetry log"

FACTS = ("HEARTBEAT", "SYSTEM_TIME", "AUTOPILOT_VERSION")
GPS = "GPS_RAW_INT"
LOADED = (*SENSORS, "ATTITUDE", "ATTITUDE_QUATERNION", "SERVO_OUTPUT_RAW", GPS)
GYRO_AXES = ("xgyro", "ygyro", "zgyro")
ACCELEROMETER_AXES = ("xacc", "yacc", "zacc")
COMPASS_AXES = ("xmag", "ymag", "zmag")
SPEED, COURSE, FIX = GROUND = ("vel", "cog", "fix_type")
FILTERED_RATES = ("rollspeed", "pitchspeed", "yawspeed")
QUATERNION = {"q1": "qw", "q2": "qx", "q3": "qy", "q4": "qz"}
# The protocol's unit: SI unit, factor, divisor. Whole numbers are divided, not multiplied by a
# fraction, so that each result is the double next to the true value.
SI = {
    "mrad/s": ("rad/s", 1.0, 1e3),
    "mG": ("m/s^2", 9.80665, 1e3),
    "m/s/s": ("m/s^2", 1.0, 1.0),
    "mgauss": ("T", 1.0, 1e7),
    "gauss": ("T", 1.0, 1e4),
    "cdegC": ("degC", 1.0, 1e2),
}
# What GPS_RAW_INT says for a speed or a course that it does not know.
UNKNOWN = 65535
ARDUPILOT = 3
FEWEST_LINKED = 4
RESTART_NS = 1_000_000_000
MOST_LISTED = 20
RAW_IS_MILLI = Problem(
    what="RAW_IMU is taken to be in mrad/s and milli-g: that is what ArduPilot sends", note=True
)
RAW_IS_RAW = Problem(
    what="RAW_IMU is left out: only of ArduPilot is it known that it is in mrad/s, and no HEARTBEAT"
    " says that this is one; a [[sources.gyro]] entry with its unit reads it",
    note=True,
)


def sniff(head: bytes) -> bool:
    """Tell a log by packets that follow one another by their lengths."""
    magics = [match.start() for match in re.finditer(rb"[\xfd\xfe]", head)]
    return any(
        _linked(head, start, before)
        for before in (STAMP_BYTES, 0)
        for start in magics
        if start >= before
    )


def _linked(head: bytes, at: int, before: int) -> bool:
    """Whether enough headers follow one another from ``at`` on."""
    for _ in range(FEWEST_LINKED):
        if at + 2 >= len(head) or head[at] not in MAGICS:
            return False
        length, flags = head[at + 1 : at + 3]
        if head[at] == V1:
            at += HEADER_V1
        elif flags <= SIGNED:
            at += HEADER_V2 + SIGNATURE_BYTES * flags
        else:
            return False
        at += length + CHECKSUM_BYTES + before
    return True


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read gyros, attitude, outputs and what tells of the vehicle, and the messages in ``also``.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened or holds no packet.
    """
    known = dialect()
    asked = {name.rpartition("/")[2].partition("[")[0] for name in also}
    ids = {known.id_of(name) for name in {*FACTS, *LOADED, *asked}}
    log = read_packets(path, {number for number in ids if number is not None})
    notes: list[Problem] = []
    found = messages_of(log, known, notes)
    senders = fleet(found)
    reference = set_clocks(found, senders, stamped=log.stamped)
    main = senders[0] if senders else max(log.counts, key=lambda key: log.counts[key])[0]
    own = {m.kind: m for m in found if m.sender == main}
    raw_is_milli = autopilot_of(own) == ARDUPILOT

    def title(sender: int, name: str) -> str:
        plain = sender == main and len(senders) < 2
        return name if plain else f"{name_of(sender)}/{name}"

    shown = [m for m in found if m.kind in LOADED or m.kind in asked]
    streams = [
        _stream(m, title(m.sender, m.name))
        if m.sender == main and (raw_is_milli or m.kind != "RAW_IMU")
        else _as_sent(m, title(m.sender, m.name))
        for m in shown
    ]
    loaded = {(m.sender, m.kind) for m in shown}
    streams += [
        Stream(name=title(sender, known.name(number)), time_ns=np.empty(0, np.int64), count=count)
        for (sender, number), count in sorted(log.counts.items())
        if (sender, known.name(number)) not in loaded
    ]
    if "RAW_IMU" in own:
        notes.append(RAW_IS_MILLI if raw_is_milli else RAW_IS_RAW)
    if len(senders) > 1:
        others = ", ".join(name_of(sender) for sender in senders[1:])
        what = f"several senders of gyros: those of {name_of(main)} are used, not those of {others}"
        notes.append(Problem(what=what, note=True))
    if reference is not None:
        notes += _restarts(reference)
    return Recording(
        path=str(path),
        format="tlog",
        bytes=log.bytes,
        streams=tuple(streams),
        problems=(*log.problems, *notes),
        vehicle=vehicle(main, own),
        armed=armed(own, reference) if reference else None,
        utc_at_zero_ns=utc_at_zero(own, reference) if reference else None,
    )


def _as_sent(messages: Messages, name: str) -> Stream:
    """Make a stream of numbers as the official reader gives them."""
    columns = dict(messages.columns)
    if messages.clock == SINCE_BOOT:
        columns.pop("time_usec", columns.pop("time_boot_ms", None))
    units = {f: unit for f in columns if (unit := messages.units.get(f.partition("[")[0]))}
    if messages.sensor is not None:  # not told what their numbers are, or of another vehicle
        units = {f: unit for f, unit in units.items() if unit not in SI}
    if messages.stamp_ns.any():
        columns["tlog_time_ns"], units["tlog_time_ns"] = messages.stamp_ns, "ns"
    return Stream(
        name=name,
        time_ns=messages.time_ns,
        columns=columns,
        units=units,
        clock=messages.clock,
        offsets=messages.offset,
    )


def _stream(messages: Messages, name: str) -> Stream:
    """Make a stream of what the protocol tells the meaning of."""
    stream = _as_sent(messages, name)
    columns, units = dict(stream.columns), dict(stream.units)
    if messages.kind == GPS and {*GROUND} <= columns.keys():
        return _with_velocity(stream)
    if messages.sensor is None:
        rates = FILTERED_RATES if {*FILTERED_RATES} <= columns.keys() else ()
        columns |= {also: columns[f] for f, also in QUATERNION.items() if f in columns}
        return replace(
            stream,
            columns=columns,
            units=units,
            gyro=rates,
            origin="selected" if rates else "sensor",
        )
    for f in columns:
        unit, factor, divisor = SI.get(messages.units.get(f, ""), ("", 1.0, 1.0))
        if unit:
            units[f] = unit
        if divisor != 1.0:
            columns[f] = columns[f] / divisor if factor == 1.0 else columns[f] * factor / divisor
    return replace(
        stream,
        columns=columns,
        units=units,
        gyro=GYRO_AXES,
        accelerometer=ACCELEROMETER_AXES,
        compass=COMPASS_AXES if {*COMPASS_AXES} <= columns.keys() else (),
        sensor=messages.sensor,
    )


def _with_velocity(stream: Stream) -> Stream:
    """Add the velocity to what GPS says in cm/s and hundredths of a degree."""
    speed, course, fix = (stream.columns[f] for f in GROUND)
    known = (fix >= reported.FIX_3D) & (speed != UNKNOWN) & (course != UNKNOWN)
    told = reported.velocity(speed / 100.0, course / 100.0, known)
    return replace(
        stream,
        columns={**stream.columns, **told},
        units={**stream.units, **dict.fromkeys(told, "m/s")},
        velocity=reported.VELOCITY,
    )


def _restarts(reference: Messages) -> list[Problem]:
    """Say where the time since boot begins again."""
    step = np.diff(reference.time_ns)
    return [
        Problem(
            what=f"the {reference.clock} goes back by {-step[k] / 1e9:.3f} s: restarted there",
            offset=int(reference.offset[k + 1]),
            note=True,
        )
        for k in np.flatnonzero(step < -RESTART_NS)[:MOST_LISTED]
    ]
