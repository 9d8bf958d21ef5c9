"""How well a log's own flight tells misalignment, scale and time offset between its gyros.

python benchmarks/calibration.py ../shared/logs/dataflash
python benchmarks/calibration.py ../shared/logs/dataflash --log quad_2imu_50hz_a --rows

One device of each healthy flight with several is changed in memory, all along: turned by 2 degrees
about one of its axes, 1 % too large in the scale of one of them, its stamps 30 ms late, all three
at once; each axis, both signs and every device in turn. What the analysis then reports, less what
it reports of the untouched flight, is held against what was put in. Counted as right is what is
within 20 % of it. A flight that hardly turns about an axis cannot tell its scale: `motion` is the
root mean square of the body rate over one second, and `known to` what one standard deviation of
the difference of the two gyros over one second leaves of 1 % about the axis that moves least.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.recording import Recording, Stream
from fdilog.registry import read
from fdilog.text_table import text_table

CONFIG = Config().replace("detectors", use=("parity", "impulse", "dropout", "flatline", "noise"))
HEALTHY = (
    "quad_2imu_50hz_a",
    "quad_2imu_50hz_b",
    "hexa_2imu_25hz",
    "copter_2imu_50hz",
    "quad_3imu_good_prop_hover_1",
    "quad_3imu_good_prop_straight_line_1",
    "quad_3imu_10_mm_cut_straight_line_2",
    "quad_3imu_25_mm_cut_hover_1",
)
TURN_DEG, SCALE, LATE_S = 2.0, 0.01, 0.030
RIGHT = 0.2


@dataclass(frozen=True)
class Change:
    """What is put into one device; axes are 0, 1, 2 for x, y, z."""

    device: int
    turn_axis: int
    scale_axis: int
    sign: int


@dataclass(frozen=True)
class Told:
    """What was reported of a change, as parts of what was put in."""

    change: Change
    turn: float
    scale: float
    late: float
    turn_elsewhere_deg: float
    findings: tuple[str, ...]


def changed(recording: Recording, change: Change) -> Recording:
    """Put a change into a recording."""
    return replace(
        recording,
        streams=tuple(
            _changed(stream, change) if stream.gyro and stream.sensor == change.device else stream
            for stream in recording.streams
        ),
    )


def _changed(stream: Stream, change: Change) -> Stream:
    angle = change.sign * np.radians(TURN_DEG)
    first, second = (change.turn_axis + 1) % 3, (change.turn_axis + 2) % 3
    back = np.eye(3)  # from body axes into those of the turned device
    back[[first, second], [first, second]] = np.cos(angle)
    back[first, second], back[second, first] = np.sin(angle), -np.sin(angle)
    scale = np.ones(3)
    scale[change.scale_axis] += change.sign * SCALE
    rate = np.column_stack([np.asarray(stream.columns[name], float) for name in stream.gyro])
    rate = rate @ (scale[:, None] * back).T
    return replace(
        stream,
        time_ns=stream.time_ns + round(change.sign * LATE_S * 1e9),
        columns={**stream.columns, **dict(zip(stream.gyro, rate.T, strict=True))},
    )


def reported(analysis: Analysis, device: int) -> tuple[np.ndarray, np.ndarray, float]:
    """Rotation, scale and offset of a device against the first, or the first's against it."""
    name = f"imu{max(device, 1)}"
    sign = 1.0 if device else -1.0
    one = next(c for c in analysis.calibration if c.source == name)
    late = [c.offset_s for c in analysis.clocks if c.source == name]
    return (
        sign * np.array(one.rotation_deg),
        sign * (np.array(one.scale) - 1.0),
        sign * late[0] if late else float("nan"),
    )


def told(recording: Recording, change: Change, before: Analysis) -> Told:
    """Analyse a changed recording and compare it with the untouched one."""
    after = analyse_recording(changed(recording, change), CONFIG)
    was, now = reported(before, change.device), reported(after, change.device)
    turn, scale = now[0] - was[0], now[1] - was[1]
    elsewhere = np.delete(turn, change.turn_axis)
    return Told(
        change=change,
        turn=change.sign * turn[change.turn_axis] / TURN_DEG,
        scale=change.sign * scale[change.scale_axis] / SCALE,
        late=change.sign * (now[2] - was[2]) / LATE_S,
        turn_elsewhere_deg=float(np.abs(elsewhere).max()),
        findings=tuple(f"{f.kind} of {'|'.join(f.suspects)}" for f in after.findings),
    )


def motion(analysis: Analysis) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square of each axis over one second, and 1 sigma of a scale error it tells."""
    table = analysis.table.gyros
    second = np.floor(table.time_s).astype(int)
    start = np.flatnonzero(np.diff(second, prepend=-1))
    count = np.diff(np.append(start, len(second)))[:, None]
    means = np.add.reduceat(np.where(table.valid, table.rate_rad_s, np.nan), start) / count
    means = means[np.isfinite(means).all(axis=1)]
    rate = means[:, :3] - np.median(means[:, :3], axis=0)
    apart = means[:, 3:6] - means[:, :3]
    apart = 1.4826 * np.median(np.abs(apart - np.median(apart, axis=0)), axis=0)
    power = np.sqrt((rate**2).sum(axis=0))
    return np.degrees(np.sqrt((rate**2).mean(axis=0))), apart / power


def changes(devices: int) -> Iterator[Change]:
    for device in range(devices):
        for turn_axis in range(3):
            for scale_axis in range(3):
                yield Change(device, turn_axis, scale_axis, 1 if turn_axis != scale_axis else -1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path, help="of DataFlash logs")
    parser.add_argument("--log", action="append", help="only this one")
    parser.add_argument("--rows", action="store_true", help="print every change")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    lines = []
    for name in arguments.log or HEALTHY:
        recording = read(arguments.folder / f"{name}.bin")
        before = analyse_recording(recording, CONFIG)
        devices = len({c.source for c in before.table.gyros.channels})
        found = [told(recording, change, before) for change in changes(devices)]
        rate, known = motion(before)
        lines.append(
            [
                name,
                str(len(found)),
                f"{rate.min():.1f}",
                f"{known.max() / SCALE:.0%}",
                *(
                    right([getattr(one, part) for one in found])
                    for part in ("turn", "scale", "late")
                ),
                str(sum(len(one.findings) for one in found)),
            ]
        )
        for one in found if arguments.rows else ():
            c = one.change
            print(
                f"{name} imu{c.device} turn {'xyz'[c.turn_axis]} {one.turn:.2f}"
                f" (elsewhere {one.turn_elsewhere_deg:.2f} deg)"
                f" scale {'xyz'[c.scale_axis]} {one.scale:.2f} late {one.late:.2f} {one.findings}"
            )
    head = ["flight", "changes", "motion", "known to", "2 deg", "1 %", "30 ms", "findings"]
    print(text_table(head, lines, markdown=True))


def right(parts: list[float]) -> str:
    """How many are within 20 %, and the worst of all."""
    values = np.array(parts)
    good = np.abs(values - 1.0) <= RIGHT
    worst = values[np.argmax(np.where(np.isfinite(values), np.abs(values - 1.0), np.inf))]
    return f"{good.sum()} of {len(values)} ({worst:.2f})"


if __name__ == "__main__":
    main()
