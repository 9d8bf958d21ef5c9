"""Where a fault begins and ends, and of what shape it is: least squares over both edges.

Outside of a fault the residual of a channel is its usual level plus noise; inside it follows one
of few shapes with one unknown size. The edges and the shape that leave the least sum of squares
are those with the largest gain ``(sum y s)^2 / sum s^2`` over the samples inside, with y the
residual less its level and s the shape. All shapes have the same number of unknowns.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Kind

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]
Products = Callable[[Rows, Rows], tuple[Floats, Floats]]

# Edges are first looked for among this many bins, then among samples.
EDGE_BINS = 400


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A fault of one shape between two samples.

    Parameters
    ----------
    start, stop
        First sample, one past the last.
    gain
        By how much it lessens the sum of squares. [(rad/s)^2]
    size
        Step [rad/s], rate of drift [rad/s^2], or relative scale error [1].
    """

    kind: Kind
    start: int
    stop: int
    gain: float
    size: float


def best_step(residual: Floats, weight: Floats | None = None) -> Shape:
    """Find the span over which a constant explains most of a residual.

    Parameters
    ----------
    residual : (n,)
        Residual less its level outside. [rad/s]
    weight : (n,)
        What each sample counts, all alike by default. [1]
    """
    alike = np.ones(len(residual))
    return _best("bias", residual, alike, alike if weight is None else weight)


def best_scale(residual: Floats, predicted: Floats) -> Shape:
    """Find the span over which a multiple of the predicted rate explains most of a residual.

    Parameters
    ----------
    predicted : (n,)
        What the other channels say the reading is. [rad/s]
    """
    return _best("scale", residual, predicted, np.ones(len(residual)))


def best_ramp(residual: Floats, time_s: Floats) -> Shape:
    """Find the span over which a drift from zero explains most of a residual.

    Parameters
    ----------
    time_s : (n,)
        Times of the samples. [s]
    """
    elapsed = time_s - time_s[0]
    sums = [_sums(x) for x in (residual, residual * elapsed, elapsed, elapsed**2)]

    def products(a: Rows, b: Rows) -> tuple[Floats, Floats]:
        y, yt, t, tt = (total[b][None, :] - total[a][:, None] for total in sums)
        onset = elapsed[np.minimum(a, len(elapsed) - 1)][:, None]
        count = (b[None, :] - a[:, None]).astype(float)
        return yt - onset * y, tt - 2.0 * onset * t + onset**2 * count

    return _search("drift", len(residual), products)


def _best(kind: Kind, residual: Floats, shape: Floats, weight: Floats) -> Shape:
    with_residual, alone = _sums(weight * residual * shape), _sums(weight * shape**2)

    def products(a: Rows, b: Rows) -> tuple[Floats, Floats]:
        return (
            with_residual[b][None, :] - with_residual[a][:, None],
            alone[b][None, :] - alone[a][:, None],
        )

    return _search(kind, len(residual), products)


def _sums(values: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(values)])


def _search(kind: Kind, n: int, products: Products) -> Shape:
    """Search bins first, then samples near the best edges."""
    edges = np.unique(np.linspace(0, n, min(n, EDGE_BINS) + 1).astype(np.int64))
    step = int(np.diff(edges).max())
    found = _largest(kind, edges, edges, products)
    for _ in range(2):
        near_start = np.arange(max(0, found.start - step), min(n - 1, found.start + step) + 1)
        found = _largest(kind, near_start, np.array([found.stop]), products)
        near_stop = np.arange(max(1, found.stop - step), min(n, found.stop + step) + 1)
        found = _largest(kind, np.array([found.start]), near_stop, products)
    return found


def _largest(kind: Kind, starts: Rows, stops: Rows, products: Products) -> Shape:
    with_residual, alone = products(starts, stops)
    inside = (stops[None, :] > starts[:, None]) & (alone > 0.0)
    gain = np.where(inside, with_residual**2 / np.where(inside, alone, 1.0), -1.0)
    a, b = np.unravel_index(int(gain.argmax()), gain.shape)
    size = float(with_residual[a, b] / alone[a, b]) if inside[a, b] else 0.0
    return Shape(
        kind=kind, start=int(starts[a]), stop=int(stops[b]), gain=float(gain[a, b]), size=size
    )
