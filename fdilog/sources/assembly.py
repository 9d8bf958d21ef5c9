"""Which streams are gyros, which of them are one sensor, and the table they make."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config, GyroSource
from fdilog.errors import NoGyroError, UsageError, nearest
from fdilog.recording import Problem, Recording, Stream
from fdilog.sources.clocks import (
    CleanStamps,
    TimeBase,
    clean_stamps,
    hole_threshold_s,
    nearest_samples,
    place,
    time_base,
)
from fdilog.sources.offsets import ClockOffset, estimate_offset
from fdilog.sources.witness import SOURCE as WITNESS
from fdilog.sources.witness import Witness, attitude_stream, find_witness
from fdilog.table import Channel, ChannelTable

RAD_S = {"rad/s": 1.0, "deg/s": np.pi / 180.0, "mrad/s": 1e-3}
AXIS_NAMES = "xyz"
MOST_EXPLAINED = 3
MOST_LISTED = 20
# A source that misses no more of a log than this may still be healthy over the whole of it.
MOST_MISSED = 0.1
# Two gyros differ by biases and noise of several quantisation steps: while they move, all axes of
# two sensors are equal to the last bit by chance alone, once in hundreds of records. Those of one
# sensor in two messages are equal unless the messages were filled a loop apart.
SAME_SENSOR = 0.25
MOVING_STEPS = 5.0
FEWEST_TO_COMPARE = 10
# Offsets below this part of a sampling period stay in; see `_aligned`.
LEAST_SHIFT = 0.25
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Assembly:
    """A table, with what became of every stream on the way to it.

    Parameters
    ----------
    zero_ns
        The table's time 0 on the recording's clock. [ns]
    clocks
        Time offsets between the sources, as estimated.
    """

    table: ChannelTable
    sources: tuple[SourceInfo, ...]
    problems: tuple[Problem, ...]
    zero_ns: int
    clocks: tuple[ClockOffset, ...]
    witness: Witness | None = None


def channel_table(recording: Recording, config: Config | None = None) -> ChannelTable:
    """Make the table of gyro channels of a recording.

    Raises
    ------
    NoGyroError
        If the recording holds no gyro; the text says what streams there are.
    UsageError
        If the configuration does not fit the recording.
    """
    return assemble(recording, config or Config()).table


def assemble(recording: Recording, config: Config) -> Assembly:
    """Choose the gyros of a recording and bring them onto one time base.

    Raises
    ------
    NoGyroError, UsageError
        As for `channel_table`.
    """
    gyros, infos = choose(recording, config)
    stamps = clean_stamps([gyro.time_ns for gyro in gyros])
    problems = [
        problem
        for gyro, clean in zip(gyros, stamps, strict=True)
        for problem in _stamp_problems(gyro, clean)
    ]
    gyros = [
        replace(gyro, time_ns=clean.time_ns, rate_rad_s=gyro.rate_rad_s[clean.keep])
        for gyro, clean in zip(gyros, stamps, strict=True)
    ]
    gyros, infos = _without_duplicates(gyros, infos)
    axes = _axes(gyros, config)
    gyros, clocks = _aligned(gyros, axes, config)
    base = time_base([gyro.time_ns for gyro in gyros], config.tolerance.dropout_s)
    zero_ns = int(base.time_ns[0])
    restarts = [after for clean in stamps for after, _ in clean.restarts]
    holes: list[Problem] = []
    if not all(gyro.stream.batched for gyro in gyros):
        holes = _holes(base, restarts, config.tolerance.dropout_s)
    if not restarts:
        holes += _outlasted(recording, base, config.tolerance.dropout_s)
    placed = [place(gyro.time_ns, gyro.rate_rad_s, base) for gyro in gyros]
    table = ChannelTable(
        time_s=(base.time_ns - zero_ns) / 1e9,
        rate_rad_s=np.concatenate([rate for rate, _ in placed], axis=1),
        valid=np.concatenate([valid for _, valid in placed], axis=1),
        channels=_channels(gyros, axes, base),
        period_s=base.period_ns / 1e9,
        deviation_rad_s=_deviations(gyros, base),
    )
    table, infos, witness = _witnessed(recording, table, infos, zero_ns, config)
    if witness is not None and witness.clock is not None:
        clocks = (*clocks, witness.clock)
    return Assembly(
        table=table,
        sources=tuple(infos),
        problems=(*problems, *_late_starts(gyros, base, config), *_not_finite(gyros), *holes),
        zero_ns=zero_ns,
        clocks=clocks,
        witness=witness,
    )


def _deviations(gyros: Sequence[Gyro], base: TimeBase) -> NDArray[np.float64] | None:
    """Say how far readings lay from their neighbours as logged, if any had to be interpolated.

    The neighbours are those as far away as those of the slowest source: closer ones follow the
    same vibration more smoothly.
    """
    from fdilog.maths.neighbours import from_neighbours

    if all(np.array_equal(gyro.time_ns, base.time_ns) for gyro in gyros):
        return None
    columns = []
    slowest_hz = min(_rate_hz(gyro.time_ns) for gyro in gyros)
    for gyro in gyros:
        time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
        rate_hz = _rate_hz(gyro.time_ns)
        apart = max(1, round(rate_hz / slowest_hz)) if slowest_hz else 1
        found = from_neighbours(time_s, gyro.rate_rad_s, rate_hz, apart)
        nearest, near = nearest_samples(gyro.time_ns, base)
        columns.append(np.where(near[:, None], found[nearest], np.nan))
    return np.concatenate(columns, axis=1)


def _witnessed(
    recording: Recording,
    table: ChannelTable,
    infos: list[SourceInfo],
    zero_ns: int,
    config: Config,
) -> tuple[ChannelTable, list[SourceInfo], Witness | None]:
    """Add the attitude of the log to the table as a witness, and say why it was or was not used."""
    stream = attitude_stream(recording)
    if stream is None:
        return table, infos, None
    found: tuple[ChannelTable, Witness] | str = "not among the sources that the configuration uses"
    if not config.sources.use or WITNESS in config.sources.use:
        found = find_witness(recording, stream, table, zero_ns, config)
    about = SourceInfo(
        name=WITNESS,
        topic=stream.name,
        used=not isinstance(found, str),
        reason=f"witness: the attitude, stamped by {stream.clock or 'its log'}",
        rate_hz=stream.rate_hz,
        samples=len(stream.time_ns),
        derived=True,
    )
    others = [info for info in infos if info.topic != stream.name or not info.derived]
    if isinstance(found, str):
        return table, [*others, replace(about, reason=f"no witness: {found}")], None
    table, witness = found
    return table, [*others, about], witness


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
    stamps = clean_stamps([gyro.time_ns for gyro in gyros])
    gyros = [
        replace(gyro, time_ns=clean.time_ns, rate_rad_s=gyro.rate_rad_s[clean.keep])
        for gyro, clean in zip(gyros, stamps, strict=True)
    ]
    return {gyro.stream.name for gyro in _without_duplicates(gyros, infos)[0]}


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


def _without_duplicates(
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


def _aligned(
    gyros: list[Gyro], axes: NDArray[np.float64], config: Config
) -> tuple[list[Gyro], tuple[ClockOffset, ...]]:
    """Estimate by how much each triad runs late against the first; put right what matters.

    An offset is taken out if it is surely more than a quarter of a sampling period: shifting
    readings by less would cost more, by interpolation, than it mends.
    """
    edges = np.cumsum([0, *(_width(gyro) for gyro in gyros)])
    frames = [axes[a:b] for a, b in pairwise(edges)]
    first_ns = int(gyros[0].time_ns[0])
    moved = gyros[:1]
    found = []
    for gyro, frame in zip(gyros[1:], frames[1:], strict=True):
        offset, late_ns = None, 0
        if frame.shape == (3, 3) and frame.shape == frames[0].shape:
            # Both in the body frame: a skewed triad is solved for the rates along x, y, z.
            offset = estimate_offset(
                gyro.name,
                _in_body(gyros[0], frames[0], first_ns),
                _in_body(gyro, frame, first_ns),
                config.windows.confidence,
            )
        if offset is not None:
            found.append(offset)
            surely_s = max(offset.low, -offset.high)
            if surely_s * _rate_hz(gyro.time_ns) > LEAST_SHIFT:
                late_ns = round(offset.offset_s * 1e9)
        moved.append(replace(gyro, time_ns=gyro.time_ns - late_ns))
    return moved, tuple(found)


def _in_body(
    gyro: Gyro, frame: NDArray[np.float64], first_ns: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return (gyro.time_ns - first_ns) / 1e9, gyro.rate_rad_s @ np.linalg.pinv(frame).T


def _axes(gyros: list[Gyro], config: Config) -> NDArray[np.float64]:
    """Sensitivity axes H of all channels, from the configuration or by convention."""
    from fdilog.maths.geometry import named_axes

    names = [name for gyro in gyros for name in gyro.channel_names]
    settings = config.geometry
    if settings.axes:
        axes = np.array(settings.axes, float)
        if len(axes) != len(names):
            raise UsageError(
                f"geometry.axes holds {len(axes)} axes for {len(names)} channels:"
                f" {', '.join(names)}"
            )
        axes = axes / np.linalg.norm(axes, axis=1)[:, None]
    elif settings.name:
        try:
            axes = named_axes(settings.name, len(names))
        except ValueError as error:
            raise UsageError(f"{error} (channels: {', '.join(names)})") from None
    else:
        axes = np.array([_axis_by_name(gyro, k) for gyro in gyros for k in range(_width(gyro))])
    return _mounted(axes, gyros, config)


def _width(gyro: Gyro) -> int:
    return len(gyro.channel_names)


def _axis_by_name(gyro: Gyro, k: int) -> list[float]:
    """Axis of a channel whose name ends in x, y or z (and perhaps a number)."""
    name = gyro.channel_names[k]
    letter = re.search(r"([xyz])[_ ]?\d*$", name, re.IGNORECASE)
    if letter is None:
        raise UsageError(
            f"where channel '{name}' points is not known; add --geometry NAME, or geometry.axes to"
            " the configuration (`fdilog config` tells the names)"
        )
    return [float(letter[1].lower() == axis) for axis in AXIS_NAMES]


def _mounted(axes: NDArray[np.float64], gyros: list[Gyro], config: Config) -> NDArray[np.float64]:
    """Turn the axes of sources whose mounting the configuration gives."""
    known = [gyro.name for gyro in gyros]
    for name in config.geometry.mounting:
        if name not in known:
            raise UsageError(f"geometry.mounting: no source '{name}'{nearest(name, known)}")
    turned = axes.copy()
    first = 0
    for gyro in gyros:
        last = first + _width(gyro)
        mounting = config.geometry.mounting.get(gyro.name)
        if mounting:
            turned[first:last] = axes[first:last] @ rotation_matrix(mounting["quaternion"]).T
        first = last
    return turned


def rotation_matrix(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """Rotation from sensor to body of a Hamilton quaternion (w, x, y, z) of any length."""
    w, x, y, z = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _channels(gyros: list[Gyro], axes: NDArray[np.float64], base: TimeBase) -> tuple[Channel, ...]:
    from fdilog.maths.noise import quantisation_step

    channels: list[Channel] = []
    for gyro in gyros:
        nearest, near = nearest_samples(gyro.time_ns, base)
        apart_ns = np.abs(gyro.time_ns[nearest] - base.time_ns)[near]
        for k, name in enumerate(gyro.channel_names):
            axis = axes[len(channels)]
            column = gyro.rate_rad_s[:, k]
            readings = column[np.isfinite(column)]
            channels.append(
                Channel(
                    name=name,
                    source=gyro.name or name,
                    axis=(float(axis[0]), float(axis[1]), float(axis[2])),
                    rate_hz=_rate_hz(gyro.time_ns),
                    samples=len(readings),
                    step_rad_s=float(quantisation_step(readings)),
                    derived=gyro.derived,
                    batched=gyro.stream.batched,
                    apart_s=float(np.median(apart_ns)) / 1e9 if len(apart_ns) else 0.0,
                )
            )
    return tuple(channels)


def _rate_hz(time_ns: NDArray[np.int64]) -> float:
    return 1e9 / float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0


def _stamp_problems(gyro: Gyro, clean: CleanStamps) -> list[Problem]:
    topic = gyro.stream.name
    problems = []
    if clean.repeated:
        what = f"{topic}: {clean.repeated} records repeat the time stamp before them; left out"
        problems.append(Problem(what=what, note=True))
    if clean.late:
        were = "record was" if clean.late == 1 else "records were"
        what = f"{topic}: {clean.late} {were} held up and stamped too late, in bursts; left out"
        problems.append(Problem(what=what, note=True))
    if clean.misplaced:
        are = "record is" if clean.misplaced == 1 else "records are"
        what = f"{topic}: {clean.misplaced} {are} stamped out of order; left out"
        problems.append(Problem(what=what))
    problems += [
        Problem(
            what=f"{topic}: the clock jumps back by {back / 1e9:.3f} s (a restart);"
            " what follows is a stretch of its own, the pause before it unknown"
        )
        for _, back in clean.restarts
    ]
    return problems


def _late_starts(gyros: Sequence[Gyro], base: TimeBase, config: Config) -> list[Problem]:
    """List the sources that were recorded later than the others; a while is usual and only noted.

    Drivers and nodes start one after another, so that it is no failure. But nobody knows what such
    a gyro did before. Batches come one after another, and what lies between them is no loss.
    """
    length_s = (int(base.time_ns[-1]) - int(base.time_ns[0])) / 1e9
    problems = []
    for gyro in gyros:
        late_s = (int(gyro.time_ns[0]) - int(base.time_ns[0])) / 1e9 if len(gyro.time_ns) else 0.0
        allowed_s = hole_threshold_s(base.period_ns / 1e9, config.tolerance.dropout_s)
        if gyro.stream.batched or late_s <= allowed_s:
            continue
        what = f"{gyro.stream.name}: nothing recorded before {late_s:.3f} s, while other gyros were"
        usual = late_s <= MOST_MISSED * length_s
        problems.append(Problem(what=what, seconds_lost=None if usual else late_s, note=usual))
    return problems


def _not_finite(gyros: list[Gyro]) -> list[Problem]:
    problems = []
    for gyro in gyros:
        for k, name in enumerate(gyro.channel_names):
            bad = int((~np.isfinite(gyro.rate_rad_s[:, k])).sum())
            if bad:
                lost = bad / _rate_hz(gyro.time_ns) if len(gyro.time_ns) > 1 else None
                what = f"{name}: {bad} readings are not finite numbers, or beyond any turn"
                problems.append(Problem(what=what, seconds_lost=lost))
    return problems


def _holes(base: TimeBase, restarts: Sequence[int], dropout_s: float) -> list[Problem]:
    """List the stretches in which every gyro is silent, restarts of the clock apart."""
    steps = np.diff(base.time_ns)
    limit = hole_threshold_s(base.period_ns / 1e9, dropout_s) * 1e9
    starts = np.flatnonzero(steps > limit)
    known = set(restarts)
    starts = np.array([k for k in starts if int(base.time_ns[k]) not in known], int)
    lost = (steps[starts] - base.period_ns) / 1e9
    from_s = (base.time_ns[starts] - base.time_ns[0]) / 1e9
    problems = [
        Problem(
            what=f"no gyro was recorded from {start:.3f} s to {start + step / 1e9:.3f} s",
            seconds_lost=float(seconds),
        )
        for start, step, seconds in zip(
            from_s[:MOST_LISTED], steps[starts][:MOST_LISTED], lost, strict=False
        )
    ]
    if len(starts) > MOST_LISTED:
        rest = float(lost[MOST_LISTED:].sum())
        what = f"{len(starts) - MOST_LISTED} more holes in which no gyro was recorded"
        problems.append(Problem(what=what, seconds_lost=rest))
    return problems


def _outlasted(recording: Recording, base: TimeBase, dropout_s: float) -> list[Problem]:
    """Say if the vehicle's other senses were recorded long before, or after, any gyro was.

    What is recorded begins at different times; so a while is asked before, and none after.
    """
    first_ns, last_ns = int(base.time_ns[0]), int(base.time_ns[-1])
    end_s = (last_ns - first_ns) / 1e9
    limit_s = hole_threshold_s(base.period_ns / 1e9, dropout_s)
    before, after = ("", MOST_MISSED * end_s), ("", 0.0)
    for stream in recording.streams:
        senses = stream.origin == "derived" or any(
            (stream.gyro, stream.accelerometer, stream.compass, stream.velocity)
        )
        if not senses or not stream.rate_hz:
            continue
        begin_ns, stop_ns = int(stream.time_ns.min()), int(stream.time_ns.max())
        # One that is apart is stamped by another clock, or of another flight.
        if begin_ns > last_ns or stop_ns < first_ns:
            continue
        least_s = limit_s + 1.0 / stream.rate_hz
        earlier_s, later_s = (first_ns - begin_ns) / 1e9, (stop_ns - last_ns) / 1e9
        before = (stream.name, earlier_s) if earlier_s > max(before[1], least_s) else before
        after = (stream.name, later_s) if later_s > max(after[1], least_s) else after
    problems = []
    if before[0]:
        what = f"no gyro was recorded before 0.000 s, while {before[0]} was from -{before[1]:.3f} s"
        problems.append(Problem(what=what, seconds_lost=before[1]))
    if after[0]:
        until_s = end_s + after[1]
        what = f"no gyro was recorded after {end_s:.3f} s, while {after[0]} was until"
        problems.append(Problem(what=f"{what} {until_s:.3f} s", seconds_lost=after[1]))
    return problems
