"""What no gyro feeds: gravity, the compass and the acceleration that GPS saw, against an attitude.

A filter that integrates a failed gyro turns away from the truth, ``R_att = exp(d) R``, and its
error d grows by ``R_att b`` where b is the error of its body rate. Directions fixed in the world
show d: the specific force of the accelerometers turned by the attitude must be the vehicle's
acceleration less gravity, and the magnetic field must stand still. Over a span the attitude's rate
error b is therefore a slope that can be fitted, with an interval, whatever the filter did with the
gyro. To tell a gyro that is off by 3 deg/s for 30 s from one that is not, an attitude need only be
known to some 40 degrees; so weak anchors decide long spans, and no anchor decides a short one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.noise import windowed_mean
from fdilog.student import student_quantile

Floats = NDArray[np.float64]

CELL_S = 1.0
"""Means over a second: long against vibration, short against every span that can be anchored."""

FEWEST_CELLS = 8
"""Two constants and a slope for each axis need some more points than that to show their noise."""

VAGUE = 1.0
"""Prior standard deviation of a rate error [rad/s] and of an attitude error [rad]: knows nothing.
It makes an axis that no anchor shows a very wide interval instead of a division by zero."""

COMPASS_DOUBT_RAD = float(np.arcsin(0.6))
"""How far a field of the vehicle's own may turn the compass during a flight. ArduPilot's compassmot
calls an interference of 60 % of the earth's field the limit of what may fly."""

LOST_RAD = np.radians(30.0)
"""An attitude whose vertical is this far from the accelerometers' for half of a span is lost: no
vehicle accelerates at 0.6 g for so long."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Drift:
    """How wrong an attitude's mean body rate was over a span, as far as anchors can tell.

    Parameters
    ----------
    error_rad_s, half_width_rad_s : (3,)
        Rate error b along body x, y, z, and the half-width of its interval. [rad/s]
    tilt_rad
        Median angle between the attitude's vertical and the accelerometers'. [rad]
    anchors
        What it was held against, in words.
    """

    error_rad_s: Floats
    half_width_rad_s: Floats
    tilt_rad: float
    anchors: tuple[str, ...]

    @property
    def lost(self) -> bool:
        """Whether the attitude contradicts gravity."""
        return bool(self.tilt_rad > LOST_RAD)

    def within(self, axis: Floats, tolerance_rad_s: float) -> bool:
        """Whether the error about an axis lies inside a tolerance for sure."""
        size = abs(float(axis @ self.error_rad_s)) + self.half_width(axis)
        return size < tolerance_rad_s

    def half_width(self, axis: Floats) -> float:
        """Half-width of the interval of the error about an axis. [rad/s]"""
        return float(np.sqrt((axis**2 * self.half_width_rad_s**2).sum()))


@dataclass(frozen=True, kw_only=True, eq=False)
class Anchors:
    """Directions in the attitude's own world, second by second.

    Parameters
    ----------
    time_s : (n,)
        Middle of each second. [s]
    segment : (n,) int64
        Number of the stretch in which the attitude neither jumps nor pauses.
    turned : (n, 3, 3)
        Integral of R_att over time since the beginning. [s]
    force : (n, 3)
        Mean specific force, turned by the attitude, over that of gravity; NaN where unknown. [1]
    expected : (n, 3)
        What it should be: acceleration by GPS less gravity, or gravity alone. [1]
    compass : (n, 3)
        Mean field, turned by the attitude, over its usual size; NaN where unknown. [1]
    by_gps
        Whether ``expected`` holds accelerations.
    """

    time_s: Floats
    segment: NDArray[np.int64]
    turned: Floats
    force: Floats
    expected: Floats
    compass: Floats
    by_gps: bool

    def drift(self, start_s: float, end_s: float, confidence: float) -> Drift | None:
        """Fit the attitude's rate error over a span, or nothing where too little is known."""
        inside = (self.time_s - CELL_S / 2 >= start_s) & (self.time_s + CELL_S / 2 <= end_s)
        rows = np.flatnonzero(inside & _known(self.force))
        if len(rows) < FEWEST_CELLS:
            return None
        design, target, kind = self._equations(rows)
        error, variance, dof = _fitted(design, target, kind)
        half = np.sqrt(variance) * float(student_quantile(np.array([dof]), confidence)[0])
        anchors = ["gravity", *(["GPS"] if self.by_gps else [])]
        if _known(self.compass[rows]).sum() >= FEWEST_CELLS:
            anchors.append("compass")
            span_s = self.time_s[rows[-1]] - self.time_s[rows[0]] + CELL_S
            step = np.diff(self.turned[rows, 2], axis=0) / np.diff(self.time_s[rows])[:, None]
            half = half + np.abs(step).mean(axis=0) * COMPASS_DOUBT_RAD / span_s
        return Drift(
            error_rad_s=error,
            half_width_rad_s=half,
            tilt_rad=float(np.median(_angle(self.force[rows], self.expected[rows]))),
            anchors=tuple(anchors),
        )

    def _equations(self, rows: NDArray[np.int64]) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Linear equations for b, the error at the start of each segment, and the field's.

        Returns
        -------
        design : (n, 5, n_unknowns)
            Five equations a cell: the two horizontal components of the force, the three of the
            compass; zeros where there is none.
        target : (n, 5)
        kind : (5,)
            Which equations have one and the same noise.
        """
        segments, number = np.unique(self.segment[rows], return_inverse=True)
        start = np.zeros((len(rows), 3, 3 * len(segments)))
        for axis in range(3):
            start[np.arange(len(rows)), axis, 3 * number + axis] = 1.0
        turned = self.turned[rows] - self.turned[rows[0]]
        nothing = np.zeros((len(rows), 3, 3))
        # Attitude error d = turned b + d_start; a direction s appears as s + d x s.
        tilt = np.concatenate([turned, start, nothing], axis=2)
        expected = self.expected[rows]
        gravity = (-_cross(expected) @ tilt)[:, :2]
        known = _known(self.compass[rows])
        field = np.where(known[:, None], self.compass[rows], 0.0)
        usual = field[known].mean(axis=0) if known.any() else np.zeros(3)
        compass = -_cross(np.broadcast_to(usual, field.shape)) @ tilt
        compass[:, :, -3:] = np.eye(3)
        compass[~known] = 0.0
        target = np.concatenate(
            [(self.force[rows] - expected)[:, :2], np.where(known[:, None], field - usual, 0.0)],
            axis=1,
        )
        return np.concatenate([gravity, compass], axis=1), target, np.array([0, 0, 1, 1, 1])


def _fitted(
    design: Floats, target: Floats, kind: NDArray[np.int64]
) -> tuple[Floats, Floats, float]:
    """Least squares for the first three unknowns, with variances that allow for slow noise.

    The variance is that of the mean of each second's influence on the answer, which
    `fdilog.noise.windowed_mean` estimates whatever the colour of the noise; the prior's share is
    added for what the anchors do not show.
    """
    n, _, unknowns = design.shape
    used = np.asarray(design.any(axis=2), bool)
    prior = np.eye(unknowns) / VAGUE**2
    sigma = np.ones(len(kind))
    solved = np.zeros(unknowns)
    inverse = prior
    residual = target
    for _ in range(4):
        weighted = design / sigma[:, None] ** 2
        inverse = np.linalg.inv(np.einsum("nru,nrv->uv", weighted, design) + prior)
        solved = inverse @ np.einsum("nru,nr->u", weighted, target)
        residual = np.where(used, target - design @ solved, 0.0)
        for group in np.unique(kind):
            rows = kind == group
            count = used[:, rows].sum()
            if count:
                power = float((residual[:, rows] ** 2).sum())
                sigma[rows] = max(np.sqrt(power / count), 1e-4)
    influence = np.einsum("nru,nr->nu", design / sigma[:, None] ** 2, residual) @ inverse[:, :3]
    looks = windowed_mean((n * influence)[None])
    equations = int(used.sum())
    lost = equations / max(equations - np.linalg.matrix_rank(inverse[3:, 3:]) - 3, 1)
    variance = (
        np.diag(looks.covariance[0]) * lost + (inverse @ prior @ inverse)[[0, 1, 2], [0, 1, 2]]
    )
    return solved[:3], variance, float(looks.dof[0])


def _known(v: Floats) -> NDArray[np.bool_]:
    """Tell which vectors (n, 3) are finite, (n,)."""
    return np.asarray(np.isfinite(v).all(axis=1), bool)


def _cross(v: Floats) -> Floats:
    """Matrices (n, 3, 3) by which v x u is a product."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.stack(
        [
            np.stack([zero, -z, y], axis=1),
            np.stack([z, zero, -x], axis=1),
            np.stack([-y, x, zero], axis=1),
        ],
        axis=1,
    )


def _angle(one: Floats, other: Floats) -> Floats:
    """Angle between directions, (n,). [rad]"""
    return np.asarray(
        np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
    )
