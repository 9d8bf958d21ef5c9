"""Which streams of a recording are gyros, and which of them are one sensor."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config, GyroSource
from fdilog.errors import NoGyroError, UsageError, nearest
from fdilog.recording import Recording, Stream
from fdilog.sources.clocks import CleanStamps, clean_stamps
from fdilog.sources.witness import SOURCE as WITNESS

RAD_S = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3}
AXIS_NAMES = "xyz"
MOST_EXPLAINED = 3
MOST_LISTED = 20
# Two gyros differ by biases and noise of several quantisation steps: while they move, all axes of
# two sensors are equal to the last bit by chance alone, once in hundreds of records. Those of one
# sensor in two messages are equal unless the messages were filled a loop apart.
SAME_SENSOR = 0.25
MOVING_STEPS = 5.0
FEWEST_TO_COMPARE = 10
# Beyond this a number is damage and no reading: 30 cm from the axis of such a turn, a point would
# move at the speed of light. Characters lost on a serial line have made readings of 30 000 rad/s.
MOST_RAD_S = 1e9


@dataclass(frozen=True, kw_only=True)
class SourceInfo:
    """A stream that could have been used as a gyro, and why it was or was not."""

    name: str
    topic: str
    used: bool
    reason: str
    rate_hz: float
    samples: int
    derived: bool


@dataclass(frozen=True, kw_only=True, eq=False)
class Gyro:
    """One source: a physical device of one or more gyros, with its readings in SI units.

    Parameters
    ----------
    time_ns : (n,) int64
        Stamps as logged. [ns]
    rate_rad_s : (n, n_axes)
        Readings. [rad/s]
    alive : bool or None
        Whether its accelerometer ever reads anything but zero; None if the log holds none.
    """

    name: str
    stream: Stream
    channel_names: tuple[str, ...]
    time_ns: NDArray[np.int64]
    rate_rad_s: NDArray[np.float64]
    alive: bool | None

    @property
    def derived(self) -> bool:
        """Whether it is a witness only."""
        return self.stream.origin == "derived"

    @property
    def width(self) -> int:
        """Number of channels."""
        return len(self.channel_names)

    @property
    def rate_hz(self) -> float:
        """Median rate of its readings; 0 if it has none or one. [Hz]"""
        return 1e9 / float(np.median(np.diff(self.time_ns))) if len(self.time_ns) > 1 else 0.0


def choose(recording: Recording, config: Config) -> tuple[list[Gyro], list[SourceInfo]]:
    """Choose one stream for each physical gyro and say why the others were not used."""
    candidates = _candidates(recording, config)
    by_sensor: dict[str, list[Gyro]] = {}
    for gyro in candidates:
        by_sensor.setdefault(gyro.name, []).append(gyro)
    measured = any(gyro.stream.origin == "sensor" for gyro in candidates)
    chosen: list[Gyro] = []
    infos: list[SourceInfo] = []
    for streams in by_sensor.values():
        best = max(streams, key=_preference)
        reason = _reason_against(best, measured=measured, use=config.sources.use)
        for gyro in streams:
            if gyro is best:
                why = reason or f"{gyro.stream.name}, stamped by {gyro.stream.clock or 'its log'}"
            else:
                why = f"the same sensor as {best.stream.name}, which has more to say"
            infos.append(_info(gyro, used=gyro is best and not reason, reason=why))
        if not reason:
            chosen.append(best)
    unknown = [name for name in config.sources.use if name not in (*by_sensor, WITNESS)]
    if unknown:
        raise UsageError(f"no source named '{unknown[0]}'{nearest(unknown[0], list(by_sensor))}")
    if not chosen:
        raise NoGyroError(_nothing_found(recording, infos))
    return chosen, infos


def physical_streams(recording: Recording, config: Config) -> set[str]:
    """Name the streams that an analysis uses as gyros: each physical sensor once."""
    gyros, infos = choose(recording, config)
    return {gyro.stream.name for gyro in without_duplicates(cleaned(gyros)[0], infos)[0]}


def cleaned(gyros: Sequence[Gyro]) -> tuple[list[Gyro], list[CleanStamps]]:
    """Leave out the records whose stamps tell no time, and say what was left out of each gyro."""
    stamps = clean_stamps([gyro.time_ns for gyro in gyros])
    kept = [
        replace(gyro, time_ns=clean.time_ns, rate_rad_s=gyro.rate_rad_s[clean.keep])
        for gyro, clean in zip(gyros, stamps, strict=True)
    ]
    return kept, stamps


def without_duplicates(
    gyros: list[Gyro], infos: list[SourceInfo]
) -> tuple[list[Gyro], list[SourceInfo]]:
    """Drop a source that is bit-identical to one before it: one sensor, logged twice."""
    kept: list[Gyro] = []
    for gyro in gyros:
        twin = next((other for other in kept if _identical(other, gyro)), None)
        if twin is None:
            kept.append(gyro)
            continue
        reason = f"bit-identical to {twin.name} ({twin.stream.name}): one sensor logged twice"
        infos = [
            replace(info, used=False, reason=reason)
            if info.used and info.name == gyro.name
            else info
            for info in infos
        ]
    return kept, infos


def _nothing_found(recording: Recording, infos: list[SourceInfo]) -> str:
    if infos:
        what = "; ".join(f"{info.topic}: {info.reason}" for info in infos[:MOST_LISTED])
    else:
        names = [stream.name for stream in recording.streams]
        what = f"streams: {', '.join(names[:MOST_LISTED]) or 'none'}"
        if len(names) > MOST_LISTED:
            what += f" and {len(names) - MOST_LISTED} more"
    # A note that begins with a stream's name says why nothing was found in it.
    streams = tuple(f"{stream.name} " for stream in recording.streams)
    of_streams = [p.what for p in recording.problems if p.note and p.what.startswith(streams)]
    losses = [problem.what for problem in recording.problems if not problem.note]
    why = "".join(f"; {text}" for text in (*of_streams[:MOST_EXPLAINED], *losses[:1]))
    return f"{recording.path}: no gyro channels; {what}{why}"


def _candidates(recording: Recording, config: Config) -> list[Gyro]:
    named = {source.topic for source in config.sources.gyro}
    streams = [stream for stream in recording.streams if stream.gyro and stream.name not in named]
    numbered = [stream for stream in streams if stream.sensor is not None]
    loose = sorted(
        (stream for stream in streams if stream.sensor is None), key=lambda stream: stream.name
    )
    gyros = [_gyro(stream, f"imu{stream.sensor}", recording) for stream in numbered]
    number = 1 + max((stream.sensor or 0 for stream in numbered), default=-1)
    for stream in loose:
        if stream.origin == "derived" or stream.channel_names:
            gyros.append(_gyro(stream, stream.name, recording))
        else:
            gyros.append(_gyro(stream, f"imu{number}", recording))
            number += 1
    gyros += [_configured(recording, source) for source in config.sources.gyro]
    return sorted(gyros, key=lambda gyro: _natural(gyro.name))


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key by which imu10 comes after imu2."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d*)", name)]


def _gyro(stream: Stream, name: str, recording: Recording) -> Gyro:
    columns = [
        np.asarray(stream.columns[field], float) * RAD_S.get(stream.units.get(field, ""), 1.0)
        for field in stream.gyro
    ]
    letters = AXIS_NAMES if len(columns) == 3 else [str(k) for k in range(len(columns))]
    rate_rad_s = np.column_stack(columns)
    rate_rad_s[np.abs(rate_rad_s) > MOST_RAD_S] = np.nan
    return Gyro(
        name=name,
        stream=stream,
        channel_names=stream.channel_names or tuple(f"{name}.{letter}" for letter in letters),
        time_ns=stream.time_ns,
        rate_rad_s=rate_rad_s,
        alive=_accelerometer_alive(stream, recording),
    )


def _configured(recording: Recording, source: GyroSource) -> Gyro:
    found = [stream for stream in recording.streams if stream.name == source.topic]
    if not found:
        known = [stream.name for stream in recording.streams]
        raise UsageError(
            f"source '{source.name}': no stream '{source.topic}'{nearest(source.topic, known)}"
        )
    stream = found[0]
    for field in source.fields:
        if field not in stream.columns:
            raise UsageError(
                f"source '{source.name}': no field '{field}' in '{source.topic}'"
                f"{nearest(field, list(stream.columns))}"
            )
    units = dict.fromkeys(source.fields, source.unit)
    stream = replace(stream, gyro=source.fields, units=units, sensor=None, origin="sensor")
    return _gyro(stream, source.name, recording)


def _accelerometer_alive(stream: Stream, recording: Recording) -> bool | None:
    """Whether any accelerometer of the same device reads anything but zero."""
    same = [
        other
        for other in recording.streams
        if other is stream or (stream.sensor is not None and other.sensor == stream.sensor)
    ]
    columns = [
        np.asarray(other.columns[field], float)
        for other in same
        for field in other.accelerometer
        if field in other.columns
    ]
    if not columns:
        return None
    return any(bool((np.isfinite(column) & (column != 0.0)).any()) for column in columns)


def _preference(gyro: Gyro) -> tuple[int, bool, bool, float, int]:
    """Sort key: what one sensor measured, what holds readings, what goes on, the faster one."""
    rank = {"sensor": 2, "selected": 1, "derived": 0}[gyro.stream.origin]
    alive = bool((np.isfinite(gyro.rate_rad_s) & (gyro.rate_rad_s != 0.0)).any())
    steady = not gyro.stream.batched
    return (rank, alive, steady, round(gyro.stream.rate_hz, 3), len(gyro.time_ns))


def _reason_against(gyro: Gyro, *, measured: bool, use: Sequence[str]) -> str:
    """Why this source cannot be used, or nothing."""
    if gyro.derived:
        return "derived from an attitude or odometry: a witness, not a gyro"
    if gyro.stream.origin == "selected" and measured:
        return "selected or filtered by the autopilot from one of its sensors"
    if not len(gyro.time_ns):
        return "no records"
    silent = not bool((np.isfinite(gyro.rate_rad_s) & (gyro.rate_rad_s != 0.0)).any())
    if silent and not gyro.alive:
        return "absent: its gyro and accelerometer are zero or missing all along"
    if use and gyro.name not in use:
        return "not among the sources that the configuration uses"
    return ""


def _info(gyro: Gyro, *, used: bool, reason: str) -> SourceInfo:
    return SourceInfo(
        name=gyro.name,
        topic=gyro.stream.name,
        used=used,
        reason=reason,
        rate_hz=gyro.stream.rate_hz,
        samples=len(gyro.time_ns),
        derived=gyro.derived,
    )


def _identical(one: Gyro, other: Gyro) -> bool:
    if one.rate_rad_s.shape[1] != other.rate_rad_s.shape[1]:
        return False
    from fdilog.maths.noise import quantisation_step

    steps = np.array([quantisation_step(column) for column in other.rate_rad_s.T])
    changes = np.abs(np.diff(other.rate_rad_s, axis=0, prepend=other.rate_rad_s[:1]))
    moving = (changes > MOVING_STEPS * steps).any(axis=1) & np.isfinite(changes).all(axis=1)
    if moving.sum() < FEWEST_TO_COMPARE:
        return False
    # The two are stamped apart by a message or two; equal neighbours are looked for on both sides.
    after = np.searchsorted(one.time_ns, other.time_ns)
    equal = np.zeros(len(other.time_ns), bool)
    for step in (-2, -1, 0, 1):
        index = np.clip(after + step, 0, len(one.time_ns) - 1)
        equal |= (one.rate_rad_s[index] == other.rate_rad_s).all(axis=1)
    return float(equal[moving].mean()) >= SAME_SENSOR
