"""Devices of three gyros, laid out for comparing each as a whole with the others.

A device that is mounted wrongly, or reads in another unit, disagrees with the others about
everything. Before channels are compared one by one, whole devices are, over means of half a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.sources.turned import CELL_S, FIT, LEAST_MOTION_RAD_S
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

FEWEST_IN_CELL = 0.5
"""A cell needs half of its usual readings; the mean over fewer belongs to another time."""

FEWEST_REPEATED = 5
"""Fewer readings of one value in a row are what quantisation makes of slow turns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Devices:
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
    def of(cls, table: ChannelTable) -> Devices:
        """Lay out the devices of a table."""
        cell = _cells(table)
        rate: dict[str, Floats] = {}
        told: dict[str, NDArray[np.bool_]] = {}
        gyros: list[str] = []
        derived: list[str] = []
        for name, columns in triads_of(table).items():
            rate[name] = table.rate_rad_s[:, columns] @ np.linalg.inv(table.axes[columns]).T
            (derived if table.channels[columns[0]].derived else gyros).append(name)
            told[name] = ~_repeating(cell, table.rate_rad_s[:, columns])
        means = {name: _cell_means(cell, one, told[name]) for name, one in rate.items()}
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
        rates = np.array([centred(self.means[name]) for name in names])
        middle = np.asarray(rates.mean(axis=0))
        apart = np.linalg.norm(rates - middle, axis=2).max(axis=0)
        with np.errstate(invalid="ignore"):
            alike = apart < np.maximum(LEAST_MOTION_RAD_S, FIT * np.linalg.norm(middle, axis=1))
        return np.where(np.asarray(alike, bool)[:, None], middle, np.nan)


def triads_of(table: ChannelTable) -> dict[str, list[int]]:
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


def _repeating(cell: NDArray[np.int64], readings: Floats) -> NDArray[np.bool_]:
    """Tell in which cells some gyro of a device does nothing but repeat one reading, (n_cells,).

    It stands still, or that gyro is stuck or at full scale: neither tells of the device.
    """
    found = np.zeros(int(cell[-1]) + 1 if len(cell) else 0, bool)
    start = np.flatnonzero(np.diff(cell, prepend=-1))
    if not len(start):
        return found
    steps = np.abs(np.diff(readings, axis=0, prepend=np.nan))
    steps[start] = 0.0
    count = np.diff(np.append(start, len(cell)))
    still = np.add.reduceat(np.nan_to_num(steps, nan=1.0), start, axis=0) == 0.0
    found[cell[start]] = still.any(axis=1) & (count >= FEWEST_REPEATED)
    return found


def _cell_means(cell: NDArray[np.int64], rate: Floats, told: NDArray[np.bool_]) -> Floats:
    """Mean body rate in each cell, (n_cells, 3), where it is told."""
    n = int(cell[-1]) + 1 if len(cell) else 0
    known = np.asarray(np.isfinite(rate).all(axis=1), bool)
    count = np.bincount(cell[known], minlength=n)
    sums = [np.bincount(cell[known], weights=one, minlength=n) for one in rate[known].T]
    usual = float(np.median(count[count > 0])) if count.any() else 1.0
    means = np.column_stack(sums) / np.maximum(count, 1)[:, None]
    return np.where((told & (count > FEWEST_IN_CELL * usual))[:, None], means, np.nan)


def centred(rate: Floats) -> Floats:
    """Rates less their median over the flight, so that a constant offset is none."""
    known = np.isfinite(rate).all(axis=1)
    return np.asarray(rate - np.median(rate[known], axis=0)) if known.any() else rate
