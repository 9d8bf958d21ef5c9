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

from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]

CELL_S = 0.5
"""Means over half a second: long against vibration, two records of a usual GPS, and short enough to
keep the accelerations of a vehicle that manoeuvres, which tell its heading."""

FEWEST_CELLS = 16
"""Two constants and a slope for each axis need many more points than that to show their noise."""

FEWEST_IN_SEGMENT = 8
MOST_SEGMENTS = 50
"""Each segment has three constants of its own; an attitude with more pauses is no thread."""

VAGUE = 1.0
"""Prior standard deviation of a rate error [rad/s] and of an attitude error [rad]: knows nothing.
It makes an axis that no anchor shows a very wide interval instead of a division by zero."""

LEAST_REACH_S = 10.0
"""Over so long before and after a short span gravity is known to a degree or two, on recorded
flights."""

COMPASS_DOUBT_RAD = float(np.arcsin(0.6))
"""How far a field of the vehicle's own may turn the compass during a flight: ArduPilot's compassmot
calls an interference of 60 % of the earth's field the limit of what may fly. Over a part of what is
looked at, it may have turned by as much less as a random walk does."""

ROUNDS = 4
LEAST_VARIANCE = 1e-8
"""A ten-thousandth of gravity, squared: no accelerometer is better."""

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
    """Directions in the attitude's own world, cell by cell.

    Parameters
    ----------
    time_s : (n,)
        Middle of each cell. [s]
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
    healthy_rad_s
        Standard deviation of a healthy gyro's bias. [rad/s]
    """

    time_s: Floats
    segment: NDArray[np.int64]
    turned: Floats
    force: Floats
    expected: Floats
    compass: Floats
    by_gps: bool
    healthy_rad_s: float

    def drift(
        self,
        start_s: float,
        end_s: float,
        confidence: float,
        path: tuple[Floats, Floats] | None = None,
        axis: tuple[Floats, float] | None = None,
    ) -> Drift | None:
        """Fit the attitude's rate error over a span, or nothing where too little is known.

        Half of the span before it and after it, or ten seconds, are looked at too: there the error
        is that of a healthy gyro, so that the attitude before and after is known the better.

        Parameters
        ----------
        path
            Times (m,) [s] and by how much more than the attitude some gyro has turned until then,
            in the world, (m, 3) [rad]; the error is then that of the attitude that the gyro would
            have given.
        axis
            The axis (3,) in the body frame [1] about which alone something may have failed, and
            the standard deviation of the rate error across it [rad/s]. Else it may be any.
        """
        length_s = end_s - start_s
        reach_s = max(length_s / 2, LEAST_REACH_S)
        known = _known(self.force)
        inside = known & self._within(start_s, end_s)
        rows = self._told(known & self._within(start_s - reach_s, end_s + reach_s))
        before, after = (self.time_s[rows] < start_s).sum(), (self.time_s[rows] > end_s).sum()
        if inside.sum() < FEWEST_CELLS and min(before, after) < FEWEST_CELLS:
            return None
        more = np.zeros((len(rows), 3))
        if path is not None:
            columns = [np.interp(self.time_s[rows], path[0], column) for column in path[1].T]
            more = np.column_stack(columns)
        design, target, kind = self._equations(rows, (start_s, end_s), more)
        information = np.eye(design.shape[2]) / VAGUE**2
        information[3:6, 3:6] = np.eye(3) / self.healthy_rad_s**2
        if axis is not None:
            along = np.outer(axis[0], axis[0])
            information[:3, :3] = along / VAGUE**2 + (np.eye(3) - along) / axis[1] ** 2
        error, variance, dof = _fitted(design, target, kind, information)
        half = np.sqrt(variance) * student_quantile(dof, confidence)
        anchors = ["gravity", *(["GPS"] if self.by_gps else [])]
        if _known(self.compass[rows]).sum() >= FEWEST_CELLS:
            anchors.append("compass")
            seen_s = self.time_s[rows[-1]] - self.time_s[rows[0]] + CELL_S
            step = np.diff(self.turned[rows, 2], axis=0) / np.diff(self.time_s[rows])[:, None]
            doubt = COMPASS_DOUBT_RAD * np.sqrt(length_s / (2.0 * seen_s)) / length_s
            half = np.hypot(half, np.abs(step).mean(axis=0) * doubt)
        return Drift(
            error_rad_s=error,
            half_width_rad_s=half,
            tilt_rad=float(np.median(_angle(self.force[rows], self.expected[rows]))),
            anchors=tuple(anchors),
        )

    def _told(self, usable: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Choose the cells of the longest segments; a few cells do not tell their own constants."""
        rows = np.flatnonzero(usable)
        segments, number, count = np.unique(
            self.segment[rows], return_inverse=True, return_counts=True
        )
        longest = np.argsort(-count, kind="stable")[:MOST_SEGMENTS]
        kept = np.zeros(len(segments), bool)
        kept[longest] = count[longest] >= FEWEST_IN_SEGMENT
        return np.asarray(rows[kept[number]])

    def _within(self, start_s: float, end_s: float) -> NDArray[np.bool_]:
        """Tell which cells lie wholly within a span."""
        inside = (self.time_s - CELL_S / 2 >= start_s) & (self.time_s + CELL_S / 2 <= end_s)
        return np.asarray(inside, bool)

    def _equations(
        self, rows: NDArray[np.int64], span: tuple[float, float], more: Floats
    ) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Write linear equations for what is not known.

        That is the rate error in the span, in excess of a constant one; that constant one; the
        attitude error at the start of each segment; and what the usual heading is off by.

        Parameters
        ----------
        more : (n, 3)
            What is added to the attitude error d. [rad]

        Returns
        -------
        design : (n, 3, n_unknowns)
            Three equations a cell: the two horizontal components of the force, and the heading of
            the compass; zeros where there is none.
        target : (n, 3)
        kind : (3,)
            Which equations have one and the same noise.
        """
        segments, number = np.unique(self.segment[rows], return_inverse=True)
        start = np.zeros((len(rows), 3, 3 * len(segments)))
        for axis in range(3):
            start[np.arange(len(rows)), axis, 3 * number + axis] = 1.0
        turned = self.turned[rows] - self.turned[rows[0]]
        # Attitude error d = turned b + d_start; a direction s appears as s + d x s.
        tilt = np.concatenate(
            [self._turned_in(span, rows), turned, start, np.zeros((len(rows), 3, 1))], axis=2
        )
        expected = self.expected[rows]
        lever = -_cross(expected)
        gravity = (lever @ tilt)[:, :2]
        force = self.force[rows] - expected + (lever @ more[:, :, None])[:, :, 0]
        known = _known(self.compass[rows])
        field = np.where(known[:, None], self.compass[rows], 0.0)
        usual = field[known].mean(axis=0) if known.any() else np.zeros(3)
        # Of the compass only the heading is believed: currents of the motors change its vertical
        # part with the throttle, and gravity is there to tell the tilt.
        across = np.array([-usual[1], usual[0], 0.0])
        across /= max(float(across @ across), LEAST_VARIANCE)
        lever = across @ -_cross(np.broadcast_to(usual, field.shape))
        heading = (lever[:, None, :] @ tilt)[:, 0]
        heading[:, -1] = 1.0
        turn = (field - usual) @ across + (lever * more).sum(axis=1)
        design = np.concatenate([gravity, np.where(known[:, None], heading, 0.0)[:, None]], axis=1)
        target = np.column_stack([force[:, :2], np.where(known, turn, 0.0)])
        return design, target, np.array([0, 0, 1])

    def _turned_in(self, span: tuple[float, float], rows: NDArray[np.int64]) -> Floats:
        """Integral of R_att over that part of a span which is over at each cell, (n, 3, 3). [s]"""
        at_s = np.clip(self.time_s[rows], *span)
        flat = self.turned.reshape(-1, 9)
        columns = [np.interp(at_s, self.time_s, column) for column in flat.T]
        turned = np.column_stack(columns).reshape(-1, 3, 3)
        return np.asarray(turned - turned[0])


def _fitted(
    design: Floats, target: Floats, kind: NDArray[np.int64], information: Floats
) -> tuple[Floats, Floats, Floats]:
    """Fit both rate errors by least squares, and add them up.

    Each kind of equation is weighted by the long-run variance of its residuals, which allows for
    noise of any colour: a manoeuvre that goes on counts for more, a velocity that comes back to
    what it was for less.

    Parameters
    ----------
    information : (n_unknowns, n_unknowns)
        What is known beforehand: the inverse of a covariance.

    Returns
    -------
    error, variance : (3,)
        Rate error about each axis and its variance. [rad/s], [rad^2/s^2]
    dof : (3,)
        Degrees of freedom of the variance: a kind of equation whose noise is badly known matters
        as far as it has a part in the answer (Satterthwaite's formula).
    """
    unknowns = design.shape[2]
    used = np.asarray(design.any(axis=2), bool)
    long_run = np.ones(len(kind))
    groups = [kind == group for group in np.unique(kind) if used[:, kind == group].any()]
    known = np.zeros(len(groups))
    # Each equation of a kind takes its share of the unknowns from the residuals.
    share = 1.0 - min(unknowns / max(int(used.sum()), 1), 0.5)
    total = np.zeros((3, unknowns))
    total[:, :3] = total[:, 3:6] = np.eye(3)
    for _ in range(ROUNDS):
        told = [
            np.einsum("nru,nrv->uv", design[:, g] / long_run[g, None], design[:, g]) for g in groups
        ]
        covariance = np.linalg.inv(np.sum(told, axis=0) + information)
        weighted = design / long_run[:, None]
        solved = covariance @ np.einsum("nru,nr->u", weighted, target)
        residual = target - design @ solved
        of_error = total @ covariance
        parts = np.array([np.einsum("iu,uv,iv->i", of_error, one, of_error) for one in told])
        variance = np.einsum("iu,iu->i", of_error, total)
        for number, columns in enumerate(groups):
            rows = used[:, columns].any(axis=1)
            looks = windowed_mean(residual[rows][:, columns][None])
            mean_square = float(np.trace(looks.covariance[0])) * rows.sum() / columns.sum()
            long_run[columns] = max(mean_square / share, LEAST_VARIANCE)
            known[number] = looks.dof[0]
    with np.errstate(divide="ignore"):
        dof = variance**2 / (parts**2 / known[:, None]).sum(axis=0)
    return total @ solved, variance, dof


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
