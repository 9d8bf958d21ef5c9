"""Where the gyros point: named units, parity matrices, and what redundancy can tell apart.

Notation throughout: n channels read ``z = H w + e`` with H (n, 3) the sensitivity axes, w the body
rate and e the errors; V spans the left null space of H (``V H = 0``, ``V V' = I``), the parity
vector is ``p = V z = V e``, and ``G = V' V``.

References
----------
[Larin15] V. B. Larin, "Identification of faults of navigation sensors", International Applied
    Mechanics 51(6), 2015, 112-118.
[Triads] "Improving the efficiency of search for a failed sensor in redundant angular-rate meters".
[Matasov24] A. I. Matasov, E. V. Shestakova, "Failure determination for a redundant inertial sensor
    unit by guaranteeing estimation", Vestnik MSU ser. 1, 2024, no. 5, 77-81.
[Baarda68] W. Baarda, "A testing procedure for use in geodetic networks", Netherlands Geodetic
    Commission, Publications on Geodesy 2(5), 1968.
"""

from __future__ import annotations

import difflib
from functools import lru_cache
from statistics import NormalDist
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from collections.abc import Sequence

Floats = NDArray[np.float64]

TRIAD_CONE_RAD = float(np.arccos(1.0 / np.sqrt(3.0)))
"""Half-angle of the cone on which three mutually orthogonal axes stand about their diagonal."""

TRIAD_AZIMUTH_RAD = float(np.deg2rad(15.0))
"""Azimuth phi0 of the first axis in [Triads]; it turns the unit as a whole."""

RANK_TOLERANCE = 1e-9
"""Directions weaker than this, relative to the strongest, count as absent: far above rounding
(1e-16), far below any angle to which an axis can be surveyed (1e-5 rad)."""

REMEMBERED = 1024
"""Parity matrices kept: a flight asks for the same few thousands of times."""

COLLINEAR_TOLERANCE = 1e-6
"""Sine below which two parity columns are one line in floating point; rounding alone gives 1e-8."""


def two_triads(
    azimuth_rad: float,
    cone_rad: float,
    second_cone_rad: float | None = None,
    first_azimuth_rad: float = 0.0,
) -> Floats:
    """Axes of two triads about one axis, the second turned and its cone opening downwards.

    Parameters
    ----------
    azimuth_rad
        Azimuth of the second triad relative to the first. [rad]
    cone_rad, second_cone_rad
        Angle between the axis of the cone and every axis of the first and the second triad; one
        angle for both if only one is given. [rad]
    first_azimuth_rad
        Azimuth phi0 of the first triad. [rad]

    Returns
    -------
    axes : (6, 3)
        Sensitivity axes H. [1]

    References
    ----------
    [Triads]: the unit is azimuth 0, cone arccos(1/sqrt 3), phi0 = 15 deg. A second cone that opens
    upwards is, up to the sign of its axes, this one turned by 180 deg: both are in the family.
    """
    second = cone_rad if second_cone_rad is None else second_cone_rad
    thirds = first_azimuth_rad + np.arange(3) * 2 * np.pi / 3
    halves: list[Floats] = []
    for azimuth, cone, up in ((thirds, cone_rad, 1.0), (thirds + azimuth_rad, second, -1.0)):
        flat = np.sin(cone) * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        halves.append(np.column_stack([flat, np.full(3, up * np.cos(cone))]))
    return np.concatenate(halves)


def _matasov() -> Floats:
    # The matrix is missing from the copy of [Matasov24] at hand; this one was solved from the
    # paper's worked example and reproduces every figure of it.
    s, c = np.sqrt(2.0 / 3.0), 1.0 / np.sqrt(3.0)
    h = s * np.sqrt(3.0) / 2.0
    return np.array(
        [
            [-c, -s, 0.0],
            [c, s / 2, -h],
            [-c, s / 2, h],
            [c, -s, 0.0],
            [-c, s / 2, -h],
            [-c, -s / 2, -h],
        ]
    )


def _dodecahedron() -> Floats:
    golden = (1.0 + np.sqrt(5.0)) / 2.0
    faces = [
        [1.0, 0.0, golden],
        [-1.0, 0.0, golden],
        [golden, 1.0, 0.0],
        [golden, -1.0, 0.0],
        [0.0, golden, 1.0],
        [0.0, golden, -1.0],
    ]
    unit: Floats = np.divide(faces, np.hypot(1.0, golden))
    return unit


# [Larin15], example; its minus signs are lost in print, these reproduce the paper's Table 2.
_PENTAGON = np.array(
    [
        [0.97204, 0.0, -0.23482],
        [-0.60075, 0.77653, -0.18997],
        [0.0, -0.47992, 0.87731],
        [0.0, 0.47992, 0.87731],
        [-0.60075, -0.77653, -0.18997],
    ]
)

_FIXED = MappingProxyType(
    {
        "mirrored-triads": two_triads(0.0, TRIAD_CONE_RAD, first_azimuth_rad=TRIAD_AZIMUTH_RAD),
        "matasov": _matasov(),
        "pentagon": _PENTAGON,
        "dodecahedron": _dodecahedron(),
    }
)

ALIGNED = "aligned-triads"
ALIGNED_CHANNELS = (3, 6, 9, 12)

GEOMETRIES: tuple[str, ...] = (ALIGNED, *_FIXED)
"""Names that `named_axes` knows."""


def named_axes(name: str, channels: int | None = None) -> Floats:
    """Sensitivity axes of a unit known by name.

    Parameters
    ----------
    name
        One of `GEOMETRIES`.
    channels
        How many channels the unit must have; only ``aligned-triads`` comes in several sizes
        (3, 6, 9, 12; 6 if not said).

    Returns
    -------
    axes : (n_channels, 3)
        Sensitivity axes H in the body frame. [1]

    Raises
    ------
    ValueError
        For an unknown name (the nearest known one is named) or a size that the unit does not have.

    References
    ----------
    [Triads] ``mirrored-triads``; [Matasov24] ``matasov``; [Larin15] ``pentagon``; ``dodecahedron``:
    six axes through the faces of a regular dodecahedron, any two at arccos(1/sqrt 5) up to sign.
    """
    if name == ALIGNED:
        size = 6 if channels is None else channels
        if size not in ALIGNED_CHANNELS:
            sizes = ", ".join(str(known) for known in ALIGNED_CHANNELS)
            raise ValueError(f"geometry {ALIGNED!r} has {sizes} channels, not {size}")
        return np.tile(np.eye(3), (size // 3, 1))
    if name not in _FIXED:
        nearest = difflib.get_close_matches(name, GEOMETRIES, n=1, cutoff=0.0)[0]
        raise ValueError(
            f"unknown geometry {name!r}; did you mean {nearest!r}? known: {', '.join(GEOMETRIES)}"
        )
    axes = _FIXED[name].copy()
    if channels is not None and channels != len(axes):
        raise ValueError(f"geometry {name!r} has {len(axes)} channels, not {channels}")
    return axes


def checked_axes(axes: ArrayLike) -> Floats:
    """Axes as a float array, or a clear complaint.

    Returns
    -------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Raises
    ------
    ValueError
        If the shape is not (n, 3), or a row is zero or not finite.
    """
    array = np.asarray(axes, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or not len(array):
        raise ValueError(f"axes must have the shape (channels, 3), not {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1) | ~array.any(axis=1))
    if len(bad):
        raise ValueError(f"axis {bad[0]} is zero or not finite: {array[bad[0]].tolist()}")
    return array


def checked_readings(readings: ArrayLike, axes: ArrayLike) -> tuple[Floats, Floats]:
    """Check readings and axes against each other; give both as float arrays.

    Returns
    -------
    readings : (n_samples, n_channels)
        Readings z. [as given]
    axes : (n_channels, 3)
        Sensitivity axes H. [1]

    Raises
    ------
    ValueError
        If the shapes do not fit one another.
    """
    directions = checked_axes(axes)
    samples = np.asarray(readings, dtype=np.float64)
    if samples.ndim != 2 or samples.shape[1] != len(directions):
        raise ValueError(
            f"readings must have the shape (samples, {len(directions)}), not {samples.shape}"
        )
    return samples, directions


def _rank(singular_values: NDArray[np.floating[Any]]) -> int:
    return int(np.count_nonzero(singular_values > RANK_TOLERANCE * singular_values.max(initial=0)))


def parity_matrix(axes: ArrayLike) -> Floats:
    """Orthonormal parity matrix by singular value decomposition.

    Returns
    -------
    parity : (n_channels - rank, n_channels)
        V with ``V H = 0`` and ``V V' = I``. [1]

    References
    ----------
    [Larin15] projector U2' of H = [U1 U2] [S; 0] W'.
    """
    array = checked_axes(axes)
    return _parity_matrix(array.tobytes(), len(array)).copy()


@lru_cache(maxsize=REMEMBERED)
def _parity_matrix(axes: bytes, channels: int) -> Floats:
    left, singular_values, _ = np.linalg.svd(np.frombuffer(axes).reshape(channels, 3))
    return np.ascontiguousarray(left[:, _rank(singular_values) :].T)


def parity_matrix_qr(axes: ArrayLike) -> Floats:
    """Parity matrix from the full QR factors of H: another basis of the same space.

    Returns
    -------
    parity : (n_channels - 3, n_channels)
        V with ``V H = 0`` and ``V V' = I``. [1]

    Raises
    ------
    ValueError
        If the axes do not span space: QR without pivoting does not show the rank reliably.

    References
    ----------
    [Larin15] second way to the projector.
    """
    array = checked_axes(axes)
    if _rank(np.linalg.svd(array, compute_uv=False)) < 3:
        raise ValueError("the axes do not span space: use parity_matrix")
    q, _ = np.linalg.qr(array, mode="complete")
    return np.ascontiguousarray(q[:, 3:].T)


def residual_projector(axes: ArrayLike) -> Floats:
    """Projector from readings to the least-squares residuals.

    Returns
    -------
    projector : (n_channels, n_channels)
        ``G = V' V = I - H (H'H)^-1 H'``. [1]

    References
    ----------
    [Larin15] minimum-norm error e0 = G z.
    """
    parity = parity_matrix(axes)
    return parity.T @ parity


def detectable(axes: ArrayLike) -> NDArray[np.bool_]:
    """Which channels are compared with anything at all.

    Returns
    -------
    detectable : (n_channels,)
        True where the channel's parity column is not zero, that is where its axis lies in the span
        of the other axes.
    """
    found: NDArray[np.bool_] = np.diag(residual_projector(axes)) > RANK_TOLERANCE
    return found


def leave_one_out(
    axes: ArrayLike, removed: Sequence[int] = (), sigma: Floats | None = None
) -> Floats:
    """Rows that compare each channel with its least-squares prediction from the others.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    removed
        Channels that predict nothing, being known to be bad. They are still compared themselves.
    sigma : (n_channels,)
        Relative noise, with the inverse squares of which channels weigh in the prediction; all
        alike by default. [1]

    Returns
    -------
    rows : (n_channels, n_channels)
        L with ``r = L z`` and ``r_i = z_i - h_i' pinv(H_-i) z_-i = (G z)_i / G_ii``. A row is
        not-a-number where h_i is not in the span of what is left: nothing to compare with. [1]

    References
    ----------
    [Triads] search 4; the closed form is the deleted residual of linear regression.
    """
    array = checked_axes(axes)
    if sigma is not None:
        rows_of_alike = leave_one_out(array / sigma[:, None], removed)
        return np.asarray(rows_of_alike * sigma[:, None] / sigma, np.float64)
    n = len(array)
    struck = set(removed)
    if not struck <= set(range(n)):
        raise ValueError(f"removed channels {sorted(struck)} are not all in 0..{n - 1}")
    rows = np.full((n, n), np.nan)
    kept = [i for i in range(n) if i not in struck]
    for compared, group in [(kept, kept), *(([i], [*kept, i]) for i in sorted(struck))]:
        if not group:
            continue
        projector = residual_projector(array[group])
        for i in compared:
            at = group.index(i)
            if projector[at, at] > RANK_TOLERANCE:
                rows[i] = 0.0
                rows[i, group] = projector[at] / projector[at, at]
    return rows


def _components(joined: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """Find the connected components of a symmetric relation, in the order of their first."""
    unseen = list(range(len(joined)))
    found = []
    while unseen:
        component, edge = set(unseen[:1]), unseen[:1]
        while edge:
            edge = [j for j in unseen if j not in component and joined[edge, j].any()]
            component.update(edge)
        unseen = [i for i in unseen if i not in component]
        found.append(tuple(sorted(component)))
    return found


def parity_cosines(axes: ArrayLike) -> Floats:
    """How alike two channels' faults look in the parity space.

    Returns
    -------
    cosines : (n_channels, n_channels)
        |cos| between parity columns; 0 where a column is zero, and on the diagonal. [1]
    """
    projector = residual_projector(axes)
    length = np.sqrt(np.diag(projector).clip(min=0))
    length[length**2 <= RANK_TOLERANCE] = np.inf
    cosines: Floats = np.abs(projector) / length[:, None] / length[None, :]
    np.fill_diagonal(cosines, 0.0)
    return cosines


def isolability_groups(
    axes: ArrayLike, tolerance: float = COLLINEAR_TOLERANCE
) -> list[tuple[int, ...]]:
    """Channels that no algorithm can tell apart by redundancy alone.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    tolerance
        Largest sine of the angle between two parity columns that are taken for one line: the
        part of a fault in one channel that a fault in the other cannot imitate. [1]

    Returns
    -------
    groups
        Groups of two or more channels, each as large as it can be. A channel whose fault cannot
        even be detected (see `detectable`) is in none.
    """
    cosines = np.minimum(parity_cosines(axes), 1.0)
    sines = np.sqrt(1.0 - cosines**2)
    return [group for group in _components(sines <= tolerance) if len(group) > 1]


def blocks(axes: ArrayLike, tolerance: float = COLLINEAR_TOLERANCE) -> list[tuple[int, ...]]:
    """Channels that check one another: the independent pieces of the redundancy.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    tolerance
        Largest cosine between two parity columns that is taken for none. [1]

    Returns
    -------
    blocks
        Connected components of the relation G_ij != 0. Three aligned triads fall into
        (0, 3, 6), (1, 4, 7), (2, 5, 8). A channel that nothing checks is in none.
    """
    return [block for block in _components(parity_cosines(axes) > tolerance) if len(block) > 1]


def minimal_detectable_fault(
    axes: ArrayLike,
    sigma: ArrayLike,
    n_samples: float = 1.0,
    confidence: float = 0.999,
    power: float = 0.8,
) -> Floats:
    """Smallest constant error of each channel that a test of its residual would show.

    ``(z_{1 - a/2} + z_power) sigma_i / sqrt(n_samples G_ii)`` with a = 1 - confidence and z the
    normal quantile; G is that of the axes divided by their sigma. The chance that a fault trips
    the test on the wrong side is left out, which makes the figure a little too large, never small.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    sigma : () or (n_channels,)
        Standard deviation of one sample of the noise. [any rate]
    n_samples
        Independent samples that are averaged.
    confidence
        One minus the false-alarm rate of the two-sided test.
    power
        Probability with which the fault is to be found.

    Returns
    -------
    fault : (n_channels,)
        Minimal detectable error; infinite where nothing checks the channel. [unit of sigma]

    References
    ----------
    [Baarda68] internal reliability, one outlier at a time.
    """
    array = checked_axes(axes)
    deviation = np.broadcast_to(np.asarray(sigma, dtype=np.float64), (len(array),))
    if not (deviation > 0).all():
        raise ValueError("sigma must be positive")
    normal = NormalDist()
    shift = normal.inv_cdf(0.5 + confidence / 2.0) + normal.inv_cdf(power)
    checked = np.diag(residual_projector(array / deviation[:, None])).copy()
    checked[checked <= RANK_TOLERANCE] = 0.0
    with np.errstate(divide="ignore"):
        return shift * deviation / np.sqrt(n_samples * checked)
