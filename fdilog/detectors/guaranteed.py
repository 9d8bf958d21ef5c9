"""Guaranteed (set-membership) intervals of every channel's true reading [Matasov24].

A healthy channel errs by no more than its bound, at most ``max_failures`` channels may err by
anything.  For each subset W of channels that may have failed, the readings left confine the rate
w to a polytope ``|z_i - h_i'w| <= s_i, i not in W``; the true reading ``h_i'w`` lies between the
least and the greatest value over the polytopes that are not empty.

The source solves two linear programs per channel and subset.  None is solved here.  By duality the
greatest value over one polytope is the least of ``x . z + s . |x|`` over the basic solutions x of
``H'x = h_i`` with no weight on W, and each of them is either the channel itself or what a circuit
through channel i (`fdilog.maths.circuits`) says about it:

    h_i'w <= sum over l in C, l != i of (-c_l/c_i) z_l + |c_l/c_i| s_l

A subset is feasible if and only if every circuit outside it passes ``|c . z| <= s . |c|`` (Farkas'
lemma, the multipliers being a sum of circuits without cancellation).  So an instant costs one
product with a small matrix and some minima, and subsets that leave deficient rank or nothing at all
are covered: a channel through which no circuit is left is unbounded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.maths.circuits import find_circuits, linear_forms
from fdilog.maths.geometry import Floats, checked_readings

ROUNDING = 32 * np.finfo(float).eps
"""A check fails only when it does so by more than this share of the readings in it.

Readings that stand exactly on their bound (quantised ones often do) must not lose a subset to the
rounding of a four-term sum; the sum errs by 4 units of rounding, its coefficients by a few more.
"""

BLOCK = 5000
"""Samples worked on at a time: so many that the cost of a call hardly counts, so few that the
functionals of one channel (22 rows for six skewed gyros) fit a second-level cache of 1 MB; not a
power of two, or all rows would compete for the same places in that cache."""


_UNBOUNDED = np.array(np.inf)

_Terms = list[tuple[int, list[int]]]
"""Subsets of failed channels, and which functionals each allows to bound a target."""


@dataclass(frozen=True, kw_only=True)
class _Target:
    """What can bound the true reading of one channel.

    A functional is a basic solution x: the upper bound it gives is ``x . z + s . |x|``.  The last
    one is the channel itself, which holds only for subsets that keep the channel.
    """

    functionals: Floats  # (n_functionals, n)
    rows: Floats  # (2 n_functionals, n + 1), upper and negated lower bounds as a product by [z, 1]
    struck: _Terms  # subsets with the channel
    kept: _Terms  # subsets without it
    struck_all: _Terms  # those that count when every subset is feasible
    kept_all: _Terms


@dataclass(frozen=True, kw_only=True)
class _Plan:
    """All that depends on the geometry, the bounds and the number of failures alone."""

    relations: Floats  # (n_circuits, n)
    limits: Floats  # (n_circuits,), s . |c|
    subsets: list[NDArray[np.intp]]  # for each circuit, the subsets that need it to hold
    targets: list[_Target]
    widest: int  # rows of the target with most of them


def guaranteed_intervals(
    readings: ArrayLike, axes: ArrayLike, bound: ArrayLike, max_failures: int = 2
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Bound every channel's true reading, whichever channels have failed.

    Parameters
    ----------
    readings : (n_samples, n_channels)
        Readings z; a value that is not finite is missing, which strikes the channel out for that
        sample in addition to the failures allowed. [any unit of rate]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    bound : () or (n_channels,)
        Largest error s of a healthy channel. [unit of readings]
    max_failures
        How many channels k may have failed.

    Returns
    -------
    low, high : (n_samples, n_channels)
        Bounds of the true reading h_i'w; infinite where unbounded, NaN where no subset is feasible
        (the stated bound is violated). [unit of readings]
    feasible : (n_samples, n_subsets)
        Whether the channels left by each subset of ``combinations(range(n_channels), k)`` agree.

    Raises
    ------
    ValueError
        If the shapes do not fit one another, an axis is zero or not finite, a bound is negative or
        not a number, or ``max_failures`` is negative.

    Notes
    -----
    The arrays returned are stored channel by channel (Fortran order).  If ``max_failures`` exceeds
    the number of channels there is no subset; every channel may have failed and all is unbounded.

    A feasible subset whose polytope is a single point, or thinner than rounding, may give ends that
    cross by rounding; the two are then exchanged, so that low <= high and both are inside.

    References
    ----------
    [Matasov24], the l_min, l_max of its guaranteed estimation and the example.
    """
    z, directions = checked_readings(readings, axes)
    n_samples, n_channels = z.shape
    limits = np.asarray(bound, dtype=np.float64)
    if limits.shape not in {(), (n_channels,)}:
        raise ValueError(f"bound must be one number or {n_channels}, not {limits.shape}")
    if not (limits >= 0.0).all():
        raise ValueError("bound is negative or not a number")
    if max_failures < 0:
        raise ValueError(f"max_failures is negative: {max_failures}")

    low = np.empty((n_channels, n_samples))
    high = np.empty((n_channels, n_samples))
    n_subsets = comb(n_channels, max_failures)
    feasible = np.ones((n_subsets, n_samples), dtype=bool)
    if n_subsets == 0:
        low.fill(-np.inf)
        high.fill(np.inf)
        return low.T, high.T, feasible.T
    limits = np.broadcast_to(limits, n_channels)
    plan = _plan(directions.tobytes(), limits.tobytes(), n_channels, max_failures)
    work = _Workspace(plan, min(BLOCK, n_samples))
    for start in range(0, n_samples, BLOCK):
        part = slice(start, min(start + BLOCK, n_samples))
        if part.stop - start < work.length:
            work = _Workspace(plan, part.stop - start)
        work.load(z[part])
        work.check(feasible[:, part])
        work.bound(feasible[:, part], low[:, part], high[:, part])
    return low.T, high.T, feasible.T


@lru_cache(maxsize=16)
def _plan(axes_bytes: bytes, bound_bytes: bytes, n_channels: int, max_failures: int) -> _Plan:
    axes = np.frombuffer(axes_bytes).reshape(n_channels, 3)
    bound = np.frombuffer(bound_bytes)
    subsets = list(combinations(range(n_channels), max_failures))
    struck = np.zeros((len(subsets), n_channels), dtype=bool)
    for index, subset in enumerate(subsets):
        struck[index, list(subset)] = True
    relations = find_circuits(axes)
    inside = relations != 0.0

    targets = []
    for channel in range(n_channels):
        through = relations[inside[:, channel]]
        functionals = -through / through[:, [channel]]
        functionals[:, channel] = 0.0
        functionals = np.concatenate([functionals, np.eye(n_channels)[[channel]]])
        slack = _weighted(np.abs(functionals), bound)
        rows = np.empty((2 * len(functionals), n_channels + 1))
        rows[0::2, :-1] = functionals
        rows[1::2, :-1] = -functionals
        rows[:, -1] = np.repeat(slack, 2)
        allowed = ~_overlap(struck, functionals[:-1] != 0.0)
        terms = [(index, np.flatnonzero(row).tolist()) for index, row in enumerate(allowed)]
        with_channel = [term for term in terms if struck[term[0], channel]]
        without = [term for term in terms if not struck[term[0], channel]]
        targets.append(
            _Target(
                functionals=functionals,
                rows=rows,
                struck=with_channel,
                kept=without,
                struck_all=_essential(with_channel),
                kept_all=_essential(without),
            )
        )
    return _Plan(
        relations=relations,
        limits=_weighted(np.abs(relations), bound),
        subsets=[np.flatnonzero(row) for row in ~_overlap(inside, struck)],
        targets=targets,
        widest=max(len(target.rows) for target in targets),
    )


def _essential(terms: _Terms) -> _Terms:
    """Leave out subsets that allow all that another allows: their least is never the greatest."""
    found: dict[frozenset[int], int] = {}
    for subset, allowed in sorted(terms, key=lambda term: len(term[1])):
        functionals = frozenset(allowed)
        smaller = (other for other in found if len(other) < len(functionals))
        if functionals not in found and not any(other < functionals for other in smaller):
            found[functionals] = subset
    return [(subset, sorted(functionals)) for functionals, subset in found.items()]


def _weighted(weights: Floats, bound: Floats) -> Floats:
    """Sum weights times bound over channels; an infinite bound counts only where it has weight."""
    total: Floats = np.where(weights > 0.0, weights, 0.0) @ np.where(np.isfinite(bound), bound, 0.0)
    total[((weights > 0.0) & np.isinf(bound)).any(axis=1)] = np.inf
    return total


def _overlap(first: NDArray[np.bool_], second: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which rows of two membership tables share a channel."""
    return (first.astype(np.float32) @ second.T.astype(np.float32)) > 0.0


class _Workspace:
    """Reused buffers for one block of samples, and the three steps on it."""

    def __init__(self, plan: _Plan, length: int) -> None:
        n_circuits, n_channels = plan.relations.shape
        self.plan = plan
        self.length = length
        self.readings = np.ones((n_channels + 1, length))  # the last row multiplies the slack
        self.residuals = np.empty((n_circuits, length))
        self.buffer = np.empty(plan.widest * length)
        self.slots = self.buffer.reshape(plan.widest // 2, 2, length)
        self.best = np.empty((2, length))
        self.other = np.empty((2, length))
        self.spare = np.empty((2, length))
        self.missing: dict[int, Floats] = {}

    def load(self, readings: Floats) -> None:
        """Take the readings of the block; what is missing becomes zero and is remembered."""
        z = self.readings[:-1]
        np.copyto(z, readings.T)
        self.missing = {}
        finite = np.isfinite(z)
        if finite.all():
            return
        z[~finite] = 0.0
        for channel in np.flatnonzero(~finite.all(axis=1)).tolist():
            self.missing[channel] = np.where(finite[channel], -np.inf, np.inf)

    def check(self, feasible: NDArray[np.bool_]) -> None:
        """Say which subsets are feasible; ``feasible`` (n_subsets, length) comes in as true."""
        plan, z = self.plan, self.readings[:-1]
        if not len(plan.relations):
            return
        residuals = self.residuals
        linear_forms(plan.relations, z, out=residuals)
        np.abs(residuals, out=residuals)
        for channel, infinite in self.missing.items():
            through = plan.relations[:, channel] != 0.0
            residuals[through] = np.minimum(residuals[through], -infinite)
        if (residuals.max(axis=1) <= plan.limits).all():
            return
        sizes = np.empty_like(residuals)
        linear_forms((plan.relations != 0.0).astype(float), np.abs(z), out=sizes)
        holds = residuals <= plan.limits[:, None] + ROUNDING * sizes
        for circuit in np.flatnonzero(~np.logical_and.reduce(holds, axis=1)).tolist():
            feasible[plan.subsets[circuit]] &= holds[circuit]

    def bound(self, feasible: NDArray[np.bool_], low: Floats, high: Floats) -> None:
        """Write the bounds of all channels."""
        every = np.logical_and.reduce(feasible, axis=1)
        some = np.logical_or.reduce(feasible, axis=1).tolist()
        # What an infeasible subset may say is capped at minus infinity.
        caps = {
            index: np.where(feasible[index], np.inf, -np.inf)
            for index in np.flatnonzero(~every).tolist()
            if some[index]
        }
        for channel, target in enumerate(self.plan.targets):
            best = self._bound_channel(target, some, caps)
            np.negative(best[1], out=low[channel])
            high[channel] = best[0]
        lower = np.minimum(low, high)
        np.maximum(low, high, out=high)
        low[...] = lower
        if not every.any():
            none = ~np.logical_or.reduce(feasible, axis=0)
            low[:, none] = np.nan
            high[:, none] = np.nan

    def _bound_channel(self, target: _Target, some: list[bool], caps: dict[int, Floats]) -> Floats:
        """Upper and negated lower bound (2, length) of one channel's true reading."""
        count = len(target.functionals)
        rows = self.buffer[: 2 * count * self.length].reshape(2 * count, self.length)
        linear_forms(target.rows, self.readings, out=rows)
        slots = self.slots[:count]
        for gone, infinite in self.missing.items():
            for slot in np.flatnonzero(target.functionals[:, gone]).tolist():
                np.maximum(slots[slot], infinite, out=slots[slot])

        if all(some) and not caps:
            struck, kept = target.struck_all, target.kept_all
        else:
            struck = [term for term in target.struck if some[term[0]]]
            kept = [term for term in target.kept if some[term[0]]]

        best, own = self.best, slots[-1]
        _greatest(slots, struck, caps, best=best, spare=self.spare)
        # A subset that keeps the channel bounds it by its own reading at most.
        short = np.flatnonzero((best < own).any(axis=0))
        if len(short) > self.length // 4:
            _greatest(slots, kept, caps, best=self.other, spare=self.spare)
            np.minimum(self.other, own, out=self.other)
            np.maximum(best, self.other, out=best)
        elif len(short):
            few = slots.take(short, axis=2)
            few_caps = {index: cap[short] for index, cap in caps.items()}
            other, spare = np.empty((2, 2, len(short)))
            _greatest(few, kept, few_caps, best=other, spare=spare)
            best[:, short] = np.maximum(best[:, short], np.minimum(other, few[-1]))
        return best


def _greatest(
    slots: Floats, terms: _Terms, caps: dict[int, Floats], *, best: Floats, spare: Floats
) -> None:
    """Put into ``best`` the greatest over subsets of the least of what each allows."""
    best.fill(-np.inf)
    rows = list(slots)
    for subset, allowed in terms:
        least = rows[allowed[0]] if allowed else _UNBOUNDED
        for slot in allowed[1:]:
            least = np.minimum(least, rows[slot], out=spare)
        if subset in caps:
            least = np.minimum(least, caps[subset], out=spare)
        np.maximum(best, least, out=best)
