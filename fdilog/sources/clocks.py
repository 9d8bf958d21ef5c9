"""One time base: stamps that repeat or run backwards are put right, holes are found, and said."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Times = NDArray[np.int64]

# More descents than this in one stream are not glitches but noise; they are dropped wholesale.
MOST_DESCENTS = 1000
# A clock that restarts is placed this long after what came before: the true pause is unknown,
# and no window may bridge it.
RESTART_PAUSE_NS = 60_000_000_000
# Beyond this no stamp is placed: 146 years of nanoseconds, half of what 64 bits hold.
LATEST_NS = 2**62
# Steps of several periods are a hole; single lost records are not.
HOLE_PERIODS = 5.0
# Periods of one nominal rate differ by the tolerance of oscillators and by jitter: less than this.
SAME_RATE = 1.01
# No log goes on after a day: its clock was set.
SET_FORWARD_NS = 86_400_000_000_000
# So near to an instant a source must have been sampled to be read there: half a period, and jitter
NEAR = 0.6
# Between two samples further apart than this nothing is interpolated: one lost record is bridged.
LONGEST_STEP = 2.5
# A sample is taken as it is for an instant this near: in so much of a period little turns.
AT_ONCE = 0.1
# Records were held up and stamped late where they follow a pause of so many periods with less than
# this one between them, as long as that is the exception and not how the source is logged.
PAUSE, HELD_UP, EXCEPTION = 1.5, 0.5, 0.02


@dataclass(frozen=True, kw_only=True, eq=False)
class CleanStamps:
    """Stamps of one stream in strictly increasing order.

    Parameters
    ----------
    time_ns : (n_kept,)
        Strictly increasing. [ns]
    keep : (n_kept,)
        Which records they belong to.
    repeated, misplaced
        How many records were dropped because their stamp repeats the one before, or is out of
        order.
    late
        How many were dropped because they had been held up: after a pause, several follow each
        other faster than they can have been sampled. The last of them stays.
    restarts
        Where the clock jumped back and went on from there (a reboot), or forward by a day and more:
        the last stamp before, as in ``time_ns``, and by how much it jumped back. [ns]
    """

    time_ns: Times
    keep: NDArray[np.int64]
    repeated: int
    misplaced: int
    late: int
    restarts: tuple[tuple[int, int], ...]


def clean_stamps(stamps: Sequence[Times]) -> list[CleanStamps]:
    """Make the stamps of several streams of one log increase strictly, restarts alike in all.

    A stamp that repeats is dropped (the first record stays). A single stamp out of order is
    dropped. Where the clock goes back and stays back it has restarted, and where it goes forward by
    a day or more it was set: all that follows is moved
    to `RESTART_PAUSE_NS` after the latest stamp before it, by one and the same shift in every
    stream, so that records taken together stay together.
    """
    pieces = [_pieces(time) for time in stamps]
    shifts: list[int] = []
    end: int | None = None
    for k in range(max((len(parts) for parts, _ in pieces), default=0)):
        stretches = [
            time[parts[k]]
            for time, (parts, _) in zip(stamps, pieces, strict=True)
            if k < len(parts)
        ]
        first = min(int(stretch[0]) for stretch in stretches)
        shift = 0 if end is None else end + RESTART_PAUSE_NS - first
        end = shift + max(int(stretch[-1]) for stretch in stretches)
        if k and end > LATEST_NS:
            break  # stamps that no calendar holds; what follows is dropped as out of order
        shifts.append(shift)
    return [
        _joined(time, parts, misplaced, shifts)
        for time, (parts, misplaced) in zip(stamps, pieces, strict=True)
    ]


def _joined(
    time: Times, parts: list[NDArray[np.int64]], misplaced: int, shifts: list[int]
) -> CleanStamps:
    keeps, times, restarts = [], [], []
    repeated = late = 0
    misplaced += sum(len(part) for part in parts[len(shifts) :])
    for k, part in enumerate(parts[: len(shifts)]):
        stretch = time[part]
        fresh = np.ones(len(part), bool)
        fresh[1:] = stretch[1:] > stretch[:-1]
        repeated += int(len(part) - fresh.sum())
        prompt = ~_held_up(stretch[fresh])
        late += int(len(prompt) - prompt.sum())
        keeps.append(part[fresh][prompt])
        times.append(stretch[fresh][prompt] + shifts[k])
        if k:
            last = int(time[parts[k - 1][-1]])
            restarts.append((last + shifts[k - 1], last - int(stretch[0])))
    nothing = np.zeros(0, np.int64)
    return CleanStamps(
        time_ns=np.concatenate(times) if times else nothing,
        keep=np.concatenate(keeps) if keeps else nothing,
        repeated=repeated,
        misplaced=misplaced,
        late=late,
        restarts=tuple(restarts),
    )


def _held_up(time: Times) -> NDArray[np.bool_]:
    """Tell which records are stamped late: a pause, then a burst, the last of which is prompt."""
    late = np.zeros(len(time), bool)
    steps = np.diff(time)
    if len(steps) < 2:
        return late
    period = np.median(steps)
    short = steps < HELD_UP * period
    if short.mean() > EXCEPTION:
        return late
    edges = np.flatnonzero(np.diff(np.concatenate([[False], short, [False]]).astype(np.int8)))
    for first, last in edges.reshape(-1, 2).tolist():
        late[first:last] = first > 0 and steps[first - 1] > PAUSE * period
    return late


def _pieces(time: Times) -> tuple[list[NDArray[np.int64]], int]:
    """Split one stream where its clock restarts or is set; each piece does not decrease."""
    n = len(time)
    index = np.arange(n)
    steps = np.diff(time)
    descents = np.flatnonzero(steps < 0)
    if len(descents) == 0 and not (steps > SET_FORWARD_NS).any():
        return ([index] if n else []), 0
    if len(descents) > MOST_DESCENTS:
        kept = index[time >= np.maximum.accumulate(time)]
        return [kept], n - len(kept)
    drop = np.zeros(n, bool)
    cuts = []
    for i in descents.tolist():
        j = i + 1
        ran_ahead = i == 0 or time[i - 1] <= time[j]
        fell_back = j + 1 == n or time[j + 1] >= time[i]
        if drop[i]:
            continue
        if fell_back:
            drop[j] = True
        elif ran_ahead:
            drop[i] = True
        else:
            cuts.append(j)
    kept = index[~drop]
    cuts += kept[1:][np.diff(time[kept]) > SET_FORWARD_NS].tolist()
    parts = []
    for piece in np.split(index, sorted(cuts)):
        kept = piece[~drop[piece]]
        parts.append(kept[time[kept] >= np.maximum.accumulate(time[kept])])
    parts = [part for part in parts if len(part)]
    return parts, n - sum(len(part) for part in parts)


def hole_threshold_s(period_s: float, dropout_s: float) -> float:
    """Tell how long a step must be to count as a hole rather than a lost record. [s]"""
    return max(dropout_s, HOLE_PERIODS * period_s)


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeBase:
    """The instants of a table.

    Parameters
    ----------
    time_ns : (n_samples,)
        Strictly increasing. [ns]
    period_ns
        Nominal step. [ns]
    """

    time_ns: Times
    period_ns: float


def time_base(stamps: Sequence[Times], dropout_s: float) -> TimeBase:
    """Choose the instants on which sources of several rates are compared.

    They are the stamps of the fastest source, and where that one is silent those of the next
    fastest; of sources of one nominal rate the first, so that the rounding of stamps does not
    choose. Nothing is put where no source was sampled.
    """
    periods = [_period_ns(time) for time in stamps]
    fast = SAME_RATE * min(periods)
    order = sorted(range(len(stamps)), key=lambda k: (max(periods[k], fast), k))
    base = stamps[order[0]]
    period = _period_ns(base)
    for k in order[1:]:
        slowest = max((p for p in (period, _period_ns(stamps[k])) if p < np.inf), default=0.0)
        limit = hole_threshold_s(slowest * 1e-9, dropout_s) * 1e9
        extra = stamps[k]
        nearest = np.searchsorted(base, extra)
        after = base[np.minimum(nearest, len(base) - 1)]
        before = base[np.maximum(nearest - 1, 0)]
        # Far from both neighbours, or beyond the ends: the faster source is silent there.
        gap = np.where((nearest > 0) & (nearest < len(base)), after - before, np.int64(limit) + 1)
        apart = np.minimum(np.abs(after - extra), np.abs(extra - before)) > min(period, limit)
        base = np.union1d(base, extra[(gap > limit) & apart])
    return TimeBase(time_ns=base, period_ns=period if period < np.inf else 0.0)


def _period_ns(time: Times) -> float:
    return float(np.median(np.diff(time))) if len(time) > 1 else float("inf")


def _after(time_ns: Times, base: TimeBase) -> Times:
    """Give, for each instant, the later of the two samples that it lies between."""
    if len(time_ns) == 1:
        return np.zeros(len(base.time_ns), np.int64)
    return np.clip(np.searchsorted(time_ns, base.time_ns), 1, len(time_ns) - 1)


def nearest_samples(time_ns: Times, base: TimeBase) -> tuple[Times, NDArray[np.bool_]]:
    """Give, for each instant, the nearest sample of a source, and whether it is near enough.

    Parameters
    ----------
    time_ns : (n_source,)
        Strictly increasing, at least one. [ns]

    Returns
    -------
    nearest : (n_samples,)
        Which of the source's samples.
    near : (n_samples,) bool
        Whether it lies within 0.6 of a base period.
    """
    return _nearest(time_ns, base, _after(time_ns, base))


def _nearest(time_ns: Times, base: TimeBase, upper: Times) -> tuple[Times, NDArray[np.bool_]]:
    lower = np.maximum(upper - 1, 0)
    to_lower = np.abs(base.time_ns - time_ns[lower])
    to_upper = np.abs(time_ns[upper] - base.time_ns)
    nearest = np.where(to_lower <= to_upper, lower, upper)
    return nearest, np.minimum(to_lower, to_upper) <= NEAR * base.period_ns


def place(
    time_ns: Times, values: NDArray[np.float64], base: TimeBase
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Put one source's readings on the time base, inventing none.

    An instant of the base holds a reading only if the source was sampled within 0.6 of a base
    period of it; the value is then interpolated between the source's own neighbouring samples to
    that instant. Beyond the first and the last sample these are taken as they are, and so is one
    beside a hole if it was read at just that instant, within a tenth of a period.

    Parameters
    ----------
    time_ns : (n_source,)
        Strictly increasing. [ns]
    values : (n_source, n_axes)
        Readings. [rad/s]

    Returns
    -------
    values : (n_samples, n_axes)
        NaN where there is none. [rad/s]
    valid : (n_samples, n_axes) bool
    """
    if len(time_ns) == len(base.time_ns) and bool((time_ns == base.time_ns).all()):
        valid = np.isfinite(values)
        return np.where(valid, values, np.nan), valid
    upper = _after(time_ns, base)
    lower = np.maximum(upper - 1, 0)
    to_lower = base.time_ns - time_ns[lower]
    nearest, near = _nearest(time_ns, base, upper)
    step = np.maximum(time_ns[upper] - time_ns[lower], 1)
    fraction = to_lower / step
    # Never beyond the ends of a source, nor across more than one lost record.
    inside = (fraction >= 0) & (fraction <= 1) & (step <= LONGEST_STEP * _period_ns(time_ns))
    beyond = (fraction < 0) | (fraction > 1)
    at_once = np.abs(time_ns[nearest] - base.time_ns) <= AT_ONCE * base.period_ns
    weight = np.where(inside, fraction, (nearest == upper).astype(float))[:, None]
    with np.errstate(invalid="ignore"):
        # In this form a reading that is repeated stays the same to the last bit: a stuck gyro.
        placed = values[lower] + (values[upper] - values[lower]) * weight
    exact = (weight == 0.0) | (weight == 1.0)
    placed = np.where(exact, np.where(weight == 0.0, values[lower], values[upper]), placed)
    valid = (near & (inside | beyond | at_once))[:, None] & np.isfinite(placed)
    return np.where(valid, placed, np.nan), valid
