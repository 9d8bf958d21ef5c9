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

from collections.abc import Sequence
from dataclasses import dataclass, replace

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

RAMP = float(np.sqrt(6.0))
"""What changes steadily during half of a time and else stays, changes by so many of its standard
deviations."""

ROUNDS = 4
MOST_STEPS = 10
CONVERGED_RAD = np.radians(1.0)
"""Over the span, a step of the fit that no anchor would show."""

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
        return float(np.linalg.norm(axis * self.half_width_rad_s))


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
    unseen : (n,)
        Horizontal acceleration that GPS saw and ``expected`` does not hold, over gravity. [1]
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
    unseen: Floats
    healthy_rad_s: float

    def drift(
        self,
        start_s: float,
        end_s: float,
        confidence: float,
        *,
        path: tuple[Floats, Floats] | None = None,
        axis: tuple[Floats, float] | None = None,
        guesses_rad_s: Sequence[Floats] = (np.zeros(3),),
    ) -> Drift | None:
        """Fit the attitude's rate error over a span, or nothing where too little is known.

        Half of the span before it and after it, or ten seconds, are looked at too: there the error
        is that of a healthy gyro, so that the attitude before and after is known the better. What
        directions do is not linear in the error: it is taken out and fitted again until nothing
        is left of it (Gauss and Newton).

        Parameters
        ----------
        path
            Times (m,) [s] and by how much more than the attitude some gyros have turned until then,
            in the world, (m, 3) [rad]; the error is then that of the attitude that they would have
            given.
        axis
            The axis (3,) in the body frame [1] about which alone something may have failed, and
            the standard deviation of the rate error across it [rad/s]. Else it may be any.
        guesses_rad_s
            Errors (3,) to begin with, of which that is kept which ends up the nearest.
        """
        length_s = end_s - start_s
        reach_s = max(length_s / 2, LEAST_REACH_S)
        known = _known(self.force)
        rows = self._told(known & self._within(start_s - reach_s, end_s + reach_s))
        before, after = (self.time_s[rows] < start_s).sum(), (self.time_s[rows] > end_s).sum()
        inside = self._within(start_s, end_s)[rows].sum()
        if inside < FEWEST_CELLS and min(before, after) < FEWEST_CELLS:
            return None
        expected = np.eye(6) / self.healthy_rad_s**2
        expected[:3, :3] = np.eye(3) / VAGUE**2
        if axis is not None:
            along = np.outer(axis[0], axis[0])
            expected[:3, :3] = along / VAGUE**2 + (np.eye(3) - along) / axis[1] ** 2
        fits = [
            self._converged(rows, (start_s, end_s), path, guess, expected)
            for guess in guesses_rad_s
        ]
        fit = min(fits, key=lambda fit: fit.left)
        error = fit.rates[:3] + fit.rates[3:]
        half = np.sqrt(fit.variance) * student_quantile(fit.dof, confidence)
        anchors = ["gravity", *(["GPS"] if self.by_gps else [])]
        # Where each body axis points, and about which axis of the world a direction may be wrong.
        pointing = np.diff(self.turned[rows], axis=0) / np.diff(self.time_s[rows])[:, None, None]
        upright = np.abs(pointing[:, 2]).mean(axis=0)
        level = np.linalg.norm(pointing[:, :2], axis=1).mean(axis=0)
        quantile = student_quantile(np.array([float(len(rows))]), confidence)
        tilted = quantile * RAMP * np.sqrt((self.unseen[rows] ** 2).mean() / 2.0)
        half = np.hypot(half, level * tilted / length_s)
        heard = rows[_known(self.compass[rows])]
        if len(heard) >= FEWEST_CELLS:
            anchors.append("compass")
            seen_s = self.time_s[rows[-1]] - self.time_s[rows[0]] + CELL_S
            own = COMPASS_DOUBT_RAD * np.sqrt(length_s / (2.0 * seen_s))
            turned = np.hypot(own, quantile * RAMP * _strayed(self.compass[heard]))
            half = np.hypot(half, upright * turned / length_s)
        return Drift(
            error_rad_s=error,
            half_width_rad_s=half,
            tilt_rad=float(np.median(_angle(self.force[rows], self.expected[rows]))),
            anchors=tuple(anchors),
        )

    def _converged(
        self,
        rows: NDArray[np.int64],
        span: tuple[float, float],
        path: tuple[Floats, Floats] | None,
        guess: Floats,
        expected: Floats,
    ) -> _Fit:
        """Take rate errors out and fit again what is left of them."""
        cells = slice(int(rows[0]), int(rows[-1]) + 1)
        more = np.zeros((cells.stop - cells.start, 3))
        if path is not None:
            more = np.column_stack([np.interp(self.time_s[cells], path[0], p) for p in path[1].T])
        turned, inside = self.turned[cells], self._turned_in(span, cells)
        rates = np.concatenate([guess, np.zeros(3)])
        for _ in range(MOST_STEPS):
            turn = _accumulated(np.diff(more - inside @ rates[:3] - turned @ rates[3:], axis=0))
            fit = _fitted(*self._equations(rows, cells.start, turn, inside), expected, rates)
            step = (fit.rates - rates).reshape(2, 3).sum(axis=0)
            rates = fit.rates
            if float(np.abs(step).max()) * (span[1] - span[0]) < CONVERGED_RAD:
                break
        # What it still swings by is not known.
        return replace(fit, variance=fit.variance + step**2)

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
        self, rows: NDArray[np.int64], first: int, turn: Floats, inside: Floats
    ) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Write linear equations for what is not known.

        That is the rate error in the span, in excess of a constant one; that constant one; the
        attitude error at the start of each segment; and what the usual heading is off by.

        Parameters
        ----------
        turn : (m, 3, 3)
            What turns the attitude's world into that of the gyros, from cell `first` on.
        inside : (m, 3, 3)
            Integral of R_att over the part of the span that is over. [s]

        Returns
        -------
        design : (n, 3, n_unknowns)
            Three equations a cell: the two horizontal components of the force, and the heading of
            the compass; zeros where there is none.
        target : (n, 3)
        kind : (3,)
            Which equations have one and the same noise.
        """
        own = rows - first
        segments, number = np.unique(self.segment[rows], return_inverse=True)
        start = np.zeros((len(rows), 3, 3 * len(segments)))
        for axis in range(3):
            start[np.arange(len(rows)), axis, 3 * number + axis] = 1.0
        expected = self.expected[rows]
        force = _times(turn[own], self.force[rows])
        known = _known(self.compass[rows])
        field = np.where(known[:, None], _times(turn[own], self.compass[rows]), 0.0)
        north = self.compass[rows][known].mean(axis=0) if known.any() else np.zeros(3)
        level = _levelling(number, force, expected, field, north)
        force, field = _times(level, force), _times(level, field)
        turned = self.turned[first : first + len(turn)]
        # Attitude error d = turned b + d_start; a direction s appears as s + d x s.
        tilt = np.concatenate(
            [
                level @ _along(turn, inside)[own],
                level @ _along(turn, turned)[own],
                start,
                np.zeros((len(rows), 3, 1)),
            ],
            axis=2,
        )
        lever = -_cross(expected)
        gravity = (lever @ tilt)[:, :2]
        usual = field[known].mean(axis=0) if known.any() else np.zeros(3)
        # Of the compass only the heading is believed: currents of the motors change its vertical
        # part with the throttle, and gravity is there to tell the tilt.
        across = np.array([-usual[1], usual[0], 0.0])
        across /= max(float(across @ across), LEAST_VARIANCE)
        lever = across @ -_cross(np.broadcast_to(usual, field.shape))
        heading = (lever[:, None, :] @ tilt)[:, 0]
        heading[:, -1] = 1.0
        turn_of_it = (field - usual) @ across
        design = np.concatenate([gravity, np.where(known[:, None], heading, 0.0)[:, None]], axis=1)
        target = np.column_stack([(force - expected)[:, :2], np.where(known, turn_of_it, 0.0)])
        return design, target, np.array([0, 0, 1])

    def _turned_in(self, span: tuple[float, float], cells: slice) -> Floats:
        """Integral of R_att over that part of a span which is over at each cell, (n, 3, 3). [s]"""
        at_s = np.clip(self.time_s[cells], *span)
        flat = self.turned.reshape(-1, 9)
        columns = [np.interp(at_s, self.time_s, column) for column in flat.T]
        return np.column_stack(columns).reshape(-1, 3, 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fit:
    """Rate errors that were fitted.

    Parameters
    ----------
    rates : (6,)
        The error in the span in excess of a constant one, and that constant one. [rad/s]
    variance, dof : (3,)
        Of their sum about each axis, [rad^2/s^2], and its degrees of freedom: a kind of equation
        whose noise is badly known matters as far as it has a part in the answer (Satterthwaite's
        formula).
    left
        Mean square of what is left of the equations.
    """

    rates: Floats
    variance: Floats
    dof: Floats
    left: float


def _fitted(
    design: Floats,
    target: Floats,
    kind: NDArray[np.int64],
    expected: Floats,
    taken_out: Floats,
) -> _Fit:
    """Fit both rate errors by least squares.

    Each kind of equation is weighted by the long-run variance of its residuals, which allows for
    noise of any colour: a manoeuvre that goes on counts for more, a velocity that comes back to
    what it was for less.

    Parameters
    ----------
    expected : (6, 6)
        What is known of the rate errors beforehand: the inverse of a covariance.
    taken_out : (6,)
        What has been taken out of them. [rad/s]
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
    information = np.eye(unknowns) / VAGUE**2
    information[:6, :6] = expected
    pull = np.zeros(unknowns)
    pull[:6] = -expected @ taken_out
    for _ in range(ROUNDS):
        told = [
            np.einsum("nru,nrv->uv", design[:, g] / long_run[g, None], design[:, g]) for g in groups
        ]
        covariance = np.linalg.inv(np.sum(told, axis=0) + information)
        weighted = design / long_run[:, None]
        solved = covariance @ (np.einsum("nru,nr->u", weighted, target) + pull)
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
    left = float((residual[used] ** 2).mean())
    return _Fit(rates=solved[:6] + taken_out, variance=variance, dof=dof, left=left)


def _strayed(field: Floats) -> float:
    """Tell by what standard deviation the heading of a field (n, 3) strays, by its size. [rad]

    Neither steel nor currents know where north is: what they add to the field changes its size as
    much as its direction. Turning does not change the size, so that no attitude has a part in it.
    """
    across = float(np.median(np.linalg.norm(field[:, :2], axis=1)))
    return float(np.linalg.norm(field, axis=1).std()) / max(across, LEAST_VARIANCE)


def _accumulated(steps: Floats) -> Floats:
    """Multiply small turns (n, 3) [rad] up, (n + 1, 3, 3)."""
    angle = np.linalg.norm(steps, axis=1)[:, None, None]
    about = _cross(steps)
    # Rodrigues' formula; sin(a) / a and (1 - cos(a)) / a^2 without a division by zero.
    small = np.eye(3) + np.sinc(angle / np.pi) * about
    small = small + np.sinc(angle / (2 * np.pi)) ** 2 / 2.0 * about @ about
    turns = [np.eye(3)]
    for turn in small:
        turns.append(turns[-1] @ turn)
    return np.array(turns)


def _along(turn: Floats, integral: Floats) -> Floats:
    """Integrate anew what was integrated over cells (n, 3, 3), each step of it turned (n, 3, 3)."""
    found = np.zeros_like(integral)
    middle = (turn[1:] + turn[:-1]) / 2.0
    np.cumsum(middle @ np.diff(integral, axis=0), axis=0, out=found[1:])
    return found


def _levelling(
    segment: NDArray[np.int64], force: Floats, expected: Floats, field: Floats, north: Floats
) -> Floats:
    """Rotations (n, 3, 3) that level each segment by the mean of its forces, and head it north.

    A filter that starts anew knows neither, and the equations are linear in what it is off by.
    """
    level = np.empty((len(force), 3, 3))
    for number in np.unique(segment):
        own = segment == number
        found, wanted = _directions(np.stack([force[own].mean(axis=0), expected[own].mean(axis=0)]))
        about = _cross(np.cross(found, wanted)[None])[0]
        cosine = max(float(found @ wanted), LEAST_VARIANCE - 1.0)
        # Rodrigues' formula of the shortest turn from one direction to another.
        upright = np.eye(3) + about + about @ about / (1.0 + cosine)
        seen = upright @ field[own].sum(axis=0)
        turn = np.arctan2(north[1], north[0]) - np.arctan2(seen[1], seen[0]) if seen.any() else 0.0
        level[own] = _accumulated(np.array([[0.0, 0.0, turn]]))[1] @ upright
    return level


def _directions(v: Floats) -> Floats:
    """Make vectors (n, 3) one long."""
    return np.asarray(v / np.maximum(np.linalg.norm(v, axis=1), LEAST_VARIANCE)[:, None])


def _times(matrices: Floats, vectors: Floats) -> Floats:
    """Turn vectors (n, 3) by matrices (n, 3, 3)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])


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
