"""Whether one triad of gyros is mounted otherwise than another, from their rates alone.

Two triads that point the same way read the same body rate. If one is turned, or has an axis the
wrong way round, it reads ``M w`` with M orthogonal: one of the 48 signed permutations, or a turn by
any other angle. Each half second in which the vehicle turns tells by how much better M explains
the readings than the identity does; a span in which that adds up is one in which M holds.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations, product

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.student import student_quantile
from fdilog.table import PARALLEL

Floats = NDArray[np.float64]

CELL_S = 0.5
"""Means over half a second: manoeuvres take longer than this, vibration is faster."""

LEAST_MOTION_RAD_S = float(np.radians(3.0))
"""Three times the tolerance for biases; below it two healthy gyros may differ by as much."""

MOTION_SIGMAS = 3.0
"""A cell tells if its rate is this many times the usual difference of the two."""

FIT = 0.25
"""Share of the motion that a mounting may leave unexplained in a cell and still be a good fit:
scale errors, small misalignments and time offsets of healthy gyros together leave less."""

LEAST_GAIN = 20.0
"""A mounting is believed when it explains the readings e^20 times better, and ..."""

FEWEST_TELLING = 10
"""... at least so many half seconds each favour it by a factor of e or more."""

FOLLOWED = 0.5
"""In half of those cells it explains at least half of the motion."""

STANDING = float(np.log(1000.0))
"""Other mountings a thousand times less likely than the best are no longer thought of."""

PIECES = 12
"""The flight is cut into this many pieces, each of which proposes one turn by any angle."""

CONFIDENCE = 0.999
"""That a turn by any angle is further than `PARALLEL` from a simple one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Turn:
    """A mounting other than the one that is assumed, over some cells.

    Parameters
    ----------
    first, last
        First cell, and one past the last.
    matrix : (3, 3)
        M: the readings are M times the body rate. [1]
    standing : (n, 3, 3)
        All that explain the readings about as well, ``matrix`` among them. [1]
    begins, ends
        Cells from the last that speaks for the one mounting to the first that speaks for the other,
        both counted in; nothing where it holds from the first cell, or to the last.
    """

    first: int
    last: int
    matrix: Floats
    standing: Floats
    begins: tuple[int, int] | None
    ends: tuple[int, int] | None

    @property
    def simple(self) -> bool:
        """Whether axes are swapped or inverted, and nothing is turned by another angle."""
        return bool((self.matrix == signed_permutations()).all(axis=(1, 2)).any())

    @property
    def differs(self) -> NDArray[np.bool_]:
        """Which of the readings x, y, z are not those of that body axis, whatever stands, (3,)."""
        off = np.abs(np.einsum("nii->ni", self.standing) - 1.0) > 1.0 - PARALLEL
        return np.asarray(off.all(axis=0), bool)


@cache
def signed_permutations() -> Floats:
    """All 48 ways in which three axes can be swapped and inverted, the identity first."""
    return np.array(
        [
            np.diag(signs)[:, list(order)]
            for order in permutations(range(3))
            for signs in product((1.0, -1.0), repeat=3)
        ]
    )


def turns(rate: Floats, reading: Floats) -> list[Turn]:
    """Find the spans in which one triad is mounted otherwise than assumed, in order of time.

    Parameters
    ----------
    rate, reading : (n_cells, 3)
        Body rate w by the other sources, and what the triad reads, both along body x, y, z and
        averaged over `CELL_S`; not-a-number where there is none. [rad/s]
    """
    cells = Cells.of(rate, reading)
    found: list[Turn] = []
    todo = [(0, len(rate))]
    while todo:
        first, last = todo.pop()
        turn = cells.best(first, last)
        if turn is not None:
            found.append(turn)
            todo += [(first, turn.first), (turn.last, last)]
    return sorted(found, key=lambda turn: turn.first)


@dataclass(frozen=True, kw_only=True, eq=False)
class Cells:
    """What every cell says of every mounting that is thought of.

    Parameters
    ----------
    rate, reading : (n, 3)
        Without their usual levels, so that a constant offset is none. [rad/s]
    mountings : (k, 3, 3)
        The identity first. [1]
    apart : (n, k)
        Distance of the reading from what the mounting says. [rad/s]
    gain : (n, k)
        Logarithm of how much better than the identity it explains the cell. [1]
    """

    rate: Floats
    reading: Floats
    mountings: Floats
    apart: Floats
    gain: Floats

    @classmethod
    def of(cls, rate: Floats, reading: Floats, more: Sequence[Floats] = ()) -> Cells:
        """Lay out all cells of a flight; ``more`` are mountings to think of, (3, 3) each."""
        known = np.asarray((np.isfinite(rate) & np.isfinite(reading)).all(axis=1), bool)
        level = np.zeros(3) if not known.any() else np.median(rate[known], axis=0)
        w = np.where(known[:, None], rate - level, 0.0)
        level = np.zeros(3) if not known.any() else np.median(reading[known], axis=0)
        z = np.where(known[:, None], reading - level, 0.0)
        mountings = np.concatenate(
            [signed_permutations(), _proposed(w, z), *(m[None] for m in more)]
        )
        apart = np.column_stack([np.linalg.norm(z - w @ matrix.T, axis=1) for matrix in mountings])
        size = np.linalg.norm(w, axis=1)
        usual = np.median(apart[known], axis=0) if known.any() else np.zeros(len(mountings))
        # The better of the two mountings that are compared tells what is usual between them.
        least = np.maximum(LEAST_MOTION_RAD_S, MOTION_SIGMAS * np.minimum(usual, usual[0]))
        said = _said(apart, size[:, None])
        gain = np.where(size[:, None] > least, said - said[:, :1], 0.0)
        return cls(rate=w, reading=z, mountings=mountings, apart=apart, gain=gain)

    def best(self, first: int, last: int) -> Turn | None:
        """Find the mounting and the span within some cells that explain most, if any is sure."""
        inside = self.gain[first:last]
        if len(inside) < FEWEST_TELLING:
            return None
        total = np.concatenate([np.zeros((1, inside.shape[1])), np.cumsum(inside, axis=0)])
        lowest = np.minimum.accumulate(total, axis=0)
        stop = (total - lowest).argmax(axis=0)
        each = np.arange(inside.shape[1])
        sums = (total - lowest)[stop, each]
        for k in _in_order(sums, self.mountings):
            if sums[k] < LEAST_GAIN:
                break
            b = int(stop[k])
            a = int(total[: b + 1, k].argmin())
            a, b = first + a, first + b
            simple = self._simplest(k, a, b)
            if simple and self._sure(simple, a, b) and not self._offset(simple, a, b):
                return self._turn(simple, a, b, (first, last))
        return None

    def _sure(self, k: int, first: int, last: int) -> bool:
        """Whether enough cells speak for a mounting, and it explains their motion."""
        rows = first + np.flatnonzero(self.gain[first:last, k] > 1.0)
        if len(rows) < FEWEST_TELLING:
            return False
        share = self.apart[rows, k] / np.linalg.norm(self.rate[rows], axis=1)
        return bool(np.median(share) < FOLLOWED)

    def _offset(self, k: int, first: int, last: int) -> bool:
        """Whether a constant error explains a span better than a mounting, beyond doubt.

        While a gyro is off by far more than the vehicle turns, whatever turns that axis explains a
        part of it.
        """
        rows = first + np.flatnonzero(self.gain[first:last, k])
        apart = self.reading[rows] - self.rate[rows]
        left = np.linalg.norm(apart - np.median(apart, axis=0), axis=1)
        size = np.linalg.norm(self.rate[rows], axis=1)
        better = _said(left, size) - _said(self.apart[rows, k], size)
        return bool(better.sum() > LEAST_GAIN)

    def _simplest(self, k: int, first: int, last: int) -> int:
        """Return the simple mounting from which a turn by any angle does not surely differ."""
        plain = signed_permutations()
        if k < len(plain):
            return k
        rate, reading = self.rate[first:last], self.reading[first:last]
        matrix = _rotation(rate, reading)
        near = int(np.einsum("kij,ij->k", plain, matrix).argmax())
        # The jackknife: how the angle changes as each piece of the span is left out.
        left_out = [np.delete(np.arange(last - first), piece) for piece in _pieces(last - first)]
        angles = np.array([_angle(_rotation(rate[r], reading[r]), plain[near]) for r in left_out])
        n = len(angles)
        sigma = np.sqrt((n - 1) / n * float(((angles - angles.mean()) ** 2).sum()))
        quantile = float(student_quantile(np.array([n - 1.0]), CONFIDENCE)[0])
        apart = _angle(matrix, plain[near]) - quantile * sigma
        return k if apart > np.arccos(PARALLEL) else near

    def _turn(self, k: int, first: int, last: int, within: tuple[int, int]) -> Turn:
        sums = self.gain[first:last].sum(axis=0)
        stands = sums > max(sums[k] - STANDING, 0.0)
        matrix, plain = self.mountings[k], len(signed_permutations())
        if k >= plain:
            matrix = _rotation(self.rate[first:last], self.reading[first:last])
        stands[k] = False
        stands[plain:] = False
        # Before and after it nothing may speak for the identity: then it held there too.
        gain = self.gain[within[0] : within[1], k]
        against = within[0] + np.flatnonzero(gain < -1.0)
        telling = within[0] + np.flatnonzero(gain > 1.0)
        telling = telling[(telling >= first) & (telling < last)]
        before, after = against[against < first], against[against >= last]
        return Turn(
            first=first if len(before) else within[0],
            last=last if len(after) else within[1],
            matrix=matrix,
            standing=np.concatenate([matrix[None], self.mountings[stands]]),
            begins=(int(before[-1]), int(telling[0])) if len(before) else None,
            ends=(int(telling[-1]), int(after[0])) if len(after) else None,
        )

    def gained(self, first: int, last: int) -> float:
        """Logarithm of how much better than the identity the last mounting explains a span."""
        return float(self.gain[first:last, -1].sum())


def _said(apart: Floats, size: Floats) -> Floats:
    """Log odds of a distance from what is expected of cells, given the size of their rates."""
    odds: Floats = -np.log1p((apart / (FIT * np.maximum(size, LEAST_MOTION_RAD_S))) ** 2)
    return odds


def untold_axes(rate: Floats, reading: Floats) -> list[int]:
    """List the body axes about which a flight turns too little to tell an inverted gyro."""
    found = []
    for axis in range(3):
        inverted = np.ones(3)
        inverted[axis] = -1.0
        if Cells.of(rate, reading * inverted).best(0, len(rate)) is None:
            found.append(axis)
    return found


def _in_order(sums: Floats, mountings: Floats) -> Iterator[int]:
    """Order mountings by what they explain; of those that explain alike, simple turns come first.

    A device can be turned by its installer; an axis is inverted by a mistake in software. A turn by
    any angle has three free numbers, and always fits better than it should.
    """
    alike = sums > float(sums.max()) - STANDING
    plain = np.arange(len(sums)) < len(signed_permutations())
    proper = np.linalg.det(mountings) > 0
    moved = 3.0 - np.einsum("kii->k", mountings)
    keys = (-sums, np.where(alike, moved, 0.0), ~(proper & alike), ~(plain & alike), ~alike)
    yield from np.lexsort(keys).tolist()


def _proposed(rate: Floats, reading: Floats) -> Floats:
    """Propose turns by any angle, one from each piece of a flight, (n, 3, 3)."""
    found = []
    for piece in _pieces(len(rate)):
        matrix = _rotation(rate[piece], reading[piece])
        far = np.einsum("kij,ij->k", signed_permutations(), matrix)
        # Within ten degrees of what is thought of already it is no other mounting.
        if (far < 1.0 + 2.0 * PARALLEL).all():
            found.append(matrix)
    return np.array(found).reshape(-1, 3, 3)


def _pieces(n: int) -> list[NDArray[np.int64]]:
    return np.array_split(np.arange(n), PIECES)


def _angle(matrix: Floats, other: Floats) -> float:
    """Angle between two rotations. [rad]"""
    return float(np.arccos(np.clip((np.einsum("ij,ij->", matrix, other) - 1.0) / 2.0, -1.0, 1.0)))


def _rotation(rate: Floats, reading: Floats) -> Floats:
    """Rotation matrix that turns rates into readings best (least squares).

    References
    ----------
    G. Wahba, "A least squares estimate of satellite attitude", SIAM Review 7(3), 1965, 409; solved
    by the singular value decomposition.
    """
    u, _, vt = np.linalg.svd(reading.T @ rate)
    sign = np.diag([1.0, 1.0, float(np.linalg.det(u) * np.linalg.det(vt))])
    matrix: Floats = u @ sign @ vt
    return matrix
