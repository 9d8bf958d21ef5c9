"""Write a PX4 ULog: what the autopilot's logger would have written of the same flight."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.experiments.motion import quaternion
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import Gyro
from fdilog_readers import reported
from fdilog_readers.triads import numbered_triads
from fdilog_readers.ulog_layout import HEADER_BYTES, MAGIC, TYPES
from fdilog_readers.ulog_topics import COMPASS_FIELDS

suffix = ".ulg"

VERSION = 1
NO_FLAGS = bytes(40)
STATUS_NS = 500_000_000
DISARMED, ARMED = 1, 2

GAUSS_PER_TESLA = 1e4
# What PX4's own simulator calls its devices; the next one is this much further.
FIRST_DEVICE, DEVICE_STEP = 1_310_988, 8
STAMPS = "uint64_t timestamp;uint64_t timestamp_sample;"
TRIAD = (
    STAMPS + "uint32_t device_id;float x;float y;float z;float temperature;uint32_t error_count;"
)
GYRO = f"sensor_gyro:{TRIAD}uint8_t samples;uint8_t[7] _padding0;"
ACCELEROMETER = f"sensor_accel:{TRIAD}uint8_t[3] clip_counter;uint8_t samples;uint8_t[4] _padding0;"
ATTITUDE = (
    f"vehicle_attitude:{STAMPS}float[4] q;float[4] delta_q_reset;uint8_t quat_reset_counter;"
    "uint8_t[7] _padding0;"
)
COMPASS = (
    f"vehicle_magnetometer:{STAMPS}uint32_t device_id;float[3] magnetometer_ga;"
    "uint8_t calibration_count;uint8_t[7] _padding0;"
)
GROUND = (
    "vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;float vel_n_m_s;"
    "float vel_e_m_s;uint8_t fix_type;uint8_t[7] _padding0;"
)
STATUS = "vehicle_status:uint64_t timestamp;uint8_t arming_state;uint8_t[7] _padding0;"
GPS = (
    "vehicle_gps_position:uint64_t timestamp;uint64_t time_utc_usec;uint8_t fix_type;"
    "uint8_t[7] _padding0;"
)


@dataclass(frozen=True, eq=False)
class Topic:
    """Records of one instance of a topic, to be written.

    Parameters
    ----------
    format
        The definition, as it stands in the log.
    fields : each (n,)
        Those that are not given are zero. ``timestamp`` is in microseconds.
    """

    format: str
    instance: int
    fields: dict[str, Any]

    @property
    def name(self) -> str:
        """Name of the topic."""
        return self.format.partition(":")[0]

    def records(self, message_id: int) -> NDArray[Any]:
        """Lay the records out with their headers; padding at the end is not written."""
        entries: list[tuple[Any, ...]] = [("size", "<u2"), ("kind", "u1"), ("id", "<u2")]
        fields = [f.split(" ") for f in self.format.partition(":")[2].split(";") if f]
        while fields and fields[-1][1].startswith("_padding"):
            fields.pop()
        for kind, name in fields:
            base, _, count = kind.rstrip("]").partition("[")
            entries.append((name, TYPES[base], (int(count),)) if count else (name, TYPES[base]))
        records = np.zeros(len(self.fields["timestamp"]), np.dtype(entries))
        records["size"] = records.itemsize - HEADER_BYTES
        records["kind"], records["id"] = ord("D"), message_id
        for name, values in self.fields.items():
            records[name] = values
        return records


def write(recording: Recording, path: Path) -> None:
    """Write the gyros and accelerometers of a recording, its attitude, compass and GPS velocity.

    And when it was armed, and UTC.

    Stamps are whole microseconds and readings single precision there. Of each sensor the stream
    is written that an analysis would use, as sensor_gyro. A stream with ``qw``, ``qx``, ``qy`` and
    ``qz``, or with ``roll``, ``pitch`` and ``yaw``, becomes vehicle_attitude.

    Raises
    ------
    NoGyroError
        If there is no gyro.
    UsageError
        If a device is no triad: no topic of this format holds it.
    """
    triads = numbered_triads(recording, path, "a ULog has no topic")
    topics: list[Topic] = []
    for number, gyro in triads.items():
        topics.append(_triad(GYRO, number, gyro.stream, gyro.rate_rad_s))
        sensed = _accelerometer(recording, gyro)
        if sensed is not None:
            forces = np.column_stack([sensed.columns[name] for name in sensed.accelerometer])
            topics.append(_triad(ACCELEROMETER, number, sensed, forces))
    topics += [topic for s in recording.streams if (topic := _attitude(s)) is not None]
    compasses = [topic for s in recording.streams if (topic := _compass(s)) is not None]
    topics += [replace(topic, instance=k) for k, topic in enumerate(compasses)]
    ground = [s for s in recording.streams if s.velocity]
    topics += [_ground(stream, recording.utc_at_zero_ns) for stream in ground[:1]]
    topics += _regular(recording, [gyro.stream for gyro in triads.values()])
    info = {"sys_name": "fdilog"} | {
        k: v for k, v in (recording.vehicle or {}).items() if k.isidentifier()
    }
    path.write_bytes(ulog(topics, info))


def ulog(topics: Sequence[Topic], info: dict[str, str]) -> bytes:
    """Put definitions, subscriptions and records, in order of time, together as a log."""
    parts = [topic.records(k) for k, topic in enumerate(topics)]
    first_us = min((int(part["timestamp"].min()) for part in parts if len(part)), default=0)
    out = [MAGIC, bytes([VERSION]), struct.pack("<Q", first_us), _record("B", NO_FLAGS)]
    for key, value in info.items():
        text = value.encode()
        name = f"char[{len(text)}] {key}".encode()
        out.append(_record("I", bytes([len(name)]) + name + text))
    out += [_record("F", form.encode()) for form in dict.fromkeys(t.format for t in topics)]
    for k, topic in enumerate(topics):
        out.append(_record("A", struct.pack("<BH", topic.instance, k) + topic.name.encode()))
    return b"".join(out) + _interleaved(parts)


def _record(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def _interleaved(parts: list[NDArray[Any]]) -> bytes:
    """Put records of several topics in the order of their stamps, each topic in its own order."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return b""
    # A stamp that runs backwards keeps its place behind the one before it.
    keys = np.concatenate([np.maximum.accumulate(part["timestamp"]) for part in parts])
    sizes = np.concatenate([np.full(len(part), part.itemsize) for part in parts])
    order = np.argsort(keys, kind="stable")
    ends = np.empty(len(order), np.int64)
    ends[order] = np.cumsum(sizes[order])
    data = np.zeros(int(sizes.sum()), np.uint8)
    first = 0
    for part in parts:
        opaque = f"V{part.itemsize}"
        places = np.ndarray((len(data) - part.itemsize + 1,), opaque, data, 0, (1,))
        places[ends[first : first + len(part)] - part.itemsize] = part.view(opaque)
        first += len(part)
    return data.tobytes()


def _accelerometer(recording: Recording, gyro: Gyro) -> Stream | None:
    """Find the readings of the accelerometer in a gyro's device, its own stream's first."""
    sensor = gyro.stream.sensor
    same = [s for s in recording.streams if sensor is not None and s.sensor == sensor]
    return next((s for s in (gyro.stream, *same) if len(s.accelerometer) == 3), None)


def _triad(form: str, number: int, sensor: Stream, readings: NDArray[Any]) -> Topic:
    time_us = sensor.time_ns // 1000
    fields = dict(zip("xyz", readings.T, strict=True))
    fields["timestamp"] = fields["timestamp_sample"] = time_us
    fields["temperature"] = sensor.columns.get("temperature", np.full(len(time_us), np.nan))
    return Topic(
        form, number, {**fields, "device_id": FIRST_DEVICE + DEVICE_STEP * number, "samples": 1}
    )


def _attitude(stream: Stream) -> Topic | None:
    columns = stream.columns
    if columns.keys() >= {"qw", "qx", "qy", "qz"}:
        turned = np.column_stack([columns[f"q{part}"] for part in "wxyz"])
    elif columns.keys() >= {"roll", "pitch", "yaw"}:
        turned = quaternion(np.column_stack([columns[a] for a in ("roll", "pitch", "yaw")]))
    else:
        return None
    time_us = stream.time_ns // 1000
    return Topic(ATTITUDE, 0, {"timestamp": time_us, "timestamp_sample": time_us, "q": turned})


def _compass(stream: Stream) -> Topic | None:
    """Write a magnetic field, where it is known in what unit the log has it."""
    if stream.compass == COMPASS_FIELDS:  # as PX4 logs it
        per_unit = 1.0
    elif {stream.units.get(name) for name in stream.compass} == {"T"}:
        per_unit = GAUSS_PER_TESLA
    else:
        return None
    field = np.column_stack([stream.columns[name] for name in stream.compass]) * per_unit
    time_us = stream.time_ns // 1000
    stamps = {"timestamp": time_us, "timestamp_sample": time_us}
    return Topic(COMPASS, 0, {**stamps, "magnetometer_ga": field})


def _ground(stream: Stream, utc_at_zero_ns: int | None) -> Topic:
    """Write what GPS says of the velocity; where it does not, it has no fix."""
    north, east = (stream.columns[name] for name in stream.velocity)
    known = np.isfinite(north) & np.isfinite(east)
    utc_us = 0 if utc_at_zero_ns is None else (stream.time_ns + utc_at_zero_ns) // 1000
    fields = {
        "timestamp": stream.time_ns // 1000,
        "time_utc_usec": utc_us,
        "vel_n_m_s": np.where(known, north, 0.0),
        "vel_e_m_s": np.where(known, east, 0.0),
        "fix_type": np.where(known, reported.FIX_3D, 0),
    }
    return Topic(GROUND, 0, fields)


def _regular(recording: Recording, sensors: list[Stream]) -> list[Topic]:
    """Tell twice a second whether the vehicle is armed, and UTC if it is known and GPS is mute."""
    ends = [int(s.time_ns[k]) for s in sensors if len(s.time_ns) for k in (0, -1)]
    if not ends:
        return []
    time_ns = np.arange(min(ends), max(ends) + 1, STATUS_NS)
    stamps = [stamp for span in recording.armed or () for stamp in span]
    time_ns = np.union1d(time_ns, np.array(stamps, np.int64))
    armed = np.zeros(len(time_ns), bool)
    for start, end in recording.armed or ():
        armed |= (time_ns >= start) & (time_ns < end)
    state = np.where(armed, ARMED, DISARMED)
    topics = [Topic(STATUS, 0, {"timestamp": time_ns // 1000, "arming_state": state})]
    if recording.utc_at_zero_ns is not None and not any(s.velocity for s in recording.streams):
        utc_us = (time_ns + recording.utc_at_zero_ns) // 1000
        fields = {
            "timestamp": time_ns // 1000,
            "time_utc_usec": utc_us,
            "fix_type": reported.FIX_3D,
        }
        topics.append(Topic(GPS, 0, fields))
    return topics
