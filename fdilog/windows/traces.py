"""What one channel is off by, sample by sample, against the others that sense its axis."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.geometry import leave_one_out
from fdilog.maths.noise import robust_sigma, windowed_mean
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape
from fdilog.windows.survey import FEWEST_PRESENT
from fdilog.windows.usual import usual

# Manoeuvres take longer than this, vibration is faster. [s]
MANOEUVRE_S = 0.5
# Vibration is taken as even over stretches of this length, and of this many samples at least.
EVEN_S = 1.0
FEWEST_EVEN = 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """What one channel is off by, sample by sample, against the others of its block.

    Parameters
    ----------
    rows, last : (n,) int64
        Samples of the table; of means, the first and the last that were averaged.
    time_s, residual, predicted : (n,)
        Their times [s], reading less prediction less the level outside the region [rad/s], and
        prediction [rad/s].
    """

    rows: NDArray[np.int64]
    last: NDArray[np.int64]
    time_s: NDArray[np.float64]
    residual: NDArray[np.float64]
    predicted: NDArray[np.float64]

    def placed(self, shape: Shape) -> Shape:
        """Return a shape found in this trace with its samples counted in the table."""
        start, stop = int(self.rows[shape.start]), int(self.last[shape.stop - 1]) + 1
        return replace(shape, start=start, stop=stop)

    def holds(self, shape: Shape) -> bool:
        """Whether a shape found in this trace begins and ends within."""
        return shape.start > 0 and shape.stop < len(self.rows)

    def averaged(self) -> Trace:
        """Return means over `MANOEUVRE_S`, in which motion is left and vibration is not.

        The prediction holds the vibration of the gyros that it is made of, the residual the same
        with the opposite sign: sample by sample, that alone looks like a scale error.
        """
        bins = np.floor(self.time_s / MANOEUVRE_S)
        first = np.flatnonzero(np.concatenate([[True], np.diff(bins) > 0]))
        count = np.diff(np.append(first, len(bins)))
        return Trace(
            rows=self.rows[first],
            last=self.last[first + count - 1],
            time_s=np.add.reduceat(self.time_s, first) / count,
            residual=np.add.reduceat(self.residual, first) / count,
            predicted=np.add.reduceat(self.predicted, first) / count,
        )

    def weight(self) -> NDArray[np.float64]:
        """Weigh the samples, (n,): one where they are as noisy as usual or less, else below.

        Inverse to the variance, relative to the usual one, of a stretch of `EVEN_S`. Without it, a
        second of hard vibration holds a larger step by chance than a quiet fault beside it.
        """
        n = len(self.residual)
        step = max(int(np.searchsorted(self.time_s - self.time_s[0], EVEN_S)), FEWEST_EVEN)
        first = np.arange(0, max(n - FEWEST_EVEN, 1), step)
        spread = np.array([robust_sigma(part) for part in np.split(self.residual, first[1:])])
        usual = float(np.median(spread))
        share = np.minimum(1.0, usual / np.where(spread > 0.0, spread, usual or 1.0)) ** 2
        return np.repeat(
            share if usual > 0.0 else np.ones(len(first)), np.diff(np.append(first, n))
        )

    def noise_about(self, shape: Shape) -> tuple[float, float]:
        """Long-run noise variance per sample about a shape of this trace, and its dof."""
        inside = slice(shape.start, shape.stop)
        form = self.form(shape)
        looks = windowed_mean((self.residual[inside] - shape.size * form)[None, :, None])
        return float(looks.covariance[0, 0, 0]) * len(form), float(looks.dof[0])

    def form(self, shape: Shape) -> NDArray[np.float64]:
        """Shape of size one over its own span."""
        inside = slice(shape.start, shape.stop)
        forms = {"drift": self.time_s - self.time_s[shape.start], "scale": self.predicted}
        form: NDArray[np.float64] = forms.get(shape.kind, np.ones(len(self.time_s)))[inside]
        return form


def trace_of(
    table: ChannelTable, channel: int, removed: frozenset[int], first: int, last: int
) -> Trace | None:
    """Trace one channel from the first sample up to the last, or nothing if it cannot be."""
    absent = np.flatnonzero(table.valid[first:last].mean(axis=0) < FEWEST_PRESENT)
    without = sorted(removed.union(absent.tolist()) - {channel})
    row = leave_one_out(table.axes, without, usual(table).sigma)[channel]
    if not bool(np.isfinite(row).all()):
        return None
    needed = np.flatnonzero(row != 0)
    complete = np.asarray(table.valid[:, needed].all(axis=1), bool)
    residual = np.full(len(complete), np.nan)
    residual[complete] = table.rate_rad_s[complete][:, needed] @ row[needed]
    inside = np.zeros(len(complete), bool)
    inside[first:last] = True
    rows = np.flatnonzero(complete & inside)
    if len(rows) < 3:
        return None
    outside = complete & ~inside
    # With little left outside, the usual level is not known and zero is what it should be.
    level = float(np.median(residual[outside])) if outside.sum() >= len(rows) / 4 else 0.0
    return Trace(
        rows=rows,
        last=rows,
        time_s=table.time_s[rows],
        residual=residual[rows] - level,
        predicted=table.rate_rad_s[rows, channel] - residual[rows],
    )
