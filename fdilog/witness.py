"""The attitude of the log as a witness: a further triad that is never accused itself.

A filter that integrates a failed gyro follows it for a while, and then agrees with the wrong one.
So the witness decides only where two things say the same: the attitude itself, and the attitude put
right by what no gyro feeds (`fdilog.anchors`), each with its own interval.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.anchors import CELL_S, Anchors, Drift
from fdilog.attitude import (
    interpolated,
    logged_attitude,
    matrices,
    mean_rates,
    rotation_vectors,
)
from fdilog.clocks import HOLE_PERIODS, clean_stamps
from fdilog.config import Config
from fdilog.noise import windowed_mean
from fdilog.offsets import ClockOffset, estimate_offset
from fdilog.recording import Recording, Stream
from fdilog.table import Channel, ChannelTable

Floats = NDArray[np.float64]

SOURCE = "att"
FEWEST_ATTITUDES = 50
SLOWEST_HZ = 2.0
"""Between slower attitudes a vehicle turns back and forth, which no rotation vector shows."""

JUMP_RAD = np.radians(5.0)
"""A step that turns so much further than any gyro says is a jump: a lane switch, a reset of yaw."""
JUMP_SIGMAS = 10.0
LONGEST_JUMP = 2
"""A jump is one step, or two where it falls between; what goes on for longer is another rate."""

STANDARD_GRAVITY = 9.80665
NORTH_EAST = ("GPS", "Spd", "GCrs", "Status")
"""Stream of GPS with ground speed [m/s] and course [deg], as DataFlash logs have it."""
GPS_FIX_3D = 3
GPS_LAGS_S = np.arange(0.0, 0.65, 0.1)
"""A GPS velocity is up to half a second old when it is logged."""
FIELD = ("MagX", "MagY", "MagZ")
COMPASS = "MAG"


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """An attitude fit to be a witness.

    Parameters
    ----------
    stream
        Name of the stream it comes from.
    anchors
        What it is held against.
    clock
        By how much its stamps run late against the gyros, which has been put right.
    """

    stream: str
    anchors: Anchors
    clock: ClockOffset | None = None


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

    stream: str
    time_s: Floats
    quaternion: Floats
    sound: NDArray[np.bool_]


def attitude_stream(recording: Recording) -> Stream | None:
    """Choose the attitude of a recording: a solution before an IMU's own orientation."""
    found = [
        stream
        for stream in recording.streams
        if len(stream.time_ns) >= FEWEST_ATTITUDES
        and stream.rate_hz >= SLOWEST_HZ
        and _is_attitude(stream)
    ]
    return max(
        found,
        key=lambda stream: (stream.origin == "derived", len(stream.time_ns), stream.name),
        default=None,
    )


def _is_attitude(stream: Stream) -> bool:
    angles = ("roll", "pitch", "yaw")
    in_radians = all(unit == "rad" for name, unit in stream.units.items() if name.lower() in angles)
    # An IMU's own orientation counts, a filter's other outputs (another lane, degrees) do not.
    own = stream.origin == "derived" or bool(stream.gyro)
    q = logged_attitude(stream.columns) if own and in_radians else None
    if q is None:
        return False
    known = q[np.isfinite(q).all(axis=1)]
    return len(known) >= FEWEST_ATTITUDES and bool((known != known[0]).any())


def find_witness(
    recording: Recording, stream: Stream, table: ChannelTable, zero_ns: int, config: Config
) -> tuple[ChannelTable, Witness] | str:
    """Add an attitude to a table of gyros as a derived triad, or say why it is no witness.

    Parameters
    ----------
    stream
        Of the attitude, as `attitude_stream` chose it.
    table
        Gyros alone.
    zero_ns
        The table's time 0 on the recording's clock. [ns]

    Returns
    -------
    table, witness
        The table with ``att.x``, ``att.y``, ``att.z`` as its last columns.
    """
    attitude = _placed(stream, zero_ns)
    if attitude is None:
        return "too few attitudes, or its clock restarts"
    attitude, clock = _aligned(attitude, table, config)
    attitude = _without_jumps(attitude, table)
    turn = rotation_vectors(attitude.quaternion)
    rate, valid = mean_rates(attitude.time_s, turn, attitude.sound, table.time_s)
    anchors = _anchors(recording, attitude, zero_ns)
    if anchors is None:
        return "no accelerometer to hold it against"
    flight = anchors.drift(attitude.time_s[0], attitude.time_s[-1], config.windows.confidence)
    if flight is not None and flight.lost:
        tilt_deg = np.degrees(flight.tilt_rad)
        return f"lost: {tilt_deg:.0f} deg from the accelerometers' vertical for half of the flight"
    with_attitude = ChannelTable(
        time_s=table.time_s,
        rate_rad_s=np.column_stack([table.rate_rad_s, rate]),
        valid=np.column_stack([table.valid, valid, valid, valid]),
        channels=(*table.channels, *_channels(attitude)),
        period_s=table.period_s,
    )
    return with_attitude, Witness(stream=stream.name, anchors=anchors, clock=clock)


def _channels(attitude: Attitude) -> tuple[Channel, ...]:
    rate_hz = 1.0 / float(np.median(np.diff(attitude.time_s)))
    return tuple(
        Channel(
            name=f"{SOURCE}.{letter}",
            source=SOURCE,
            axis=(float(k == 0), float(k == 1), float(k == 2)),
            rate_hz=rate_hz,
            samples=len(attitude.time_s),
            derived=True,
        )
        for k, letter in enumerate("xyz")
    )


def _placed(stream: Stream, zero_ns: int) -> Attitude | None:
    """Bring an attitude into flight time; nothing if its clock restarts."""
    (stamps,) = clean_stamps([stream.time_ns])
    q = logged_attitude(stream.columns)
    if stamps.restarts or q is None:
        return None
    q = q[stamps.keep]
    known = np.isfinite(q).all(axis=1)
    time_s = (stamps.time_ns[known] - zero_ns) / 1e9
    if len(time_s) < FEWEST_ATTITUDES:
        return None
    steps = np.diff(time_s)
    sound = steps <= HOLE_PERIODS * float(np.median(steps))
    return Attitude(stream=stream.name, time_s=time_s, quaternion=q[known], sound=sound)


def _triads(table: ChannelTable) -> list[tuple[Floats, Floats]]:
    """Return times (n,) and body rates (n, 3) of every source that senses all three axes."""
    found = []
    for source in dict.fromkeys(channel.source for channel in table.channels):
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        axes = table.axes[columns]
        if len(columns) < 3 or np.linalg.matrix_rank(axes) < 3:
            continue
        rows = np.flatnonzero(table.valid[:, columns].all(axis=1))
        if len(rows) > 2:
            rate = table.rate_rad_s[rows][:, columns] @ np.linalg.pinv(axes).T
            found.append((table.time_s[rows], rate))
    return found


def _aligned(
    attitude: Attitude, table: ChannelTable, config: Config
) -> tuple[Attitude, ClockOffset | None]:
    """Take out by how much the attitude runs late against the first triad, where it is sure."""
    turn = rotation_vectors(attitude.quaternion)
    steps = np.diff(attitude.time_s)
    middle = attitude.time_s[:-1] + steps / 2
    rate = turn / steps[:, None]
    for reference in _triads(table):
        clock = estimate_offset(
            SOURCE,
            reference,
            (middle[attitude.sound], rate[attitude.sound]),
            config.windows.confidence,
        )
        if clock is not None:
            sure = clock.low > 0 or clock.high < 0
            shift_s = clock.offset_s if sure else 0.0
            return replace(attitude, time_s=attitude.time_s - shift_s), clock
    return attitude, None


def _without_jumps(attitude: Attitude, table: ChannelTable) -> Attitude:
    """Mark steps in which the attitude jumps away from what every gyro says."""
    turn = rotation_vectors(attitude.quaternion)
    apart = np.full(len(turn), np.inf)
    for time_s, rate in _triads(table):
        steps = np.diff(time_s)
        path = np.zeros((len(time_s), 3))
        np.cumsum((rate[1:] + rate[:-1]) / 2 * steps[:, None], axis=0, out=path[1:])
        turned = np.column_stack([np.interp(attitude.time_s, time_s, p) for p in path.T])
        apart = np.minimum(apart, np.linalg.norm(turn - np.diff(turned, axis=0), axis=1))
    if not bool(np.isfinite(apart).all()):
        return attitude
    usual = float(np.median(apart[attitude.sound])) if attitude.sound.any() else 0.0
    far = attitude.sound & (apart > max(JUMP_RAD, JUMP_SIGMAS * usual))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(np.int8), [0]])))
    jump = np.zeros(len(far), bool)
    for start, stop in edges.reshape(-1, 2):
        jump[start:stop] = stop - start <= LONGEST_JUMP
    return replace(attitude, sound=attitude.sound & ~jump)


def _anchors(recording: Recording, attitude: Attitude, zero_ns: int) -> Anchors | None:
    """Lay what the attitude is held against out in cells of a second."""
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
    by_gps = False
    if upward < 0:
        # Only then is the world north, east, down, as GPS has it.
        accelerated = _acceleration_by_gps(recording, edges, zero_ns, force)
        if accelerated is not None:
            expected[:, :2], by_gps = accelerated, True
    return Anchors(
        time_s=edges[:-1] + CELL_S / 2,
        segment=_segments(attitude, edges),
        turned=_integrated(attitude, edges),
        force=force,
        expected=expected,
        compass=_compass(recording, attitude, edges, zero_ns),
        by_gps=by_gps,
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
    """Mean magnetic field in the world, over its usual size, (n_cells, 3)."""
    nothing = np.full((len(edges) - 1, 3), np.nan)
    stream = next((s for s in recording.streams if s.name == COMPASS), None)
    if stream is None or not all(name in stream.columns for name in FIELD):
        return nothing
    values, time_s = _values(stream, FIELD), _times(stream, zero_ns)
    instance = stream.columns.get("I")
    if instance is not None and len(instance):
        first = instance == instance.min()
        values, time_s = values[first], time_s[first]
    field = _turned(attitude, edges, time_s, values)
    if not np.isfinite(field).any():
        return nothing
    usual = float(np.nanmedian(np.linalg.norm(field, axis=1)))
    return field / usual if usual > 0 else nothing


def _acceleration_by_gps(
    recording: Recording, edges: Floats, zero_ns: int, force: Floats
) -> Floats | None:
    """Horizontal acceleration (north, east) over gravity, (n_cells, 2), if it explains the force.

    It is used only where taking it out leaves less than there was: an accelerometer that vibration
    spoils, or a filter whose yaw is wrong all along, is not helped by it.
    """
    name, *columns = NORTH_EAST
    stream = next((s for s in recording.streams if s.name == name), None)
    if stream is None or not all(column in stream.columns for column in columns):
        return None
    time_s = _times(stream, zero_ns)
    speed, course, status = (np.asarray(stream.columns[c], np.float64) for c in columns)
    good = (status >= GPS_FIX_3D) & np.isfinite(speed) & np.isfinite(course)
    good[1:] &= np.diff(time_s) > 0
    if good.sum() < FEWEST_ATTITUDES:
        return None
    time_s, speed, course = time_s[good], speed[good], np.radians(course[good])
    velocity = np.column_stack([speed * np.cos(course), speed * np.sin(course)])
    # Between records further apart than a cell the velocity is not known.
    after = np.clip(np.searchsorted(time_s, edges), 1, len(time_s) - 1)
    heard = (edges >= time_s[0]) & (edges <= time_s[-1])
    heard &= time_s[after] - time_s[after - 1] <= CELL_S
    rows = np.isfinite(force).all(axis=1) & heard[1:] & heard[:-1]
    best, least = None, np.inf
    for lag in GPS_LAGS_S:
        at = np.column_stack([np.interp(edges + lag, time_s, v) for v in velocity.T])
        found = np.diff(at, axis=0) / CELL_S / STANDARD_GRAVITY
        left = _spread(force[rows, :2] - found[rows])
        if left < least:
            best, least = found, left
    if best is None or not least < _spread(force[rows, :2]):
        return None
    return np.where((heard[1:] & heard[:-1])[:, None], best, 0.0)


def _spread(values: Floats) -> float:
    """Median square distance from the median, which a few bad seconds do not decide."""
    if not len(values):
        return np.inf
    return float(np.median(((values - np.median(values, axis=0)) ** 2).sum(axis=1)))


@dataclass(frozen=True, kw_only=True)
class Testimony:
    """What a witness says of one gyro over a span.

    Parameters
    ----------
    error, half_width
        The gyro's error if the attitude is right, and the half-width of its interval. [rad/s]
    anchored, anchored_half_width
        The same with the attitude put right by its anchors. [rad/s]
    tolerance
        What they are held against. [rad/s]
    """

    error: float
    half_width: float
    anchored: float
    anchored_half_width: float
    tolerance: float

    @property
    def failed(self) -> bool:
        """Whether the attitude and its anchors both say that the gyro is off."""
        direct = abs(self.error) - self.half_width > self.tolerance
        return direct and abs(self.anchored) - self.anchored_half_width > self.tolerance

    @property
    def sound(self) -> bool:
        """Whether neither the attitude nor its anchors say that the gyro is off."""
        direct = abs(self.error) - self.half_width > self.tolerance
        return not direct and abs(self.anchored) - self.anchored_half_width <= self.tolerance


@dataclass(frozen=True, kw_only=True)
class Statement:
    """What a witness concludes of a fault: whom it names, if anyone, and why."""

    named: int | None
    detail: str


def hear(
    witness: Witness,
    table: ChannelTable,
    suspects: Sequence[int],
    span: tuple[int, int],
    config: Config,
) -> Statement:
    """Ask which of some gyros was off over a span of samples.

    A gyro is named only if the attitude and its anchors both say that it was off, and that none of
    the others was.

    Parameters
    ----------
    table
        Gyros and, among the channels, the derived ones of the attitude.
    suspects
        Columns of gyros.
    """
    start_s, end_s = float(table.time_s[span[0]]), float(table.time_s[span[1] - 1])
    drift = witness.anchors.drift(start_s, end_s, config.windows.confidence)
    if drift is None:
        return Statement(named=None, detail="the attitude has no anchor over so short a time")
    if drift.lost:
        tilt_deg = np.degrees(drift.tilt_rad)
        return Statement(
            named=None,
            detail=f"the attitude is lost: {tilt_deg:.0f} deg from the accelerometers' vertical",
        )
    said = {k: testimony(table, k, span, drift, config) for k in suspects}
    heard = {k: one for k, one in said.items() if one is not None}
    failed = [k for k, one in heard.items() if one.failed]
    rest = [one for k, one in heard.items() if k not in failed]
    if len(failed) == 1 and len(heard) == len(suspects) and all(one.sound for one in rest):
        return Statement(named=failed[0], detail=_words(table, heard, failed[0], drift))
    return Statement(
        named=None,
        detail=f"the attitude, held against {_list(drift.anchors)}, does not tell which",
    )


def testimony(
    table: ChannelTable, channel: int, span: tuple[int, int], drift: Drift, config: Config
) -> Testimony | None:
    """Hold one gyro against the attitude over a span, or nothing where that is not possible."""
    derived = [k for k, one in enumerate(table.channels) if one.derived]
    columns = [channel, *derived]
    rows = span[0] + np.flatnonzero(table.valid[span[0] : span[1], columns].all(axis=1))
    if len(derived) != 3 or not len(rows):
        return None
    axis = table.axes[channel]
    body = table.rate_rad_s[rows][:, derived] @ table.axes[derived]
    apart = table.rate_rad_s[rows, channel] - body @ axis
    looks = windowed_mean(apart[None, :, None])
    error = float(looks.mean[0, 0])
    half = float(looks.half_width(np.ones(1), config.windows.confidence)[0])
    across = drift.half_width(axis)
    bias = np.radians(config.tolerance.bias_deg_s)
    predicted = float((body @ axis).mean())
    return Testimony(
        error=error,
        half_width=half,
        anchored=error + float(axis @ drift.error_rad_s),
        anchored_half_width=float(np.hypot(half, across)),
        tolerance=float(np.hypot(bias, config.tolerance.scale * predicted)),
    )


def _words(table: ChannelTable, heard: dict[int, Testimony], named: int, drift: Drift) -> str:
    def shown(k: int) -> str:
        one = heard[k]
        return (
            f"{table.names[k]} reads {np.degrees(one.error):+.2f} deg/s"
            f" (± {np.degrees(one.half_width):.2f}) beside it,"
            f" {np.degrees(one.anchored):+.2f} (± {np.degrees(one.anchored_half_width):.2f})"
            " with it put right by them"
        )

    order = [named, *(k for k in heard if k != named)]
    return f"the attitude, held against {_list(drift.anchors)}: " + "; ".join(map(shown, order))


def _list(words: Sequence[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
