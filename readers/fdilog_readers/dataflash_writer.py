"""Writing ArduPilot DataFlash logs: what a 4.1 autopilot would have written of the same flight.

Records, units and multipliers are those of real logs; fields that a recording says nothing about
are not made up but left out, as the format allows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import choose
from fdilog_readers.dataflash_layout import FIELDS, FMT, HEADER, MAGIC, Layout
from fdilog_readers.dataflash_patch import patch

__all__ = ["patch", "suffix", "write"]

suffix = ".bin"

ARMED, DISARMED = 10, 11
"""Event numbers of the autopilot (LogEvent)."""
HEALTHY = 1
LEAD_US = 100_000
"""What describes the log is stamped this long before its first record."""


class Kind(NamedTuple):
    """One kind of record: its FMT record, and the FMTU record that tells its units."""

    layout: Layout
    units: str
    multipliers: str

    def records(self, n: int, **columns: Any) -> NDArray[Any]:
        """Make n records; a column may be one value for all of them."""
        records = np.zeros(n, self.layout.dtype)
        head = records.view(np.uint8).reshape(n, self.layout.length)[:, :HEADER]
        head[:] = np.frombuffer(MAGIC + bytes([self.layout.type]), np.uint8)
        for name, values in columns.items():
            records[name] = values
        return records


def _kind(number: int, name: str, form: str, fields: str, units: str, multipliers: str) -> Kind:  # noqa: PLR0917
    length = HEADER + sum(np.dtype(FIELDS[character][0]).itemsize for character in form)
    layout = Layout(number, name, length, form, tuple(fields.split(",")))
    return Kind(layout, units, multipliers)


FORMAT = Kind(FMT, "-b---", "-----")
UNIT = _kind(178, "UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--")
MULT = _kind(179, "MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--")
MEANING = _kind(177, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---")
PARAMETER = _kind(64, "PARM", "QNf", "TimeUS,Name,Value", "s--", "F--")
MESSAGE = _kind(91, "MSG", "QZ", "TimeUS,Message", "s-", "F-")
EVENT = _kind(198, "EV", "QB", "TimeUS,Id", "s-", "F-")
ATTITUDE = _kind(100, "ATT", "QccC", "TimeUS,Roll,Pitch,Yaw", "sddh", "FBBB")
IMU = _kind(
    162,
    "IMU",
    "QBffffffIIfBBHH",
    "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz",
    "s#EEEooo--O--zz",
    "F-000000-----00",
)
KINDS = (FORMAT, UNIT, MULT, MEANING, PARAMETER, MESSAGE, EVENT, ATTITUDE, IMU)

UNITS = {
    "-": "", "s": "s", "b": "B", "#": "instance", "E": "rad/s", "o": "m/s/s", "O": "degC",
    "z": "Hz", "d": "deg", "h": "degheading",
}  # fmt: skip
MULTIPLIERS = {"-": 0.0, "0": 1.0, "F": 1e-6, "B": 1e-2}
"""Multiplier 0 stands for "none" in this format."""

CENTIDEGREE_RAD = np.pi / 18_000.0


def write(recording: Recording, path: Path) -> None:
    """Write a recording's gyros, accelerometers, attitude and armed spans as a DataFlash log.

    Stamps are whole microseconds and readings single precision there. Of each sensor the stream
    is written that an analysis would use; one with ``roll``, ``pitch`` and ``yaw`` becomes ATT.

    Raises
    ------
    NoGyroError
        If there is no gyro.
    UsageError
        If a source does not have the three gyros x, y, z that an IMU record holds.
    """
    imus = [gyro.stream for gyro in choose(recording, Config())[0]]
    numbers = _numbers(imus)
    parts = [_imu(stream, number) for stream, number in zip(imus, numbers, strict=True)]
    parts += [_attitude(stream) for stream in recording.streams if _angles(stream)]
    parts.append(_events(recording))
    stamps = [part["TimeUS"][0] for part in parts if len(part)]
    start_us = max(0, int(min(stamps, default=0)) - LEAD_US)
    described = b"".join(part.tobytes() for part in _description(recording, numbers, start_us))
    path.write_bytes(described + _interleaved(parts))


def _description(recording: Recording, numbers: list[int], start_us: int) -> list[NDArray[Any]]:
    """Make the records with which a log describes itself."""
    layouts = [kind.layout for kind in KINDS]
    formats = FORMAT.records(
        len(KINDS),
        Type=[layout.type for layout in layouts],
        Length=[layout.length for layout in layouts],
        Name=[layout.name.encode() for layout in layouts],
        Format=[layout.format.encode() for layout in layouts],
        Columns=[",".join(layout.fields).encode() for layout in layouts],
    )
    units = UNIT.records(
        len(UNITS),
        TimeUS=start_us,
        Id=[ord(key) for key in UNITS],
        Label=[label.encode() for label in UNITS.values()],
    )
    multipliers = MULT.records(
        len(MULTIPLIERS),
        TimeUS=start_us,
        Id=[ord(key) for key in MULTIPLIERS],
        Mult=list(MULTIPLIERS.values()),
    )
    meanings = MEANING.records(
        len(KINDS),
        TimeUS=start_us,
        FmtType=[layout.type for layout in layouts],
        UnitIds=[kind.units.encode() for kind in KINDS],
        MultIds=[kind.multipliers.encode() for kind in KINDS],
    )
    parameters = {b"SYSID_THISMAV": 1.0, b"INS_ENABLE_MASK": float(sum(1 << k for k in numbers))}
    values = PARAMETER.records(
        len(parameters), TimeUS=start_us, Name=list(parameters), Value=list(parameters.values())
    )
    told = recording.vehicle or {}
    lines = [told[fact].encode() for fact in ("firmware", "board") if fact in told]
    messages = MESSAGE.records(len(lines), TimeUS=start_us, Message=lines or b"")
    return [formats, units, multipliers, meanings, values, messages]


def _numbers(imus: list[Stream]) -> list[int]:
    """Give each source its instance: its own number, or the next that is free."""
    taken = {stream.sensor for stream in imus}
    free = (k for k in range(256) if k not in taken)
    return [next(free) if stream.sensor is None else stream.sensor for stream in imus]


def _imu(stream: Stream, number: int) -> NDArray[Any]:
    letters = "".join(name[-1:] for name in stream.channel_names) or "xyz"
    if len(stream.gyro) != 3 or letters != "xyz":
        raise UsageError(
            f"a DataFlash IMU has gyros x, y, z, but {stream.name} has"
            f" {', '.join(stream.channel_names or stream.gyro)}; a .csv holds any"
        )
    missing = np.full(len(stream.time_ns), np.nan, np.float32)
    forces = [stream.columns[name] for name in stream.accelerometer] or [missing] * 3
    rate_hz = min(round(stream.rate_hz), np.iinfo(np.uint16).max)
    return IMU.records(
        len(stream.time_ns),
        TimeUS=_microseconds(stream),
        I=number,
        **dict(
            zip(("GyrX", "GyrY", "GyrZ"), (stream.columns[n] for n in stream.gyro), strict=True)
        ),
        **dict(zip(("AccX", "AccY", "AccZ"), forces, strict=True)),
        T=stream.columns.get("temperature", missing),
        GH=HEALTHY,
        AH=HEALTHY,
        GHz=rate_hz,
        AHz=rate_hz,
    )


def _angles(stream: Stream) -> list[str]:
    """Names of the columns that are roll, pitch and yaw in radians; none if it has none."""
    known = {name.lower(): name for name in stream.columns if stream.units.get(name) == "rad"}
    names = [known.get(angle, "") for angle in ("roll", "pitch", "yaw")]
    return names if all(names) else []


def _attitude(stream: Stream) -> NDArray[Any]:
    angles = np.array([stream.columns[name] for name in _angles(stream)], np.float64)
    roll, pitch, yaw = np.round(angles / CENTIDEGREE_RAD)
    return ATTITUDE.records(
        len(stream.time_ns), TimeUS=_microseconds(stream), Roll=roll, Pitch=pitch, Yaw=yaw % 36_000
    )


def _events(recording: Recording) -> NDArray[Any]:
    spans = recording.armed or ()
    stamps = [stamp // 1000 for span in spans for stamp in span]
    return EVENT.records(len(stamps), TimeUS=stamps, Id=[ARMED, DISARMED] * len(spans))


def _microseconds(stream: Stream) -> NDArray[np.int64]:
    return np.asarray(stream.time_ns // 1000)


def _interleaved(parts: list[NDArray[Any]]) -> bytes:
    """Put records of several kinds in the order of their stamps, each kind in its own order."""
    parts = [part for part in parts if len(part)]
    if not parts:
        return b""
    # A stamp that runs backwards keeps its place behind the one before it.
    keys = np.concatenate([np.maximum.accumulate(part["TimeUS"]) for part in parts])
    sizes = np.concatenate([np.full(len(part), part.dtype.itemsize) for part in parts])
    order = np.argsort(keys, kind="stable")
    starts = np.empty(len(order), np.int64)
    starts[order] = np.cumsum(sizes[order]) - sizes[order]
    data = np.empty(int(sizes.sum()), np.uint8)
    first = 0
    for part in parts:
        size = part.dtype.itemsize
        at = starts[first : first + len(part)]
        data[at[:, None] + np.arange(size)] = part.view(np.uint8).reshape(-1, size)
        first += len(part)
    return data.tobytes()
