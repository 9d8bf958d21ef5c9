"""How often the attitude of a log tells which gyro is off, counted on recorded flights.

A bias of 3 deg/s for 30 s is put into a random axis of a random IMU at a random time. Counted are
findings that name the failed channel alone (pinned), it among several (suspect), nobody (missed),
and any that name somebody else alone (wrong):

* two IMUs, without an attitude and with the log's own;
* two IMUs, with an attitude that a complementary filter integrated from the faulty gyro, drawn back
  to gravity and to the log's own heading with a time constant of 5 to 20 s;
* one IMU, with the log's own attitude.

    python benchmarks/witness.py LOG... [--trials 200] [--seed 1]
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.sources.attitude import from_euler, interpolated, logged_attitude, matrices
from fdilog.sources.clocks import HOLE_PERIODS, clean_stamps
from fdilog.sources.gyros import choose
from fdilog.sources.witness import attitude_stream

Floats = NDArray[np.float64]
# The other detectors corroborate what the leading one found, and take their time.
CONFIG = replace(Config(), detectors=replace(Config().detectors, use=("parity",)))
BIAS_RAD_S = np.radians(3.0)
DURATION_S = 30.0
TIME_CONSTANTS_S = (5.0, 20.0)
STEP_S = 0.02


def without_attitude(recording: Recording) -> Recording:
    stream = attitude_stream(recording)
    return replace(recording, streams=tuple(s for s in recording.streams if s is not stream))


def first_imu_alone(recording: Recording) -> Recording:
    gyros, _ = choose(recording, CONFIG)
    others = {id(gyro.stream) for gyro in gyros[1:]}
    return replace(recording, streams=tuple(s for s in recording.streams if id(s) not in others))


def misled(
    recording: Recording, imu: str, tau_s: float, upsets: Sequence[tuple[float, Floats]] = ()
) -> Recording:
    """Replace the attitude by one that a filter would have made of this IMU's gyro.

    It integrates the gyro and draws tilt to the accelerometers and heading to that of the log's own
    attitude (as a compass would), each with the time constant. Holes are the log's, not the
    filter's, which goes on meanwhile.

    Parameters
    ----------
    upsets
        When it starts anew with a wrong attitude [s since the first], and by what rotation vector
        (3,) that is off. [rad]
    """
    stream = attitude_stream(recording)
    q = None if stream is None else logged_attitude(stream.columns)
    if stream is None or q is None:
        return recording
    (gyro,) = [one for one in choose(recording, CONFIG)[0] if one.name == imu]
    stamps = clean_stamps([gyro.time_ns])[0]
    gyro_s, rate = stamps.time_ns / 1e9, gyro.rate_rad_s[stamps.keep]
    force = np.column_stack([gyro.stream.columns[name] for name in gyro.stream.accelerometer])
    force = np.asarray(force, np.float64)[stamps.keep]
    kept = clean_stamps([stream.time_ns])[0]
    time_s, true = kept.time_ns / 1e9, q[kept.keep]
    grid = np.arange(time_s[0], time_s[-1], STEP_S)
    w = np.column_stack([np.interp(grid, gyro_s, c) for c in rate.T])
    f = np.column_stack([np.interp(grid, gyro_s, c) for c in force.T])
    pauses = np.diff(gyro_s)
    pauses = np.where(pauses > HOLE_PERIODS * np.median(pauses), pauses, 0.0)
    after = np.clip(np.searchsorted(gyro_s, grid), 1, len(gyro_s) - 1)
    unheard = (pauses[after - 1] > 0.0) | (grid < gyro_s[0]) | (grid > gyro_s[-1])
    anew = {int(np.searchsorted(grid, grid[0] + at_s)): turn for at_s, turn in upsets}
    own = interpolated(time_s, true, grid)
    r_own = matrices(own)
    heading = np.arctan2(r_own[:, 1, 0], r_own[:, 0, 0])
    gain = STEP_S / tau_s
    turned = np.empty((len(grid), 3, 3))
    r = r_own[0]
    for k in range(len(grid)):
        if k in anew:
            r = _turn(anew[k]) @ r
        turned[k] = r
        if unheard[k]:
            r = r @ r_own[k].T @ r_own[min(k + 1, len(grid) - 1)]
            continue
        up = r @ f[k]
        pull = np.cross(up, [0.0, 0.0, -1.0]) / max(float(np.linalg.norm(up)), 1e-9)
        yaw = np.arctan2(r[1, 0], r[0, 0])
        pull[2] = (heading[k] - yaw + np.pi) % (2 * np.pi) - np.pi
        r = _turn(gain * pull) @ r @ _turn(w[k] * STEP_S)
    roll = np.arctan2(turned[:, 2, 1], turned[:, 2, 2])
    pitch = -np.arcsin(np.clip(turned[:, 2, 0], -1, 1))
    yaw = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    followed = interpolated(grid, from_euler(np.column_stack([roll, pitch, yaw])), time_s)
    columns = dict(zip(("qw", "qx", "qy", "qz"), followed.T, strict=True))
    made = Stream(name=stream.name, time_ns=kept.time_ns, columns=columns, origin="derived")
    streams = tuple(made if s is stream else s for s in recording.streams)
    return replace(recording, streams=streams)


def _turn(vector: Floats) -> Floats:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    turned: Floats = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)
    return turned


def outcome(recording: Recording, channel: str, span: tuple[float, float]) -> str:
    """Say what an analysis makes of a fault of one channel."""
    findings = analyse_recording(recording, CONFIG).findings
    near = [f for f in findings if f.start_s < span[1] + 5 and f.end_s > span[0] - 5]
    alone = {f.suspects[0] for f in near if f.isolated}
    if alone - {channel}:
        return "wrong"
    if channel in alone:
        return "pinned"
    return "suspect" if any(channel in f.suspects for f in near) else "missed"


def flown(recording: Recording) -> list[tuple[float, float]]:
    """Stretches of the gyros without a hole that can hold the fault, in flight time. [s]"""
    times = np.sort(np.concatenate([g.time_ns for g in choose(recording, CONFIG)[0]])) / 1e9
    times -= times[0]
    steps = np.diff(times)
    breaks = np.flatnonzero(steps > max(1.0, HOLE_PERIODS * float(np.median(steps[steps > 0]))))
    starts = np.append(times[0], times[breaks + 1])
    ends = np.append(times[breaks], times[-1])
    return [(a, b) for a, b in zip(starts, ends, strict=True) if b - a > DURATION_S + 1.0]


def count(
    title: str,
    recording: Recording,
    seen: Callable[[Recording, str, np.random.Generator], Recording],
    trials: int,
    seed: int,
) -> None:
    """Put trials faults in, look at each through ``seen``, and print what became of them."""
    rng = np.random.default_rng(seed)
    parts = flown(recording)
    names = [gyro.name for gyro in choose(recording, CONFIG)[0]]
    if not parts:
        print(f"  {title}: no stretch of {DURATION_S:g} s")
        return
    room = np.array([end - start - DURATION_S for start, end in parts])
    found: dict[str, Counter[str]] = {axis: Counter() for axis in "xyz"}
    for _ in range(trials):
        imu, axis = names[rng.integers(len(names))], "xyz"[rng.integers(3)]
        part = int(rng.choice(len(parts), p=room / room.sum()))
        start = parts[part][0] + rng.uniform(0, room[part])
        sign = rng.choice([-1.0, 1.0])
        fault = Fault(
            kind="bias",
            channel=f"{imu}.{axis}",
            start_s=start,
            end_s=start + DURATION_S,
            size=sign * BIAS_RAD_S,
        )
        faulty = inject(recording, [fault]).recording
        what = outcome(seen(faulty, imu, rng), fault.channel, (start, start + DURATION_S))
        found[axis][what] += 1
    total: Counter[str] = sum(found.values(), Counter())
    shares = ", ".join(f"{what} {total[what]}" for what in ("pinned", "suspect", "missed", "wrong"))
    axes = "; ".join(f"{axis} {dict(sorted(c.items()))}" for axis, c in found.items())
    print(f"  {title}: {shares}   ({axes})", flush=True)


def main() -> None:
    """Count over the logs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("logs", nargs="+", type=Path)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    warnings.simplefilter("ignore")
    trials, seed = arguments.trials, arguments.seed
    for path in arguments.logs:
        recording = read(path)
        analysis = analyse_recording(recording, CONFIG)
        print(f"{path.name}: untouched {analysis.verdict}, {len(analysis.findings)} findings")
        if len(choose(recording, CONFIG)[0]) > 1:
            count("two IMUs alone", recording, lambda r, *_: without_attitude(r), trials, seed)
            count("with the attitude", recording, lambda r, *_: r, trials, seed)
            count(
                "attitude misled",
                recording,
                lambda r, imu, rng: misled(r, imu, rng.uniform(*TIME_CONSTANTS_S)),
                trials,
                seed,
            )
            single = first_imu_alone(recording)
            analysis = analyse_recording(single, CONFIG)
            print(f"  one IMU, untouched: {analysis.verdict}, {len(analysis.findings)} findings")
        else:
            single = recording
        count("one IMU with the attitude", single, lambda r, *_: r, trials, seed)


if __name__ == "__main__":
    main()
