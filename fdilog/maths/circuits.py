"""Circuits: the shortest linear relations among sensitivity axes, on which redundancy rests.

A circuit is a smallest set of channels whose axes are linearly dependent, with the one relation
``sum_i c_i h_i = 0`` among them.  ``c . z`` is then free of the rotation rate: a parity check of
the fewest channels.  Four rows in general position form a circuit, two parallel rows do, three
coplanar rows do.  Every vertex of the linear programs of set-membership and of smallest-1-norm
estimation comes from circuits, whatever the rank of the rows left, so aligned triads are no
special case.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from fdilog.maths.geometry import RANK_TOLERANCE, Floats

SERIAL_PRODUCT = 2**18
"""Multiplications above which OpenBLAS may start threads; on small matrices they mostly wait for
one another, and on a busy machine they cost tenfold."""


def find_circuits(axes: Floats) -> Floats:
    """List all circuits of the sensitivity axes, the parity checks of the fewest channels.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H, one row a channel. [1]

    Returns
    -------
    relations : (n_circuits, n_channels)
        Coefficients c of each circuit, zero outside it, largest modulus 1; ``relations @ axes`` is
        zero to rounding.  Ordered by the number of channels, then lexicographically. [1]

    Notes
    -----
    Unit rows count as dependent when their smallest singular value is within the rank tolerance of
    the geometry, so a relation may err by that share of the rate; one just outside it multiplies
    rounding by the inverse, which shows only where readings stand on the edge of feasibility.

    References
    ----------
    R. T. Rockafellar, "The elementary vectors of a subspace of R^N", 1969: every relation is a sum
    of circuits without cancellation, which is why the circuits alone decide a linear program.
    """
    n_channels = len(axes)
    lengths = np.linalg.norm(axes, axis=1)
    unit_rows = axes / lengths[:, None]
    relations = np.zeros((0, n_channels))
    for size in range(2, min(n_channels, 4) + 1):
        candidates = np.array(list(combinations(range(n_channels), size)))
        inside = np.zeros((len(candidates), n_channels), dtype=bool)
        np.put_along_axis(inside, candidates, values=True, axis=1)
        found = relations != 0.0
        # A set that holds a smaller circuit is dependent, but not minimal.
        holds_smaller = (found.astype(int) @ (~inside).T.astype(int) == 0).any(axis=0)
        candidates = candidates[~holds_smaller]
        left, singular, _ = np.linalg.svd(unit_rows[candidates])
        dependent = np.full(len(candidates), size == 4) | (singular[:, -1] <= RANK_TOLERANCE)
        null_vectors = left[dependent, :, -1] / lengths[candidates[dependent]]
        largest = np.abs(null_vectors).argmax(axis=1)[:, None]
        null_vectors /= np.take_along_axis(null_vectors, largest, axis=1)
        new = np.zeros((len(null_vectors), n_channels))
        np.put_along_axis(new, candidates[dependent], null_vectors, axis=1)
        relations = np.concatenate([relations, new])
    return relations


def linear_forms(forms: Floats, columns: Floats, *, out: Floats | None = None) -> Floats:
    """Evaluate a few linear forms, such as relations, on many samples without starting threads.

    Parameters
    ----------
    forms : (n_forms, n_channels)
        Coefficients of each form. [1]
    columns : (n_channels, n_samples)
        Readings z, a column a sample. [any]

    Returns
    -------
    values : (n_forms, n_samples)
        ``forms @ columns``; this is ``out`` if given. [unit of columns]
    """
    if out is None:
        out = np.empty((len(forms), columns.shape[1]))
    width = max(1, SERIAL_PRODUCT // max(1, forms.size))
    for start in range(0, columns.shape[1], width):
        strip = slice(start, start + width)
        np.matmul(forms, columns[:, strip], out=out[:, strip])
    return out
