"""Putting known faults into a recorded flight, so that what is found can be held against a truth.

The flight keeps its own vibration, timing and gaps; nothing but the touched readings changes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.errors import UsageError, nearest
from fdilog.experiments.faults import Fault, apply, noise_sigma, touched, turned_about, turns_source
from fdilog.recording import Recording, Stream
from fdilog.sources.clocks import clean_stamps, time_base
from fdilog.sources.gyros import RAD_S, Gyro, choose


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What becomes of one stream.

    Parameters
    ----------
    stream
        As the reader gave it.
    columns : each (n_records,)
        The columns that change, whole, in the stream's own units and types.
    removed : (n_records,) bool
        Records that are not there any more.
    """

    stream: Stream
    columns: Mapping[str, NDArray[Any]]
    removed: NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Injection:
    """A recording with faults in it.

    Parameters
    ----------
    original
        As it was before.
    changes
        What a patcher needs to do the same to the log's own bytes.
    truth
        The faults, and what was found out to apply them, as plain JSON values.
    """

    original: Recording
    recording: Recording
    changes: tuple[Change, ...]
    truth: dict[str, Any]


def inject(
    recording: Recording,
    faults: Sequence[Fault],
    *,
    seed: int = 0,
    config: Config | None = None,
) -> Injection:
    """Put faults into the gyros that an analysis of this recording would use.

    Each fault meets what the ones before it left. A fault of kind ``noise`` multiplies the
    channel's robust `noise_sigma` over the whole flight. Where one sensor is logged in several
    streams, only the one that an analysis uses is changed.

    Parameters
    ----------
    faults
        In flight time: seconds since the first reading of any of those gyros.
    seed
        Of the noise.

    Raises
    ------
    NoGyroError
        If there is no gyro to fail.
    UsageError
        If a fault names no channel or touches no reading.
    """
    config = config or Config()
    gyros, _ = choose(recording, config)
    clean = clean_stamps([gyro.time_ns for gyro in gyros])
    base = time_base([stamps.time_ns for stamps in clean], config.tolerance.dropout_s)
    zero_ns = int(base.time_ns[0])
    times = []
    for gyro, stamps in zip(gyros, clean, strict=True):
        # A record that an analysis leaves out has no flight time, and no fault touches it.
        time_s = np.full(len(gyro.time_ns), np.nan)
        time_s[stamps.keep] = (stamps.time_ns - zero_ns) / 1e9
        times.append(time_s)
    rates = [gyro.rate_rad_s.copy() for gyro in gyros]
    hits = [np.zeros(rate.shape, bool) for rate in rates]
    sigmas: dict[str, float] = {}
    for j, fault in enumerate(faults):
        k, columns = _place(fault, gyros)
        mask = touched(fault, times[k])
        if not mask.any():
            last = max(float(np.nanmax(time_s)) for time_s in times)
            raise UsageError(
                f"{fault.kind} of {fault.channel}: no reading from {fault.start_s} s to"
                f" {fault.end_s} s; the flight lasts {last:.3f} s"
            )
        if turns_source(fault):
            rates[k] = turned_about(fault, times[k], rates[k], columns[0])
            hits[k][mask] = True
            continue
        for i in columns:
            sigma = noise_sigma(gyros[k].rate_rad_s[:, i]) if fault.kind == "noise" else 0.0
            if sigma > 0.0:
                sigmas[fault.channel] = sigma
            rng = np.random.default_rng((seed, j))
            rates[k][:, i] = apply(fault, times[k], rates[k][:, i], rng, sigma)
            hits[k][mask, i] = True
    changes = tuple(
        _change(gyro, rate, hit)
        for gyro, rate, hit in zip(gyros, rates, hits, strict=True)
        if hit.any()
    )
    # A source that the configuration describes is a stream of its own around the same columns.
    changed = {id(change.stream.columns): change for change in changes}
    streams = tuple(
        _changed(stream, changed[id(stream.columns)]) if id(stream.columns) in changed else stream
        for stream in recording.streams
    )
    return Injection(
        original=recording,
        recording=replace(recording, streams=streams),
        changes=changes,
        truth={
            "faults": [fault.to_dict() for fault in faults],
            "seed": seed,
            "noise_rad_s": sigmas,
        },
    )


def _place(fault: Fault, gyros: list[Gyro]) -> tuple[int, list[int]]:
    """Find the gyro and the columns of it that a fault concerns."""
    for k, gyro in enumerate(gyros):
        if fault.kind == "dropout" and fault.channel in (gyro.name, *gyro.channel_names):
            return k, list(range(len(gyro.channel_names)))
        if fault.channel in gyro.channel_names:
            return k, [gyro.channel_names.index(fault.channel)]
    known = [name for gyro in gyros for name in gyro.channel_names]
    raise UsageError(f"{fault.kind}: no channel '{fault.channel}'{nearest(fault.channel, known)}")


def _change(gyro: Gyro, rate: NDArray[np.float64], hit: NDArray[np.bool_]) -> Change:
    stream = gyro.stream
    # A dropout leaves not-a-number in every column of the source; a log may hold its own.
    removed: NDArray[np.bool_] = np.any(hit & np.isnan(rate) & ~np.isnan(gyro.rate_rad_s), axis=1)
    columns = {}
    for i, name in enumerate(stream.gyro):
        rows = hit[:, i] & ~removed
        if rows.any():
            column = np.array(stream.columns[name])
            values = rate[rows, i] / RAD_S.get(stream.units.get(name, ""), 1.0)
            column[rows] = _in_type(values, column.dtype)
            columns[name] = column
    return Change(stream=stream, columns=columns, removed=removed)


def _in_type(values: NDArray[np.float64], kind: np.dtype[Any]) -> NDArray[Any]:
    """Round and clip to what a column of integers can hold."""
    if kind.kind in "iu":
        limits = np.iinfo(kind)
        values = np.clip(np.round(values), limits.min, limits.max)
    return values.astype(kind)


def _changed(stream: Stream, change: Change) -> Stream:
    kept = ~change.removed
    return replace(
        stream,
        time_ns=stream.time_ns[kept],
        columns={
            name: change.columns.get(name, column)[kept] for name, column in stream.columns.items()
        },
        offsets=None if stream.offsets is None else stream.offsets[kept],
        count=int(kept.sum()),
    )
