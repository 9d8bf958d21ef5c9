"""What the records of the gyros lack: stamps out of order, holes, late starts, early ends."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdilog.config import Config
from fdilog.recording import Problem, Recording
from fdilog.sources.clocks import CleanStamps, TimeBase, hole_threshold_s
from fdilog.sources.gyros import Gyro
from fdilog.sources.offsets import LARGEST_OFFSET_S

MOST_LISTED = 20
# A source that misses no more of a log than this may still be healthy over the whole of it.
MOST_MISSED = 0.1


def stamp_problems(gyro: Gyro, clean: CleanStamps) -> list[Problem]:
    """List what was left out of a gyro's records because of their stamps."""
    topic = gyro.stream.name
    problems = []
    if clean.repeated:
        what = f"{topic}: {clean.repeated} records repeat the time stamp before them; left out"
        problems.append(Problem(what=what, note=True))
    if clean.late:
        were = "record was" if clean.late == 1 else "records were"
        what = f"{topic}: {clean.late} {were} held up and stamped too late, in bursts; left out"
        problems.append(Problem(what=what, note=True))
    if clean.misplaced:
        are = "record is" if clean.misplaced == 1 else "records are"
        what = f"{topic}: {clean.misplaced} {are} stamped out of order; left out"
        problems.append(Problem(what=what))
    for _, back in clean.restarts:
        jump = f"back by {back / 1e9:.3f} s (a restart)"
        if back < 0:
            jump = f"forward by {-back / 86_400e9:.1f} days (it was set)"
        what = f"{topic}: the clock jumps {jump}; what follows is a stretch of its own"
        problems.append(Problem(what=f"{what}, the pause before it unknown"))
    return problems


def losses(
    recording: Recording,
    gyros: Sequence[Gyro],
    base: TimeBase,
    restarts: Sequence[int],
    config: Config,
) -> list[Problem]:
    """List what the gyros do not tell of the time of a recording.

    Parameters
    ----------
    base
        Their common time base.
    restarts
        Stamps after which a clock began anew: the pauses there are not known. [ns]
    """
    dropout_s = config.tolerance.dropout_s
    problems = [*_late_starts(gyros, base, config), *_not_finite(gyros)]
    if not all(gyro.stream.batched for gyro in gyros):
        problems += _holes(base, restarts, dropout_s)
    if not restarts:
        problems += _outlasted(recording, base, dropout_s)
    return problems


def _late_starts(gyros: Sequence[Gyro], base: TimeBase, config: Config) -> list[Problem]:
    """List the sources that were recorded later than the others; a while is usual and only noted.

    Drivers and nodes start one after another, so that it is no failure. But nobody knows what such
    a gyro did before. Batches come one after another, and what lies between them is no loss.
    """
    length_s = (int(base.time_ns[-1]) - int(base.time_ns[0])) / 1e9
    problems = []
    for gyro in gyros:
        late_s = (int(gyro.time_ns[0]) - int(base.time_ns[0])) / 1e9 if len(gyro.time_ns) else 0.0
        allowed_s = hole_threshold_s(base.period_ns / 1e9, config.tolerance.dropout_s)
        if gyro.stream.batched or late_s <= allowed_s:
            continue
        what = f"{gyro.stream.name}: nothing recorded before {late_s:.3f} s, while other gyros were"
        usual = late_s <= MOST_MISSED * length_s
        problems.append(Problem(what=what, seconds_lost=None if usual else late_s, note=usual))
    return problems


def _not_finite(gyros: Sequence[Gyro]) -> list[Problem]:
    """List the channels that lack readings here and there, while others may have theirs."""
    problems = []
    for gyro in gyros:
        for k, name in enumerate(gyro.channel_names):
            bad = int((~np.isfinite(gyro.rate_rad_s[:, k])).sum())
            if bad:
                of = f"{bad:,} of {len(gyro.time_ns):,} readings"
                what = f"{name}: {of} are not finite numbers, or beyond any turn"
                problems.append(Problem(what=what))
    return problems


def _holes(base: TimeBase, restarts: Sequence[int], dropout_s: float) -> list[Problem]:
    """List the stretches in which every gyro is silent, restarts of the clock apart."""
    steps = np.diff(base.time_ns)
    limit = hole_threshold_s(base.period_ns / 1e9, dropout_s) * 1e9
    starts = np.flatnonzero(steps > limit)
    # A gyro's stamps may have been shifted since, by what its clock was off.
    shift_ns = round(LARGEST_OFFSET_S * 1e9)
    for after in restarts:
        ends = base.time_ns[starts + 1]
        starts = starts[(base.time_ns[starts] > after + shift_ns) | (ends < after - shift_ns)]
    lost = (steps[starts] - base.period_ns) / 1e9
    from_s = (base.time_ns[starts] - base.time_ns[0]) / 1e9
    problems = [
        Problem(
            what=f"no gyro was recorded from {start:.3f} s to {start + step / 1e9:.3f} s",
            seconds_lost=float(seconds),
        )
        for start, step, seconds in zip(
            from_s[:MOST_LISTED], steps[starts][:MOST_LISTED], lost, strict=False
        )
    ]
    if len(starts) > MOST_LISTED:
        rest = float(lost[MOST_LISTED:].sum())
        what = f"{len(starts) - MOST_LISTED} more holes in which no gyro was recorded"
        problems.append(Problem(what=what, seconds_lost=rest))
    return problems


def _outlasted(recording: Recording, base: TimeBase, dropout_s: float) -> list[Problem]:
    """Say if the vehicle's other senses were recorded long before, or after, any gyro was.

    What is recorded begins at different times; so a while is asked before, and none after.
    """
    first_ns, last_ns = int(base.time_ns[0]), int(base.time_ns[-1])
    end_s = (last_ns - first_ns) / 1e9
    limit_s = hole_threshold_s(base.period_ns / 1e9, dropout_s)
    before, after = ("", MOST_MISSED * end_s), ("", 0.0)
    for stream in recording.streams:
        senses = stream.origin == "derived" or any(
            (stream.gyro, stream.accelerometer, stream.compass, stream.velocity)
        )
        if not senses or not stream.rate_hz:
            continue
        begin_ns, stop_ns = int(stream.time_ns.min()), int(stream.time_ns.max())
        # One that is apart is stamped by another clock, or of another flight.
        if begin_ns > last_ns or stop_ns < first_ns:
            continue
        least_s = limit_s + 1.0 / stream.rate_hz
        earlier_s, later_s = (first_ns - begin_ns) / 1e9, (stop_ns - last_ns) / 1e9
        before = (stream.name, earlier_s) if earlier_s > max(before[1], least_s) else before
        after = (stream.name, later_s) if later_s > max(after[1], least_s) else after
    problems = []
    if before[0]:
        what = f"no gyro was recorded before 0.000 s, while {before[0]} was from -{before[1]:.3f} s"
        problems.append(Problem(what=what, seconds_lost=before[1]))
    if after[0]:
        until_s = end_s + after[1]
        what = f"no gyro was recorded after {end_s:.3f} s, while {after[0]} was until"
        problems.append(Problem(what=f"{what} {until_s:.3f} s", seconds_lost=after[1]))
    return problems
