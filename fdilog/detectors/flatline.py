"""A gyro that repeats one value: stuck, dead if it is zero, saturated if it is its full scale.

A channel accuses itself here; no other gyro is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.config import Config
from fdilog.finding import Evidence, Kind
from fdilog.maths.geometry import leave_one_out
from fdilog.registry import Stage
from fdilog.table import PARALLEL, ChannelTable
from fdilog.windows.survey import Survey, spans, stretches

# One false run in a million flights of any length.
FALSE_RUNS = 1e-6
# A run is longer than any logger's hold of one sample: shorter ones are repeats, not failures.
FEWEST_REPEATS = 10
SHORTEST_RUN_S = 0.2
# Chance of a repeat that is assumed of even the finest gyro, so that a few equal readings of a
# quiet one are never called impossible.
LEAST_CHANCE = 0.05
# A gyro whose noise never once crosses one step in this many readings and seconds reads nothing,
# even if no other channel moves either. A few rows of one reading each may be a table of still
# pictures of a unit on a bench.
LONGEST_STILL = 500
LONGEST_STILL_S = 10.0
# Neither does one that reads zero for so long and is known to tell finer steps than that by as many
# values: the best gyros are noisier. Coarser ones may rest at zero, level on the ground.
FINE_RAD_S = float(np.radians(0.001))
FEWEST_LEVELS = 100
# Full scales of MEMS gyros, by their data sheets; trimmed sensitivities move them by a few percent.
FULL_SCALES_DEG_S = (125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0)
FULL_SCALE_MARGIN = 0.03
# A gyro that turns faster than it can tell reads the end of its range again and again: for two
# readings or more in so many turns at least, and oftener than anything beyond or in the next part
# of its range, in which a gyro that can tell reads more than at its very peaks.
FEWEST_TURNS = 3
BESIDE_THE_END = 0.05
# In one run alone the others must read further but for so many readings: a gyro that is stuck is
# left behind for a while, too.
ALL_OF_A_RUN = 0.1
# A turn of the vehicle moves more gyros than one, for more readings than a glitch or two.
FEWEST_MOVING = 2
MOST_GLITCHES = 5
# What moves by fewer steps than this may rest within one step of a coarser gyro.
MOVING_STEPS = 4.0
# An attitude shows a turn in its means over so long, if half of them in a run of so many differ by
# it: what converges or is set anew at rest moves for less of the time.
TURN_S = 1.0
FEWEST_TURNING = 8
# The gyros of a device that hang together begin and end to repeat at the same reading, or the next.
TOGETHER = 1


def runs_of_equal(
    values: NDArray[np.float64], breaks: ArrayLike = ()
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Find the maximal runs of one repeated value.

    Parameters
    ----------
    values : (n,)
        Readings without not-a-numbers.
    breaks
        Indices at which a run begins in any case.

    Returns
    -------
    start, stop : (n_runs,) int64
        First index of each run, one past its last.
    """
    begins = np.ones(len(values), bool)
    np.not_equal(values[1:], values[:-1], out=begins[1:])
    inside = np.asarray(breaks, np.int64)
    begins[inside[inside < len(values)]] = True
    start = np.flatnonzero(begins)
    return start, np.append(start[1:], len(values))[: len(start)]


def longest_ordinary_run(lengths: NDArray[np.int64]) -> float:
    """Length beyond which a run is not explained by the quantisation of a moving gyro.

    Between independent steps the chance p of a repeat gives runs of length R with probability
    p^R. The share of runs that hold two readings or more estimates p, and a few long runs hardly
    change it; R is where ``n p^R`` falls below `FALSE_RUNS`.

    Parameters
    ----------
    lengths : (n_runs,)
        Lengths of all runs of a channel.
    """
    chance = max(float((lengths > 1).mean()), LEAST_CHANCE)
    if chance >= 1.0:
        return float("inf")
    return float(np.log(lengths.sum() / FALSE_RUNS) / -np.log(chance))


@dataclass(frozen=True, kw_only=True)
class FlatlineDetector:
    """Stuck, dead and saturated channels, each judged by itself."""

    description: ClassVar[str] = (
        "a value repeated beyond what quantisation explains: stuck, dead, saturated"
    )
    stage: ClassVar[Stage] = "alone"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give one window for every run that no quantisation explains."""
        table = survey.table
        found: dict[Kind, list[tuple[int, int, int]]] = {"dead": [], "saturated": [], "stuck": []}
        parts = stretches(table, survey.config)
        least_motion = float(np.radians(survey.config.tolerance.bias_deg_s))
        runs = [
            _impossible_runs(survey, channel, parts, least_motion)
            for channel in range(len(table.channels))
        ]
        for channel in range(len(table.channels)):
            ends = _ends_of_range(table, channel, survey.config)
            readings = table.rate_rad_s[table.valid[:, channel], channel]
            extent = (float(readings.min(initial=0.0)), float(readings.max(initial=0.0)))
            for start, stop in _runs_at(table, channel, ends, parts):
                found["saturated"].append((start, stop, channel))
            flat = [
                (run, _kind(table, channel, run, extent, survey.config))
                for run in runs[channel]
                if run.value not in ends and (run.shown or _hangs(run, channel, table, runs))
            ]
            # What is once told to be the end of a range is so on either side, and all along.
            limits = {abs(end) for end in ends}
            limits |= {abs(run.value) for run, kind in flat if kind == "saturated"}
            for run, kind in flat:
                named: Kind = "saturated" if abs(run.value) in limits else kind
                found[named].append((run.start, run.stop, channel))
        return [_evidence(kind, table, runs) for kind, runs in found.items() if runs]


def _kind(
    table: ChannelTable,
    channel: int,
    run: _Run,
    extent: tuple[float, float],
    config: Config,
) -> Kind:
    """Name a run by its value: zero, the end of the range that is never exceeded, or any.

    Parameters
    ----------
    extent
        The lowest and the highest reading of the channel, or zero. [rad/s]
    """
    value = run.value
    if value == 0.0:
        return "dead"
    rows = run.start + np.flatnonzero(table.valid[run.start : run.stop, channel])
    at_an_end = value in extent and (
        (_is_full_scale(value) and abs(value) >= max(-extent[0], extent[1]))
        or _most(_others_read_further(table, channel, rows, value, config), ALL_OF_A_RUN) > 0.0
    )
    return "saturated" if at_an_end else "stuck"


def _is_full_scale(value: float) -> bool:
    full_scale = np.radians(FULL_SCALES_DEG_S)
    return bool((np.abs(abs(value) / full_scale - 1.0) < FULL_SCALE_MARGIN).any())


def _ends_of_range(table: ChannelTable, channel: int, config: Config) -> list[float]:
    """Find the values at which a channel's readings pile up because it can tell no more. [rad/s]

    What piles up at an end may also be a turn held steady, as on a rate table. So another gyro of
    the axis must read further meanwhile, or the value be the full scale of a gyro.
    """
    rows = np.flatnonzero(table.valid[:, channel])
    if not len(rows):
        return []
    values = table.rate_rad_s[rows, channel]
    start, stop = runs_of_equal(values)
    repeated = stop - start >= 2
    levels, turns = np.unique(values[start[repeated]], return_counts=True)
    below = np.cumsum(turns) - turns
    outer = turns > np.minimum(below, turns.sum() - turns - below)
    # A range is as wide on both sides.
    both = turns + np.array([turns[levels == -level].sum() for level in levels.tolist()], np.int64)
    middle, step = float(np.median(values)), table.channels[channel].step_rad_s
    ends = []
    for end in levels[outer & (both >= FEWEST_TURNS)].tolist():
        outward = np.sign(end - middle) * (values - end)
        band = max(BESIDE_THE_END * abs(end - middle), MOVING_STEPS * step)
        at = np.flatnonzero(outward == 0.0)
        within = int(((outward < 0.0) & (outward >= -band)).sum())
        if (
            abs(end - middle) > band
            and len(at) > max(within, int((outward[at[0] : at[-1]] > 0.0).sum()))
            and (
                _most(_others_read_further(table, channel, rows[at], end, config), 0.5) > 0.0
                or (_is_full_scale(end) and abs(end) >= np.abs(values).max())
            )
        ):
            ends.append(end)
    often = levels[both >= FEWEST_TURNS]
    return sorted({*ends, *(float(end) for end in often if -end in ends)})


def _others_read_further(
    table: ChannelTable, channel: int, rows: NDArray[np.int64], value: float, config: Config
) -> NDArray[np.float64]:
    """By how much more the others tell than a channel that reads this, less the tolerances, (n,).

    Not-a-number where there is nothing to tell it. [rad/s]
    """
    row = leave_one_out(table.axes)[channel]
    needed = np.flatnonzero(row != 0.0)
    if not bool(np.isfinite(row).all()):
        return np.full(len(rows), np.nan)
    error = table.rate_rad_s[np.ix_(rows, needed)] @ row[needed]
    doubt = np.radians(config.tolerance.bias_deg_s) + config.tolerance.scale * abs(value)
    return np.asarray(-np.sign(value) * error - doubt, np.float64)


def _most(values: NDArray[np.float64], share: float) -> float:
    """Return what all but a share of the known values reach; minus infinity if none is known."""
    known = values[np.isfinite(values)]
    return float(np.quantile(known, share)) if len(known) else -np.inf


def _runs_at(
    table: ChannelTable, channel: int, ends: Sequence[float], parts: list[tuple[int, int]]
) -> list[tuple[int, int]]:
    """List the runs of readings (first sample, one past the last) at the ends of a range."""
    if not ends:
        return []
    rows = np.flatnonzero(table.valid[:, channel])
    at = np.isin(table.rate_rad_s[rows, channel], ends)
    breaks = np.searchsorted(rows, [first for first, _ in parts[1:]])
    start, stop = runs_of_equal(at.astype(np.float64), breaks)
    here = at[start]
    return [
        (int(rows[a]), int(rows[b - 1]) + 1) for a, b in zip(start[here], stop[here], strict=True)
    ]


@dataclass(frozen=True, kw_only=True)
class _Run:
    """A value repeated for longer than quantisation explains.

    Parameters
    ----------
    start, stop
        First sample, one past the last.
    value
        [rad/s]
    shown
        Whether it accuses the channel: the vehicle moved meanwhile, or no gyro rests like that.
    """

    start: int
    stop: int
    value: float
    shown: bool


def _hangs(run: _Run, channel: int, table: ChannelTable, runs: Sequence[Sequence[_Run]]) -> bool:
    """Whether another gyro of the device repeats itself over just these readings, and is accused.

    A device that hangs stops all three; not all of them need have turned meanwhile.
    """
    source = table.channels[channel].source
    return any(
        other.shown
        and abs(other.start - run.start) <= TOGETHER
        and abs(other.stop - run.stop) <= TOGETHER
        for k, beside in enumerate(runs)
        if table.channels[k].source == source
        for other in beside
    )


def _impossible_runs(
    survey: Survey, channel: int, parts: list[tuple[int, int]], least_motion: float
) -> list[_Run]:
    """List the runs of one channel that its quantisation does not explain."""
    table = survey.table
    rows = np.flatnonzero(table.valid[:, channel])
    values = table.rate_rad_s[rows, channel]
    if len(values) < FEWEST_REPEATS:
        return []
    # A run ends where the log has a hole: what the gyro did there is not known.
    start, stop = runs_of_equal(values, np.searchsorted(rows, [first for first, _ in parts[1:]]))
    lengths = stop - start
    never_moved = bool((values == values[0]).all())
    limit = FEWEST_REPEATS if never_moved else longest_ordinary_run(lengths)
    period_s = 1.0 / table.channels[channel].rate_hz if table.channels[channel].rate_hz else 0.0
    long = (lengths >= max(limit, FEWEST_REPEATS)) & (lengths * period_s >= SHORTEST_RUN_S)
    found = []
    for a, b in zip(start[long].tolist(), stop[long].tolist(), strict=True):
        first, last, value = int(rows[a]), int(rows[b - 1]) + 1, float(values[a])
        shown = (
            _others_move(table, channel, first, last, least_motion)
            or _attitude_turns(survey, channel, (first, last), least_motion)
            or (
                b - a >= LONGEST_STILL
                and (b - a) * period_s >= LONGEST_STILL_S
                and (never_moved or (value == 0.0 and _is_fine(table, channel, values)))
            )
        )
        found.append(_Run(start=first, stop=last, value=value, shown=shown))
    return found


def _is_fine(table: ChannelTable, channel: int, values: NDArray[np.float64]) -> bool:
    fine = table.channels[channel].step_rad_s < FINE_RAD_S
    return fine and len(np.unique(values)) >= FEWEST_LEVELS


def _others_move(
    table: ChannelTable, channel: int, start: int, stop: int, least_motion: float
) -> bool:
    """Whether a healthy gyro in this channel's place would have moved during the run.

    Any channel that senses along its axis says so; without one, all others of its own source must.
    And one channel is not enough where there are more: it may be the one that fails. Motion is what
    is more than a few steps of this channel, and more than ``least_motion``: at rest, one gyro may
    rest within a step while another shows its noise.
    """
    along = table.along(channel)
    of_source = np.array([c.source == table.channels[channel].source for c in table.channels])
    of_source[channel] = False
    threshold = max(MOVING_STEPS * table.channels[channel].step_rad_s, least_motion)

    def moves(k: int) -> bool:
        return _range(table, k, start, stop) > threshold

    axis = along if along.any() else of_source
    moving = [moves(k) for k in np.flatnonzero(axis).tolist()]
    seen = any(moving) if along.any() else bool(moving) and all(moving)
    if not seen or sum(moving) >= FEWEST_MOVING:
        return seen
    axis[channel] = True
    others = np.flatnonzero(~axis).tolist()
    return not others or any(moves(k) for k in others)


def _attitude_turns(
    survey: Survey, channel: int, span: tuple[int, int], least_motion: float
) -> bool:
    """Whether the attitude turned about the axis of a channel that no other gyro senses along.

    The other gyros of its device do not tell, if that hangs.
    """
    table, derived = survey.table, survey.derived
    if derived is None or table.along(channel).any():
        return False
    threshold = max(MOVING_STEPS * table.channels[channel].step_rad_s, least_motion)
    cell = max(1, round(TURN_S / table.period_s)) if table.period_s else 1
    within = slice(*span)
    for k in np.flatnonzero(np.abs(derived.axes @ table.axes[channel]) > PARALLEL):
        rate = derived.rate_rad_s[within, k][derived.valid[within, k]]
        cells = len(rate) // cell
        if cells >= FEWEST_TURNING:
            means = rate[: cells * cell].reshape(cells, cell).mean(axis=1)
            low, high = np.quantile(means, [0.25, 0.75])
            if high - low > threshold:
                return True
    return False


def _range(table: ChannelTable, channel: int, start: int, stop: int) -> float:
    """Range of a channel's readings but the few furthest off at either end. [rad/s]"""
    readings = table.rate_rad_s[start:stop, channel][table.valid[start:stop, channel]]
    few = min(len(readings) // 20, MOST_GLITCHES)
    if not len(readings):
        return 0.0
    ordered = np.partition(readings, [few, len(readings) - 1 - few])
    return float(ordered[len(readings) - 1 - few] - ordered[few])


def _evidence(kind: Kind, table: ChannelTable, runs: list[tuple[int, int, int]]) -> Evidence:
    shape = (len(runs), len(table.channels))
    accused = np.zeros(shape, np.int8)
    tested = np.zeros(shape, bool)
    for row, (_, _, channel) in enumerate(runs):
        accused[row, channel] = 1
        tested[row, channel] = True
    nothing = np.full(shape, np.nan)
    return Evidence(
        detector="flatline",
        kind=kind,
        windows=spans(
            table, np.array([run[0] for run in runs]), np.array([run[1] for run in runs])
        ),
        tested=tested,
        low=nothing,
        high=nothing,
        tolerance=nothing,
        accused=accused,
        confidence=1.0 - FALSE_RUNS,
    )
