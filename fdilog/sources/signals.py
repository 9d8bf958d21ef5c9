"""What else a log holds than gyros: series that the configuration names, on one uniform grid.

A model of the vehicle needs its commands (servo outputs, a rudder) and perhaps a speed. They are
logged at rates of their own; `sampled` brings them onto the instants of an observer.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UsageError, nearest
from fdilog.recording import Recording, Stream
from fdilog.sources.clocks import clean_stamps, hole_threshold_s

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Signal:
    """One series, on its own stamps.

    Parameters
    ----------
    name
        As the configuration names it.
    unit
        SI unit, or empty where the log does not tell.
    time_s : (n,)
        Flight time, strictly increasing. [s]
    values : (n,)
        Finite. [unit]
    """

    name: str
    unit: str
    time_s: Floats
    values: Floats

    @property
    def period_s(self) -> float:
        """Median step, or 0 where there are too few to tell. [s]"""
        return float(np.median(np.diff(self.time_s))) if len(self.time_s) > 1 else 0.0


def streams_of(names: Collection[str]) -> list[str]:
    """List the streams that STREAM.FIELD may mean: topics and fields may hold dots themselves."""
    found: dict[str, None] = {}
    for name in names:
        parts = name.split(".")
        for k in range(1, len(parts)):
            found[".".join(parts[:k])] = None
    return list(found)


def find_signals(
    recording: Recording, names: Sequence[str], zero_ns: int
) -> tuple[dict[str, Signal], list[str]]:
    """Find the named series of a recording.

    Parameters
    ----------
    names
        STREAM.FIELD; of a table without streams the name of the column is enough.
    zero_ns
        Flight time 0 on the recording's clock. [ns]

    Returns
    -------
    signals, complaints
        By name; and what is wrong with those that are missing. Not every log of a campaign holds
        every stream, and that is no error.

    Raises
    ------
    UsageError
        If a stream that is there has no such field, or several streams have; the text names the
        nearest one, or all.
    """
    signals, complaints = {}, []
    for name in names:
        found = _found(recording, name)
        if found is None:
            complaints.append(f"no '{name}' in this log")
            continue
        stream, field = found
        (stamps,) = clean_stamps([stream.time_ns])
        if stamps.restarts:
            complaints.append(f"the clock of {stream.name} restarts")
            continue
        values = np.asarray(stream.columns[field], float)[stamps.keep]
        known = np.isfinite(values)
        if known.sum() < 2:
            complaints.append(f"{name} holds no readings")
            continue
        signals[name] = Signal(
            name=name,
            unit=stream.units.get(field, ""),
            time_s=(stamps.time_ns[known] - zero_ns) / 1e9,
            values=values[known],
        )
    return signals, complaints


def _found(recording: Recording, name: str) -> tuple[Stream, str] | None:
    matches = [
        (stream, field)
        for stream in recording.streams
        for field, column in stream.columns.items()
        if name in {f"{stream.name}.{field}", field} and np.issubdtype(column.dtype, np.number)
    ]
    whole = [(stream, field) for stream, field in matches if f"{stream.name}.{field}" == name]
    matches = whole or matches
    if len(matches) == 1:
        return matches[0]
    if matches:
        known = ", ".join(f"{stream.name}.{field}" for stream, field in matches)
        raise UsageError(f"observer: '{name}' is not one series; name one of {known}")
    topics = [s for s in recording.streams if name.startswith(f"{s.name}.") and s.columns]
    if topics:
        fields = [f"{s.name}.{field}" for s in topics for field in s.columns]
        raise UsageError(f"observer: no '{name}' in this log{nearest(name, fields)}")
    return None


def sampled(signal: Signal, time_s: Floats, dropout_s: float) -> Floats:
    """Mean of a measured series about each instant, over one step of the grid.

    Parameters
    ----------
    time_s : (n,)
        Instants, evenly spaced. [s]
    dropout_s
        A longer pause is a gap. [s]

    Returns
    -------
    values : (n,)
        Not-a-number where the step reaches into a gap or beyond the series. [unit]

    Notes
    -----
    Between its readings a series is a straight line; its integral over a step is exact.
    """
    return _means(signal, time_s - _step(time_s) / 2, dropout_s, held=False)


def held(signal: Signal, time_s: Floats, dropout_s: float) -> Floats:
    """Mean of a command over the step that follows each instant; it holds until the next one.

    Parameters and result as for `sampled`.
    """
    return _means(signal, time_s, dropout_s, held=True)


def _step(time_s: Floats) -> float:
    return float(time_s[1] - time_s[0]) if len(time_s) > 1 else 0.0


def _means(signal: Signal, start_s: Floats, dropout_s: float, *, held: bool) -> Floats:
    step = _step(start_s)
    if step <= 0.0:
        return np.full(len(start_s), np.nan)
    edges = np.append(start_s, start_s[-1] + step)
    at, values = signal.time_s, signal.values
    widths = np.diff(at)
    gap = widths > hole_threshold_s(signal.period_s, dropout_s)
    rise = np.zeros(len(widths)) if held else np.diff(values) / widths
    area = np.concatenate([[0.0], np.cumsum(widths * (values[:-1] + rise * widths / 2))])
    lost = np.concatenate([[0.0], np.cumsum(np.where(gap, widths, 0.0))])
    # A command is taken to hold for one more period after its last record.
    last = at[-1] + (signal.period_s if held else 0.0)
    k = np.clip(np.searchsorted(at, edges, side="right") - 1, 0, len(at) - 1)
    into = edges - at[k]
    slope = np.append(rise, 0.0)[k]
    integral = area[k] + into * (values[k] + slope * into / 2)
    missing = lost[k] + np.where(np.append(gap, False)[k], into, 0.0)
    means = np.diff(integral) / step
    outside = (edges[:-1] < at[0]) | (edges[1:] > last)
    return np.where(outside | (np.diff(missing) > 0.0), np.nan, means)
