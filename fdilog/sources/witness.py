"""The attitude of the log as a witness: a further triad that is never accused itself.

Which attitude there is, how late it runs, where it jumps, and the body rates that it gives. What it
is held against is in `fdilog.sources.anchoring`, what it says of a gyro in
`fdilog.decision.testimony`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.sources.anchoring import Attitude, anchored
from fdilog.sources.anchors import Anchors
from fdilog.sources.attitude import logged_attitude, mean_rates, rotation_vectors
from fdilog.sources.clocks import HOLE_PERIODS, clean_stamps
from fdilog.sources.mounting import mountings
from fdilog.sources.offsets import ClockOffset, estimate_offset
from fdilog.table import Channel, ChannelTable

Floats = NDArray[np.float64]

SOURCE = "att"
FEWEST_ATTITUDES = 50
SLOWEST_HZ = 0.9
"""Telemetry sends attitudes once a second at the slowest; some are lost."""

LEAST_TILT = 1e-9
"""What rounding makes of the cosine of a tilt that is none."""

LEAST_MOTION_RAD_S = np.radians(10.0)
"""Twice what aliased vibration leaves in the means of recorded flights."""

FEWEST_LIVELY = 10
FOLLOWED = 0.5
"""A witness explains at least half of the motion of some gyros, second by second, where there is
any to speak of: else it is that of another body, or lost."""

ONE_BODY_FRAME = ("dataflash", "dataflash-text", "tlog", "ulog", "simulated")
"""Formats of autopilots, which log gyros and attitude in the frame of the vehicle."""

JUMP_RAD = np.radians(5.0)
"""A step that turns so much further than any gyro says, and than the steps beside it do, is a jump:
a lane switch, a reset of yaw."""
JUMP_SIGMAS = 10.0
WHIRL_RAD = np.pi / 2
"""A turn by more than that between two attitudes, on which gyros and attitude agree to a half of
it, is too large for a rotation vector to tell the mean of body rates."""
LONGEST_JUMP = 2
BESIDE = 5
"""A jump is one step, or two where it falls between; what goes on for longer is another rate, and
the steps before and after tell it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Witness:
    """An attitude fit to be a witness.

    Parameters
    ----------
    stream
        Name of the stream it comes from.
    attitude
        In flight time, put right by its clock.
    anchors
        What it is held against.
    clock
        By how much its stamps run late against the gyros, which has been put right.
    one_frame
        Whether it is known to be in the body frame of the gyros.
    """

    stream: str
    attitude: Attitude
    anchors: Anchors
    clock: ClockOffset | None = None
    one_frame: bool = True


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
    # The odometry of wheels holds a heading and calls the ground level: no attitude.
    vertical = 1.0 - 2.0 * (known[:, 1] ** 2 + known[:, 2] ** 2)
    return len(known) >= FEWEST_ATTITUDES and bool(np.ptp(vertical) > LEAST_TILT)


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
    if isinstance(attitude, str):
        return attitude
    attitude, clock = _aligned(attitude, table, config)
    attitude = _marked(attitude, table)
    turn = rotation_vectors(attitude.quaternion)
    rate, valid = mean_rates(attitude.time_s, turn, attitude.sound, table.time_s)
    columns = np.column_stack([valid, valid, valid])
    with_attitude = table.beside(rate, columns, _channels(attitude))
    if _contradicts(table, rate) and not _turned(recording, with_attitude):
        return "it contradicts every gyro: turned otherwise than they are, or lost"
    anchors = anchored(recording, attitude, zero_ns, config)
    if anchors is None:
        return "no accelerometer to hold it against"
    flight = anchors.drift(attitude.time_s[0], attitude.time_s[-1], config.windows.confidence)
    if flight is not None and flight.lost:
        tilt_deg = np.degrees(flight.tilt_rad)
        return f"lost, {tilt_deg:.0f} deg from the accelerometers' vertical for half of the flight"
    return with_attitude, Witness(
        stream=stream.name,
        attitude=attitude,
        anchors=anchors,
        clock=clock,
        one_frame=recording.format in ONE_BODY_FRAME,
    )


def _contradicts(table: ChannelTable, rate: Floats) -> bool:
    """Tell whether an attitude explains the motion of no triad of gyros at all."""
    shares = []
    for rows, gyro in triads(table):
        second = np.floor(table.time_s[rows]).astype(np.int64)
        start = np.flatnonzero(np.concatenate([[True], np.diff(second) > 0]))
        count = np.diff(np.append(start, len(rows)))[:, None]
        means = np.add.reduceat(np.hstack([gyro, rate[rows]]), start, axis=0) / count
        means = means[np.isfinite(means).all(axis=1)]
        if not len(means):
            continue
        means -= np.median(means, axis=0)
        # A fault that lasts is in the changes from second to second only where it begins and ends.
        for motion in (means, np.diff(means, axis=0)):
            moving = np.linalg.norm(motion[:, :3], axis=1)
            told = np.linalg.norm(motion[:, 3:], axis=1)
            apart = np.linalg.norm(motion[:, 3:] - motion[:, :3], axis=1)
            # Turned otherwise, it turns as fast. Where it does not, either may have failed.
            alike = (moving < 2.0 * told) & (told < 2.0 * moving)
            lively = alike & (moving > LEAST_MOTION_RAD_S)
            if lively.sum() >= FEWEST_LIVELY:
                shares.append(float(np.median(apart[lively] / moving[lively])))
    return bool(shares) and min(shares) > FOLLOWED


def _turned(recording: Recording, table: ChannelTable) -> bool:
    """Tell whether the gyro is mounted wrongly in the body frame in which the attitude is.

    An autopilot has one body frame. What a ROS log calls an attitude may be that of any frame, and
    then tells nothing of the gyro's mounting.
    """
    return recording.format in ONE_BODY_FRAME and bool(mountings(table).found)


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


def _placed(stream: Stream, zero_ns: int) -> Attitude | str:
    """Bring an attitude into flight time, or say why that cannot be done."""
    (stamps,) = clean_stamps([stream.time_ns])
    q = logged_attitude(stream.columns)
    if q is None:
        return "its columns are no attitude"
    if stamps.restarts:
        return "its clock restarts"
    q = q[stamps.keep]
    known = np.isfinite(q).all(axis=1)
    time_s = (stamps.time_ns[known] - zero_ns) / 1e9
    if len(time_s) < FEWEST_ATTITUDES:
        return f"{len(time_s)} attitudes are too few"
    steps = np.diff(time_s)
    sound = steps <= HOLE_PERIODS * float(np.median(steps))
    return Attitude(time_s=time_s, quaternion=q[known], sound=sound)


def triads(table: ChannelTable) -> list[tuple[NDArray[np.intp], Floats]]:
    """Return rows (n,) and body rates (n, 3) of every source that senses all three axes."""
    found = []
    for source in dict.fromkeys(channel.source for channel in table.channels):
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        axes = table.axes[columns]
        if len(columns) < 3 or np.linalg.matrix_rank(axes) < 3:
            continue
        rows = np.flatnonzero(table.valid[:, columns].all(axis=1))
        if len(rows) > 2:
            rate = table.rate_rad_s[rows][:, columns] @ np.linalg.pinv(axes).T
            found.append((rows, rate))
    return found


def _aligned(
    attitude: Attitude, table: ChannelTable, config: Config
) -> tuple[Attitude, ClockOffset | None]:
    """Take out by how much the attitude runs late against the first triad, where it is sure."""
    turn = rotation_vectors(attitude.quaternion)
    steps = np.diff(attitude.time_s)
    middle = attitude.time_s[:-1] + steps / 2
    rate = turn / steps[:, None]
    for rows, gyro in triads(table):
        clock = estimate_offset(
            SOURCE,
            (table.time_s[rows], gyro),
            (middle[attitude.sound], rate[attitude.sound]),
            config.windows.confidence,
        )
        if clock is not None:
            sure = clock.low > 0 or clock.high < 0
            shift_s = clock.offset_s if sure else 0.0
            return replace(attitude, time_s=attitude.time_s - shift_s), clock
    return attitude, None


def _marked(attitude: Attitude, table: ChannelTable) -> Attitude:
    """Mark steps in which the attitude jumps away from what every gyro says, or whirls."""
    apart = np.full(len(attitude.sound), np.inf)
    whirl = np.zeros(len(apart), bool)
    for rows, rate in triads(table):
        time_s = table.time_s[rows]
        steps = np.diff(time_s)
        path = np.zeros((len(time_s), 3))
        np.cumsum((rate[1:] + rate[:-1]) / 2 * steps[:, None], axis=0, out=path[1:])
        turned = np.column_stack([np.interp(attitude.time_s, time_s, p) for p in path.T])
        turn = np.diff(turned, axis=0)
        further = rotation_vectors(attitude.quaternion, beyond=turn)
        whirl |= (np.linalg.norm(turn, axis=1) > WHIRL_RAD) & (
            np.linalg.norm(further, axis=1) < WHIRL_RAD / 2
        )
        far = np.flatnonzero(np.linalg.norm(further, axis=1) > JUMP_RAD)
        around = np.pad(further, ((BESIDE, BESIDE), (0, 0)), mode="edge")
        beside = around[far[:, None] + np.arange(2 * BESIDE + 1)]
        further[far] -= np.median(beside, axis=1)
        apart = np.minimum(apart, np.linalg.norm(further, axis=1))
    sound = attitude.sound & ~whirl
    if not bool(np.isfinite(apart).all()):
        return attitude
    usual = float(np.median(apart[sound])) if sound.any() else 0.0
    steps_away = sound & (apart > max(JUMP_RAD, JUMP_SIGMAS * usual))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steps_away.astype(np.int8), [0]])))
    jump = np.zeros(len(apart), bool)
    for start, stop in edges.reshape(-1, 2):
        jump[start:stop] = stop - start <= LONGEST_JUMP
    return replace(attitude, sound=sound & ~jump)
