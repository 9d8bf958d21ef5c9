"""The table that the gyros of a recording make: their axes, their clocks and one time base."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.errors import UsageError, nearest
from fdilog.recording import Problem, Recording
from fdilog.sources.attitude import matrices
from fdilog.sources.clocks import TimeBase, nearest_samples, place, time_base
from fdilog.sources.gyros import (
    AXIS_NAMES,
    Gyro,
    SourceInfo,
    choose,
    cleaned,
    without_duplicates,
)
from fdilog.sources.losses import losses, stamp_problems
from fdilog.sources.offsets import ClockOffset, estimate_offset
from fdilog.sources.shocks import Shocks
from fdilog.sources.witness import SOURCE as WITNESS
from fdilog.sources.witness import Witness, attitude_stream, find_witness
from fdilog.table import Channel, ChannelTable, side_by_side

# Offsets below this part of a sampling period stay in; see `_aligned`.
LEAST_SHIFT = 0.25


@dataclass(frozen=True, kw_only=True, eq=False)
class Assembly:
    """A table, with what became of every stream on the way to it.

    Parameters
    ----------
    zero_ns
        The table's time 0 on the recording's clock. [ns]
    clocks
        Time offsets between the sources, as estimated.
    shocks
        What the accelerometers of the sources feel.
    """

    table: ChannelTable
    sources: tuple[SourceInfo, ...]
    problems: tuple[Problem, ...]
    zero_ns: int
    clocks: tuple[ClockOffset, ...]
    witness: Witness | None = None
    shocks: Shocks | None = None


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
    chosen, infos = choose(recording, config)
    gyros, stamps = cleaned(chosen)
    problems = [
        problem
        for gyro, clean in zip(gyros, stamps, strict=True)
        for problem in stamp_problems(gyro, clean)
    ]
    gyros, infos = without_duplicates(gyros, infos)
    axes = _axes(gyros, config)
    stamped = gyros
    gyros, clocks = _aligned(gyros, axes, config)
    base = time_base([gyro.time_ns for gyro in gyros], config.tolerance.dropout_s)
    zero_ns = int(base.time_ns[0])
    restarts = [after for clean in stamps for after, _ in clean.restarts]
    problems += losses(recording, gyros, base, restarts, config)
    placed = [place(gyro.time_ns, gyro.rate_rad_s, base) for gyro in gyros]
    table = ChannelTable(
        time_s=(base.time_ns - zero_ns) / 1e9,
        rate_rad_s=side_by_side([rate for rate, _ in placed]),
        valid=side_by_side([valid for _, valid in placed]),
        channels=_channels(gyros, axes, base),
        period_s=base.period_ns / 1e9,
        deviation_rad_s=_deviations(gyros, base),
    )
    table, infos, witness = _witnessed(recording, table, infos, zero_ns, config)
    if witness is not None and witness.clock is not None:
        clocks = (*clocks, witness.clock)
    late_ns = [
        int(before.time_ns[0] - after.time_ns[0])
        for before, after in zip(stamped, gyros, strict=True)
    ]
    return Assembly(
        table=table,
        sources=tuple(infos),
        problems=tuple(problems),
        zero_ns=zero_ns,
        clocks=clocks,
        witness=witness,
        shocks=Shocks.of(recording, gyros, late_ns, zero_ns),
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
    slowest_hz = min(gyro.rate_hz for gyro in gyros)
    for gyro in gyros:
        time_s = (gyro.time_ns - gyro.time_ns[0]) / 1e9
        rate_hz = gyro.rate_hz
        apart = max(1, round(rate_hz / slowest_hz)) if slowest_hz else 1
        found = from_neighbours(time_s, gyro.rate_rad_s, rate_hz, apart)
        nearest, near = nearest_samples(gyro.time_ns, base)
        columns.append(np.where(near[:, None], found[nearest], np.nan))
    return side_by_side(columns)


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


def _aligned(
    gyros: list[Gyro], axes: NDArray[np.float64], config: Config
) -> tuple[list[Gyro], tuple[ClockOffset, ...]]:
    """Estimate by how much each triad runs late against the first; put right what matters.

    An offset is taken out if it is surely more than a quarter of a sampling period: shifting
    readings by less would cost more, by interpolation, than it mends.
    """
    edges = np.cumsum([0, *(gyro.width for gyro in gyros)])
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
            if surely_s * gyro.rate_hz > LEAST_SHIFT:
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
        axes = np.array([_axis_by_name(gyro, k) for gyro in gyros for k in range(gyro.width)])
    return _mounted(axes, gyros, config)


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
        last = first + gyro.width
        mounting = config.geometry.mounting.get(gyro.name)
        if mounting:
            turned[first:last] = axes[first:last] @ rotation_matrix(mounting["quaternion"]).T
        first = last
    return turned


def rotation_matrix(quaternion: Sequence[float]) -> NDArray[np.float64]:
    """Rotation from sensor to body of a Hamilton quaternion (w, x, y, z) of any length."""
    unit = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    return np.asarray(matrices(unit[None])[0], np.float64)


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
                    rate_hz=gyro.rate_hz,
                    samples=len(readings),
                    step_rad_s=float(quantisation_step(readings)),
                    batched=gyro.stream.batched,
                    apart_s=float(np.median(apart_ns)) / 1e9 if len(apart_ns) else 0.0,
                )
            )
    return tuple(channels)
