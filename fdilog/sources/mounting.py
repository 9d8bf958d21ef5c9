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
from fdilog.sources.mounting_words import AXES, described
from fdilog.sources.turned import (
    CELL_S,
    FIT,
    LEAST_GAIN,
    LEAST_MOTION_RAD_S,
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

FEWEST_IN_CELL = 0.5
"""A cell needs half of its usual readings; the mean over fewer belongs to another time."""


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
    flight = _Flight.of(table)
    found = sorted(
        (
            _decided(flight, source, others, turn)
            for source, others in flight.compared()
            for turn in turns(flight.reference(others), flight.means[source])
            if not flight.disputed(others, turn)
            if others != flight.derived or _lasting(turn, one_frame)
        ),
        key=lambda one: (one.start, one.source),
    )
    if found:
        flight = _Flight.of(turned_back(table, found))
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
        columns = _triads(table)[one.source]
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


@dataclass(frozen=True, kw_only=True, eq=False)
class _Flight:
    """Every triad of a table, sample by sample and cell by cell.

    Parameters
    ----------
    cell : (n_samples,)
        Number of the cell of each sample.
    rate, means : each (n_samples, 3), (n_cells, 3)
        Body rate by each triad, not-a-number where there is none. [rad/s]
    """

    table: ChannelTable
    gyros: list[str]
    derived: list[str]
    cell: NDArray[np.int64]
    rate: dict[str, Floats]
    means: dict[str, Floats]

    @classmethod
    def of(cls, table: ChannelTable) -> _Flight:
        cell = _cells(table)
        rate: dict[str, Floats] = {}
        gyros: list[str] = []
        derived: list[str] = []
        for name, columns in _triads(table).items():
            rate[name] = table.rate_rad_s[:, columns] @ np.linalg.inv(table.axes[columns]).T
            (derived if table.channels[columns[0]].derived else gyros).append(name)
        means = {name: _cell_means(cell, one) for name, one in rate.items()}
        return cls(table=table, gyros=gyros, derived=derived, cell=cell, rate=rate, means=means)

    def compared(self) -> list[tuple[str, list[str]]]:
        """List every device that can be compared, and with which others."""
        if len(self.gyros) == 1:
            return [(self.gyros[0], self.derived)] if self.derived else []
        # Of two devices each is turned against the other; asking once will do.
        asked = self.gyros if len(self.gyros) > 2 else self.gyros[1:]
        return [(name, [other for other in self.gyros if other != name]) for name in asked]

    def reference(self, names: Sequence[str]) -> Floats:
        """Mean body rate of several devices in the cells in which they agree, (n_cells, 3)."""
        centred = np.array([_centred(self.means[name]) for name in names])
        middle = np.asarray(centred.mean(axis=0))
        apart = np.linalg.norm(centred - middle, axis=2).max(axis=0)
        with np.errstate(invalid="ignore"):
            alike = apart < np.maximum(LEAST_MOTION_RAD_S, FIT * np.linalg.norm(middle, axis=1))
        return np.where(np.asarray(alike, bool)[:, None], middle, np.nan)

    def disputed(self, names: Sequence[str], turn: Turn) -> bool:
        """Whether some of these are turned against one another meanwhile: no reference then."""
        return any(
            other.first < turn.last and other.last > turn.first
            for a, b in combinations(names, 2)
            for other in turns(self.means[a], self.means[b])
        )

    def odds(self, source: str, turn: Turn) -> float:
        """Tell how much better than the identity a mounting explains a device by the attitude."""
        cells = Cells.of(self.means[self.derived[0]], self.means[source], (turn.matrix,))
        return cells.gained(turn.first, turn.last)

    def edge(
        self, cells: tuple[int, int], source: str, others: Sequence[str], turn: Turn
    ) -> Floats:
        """By how much a mounting lessens the sum of squares up to each sample of some cells."""
        inside = np.flatnonzero((self.cell >= cells[0]) & (self.cell <= cells[1]))
        reading = _centred(self.rate[source])[inside]
        rate = np.mean([_centred(self.rate[name])[inside] for name in others], axis=0)
        left = (reading - rate) ** 2 - (reading - rate @ turn.matrix.T) ** 2
        known = np.isfinite(left).all(axis=1)
        gain = np.where(known, np.where(known[:, None], left, 0.0).sum(axis=1), 0.0)
        return np.concatenate([[0.0], np.cumsum(gain)])

    def span(self, source: str, others: Sequence[str], turn: Turn) -> tuple[int, int]:
        """First sample of a mounting, and one past its last: the edges of least squares."""
        start, stop = np.searchsorted(self.cell, [turn.first, turn.last])
        if turn.begins is not None:
            start = np.searchsorted(self.cell, turn.begins[0])
            start += self.edge(turn.begins, source, others, turn).argmin()
        if turn.ends is not None:
            stop = np.searchsorted(self.cell, turn.ends[0])
            stop += self.edge(turn.ends, source, others, turn).argmax()
        return int(start), int(stop)


def _triads(table: ChannelTable) -> dict[str, list[int]]:
    """Columns of every source of three gyros that sense three axes."""
    found = {}
    for source in dict.fromkeys(channel.source for channel in table.channels):
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        if len(columns) == 3 and np.linalg.matrix_rank(table.axes[columns]) == 3:
            found[source] = columns
    return found


def _cells(table: ChannelTable) -> NDArray[np.int64]:
    """Cell of each sample; a hole of any length is one cell, so that it costs nothing."""
    number = np.floor(table.time_s / CELL_S).astype(np.int64)
    steps = np.minimum(np.diff(number), 2)
    return np.concatenate([np.zeros(min(len(number), 1), np.int64), np.cumsum(steps)])


def _cell_means(cell: NDArray[np.int64], rate: Floats) -> Floats:
    """Mean body rate in each cell, (n_cells, 3)."""
    n = int(cell[-1]) + 1 if len(cell) else 0
    known = np.asarray(np.isfinite(rate).all(axis=1), bool)
    count = np.bincount(cell[known], minlength=n)
    sums = [np.bincount(cell[known], weights=one, minlength=n) for one in rate[known].T]
    usual = float(np.median(count[count > 0])) if count.any() else 1.0
    means = np.column_stack(sums) / np.maximum(count, 1)[:, None]
    return np.where((count > FEWEST_IN_CELL * usual)[:, None], means, np.nan)


def _centred(rate: Floats) -> Floats:
    """Rates less their median over the flight, so that a constant offset is none."""
    known = np.isfinite(rate).all(axis=1)
    return np.asarray(rate - np.median(rate[known], axis=0)) if known.any() else rate


def _decided(flight: _Flight, source: str, others: Sequence[str], turn: Turn) -> Mounting:
    """Say who is turned: the one against several that agree, or whom the attitude names."""
    start, stop = flight.span(source, others, turn)
    one = Mounting(source=source, among=(source,), start=start, stop=stop, turn=turn)
    if others == flight.derived:
        return replace(one, witness=flight.derived[0])
    both = replace(one, among=(*others, source))
    unwitnessed = one if len(others) > 1 else both
    if not flight.derived:
        return unwitnessed
    back = replace(turn, matrix=turn.matrix.T, standing=np.swapaxes(turn.standing, 1, 2))
    odds = {source: flight.odds(source, turn)}
    odds |= {name: flight.odds(name, back) for name in others}
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
