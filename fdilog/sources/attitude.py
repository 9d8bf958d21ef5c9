"""Rotations as arrays: what an attitude says of the body rate, and of directions in the world.

An attitude is a Hamilton quaternion (w, x, y, z) that turns body axes into world axes. Which world
(north, east, down or east, north, up) does not matter to anything here.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ANGLES = (("Roll", "Pitch", "Yaw"), ("roll", "pitch", "yaw"))
"""Names under which logs hold Euler angles, turned in the order yaw, pitch, roll. [rad]"""

QUATERNIONS = (
    ("qw", "qx", "qy", "qz"),
    ("orientation.w", "orientation.x", "orientation.y", "orientation.z"),
)
"""Names under which logs hold a quaternion, body to world. [1]"""


def logged_attitude(columns: Mapping[str, NDArray[Any]]) -> Floats | None:
    """Find an attitude among the columns of a stream.

    Returns
    -------
    quaternion : (n, 4)
        Unit quaternions, body to world, not-a-number where the log holds none; nothing if the
        columns are no attitude. [1]
    """
    for names in QUATERNIONS:
        if all(name in columns for name in names):
            q = np.column_stack([np.asarray(columns[name], np.float64) for name in names])
            length = np.linalg.norm(q, axis=1)
            with np.errstate(invalid="ignore", divide="ignore"):
                # Half a length away from one it is a placeholder: ROS fills zeros in.
                return np.where((np.abs(length - 1.0) < 0.5)[:, None], q / length[:, None], np.nan)
    for angles in ANGLES:
        if all(name in columns for name in angles):
            return from_euler(
                np.column_stack([np.asarray(columns[name], np.float64) for name in angles])
            )
    return None


def from_euler(angles: Floats) -> Floats:
    """Quaternion, body to world, of roll, pitch and yaw.

    Parameters
    ----------
    angles : (n, 3)
        Roll, pitch, yaw; the body is turned by yaw about z, then pitch about y, then roll about x.
        [rad]
    """
    half = 0.5 * angles
    (cr, cp, cy), (sr, sp, sy) = np.cos(half).T, np.sin(half).T
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )


def product(p: Floats, q: Floats) -> Floats:
    """Hamilton product p q, (n, 4): first the turn q, then the turn p."""
    w = p[:, 0] * q[:, 0] - (p[:, 1:] * q[:, 1:]).sum(axis=1)
    xyz = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.column_stack([w, xyz])


def matrices(q: Floats) -> Floats:
    """Rotation matrices (n, 3, 3), body to world, of unit quaternions (n, 4)."""
    w, x, y, z = q.T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=1),
        ],
        axis=1,
    )


def rotation_vectors(q: Floats, beyond: Floats | None = None) -> Floats:
    """Turn from each attitude to the next, in body axes, (n - 1, 3). [rad]

    It is the logarithm of ``R1' R2``, the shortest turn there is between the two, so neither the
    wrap of an angle nor gimbal lock shows in it.

    Parameters
    ----------
    q : (n, 4)
        Attitudes.
    beyond : (n - 1, 3)
        Rotation vectors of turns that each step begins with; only what is beyond them is returned.
        [rad]
    """
    inverse = q[:-1] * np.array([1.0, -1.0, -1.0, -1.0])
    step = product(inverse, q[1:])
    if beyond is not None:
        half = np.linalg.norm(beyond, axis=1, keepdims=True) / 2.0
        step = product(np.hstack([np.cos(half), -beyond * np.sinc(half / np.pi) / 2.0]), step)
    step = np.where(step[:, :1] < 0, -step, step)
    sine = np.linalg.norm(step[:, 1:], axis=1)
    angle = 2.0 * np.arctan2(sine, step[:, 0])
    with np.errstate(invalid="ignore", divide="ignore"):
        factor = np.where(sine > 0, angle / sine, 2.0)
    return np.asarray(step[:, 1:] * factor[:, None])


def interpolated(time_s: Floats, q: Floats, at_s: Floats) -> Floats:
    """Attitudes at other instants, (n, 4), between neighbours on the shorter way; ends are held.

    Normalised linear interpolation: for the turns of a tenth of a second it differs from the exact
    one by less than a logged angle is rounded by.
    """
    upper = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    before, after = q[upper - 1], q[upper]
    after = np.where((before * after).sum(axis=1, keepdims=True) < 0, -after, after)
    step = time_s[upper] - time_s[upper - 1]
    share = np.clip((at_s - time_s[upper - 1]) / step, 0.0, 1.0)[:, None]
    mixed = before * (1.0 - share) + after * share
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))


def mean_rates(
    time_s: Floats, turn: Floats, sound: NDArray[np.bool_], at_s: Floats
) -> tuple[Floats, NDArray[np.bool_]]:
    """Mean body rate between the two attitudes about each instant.

    The mean of what is returned over a window equals the net turn over it, as far as the window
    holds whole steps.

    Parameters
    ----------
    time_s : (n,)
        Strictly increasing times of the attitudes. [s]
    turn : (n - 1, 3)
        `rotation_vectors` between them. [rad]
    sound : (n - 1,) bool
        Whether a step may be used.
    at_s : (m,)
        Instants. [s]

    Returns
    -------
    rate : (m, 3)
        NaN where there is none. [rad/s]
    valid : (m,) bool
    """
    upper = np.searchsorted(time_s, at_s)
    inside = (upper > 0) & (upper < len(time_s))
    step = np.clip(upper - 1, 0, len(turn) - 1)
    valid = inside & sound[step]
    rate = turn[step] / (time_s[step + 1] - time_s[step])[:, None]
    return np.where(valid[:, None], rate, np.nan), valid
