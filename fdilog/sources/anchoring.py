"""Laying out, half second by half second, what an attitude is held against.

The accelerometers of every IMU, the compass, and the acceleration that GPS saw, each turned into
the world by the attitude itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.sources.anchors import CELL_S, Anchors
from fdilog.sources.attitude import interpolated, matrices

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
LONGEST_PAUSE_S = 1.1
"""The slowest GPS in use speaks once a second."""
FEWEST_FIXES = 50
GPS_LAGS_S = np.arange(0.0, 0.65, 0.1)
"""A GPS velocity is up to half a second old when it is logged."""
LONGEST_SAME_S = 5.0
"""A compass at rest repeats its last reading for two and a half seconds on recorded flights."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Attitude:
    """Attitudes of a log, in flight time.

    Parameters
    ----------
    time_s : (n,)
        Strictly increasing. [s]
    quaternion : (n, 4)
        Body to world. [1]
    sound : (n - 1,) bool
        Whether a step is neither a jump nor a pause.
    """

    time_s: Floats
    quaternion: Floats
    sound: NDArray[np.bool_]


def anchored(
    recording: Recording, attitude: Attitude, zero_ns: int, config: Config
) -> Anchors | None:
    """Lay what the attitude is held against out in cells."""
    first, last = attitude.time_s[0], attitude.time_s[-1]
    edges = np.arange(np.ceil(first / CELL_S), np.floor(last / CELL_S) + 1) * CELL_S
    if len(edges) < 2:
        return None
    forces = [
        _turned(attitude, edges, _times(stream, zero_ns), _values(stream, stream.accelerometer))
        for stream in recording.streams
        if len(stream.accelerometer) == 3 and stream.columns
    ]
    forces = [force for force in forces if np.isfinite(force).any()]
    if not forces:
        return None
    with np.errstate(invalid="ignore"):
        known = np.asarray(np.isfinite(forces).all(axis=2), bool)
        force = np.where(known[:, :, None], forces, 0.0).sum(axis=0) / known.sum(axis=0)[:, None]
    usual = float(np.nanmedian(np.linalg.norm(force, axis=1)))
    if not usual > 0:
        return None
    force = force / usual
    upward = 1.0 if float(np.nanmedian(force[:, 2])) > 0 else -1.0
    expected = np.zeros_like(force)
    expected[:, 2] = upward
    accelerated, explained = _acceleration_by_gps(recording, edges, zero_ns, force)
    # Only where down is positive is the world north, east, down, as GPS has it.
    by_gps = explained and upward < 0
    heard = np.asarray(np.isfinite(accelerated).all(axis=1), bool)
    if by_gps:
        expected[heard, :2] = accelerated[heard]
    # Where GPS was silent, the vehicle accelerated as it usually did.
    size = np.linalg.norm(accelerated, axis=1)
    size[~heard] = np.sqrt((size[heard] ** 2).mean()) if heard.any() else 0.0
    # An attitude that does not know north shows the same acceleration in another direction.
    shown = size if by_gps else np.nan_to_num(np.linalg.norm(force[:, :2], axis=1))
    unseen = np.where(heard, np.maximum(size - shown, 0.0), size)
    return Anchors(
        time_s=edges[:-1] + CELL_S / 2,
        segment=_segments(attitude, edges),
        turned=_integrated(attitude, edges),
        force=force,
        expected=expected,
        compass=_compass(recording, attitude, edges, zero_ns),
        by_gps=by_gps,
        unseen=unseen,
        healthy_rad_s=float(np.radians(config.noise.bias_sigma_deg_s)),
    )


def _times(stream: Stream, zero_ns: int) -> Floats:
    return np.asarray((stream.time_ns - zero_ns) / 1e9, np.float64)


def _values(stream: Stream, names: Sequence[str]) -> Floats:
    return np.column_stack([np.asarray(stream.columns[name], np.float64) for name in names])


def _turned(attitude: Attitude, edges: Floats, time_s: Floats, vectors: Floats) -> Floats:
    """Mean over each cell of body vectors turned into the world, (n_cells, 3); NaN for none."""
    cell = np.searchsorted(edges, time_s, side="right") - 1
    good = (cell >= 0) & (cell < len(edges) - 1) & np.isfinite(vectors).all(axis=1)
    good &= vectors.any(axis=1)
    step = np.clip(np.searchsorted(attitude.time_s, time_s) - 1, 0, len(attitude.sound) - 1)
    good &= attitude.sound[step]
    q = interpolated(attitude.time_s, attitude.quaternion, time_s[good])
    world = np.einsum("nij,nj->ni", matrices(q), vectors[good])
    count = np.bincount(cell[good], minlength=len(edges) - 1)
    sums = np.column_stack(
        [np.bincount(cell[good], weights=w, minlength=len(edges) - 1) for w in world.T]
    )
    # Cells with less than half of the usual number of readings belong to another time than theirs.
    enough = (
        count > 0.5 * max(float(np.median(count[count > 0])), 1.0) if count.any() else count > 0
    )
    return np.where(enough[:, None], sums / np.maximum(count, 1)[:, None], np.nan)


def _integrated(attitude: Attitude, edges: Floats) -> Floats:
    """Integral of R_att over time, at the middle of each cell, (n_cells, 3, 3). [s]"""
    r = matrices(attitude.quaternion).reshape(-1, 9)
    total = np.zeros_like(r)
    steps = np.diff(attitude.time_s)[:, None]
    np.cumsum((r[1:] + r[:-1]) / 2 * steps, axis=0, out=total[1:])
    middle = edges[:-1] + CELL_S / 2
    columns = [np.interp(middle, attitude.time_s, column) for column in total.T]
    return np.column_stack(columns).reshape(-1, 3, 3)


def _segments(attitude: Attitude, edges: Floats) -> NDArray[np.int64]:
    """Count the jumps and pauses before the middle of each cell, (n_cells,)."""
    broken = attitude.time_s[1:][~attitude.sound]
    return np.searchsorted(broken, edges[:-1] + CELL_S / 2)


def _compass(recording: Recording, attitude: Attitude, edges: Floats, zero_ns: int) -> Floats:
    """Mean magnetic field in the world, over its usual size, (n_cells, 3).

    That of the compass that tells of the most cells, the first of them.
    """
    fields = [np.full((len(edges) - 1, 3), np.nan)]
    for stream in recording.streams:
        if len(stream.compass) != 3 or not stream.columns:
            continue
        values, time_s = _values(stream, stream.compass), _times(stream, zero_ns)
        known = np.isfinite(values).all(axis=1)
        values, time_s = values[known], time_s[known]
        alive = ~_frozen(time_s, values)
        field = _turned(attitude, edges, time_s[alive], values[alive])
        if np.isfinite(field).any():
            fields.append(field / float(np.nanmedian(np.linalg.norm(field, axis=1))))
    return max(fields, key=lambda field: int(np.isfinite(field).all(axis=1).sum()))


def _frozen(time_s: Floats, values: Floats) -> NDArray[np.bool_]:
    """Tell which readings (n, k) repeat one for so long that no sensor is behind them, (n,)."""
    if not len(values):
        return np.zeros(0, bool)
    fresh = np.concatenate([[True], (np.diff(values, axis=0) != 0).any(axis=1)])
    start = np.flatnonzero(fresh)
    length_s = np.append(time_s[start[1:] - 1], time_s[-1:]) - time_s[start]
    return np.asarray(length_s[np.cumsum(fresh) - 1] > LONGEST_SAME_S)


def _acceleration_by_gps(
    recording: Recording, edges: Floats, zero_ns: int, force: Floats
) -> tuple[Floats, bool]:
    """Horizontal acceleration (north, east) over gravity, (n, 2), and if it explains the force.

    It is not-a-number where GPS was not heard. It explains the force where taking it out leaves
    less than there was: an accelerometer that vibration spoils, a filter whose yaw is wrong all
    along, or one that takes the force of a turn for the vertical, is not helped by it.
    """
    nothing = np.full((len(edges) - 1, 2), np.nan)
    stream = next((s for s in recording.streams if s.velocity and s.columns), None)
    if stream is None:
        return nothing, False
    time_s, velocity = _times(stream, zero_ns), _values(stream, stream.velocity)
    good = np.isfinite(velocity).all(axis=1) & (np.diff(time_s, prepend=-np.inf) > 0)
    if good.sum() < FEWEST_FIXES:
        return nothing, False
    time_s, velocity = time_s[good], velocity[good]
    after = np.clip(np.searchsorted(time_s, edges), 1, len(time_s) - 1)
    heard = (edges >= time_s[0]) & (edges <= time_s[-1])
    heard &= time_s[after] - time_s[after - 1] <= LONGEST_PAUSE_S
    rows = np.isfinite(force).all(axis=1) & heard[1:] & heard[:-1]
    best, least = nothing, np.inf
    for lag in GPS_LAGS_S:
        at = np.column_stack([np.interp(edges + lag, time_s, v) for v in velocity.T])
        found = np.diff(at, axis=0) / CELL_S / STANDARD_GRAVITY
        left = _spread(force[rows, :2] - found[rows])
        if left < least:
            best, least = found, left
    accelerated = np.where((heard[1:] & heard[:-1])[:, None], best, np.nan)
    return accelerated, least < _spread(force[rows, :2])


def _spread(values: Floats) -> float:
    """Median square distance from the median, which a few bad seconds do not decide."""
    if not len(values):
        return np.inf
    return float(np.median(((values - np.median(values, axis=0)) ** 2).sum(axis=1)))
