"""Linear programs, solved by HiGHS, that say what the closed forms of the detectors must give.

Many small programs are stacked into one block-diagonal program: they share neither variables nor
constraints, so each is solved exactly as alone, some fifteen times faster than one at a time.
Random instances to compare on are here too, for the tests and the benchmark.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.optimize import linprog

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

TIGHT = {"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10}


SCALE = 100.0
"""Size of the rotation rates in random instances."""

EDGE = 1e-6
"""Share of the scale: what is nearer to the edge of feasibility, a solver's tolerance decides."""


def skewed_axes(rng: np.random.Generator, n_channels: int) -> Floats:
    axes: Floats = rng.normal(size=(n_channels, 3))
    axes /= np.linalg.norm(axes, axis=1)[:, None]
    return axes


def aligned_axes(rng: np.random.Generator, n_channels: int) -> Floats:
    """Axes of triads mounted alike, in any attitude and order; some triads incomplete."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    axes: Floats = rotation[rng.permutation(np.arange(n_channels) % 3)]
    return axes


def random_instance(
    rng: np.random.Generator, n_channels: int, *, aligned: bool
) -> tuple[Floats, Floats, Floats, int]:
    """Readings (n,), axes, bounds and failures allowed; at times more channels fail than that."""
    axes = (aligned_axes if aligned else skewed_axes)(rng, n_channels)
    bound = rng.uniform(0.5, 2.0, n_channels)
    errors = rng.uniform(-1.0, 1.0, n_channels) * bound
    failed = rng.permutation(n_channels)[: rng.integers(0, 4)]
    errors[failed] += rng.normal(0.0, 10.0, len(failed))
    return axes @ rng.normal(0.0, SCALE, 3) + errors, axes, bound, int(rng.integers(1, 3))


def solve_apart(programs: list[tuple[Floats, Floats, Floats]]) -> list[Floats]:
    """Solve ``min c'x, A x <= b, x free`` for each (c, A, b); every one must have a solution."""
    if not programs:
        return []
    costs = [cost for cost, _, _ in programs]
    answer = linprog(
        np.concatenate(costs),
        A_ub=sparse.block_diag([matrix for _, matrix, _ in programs], format="csc"),
        b_ub=np.concatenate([limit for _, _, limit in programs]),
        bounds=(None, None),
        method="highs",
        options=TIGHT,
    )
    if answer.status != 0:
        raise RuntimeError(answer.message)
    return np.split(answer.x, np.cumsum([len(cost) for cost in costs])[:-1])


def slabs(readings: Floats, axes: Floats, bound: Floats, left: list[int]) -> tuple[Floats, Floats]:
    """``|z_i - h_i'w| <= s_i`` for the channels left, as ``A w <= b``."""
    rows, z, s = axes[left], readings[left], bound[left]
    return np.concatenate([rows, -rows]), np.concatenate([z + s, s - z])


def guaranteed_by_programs(
    readings: Floats,
    axes: Floats,
    bound: Floats,
    max_failures: int,
    targets: list[int] | None = None,
) -> tuple[Floats, Floats, Booleans, float]:
    """Solve one instant: low, high (n,), feasible (n_subsets,), and the edge of feasibility.

    The edge is the smallest modulus, over the subsets, of the amount by which all bounds would have
    to be widened to make the subset just feasible.  Channels that are no targets stay NaN.
    """
    n_channels = len(readings)
    subsets = list(combinations(range(n_channels), max_failures))
    remains = [[i for i in range(n_channels) if i not in subset] for subset in subsets]
    widenings = []
    for left in remains:
        matrix, limit = slabs(readings, axes, bound, left)
        # With no channel left the widening is bounded by nothing else.
        matrix = np.vstack([np.column_stack([matrix, -np.ones(len(matrix))]), [0, 0, 0, -1]])
        cost = np.array([0.0, 0.0, 0.0, 1.0])
        widenings.append((cost, matrix, np.append(limit, bound.max() + 1.0)))
    edges = np.array([x[3] for x in solve_apart(widenings)])
    feasible = edges <= 0.0

    low, high = np.full(n_channels, np.nan), np.full(n_channels, np.nan)
    programs, meaning = [], []
    for left in [left for left, good in zip(remains, feasible, strict=True) if good]:
        matrix, limit = slabs(readings, axes, bound, left)
        for channel in range(n_channels) if targets is None else targets:
            if not in_span(axes[channel], axes[left]):
                low[channel], high[channel] = -np.inf, np.inf
                continue
            for sign in (1.0, -1.0):
                programs.append((sign * axes[channel], matrix, limit))
                meaning.append((channel, sign))
    for (channel, sign), (cost, _, _), x in zip(
        meaning, programs, solve_apart(programs), strict=True
    ):
        value = sign * (cost @ x)
        if sign > 0.0:
            low[channel] = np.fmin(low[channel], value)
        else:
            high[channel] = np.fmax(high[channel], value)
    return low, high, feasible, float(np.abs(edges).min())


def in_span(row: Floats, rows: Floats) -> bool:
    """Whether a program in the direction of ``row`` is bounded by slabs along ``rows``."""
    if not len(rows):
        return False
    rank = np.linalg.matrix_rank(rows, tol=1e-8)
    return bool(np.linalg.matrix_rank(np.vstack([rows, row]), tol=1e-8) == rank)


def least_one_norms(readings: Floats, axes: Floats) -> Floats:
    """Smallest ``|z - H w|_1`` (n_samples,) of each sample, as linear programs."""
    n_channels = axes.shape[0]
    eye = np.eye(n_channels)
    matrix = np.vstack([np.hstack([-axes, -eye]), np.hstack([axes, -eye])])
    cost = np.concatenate([np.zeros(3), np.ones(n_channels)])
    answers = solve_apart([(cost, matrix, np.concatenate([-z, z])) for z in readings])
    return np.array([cost @ x for x in answers])
