"""Write a MAVLink tlog: what a ground station would have recorded of an ArduPilot vehicle."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UsageError
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import Gyro
from fdilog_readers import reported
from fdilog_readers.mavlink_dialect import CHECKSUM_BYTES, HEADER_V2, V2, checksums, dialect
from fdilog_readers.triads import numbered_triads

suffix = ".tlog"

Times = NDArray[np.int64]

STAMP_BYTES = 8
SYSTEM, COMPONENT = 1, 1
STANDARD_GRAVITY_M_S2 = 9.80665
MILLIGAUSS_PER_TESLA = 1e7
HEARTBEAT_NS = 1_000_000_000
QUADROTOR, ARDUPILOT, ARMED, ACTIVE, STANDBY, PROTOCOL = 2, 3, 128, 4, 3, 3
ANGLES = ("roll", "pitch", "yaw")
QUATERNION = {"qw": "q1", "qx": "q2", "qy": "q3", "qz": "q4"}
ACCELEROMETER_UPDATED, GYRO_UPDATED = 0x07, 0x38
# ArduPilot's own choice of message for its first, second and third sensor.
SENSOR_MESSAGES = ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")


class Messages(NamedTuple):
    """Messages of one kind to be written.

    Parameters
    ----------
    message_id
        Which message.
    time_ns : (n,)
        When each was received, on the recording's clock. [ns]
    payload : (n, size) uint8
        The whole payload.
    """

    message_id: int
    time_ns: Times
    payload: NDArray[np.uint8]


def write(recording: Recording, path: Path) -> None:
    """Write the gyros of a recording, its attitude, compass, GPS velocity, armed spans and UTC.

    The first three sensors go out as ArduPilot sends them (whole millirad/s and milli-g, 16 bits,
    and no message where a reading is no number); if there are others, all as HIGHRES_IMU with its
    id. Of each sensor the stream is written that an analysis would use. A stream with ``roll``,
    ``pitch`` and ``yaw`` becomes ATTITUDE, one of a quaternion alone ATTITUDE_QUATERNION.

    Raises
    ------
    NoGyroError
        If there is no gyro.
    UsageError
        If a device is no triad, or none of its readings is whole: there is no message for it.
    """
    triads = numbered_triads(recording, path, "MAVLink has no message")
    if max(triads) < len(SENSOR_MESSAGES):
        sent = [_scaled(gyro, SENSOR_MESSAGES[number]) for number, gyro in triads.items()]
    else:
        sent = [_highres(gyro, number) for number, gyro in triads.items()]
    for gyro, messages_sent in zip(triads.values(), sent, strict=True):
        if not len(messages_sent.time_ns):
            raise UsageError(f"{path}: no message of {gyro.name} would be without a missing number")
    sensors = [gyro.stream for gyro in triads.values()]
    sent += [turned for s in recording.streams if (turned := _attitude(s)) is not None]
    sent += [_ground(s) for s in recording.streams if s.velocity]
    sent += _once_a_second(recording, sensors)
    path.write_bytes(tlog(sent, recording.utc_at_zero_ns or 0))


def tlog(messages: Iterable[Messages], utc_at_zero_ns: int = 0) -> bytes:
    """Put messages in order of time, frame them as MAVLink 2, and stamp each with UTC."""
    kinds = [kind for kind in messages if len(kind.time_ns)]
    if not kinds:
        return b""
    time_ns = np.concatenate([kind.time_ns for kind in kinds])
    order = np.argsort(time_ns, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    lengths = [_sent_length(kind.payload) for kind in kinds]
    overhead = STAMP_BYTES + HEADER_V2 + CHECKSUM_BYTES
    end = np.cumsum(np.concatenate(lengths)[order] + overhead)
    out = np.zeros(int(end[-1]), np.uint8)
    first = 0
    for kind, length in zip(kinds, lengths, strict=True):
        mine = place[first : first + len(kind.time_ns)]
        first += len(kind.time_ns)
        stamp = ((kind.time_ns + utc_at_zero_ns) // 1000).astype(">u8")
        for one in np.unique(length):
            rows = np.flatnonzero(length == one)
            packets = _framed(kind.message_id, kind.payload[rows, :one], mine[rows], stamp[rows])
            opaque = f"V{packets.shape[1]}"
            places = np.ndarray((len(out) - packets.shape[1] + 1,), opaque, out, 0, (1,))
            places[end[mine[rows]] - packets.shape[1]] = packets.view(opaque)[:, 0]
    return out.tobytes()


def _sent_length(payload: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Bytes of each payload that are sent: all but the zeros at its end, and one at least."""
    size = payload.shape[1]
    filled = payload[:, ::-1] != 0
    return np.where(filled.any(axis=1), size - filled.argmax(axis=1), 1)


def _framed(
    message_id: int, payload: NDArray[np.uint8], number: Times, stamp: NDArray[Any]
) -> NDArray[np.uint8]:
    """Stamp, header, payload and checksum of packets of one message and length."""
    n, length = payload.shape
    covered = STAMP_BYTES + HEADER_V2 + length
    packets = np.zeros((n, covered + CHECKSUM_BYTES), np.uint8)
    packets[:, :STAMP_BYTES] = stamp.view(np.uint8).reshape(n, STAMP_BYTES)
    head = packets[:, STAMP_BYTES:]
    head[:, 0] = V2
    head[:, 1] = length
    head[:, 4] = number & 0xFF
    head[:, 5:7] = SYSTEM, COMPONENT
    head[:, 7:10] = [*message_id.to_bytes(3, "little")]
    head[:, HEADER_V2 : HEADER_V2 + length] = payload
    known = dialect()
    extra = np.full(n, known.extra[known.row_of(message_id)])
    checksum = checksums(
        packets[:, STAMP_BYTES + 1 :], np.full(n, covered - STAMP_BYTES - 1), extra
    )
    packets[:, covered:] = checksum.astype("<u2")[:, None].view(np.uint8)
    return packets


def messages(name: str, time_ns: Times, **fields: Any) -> Messages:
    """Lay out messages of one name; fields that are not given are zero."""
    known = dialect()
    message_id = known.id_of(name)
    if message_id is None:
        raise UsageError(f"no MAVLink message is called '{name}'")
    layout = known.layout(message_id)
    payload = np.zeros(len(time_ns), layout)
    for field, values in fields.items():
        payload[field] = values
    return Messages(message_id, time_ns, payload.view(np.uint8).reshape(-1, layout.itemsize))


def _scaled(gyro: Gyro, name: str) -> Messages:
    stream = gyro.stream
    others: dict[str, NDArray[Any]] = {}
    for axis, column in zip("xyz", stream.accelerometer, strict=False):
        others[f"{axis}acc"] = stream.columns[column] / STANDARD_GRAVITY_M_S2 * 1e3
    for axis, column in zip("xyz", stream.compass, strict=False):
        if stream.units.get(column) == "T":
            others[f"{axis}mag"] = stream.columns[column] * MILLIGAUSS_PER_TESLA
    if "temperature" in stream.columns:
        others["temperature"] = stream.columns["temperature"] * 100
    values = {
        f"{axis}gyro": rate * 1e3 for axis, rate in zip("xyz", gyro.rate_rad_s.T, strict=True)
    }
    # What the sensor never tells stays zero, and keeps none of its rates back.
    values |= {field: column for field, column in others.items() if np.isfinite(column).any()}
    sent = np.isfinite(np.column_stack(list(values.values()))).all(axis=1)
    time_ns = stream.time_ns[sent]
    fields = {field: _int16(column[sent]) for field, column in values.items()}
    if name == "RAW_IMU":
        return messages(name, time_ns, time_usec=time_ns // 1000, **fields)
    return messages(name, time_ns, time_boot_ms=time_ns // 1_000_000, **fields)


def _highres(gyro: Gyro, number: int) -> Messages:
    stream = gyro.stream
    fields: dict[str, Any] = {"id": number, "time_usec": stream.time_ns // 1000}
    fields["fields_updated"] = GYRO_UPDATED | ACCELEROMETER_UPDATED * bool(stream.accelerometer)
    for axis, rate in zip("xyz", gyro.rate_rad_s.T, strict=True):
        fields[f"{axis}gyro"] = rate
    for axis, column in zip("xyz", stream.accelerometer, strict=False):
        fields[f"{axis}acc"] = stream.columns[column]
    return messages("HIGHRES_IMU", stream.time_ns, **fields)


def _attitude(stream: Stream) -> Messages | None:
    if stream.columns.keys() >= {*ANGLES}:
        name, fields = "ATTITUDE", {angle: stream.columns[angle] for angle in ANGLES}
    elif stream.columns.keys() >= {*QUATERNION}:
        name = "ATTITUDE_QUATERNION"
        fields = {field: stream.columns[part] for part, field in QUATERNION.items()}
    else:
        return None
    return messages(name, stream.time_ns, time_boot_ms=stream.time_ns // 1_000_000, **fields)


def _ground(stream: Stream) -> Messages:
    """Write what GPS says of the velocity; where it does not, it has no fix."""
    north, east = (stream.columns[name] for name in stream.velocity)
    known = np.isfinite(north) & np.isfinite(east)
    course_deg = np.degrees(np.arctan2(east, north)) % 360.0
    return messages(
        "GPS_RAW_INT",
        stream.time_ns,
        time_usec=stream.time_ns // 1000,
        fix_type=np.where(known, reported.FIX_3D, 0),
        vel=np.where(known, np.rint(np.hypot(north, east) * 100.0), 0.0),
        cog=np.where(known, np.rint(course_deg * 100.0) % 36000.0, 0.0),
    )


def _once_a_second(recording: Recording, sensors: list[Stream]) -> list[Messages]:
    """HEARTBEAT with the armed flag, and SYSTEM_TIME where UTC is known."""
    ends = [int(s.time_ns[k]) for s in sensors if len(s.time_ns) for k in (0, -1)]
    if not ends:
        return []
    time_ns = np.arange(min(ends), max(ends) + HEARTBEAT_NS, HEARTBEAT_NS)
    armed = np.zeros(len(time_ns), bool)
    for start, end in recording.armed or ():
        armed |= (time_ns >= start) & (time_ns <= end)
    beats = messages(
        "HEARTBEAT",
        time_ns,
        type=QUADROTOR,
        autopilot=ARDUPILOT,
        base_mode=np.where(armed, ARMED, 0),
        system_status=np.where(armed, ACTIVE, STANDBY),
        mavlink_version=PROTOCOL,
    )
    if recording.utc_at_zero_ns is None:
        return [beats]
    unix_us = (time_ns + recording.utc_at_zero_ns) // 1000
    boot_ms = time_ns // 1_000_000
    return [
        beats,
        messages("SYSTEM_TIME", time_ns, time_unix_usec=unix_us, time_boot_ms=boot_ms),
    ]


def _int16(values: NDArray[Any]) -> NDArray[np.int16]:
    """Round and saturate, as the sender does."""
    limits = np.iinfo(np.int16)
    whole: NDArray[np.int16] = np.clip(np.rint(values), limits.min, limits.max).astype(np.int16)
    return whole
