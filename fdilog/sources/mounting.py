"""Devices that are mounted otherwise than the log assumes: found, named, and turned back.

A gyro turned by 90 or 180 degrees, or with an axis inverted, disagrees with the others about
everything. That is one fault, not one of every channel: it is recognised before anything is
compared, and the comparison goes on with its rates turned back. Which of two devices is the one is
told by a third, or by the attitude; else both are suspects.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Finding
from fdilog.sources.devices import Devices, centred, triads_of
from fdilog.sources.mounting_words import AXES, described
from fdilog.sources.turned import (
    CELL_S,
    LEAST_GAIN,
    Cells,
    Turn,
    turns,
    untold_axes,
)
from fdilog.table import PARALLEL, ChannelTable

Floats = NDArray[np.float64]

DETECTOR = "mounting"
ASTRAY_S = 20.0
"""An attitude that is corrected with a time constant of some seconds is back after so long."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Mounting:
    """A device that is mounted otherwise than assumed, over a span of the table.

    Parameters
    ----------
    source
        Whose readings are turned back; one of ``among``, or the only one.
    among
        The devices that may be the one.
    start, stop
        First sample, and one past the last.
    turn
        How it is mounted.
    witness
        The derived source that told which, if it did.
    """

    source: str
    among: tuple[str, ...]
    start: int
    stop: int
    turn: Turn
    witness: str | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Mountings:
    """All that the rates of a flight tell of how its devices are mounted.

    Parameters
    ----------
    found
        In order of time.
    untold
        For each device that was compared, the body axes about which the flight turned too little
        to tell.
    """

    found: tuple[Mounting, ...] = ()
    untold: tuple[tuple[str, tuple[str, ...]], ...] = ()

    def notes(self) -> dict[str, str]:
        """Return what is to be said of each device beside its calibration."""
        notes = {
            source: f"turned too little about {', '.join(axes)} to tell how it is mounted"
            for source, axes in self.untold
        }
        for one in self.found:
            notes[one.source] = (
                "compared with its rates turned back: see the finding of kind mounting"
            )
        return notes


def mountings(table: ChannelTable, *, one_frame: bool = True) -> Mountings:
    """Find every device whose rates are those of another mounting than the table assumes.

    Parameters
    ----------
    one_frame
        Whether derived channels are known to be in the body frame of the gyros. If not, a single
        device may differ from them all along and still be mounted as it should be.

    Notes
    -----
    A single device has only the attitude to be held against, and an attitude that was led astray
    turns otherwise than its gyro too: for a while, and by any angle.
    """
    flight = Devices.of(table)
    found = sorted(
        (
            _decided(flight, source, others, turn)
            for source, others in flight.compared()
            for turn in turns(flight.reference(others), flight.means[source])
            if not _disputed(flight, others, turn)
            if others != flight.derived or _lasting(turn, one_frame)
        ),
        key=lambda one: (one.start, one.source),
    )
    if found:
        flight = Devices.of(turned_back(table, found))
    untold = (
        (source, untold_axes(flight.reference(others), flight.means[source]))
        for source, others in flight.compared()
    )
    return Mountings(
        found=tuple(found),
        untold=tuple((source, tuple(AXES[k] for k in axes)) for source, axes in untold if axes),
    )


def _lasting(turn: Turn, one_frame: bool) -> bool:
    """Tell whether a device is turned against an attitude as no attitude is that comes back."""
    if not turn.simple:
        return False
    if turn.begins is None and turn.ends is None:
        return one_frame
    return (turn.last - turn.first) * CELL_S >= ASTRAY_S


def turned_back(table: ChannelTable, found: Sequence[Mounting]) -> ChannelTable:
    """Return the table as if every device were mounted as it should be.

    A mounting that holds all along becomes the axes of its channels, whose readings stay as they
    are; one that begins or ends in flight has its readings turned back meanwhile.
    """
    for one in found:
        columns = triads_of(table)[one.source]
        axes = table.axes[columns]
        matrix = one.turn.matrix
        if one.start == 0 and one.stop == len(table.time_s):
            turned = axes @ matrix
            channels = list(table.channels)
            for k, axis in zip(columns, turned, strict=True):
                x, y, z = (float(component) + 0.0 for component in axis)
                channels[k] = replace(channels[k], axis=(x, y, z))
            table = replace(table, channels=tuple(channels))
            continue
        rate, valid = table.rate_rad_s.copy(), table.valid.copy()
        span = slice(one.start, one.stop)
        # The readings are H M w; H w is wanted.
        back = axes @ matrix.T @ np.linalg.inv(axes)
        whole = np.asarray(valid[span][:, columns].all(axis=1), bool)
        readings = np.where(whole[:, None], rate[span][:, columns], 0.0) @ back.T
        rate[span, columns] = np.where(whole[:, None], readings, np.nan)
        valid[span, columns] = whole[:, None]
        deviation = table.deviation_rad_s
        if deviation is not None:
            deviation = deviation.copy()
            deviation[span, columns] = deviation[span][:, columns] @ back.T
        table = replace(table, rate_rad_s=rate, valid=valid, deviation_rad_s=deviation)
    return table


def mounting_findings(table: ChannelTable, found: Sequence[Mounting]) -> list[Finding]:
    """Turn mountings into findings, one for each device and span."""
    findings = []
    alone = len({channel.source for channel in table.gyros.channels}) == 1
    for one in found:
        differs = one.turn.differs
        proper = bool((np.linalg.det(one.turn.standing) > 0).any())
        # A device that is turned is wrong as a whole; an inverted axis is that axis' fault alone.
        concerned = [
            channel.name
            for source in one.among
            for channel in table.channels
            if channel.source == source
            and (proper or bool(differs @ (np.abs(channel.axis) > 1.0 - PARALLEL)))
        ]
        findings.append(
            Finding(
                kind="mounting",
                suspects=tuple(concerned),
                start_s=float(table.time_s[one.start]),
                end_s=float(table.time_s[one.stop - 1]),
                detectors=(DETECTOR,),
                witness=one.witness,
                detail=described(one.turn, one.source, one.among, one.witness, alone=alone),
                one_source=len(one.among) == 1,
            )
        )
    return findings


def _disputed(flight: Devices, names: Sequence[str], turn: Turn) -> bool:
    """Whether some of these are turned against one another meanwhile: no reference then."""
    return any(
        other.first < turn.last and other.last > turn.first
        for a, b in combinations(names, 2)
        for other in turns(flight.means[a], flight.means[b])
    )


def _odds(flight: Devices, source: str, turn: Turn) -> float:
    """Tell how much better than the identity a mounting explains a device by the attitude."""
    cells = Cells.of(flight.means[flight.derived[0]], flight.means[source], (turn.matrix,))
    return cells.gained(turn.first, turn.last)


def _edge(
    flight: Devices, cells: tuple[int, int], source: str, others: Sequence[str], turn: Turn
) -> Floats:
    """By how much a mounting lessens the sum of squares up to each sample of some cells."""
    inside = np.flatnonzero((flight.cell >= cells[0]) & (flight.cell <= cells[1]))
    reading = centred(flight.rate[source])[inside]
    rate = np.mean([centred(flight.rate[name])[inside] for name in others], axis=0)
    left = (reading - rate) ** 2 - (reading - rate @ turn.matrix.T) ** 2
    known = np.isfinite(left).all(axis=1)
    gain = np.where(known, np.where(known[:, None], left, 0.0).sum(axis=1), 0.0)
    return np.concatenate([[0.0], np.cumsum(gain)])


def _span(flight: Devices, source: str, others: Sequence[str], turn: Turn) -> tuple[int, int]:
    """First sample of a mounting, and one past its last: the edges of least squares."""
    start, stop = np.searchsorted(flight.cell, [turn.first, turn.last])
    if turn.begins is not None:
        start = np.searchsorted(flight.cell, turn.begins[0])
        start += _edge(flight, turn.begins, source, others, turn).argmin()
    if turn.ends is not None:
        stop = np.searchsorted(flight.cell, turn.ends[0])
        stop += _edge(flight, turn.ends, source, others, turn).argmax()
    return int(start), int(stop)


def _decided(flight: Devices, source: str, others: Sequence[str], turn: Turn) -> Mounting:
    """Say who is turned: the one against several that agree, or whom the attitude names."""
    start, stop = _span(flight, source, others, turn)
    one = Mounting(source=source, among=(source,), start=start, stop=stop, turn=turn)
    if others == flight.derived:
        return replace(one, witness=flight.derived[0])
    both = replace(one, among=(*others, source))
    unwitnessed = one if len(others) > 1 else both
    if not flight.derived:
        return unwitnessed
    back = replace(turn, matrix=turn.matrix.T, standing=np.swapaxes(turn.standing, 1, 2))
    odds = {source: _odds(flight, source, turn)}
    odds |= {name: _odds(flight, name, back) for name in others}
    turned = {name for name, value in odds.items() if value > LEAST_GAIN}
    sound = {name for name, value in odds.items() if value < -LEAST_GAIN}
    if turned == {source} and sound == set(others):
        return replace(one, witness=flight.derived[0])
    if turned == set(others) and sound == {source}:
        # The attitude goes with the one that differs from all others.
        if len(others) > 1:
            return both
        return replace(
            one, source=others[0], among=(others[0],), turn=back, witness=flight.derived[0]
        )
    return unwitnessed
