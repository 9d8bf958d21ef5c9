"""Gyros that surely disagree, in a way that no known kind of fault explains.

A wrong sign half of the time, a delay, a filter, a slow oscillation: over long windows such errors
average out, and over short ones each is within the doubt. What they have in common is that second
by second a gyro does not read what the others agree on. So the error of every channel is looked at
in half seconds: each tells whether it surely lies beyond the tolerance at that rate. Where that is
so again and again, after what is known to be wrong has been taken out, the finding is of kind
disagreement. A drift or scale error that leaves as much unexplained is no such thing, and becomes
a part of it. So does a bias, unless it is one that changes: by steps, or as a drift that ends.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.accusations import Accusation, Cluster
from fdilog.decision.biases import Hearing, finding_of, heard, within
from fdilog.decision.shapes import Fault, shaped
from fdilog.decision.steps import step_of
from fdilog.finding import Finding
from fdilog.maths.geometry import blocks, leave_one_out
from fdilog.maths.noise import NORMAL_CONSISTENCY, moving_mean
from fdilog.maths.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.windows.edges import Shape

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

DETECTOR = "disagreement"
CELL_S = 0.5
"""Manoeuvres take longer than this, vibration is faster."""
SWING_S = 3.0 * CELL_S
"""A swing passes zero and stays there for a cell or two, and where it begins is known to one."""
FEWEST_SAMPLES = 6
"""Of which the spread within a cell, and so the doubt of its mean, can be told."""
SIGMAS = 3.0
"""A mean this many standard errors beyond the tolerance is beyond it, if noise is white."""
MOST_RESTLESS = 1.5
"""Aliased vibration lets the means of half seconds differ by more than their readings would if they
were white. So does a disagreement that lasts for most of a flight: no more is made of it."""
CONFIDENCE = 0.9973
"""That of three sigma, which a spread known from a few readings makes more."""
USUAL_SHARE = 1.0 / 8.0
"""On recorded healthy flights aliased vibration, which is not white, carries up to an eighth of the
half seconds of some twenty seconds beyond the tolerance."""
LEAST_SHARE = 1.0 / 5.0
"""Over a whole flight in harder vibration that may be more: simulated healthy ones show up to 18 %.
Of a disagreement a fifth is asked."""
FEWEST_BEYOND = 10
LEAST_EXCESS = 5.0
"""Ten half seconds beyond tolerance, five more than that share of the span would have."""

CHANGING_S = 5.0
"""What is off by about the same for so long is off by a bias, and beyond tolerance for at most half
of that where it jumps."""

MOST_CELLS = 0.95
STANDING_OUT = 2.0
"""A bias that is surely twice what nearly all half seconds of a disagreement stay below is no swing
of it, and a finding of its own."""

SHORTEST_S = 1e-9
"""No clock of a log tells less apart."""

SHAPES = ("bias", "drift", "scale")
UNEXPLAINED = ", which no bias, drift, scale error, noise or mounting explains"


def with_disagreement(
    table: ChannelTable,
    logged: ChannelTable,
    findings: Sequence[Finding],
    config: Config,
    hearing: Hearing | None = None,
) -> list[Finding]:
    """Add disagreements to the findings, in the place of those that they contain.

    One that a bias, a drift, a scale error, or a bias that changes explains after all is a finding
    of that kind; of several suspects of a bias the witness may name one.

    Parameters
    ----------
    table
        Gyros, calibrated, in the mounting found; what accuses itself is not valid.
    logged
        The same without the calibration, in which sizes are measured.
    findings
        All that is known to be wrong.
    """
    kept = list(findings)
    for found in disagreements(table, findings, config):
        parts = [one for one in kept if _contains(found, one)]
        kept = [one for one in kept if one not in parts]
        # A part that has no proper place may still say when it began or ended.
        shapes = [one for one in parts if one.kind != "mounting"]
        whole = replace(
            found,
            start_s=min([found.start_s, *(one.start_s for one in shapes)]),
            end_s=max([found.end_s, *(one.end_s for one in shapes)]),
        )
        fault = _fault(table, whole, parts, config, hearing)
        explained = None if fault is None else finding_of(logged, fault, config)
        if explained is not None and _explains(table, explained, whole, kept, config):
            seen_in = found.detail.removesuffix(UNEXPLAINED)
            detail = f"{explained.detail}; {seen_in}"
            kept.append(replace(explained, detectors=(DETECTOR,), detail=detail))
            continue
        changing = _changing_bias(table, logged, whole, (parts, kept), config)
        if changing is not None:
            kept.append(changing)
            continue
        apart = [one for one in parts if _stands_out(table, one, found, kept)]
        kept.append(found if apart else whole)
        kept += apart
    return kept


def _fault(
    table: ChannelTable,
    found: Finding,
    parts: Sequence[Finding],
    config: Config,
    hearing: Hearing | None,
) -> Fault | None:
    """Return the drift or scale error that a disagreement may be, or the bias if none is known."""
    suspects = frozenset(table.names.index(name) for name in found.suspects)
    start, stop = np.searchsorted(table.time_s, [found.start_s, found.end_s]).tolist()
    span = Shape(kind="bias", start=start, stop=stop + 1, gain=0.0, size=0.0)
    fault = shaped(table, Fault(suspects=suspects, shape=span, longest_s=0.0), config)
    if fault.shape.kind != "bias":
        return fault
    if parts:
        return None
    # Too short, or too loud, for windows to tell that its mean is beyond tolerance for sure.
    seen = Accusation(
        kind="bias",
        detector=DETECTOR,
        suspects=suspects,
        start=start,
        stop=stop + 1,
        length_s=found.end_s - found.start_s,
    )
    return heard(table, step_of(table, Cluster.of(seen), config), config, hearing)


def _explains(
    table: ChannelTable,
    explained: Finding,
    found: Finding,
    others: Sequence[Finding],
    config: Config,
) -> bool:
    """Whether a finding of a known kind has a size, and leaves nothing of a disagreement."""
    if not _sized(explained, config):
        return False
    left = disagreements(table, [*others, explained], config)
    return not any(overlap(one, explained) or overlap(one, found) for one in left)


def _sized(finding: Finding, config: Config) -> bool:
    """Whether a finding has a size that is some error for sure, and likely one beyond tolerance."""
    size = finding.size
    if size is None:
        return False
    if finding.kind == "scale":
        return max(size.low - 1.0, 1.0 - size.high) >= config.tolerance.scale
    signed = size.low > 0.0 or size.high < 0.0
    return finding.kind != "bias" or (signed and not within(finding, config))


def _changing_bias(
    table: ChannelTable,
    logged: ChannelTable,
    found: Finding,
    known: tuple[Sequence[Finding], Sequence[Finding]],
    config: Config,
) -> Finding | None:
    """Return the bias that a disagreement is, if its mean over some seconds explains it.

    Parameters
    ----------
    known
        Findings that are a part of it, and the others.
    """
    parts, others = known
    parts = [one for one in parts if one.kind in {"bias", "drift"}]
    names = set(found.suspects).intersection(*(one.suspects for one in parts))
    if not parts or not names:
        return None
    suspects = sorted(table.names.index(name) for name in names)
    start, stop = np.searchsorted(table.time_s, [found.start_s, found.end_s]).tolist()
    row = leave_one_out(table.axes)[suspects[0]]
    needed = np.flatnonzero(np.nan_to_num(row))
    rows = start + np.flatnonzero(table.valid[start : stop + 1][:, needed].all(axis=1))
    width = round(CHANGING_S / table.period_s) if table.period_s else 0
    if not np.isfinite(row).all() or len(rows) < 2 * max(width, 1):
        return None

    def slowly(of: ChannelTable) -> Floats:
        around = np.pad(of.rate_rad_s[np.ix_(rows, needed)] @ row[needed], width // 2, mode="edge")
        return moving_mean(around, width)[width // 2 :][: len(rows)]

    slow = slowly(table)
    rate = table.rate_rad_s.copy()
    rate[rows, suspects[0]] -= slow
    left = disagreements(replace(table, rate_rad_s=rate), others, config)
    if any(overlap(one, found) for one in left):
        return None
    span = Shape(kind="bias", start=start, stop=stop + 1, gain=0.0, size=0.0)
    fault = Fault(suspects=frozenset(suspects), shape=span, longest_s=0.0)
    bias = finding_of(logged, fault, config)
    size, tolerance = bias.size, config.tolerance.bias_deg_s
    low, high = np.degrees([slow.min(), slow.max()])
    # What wanders to both sides is no error of any one size.
    if size is None or (low < -tolerance and high > tolerance):
        return None
    if max(size.low, -size.high) <= np.radians(tolerance):
        return None
    low, high = np.degrees([f(slowly(logged)) for f in (np.min, np.max)])
    longest = max(parts, key=lambda one: one.end_s - one.start_s)
    return replace(
        bias,
        detectors=(DETECTOR, *longest.detectors),
        dissent=longest.dissent,
        witness=longest.witness,
        detail=f"it changed, from {low:.2g} to {high:.2g} deg/s; {longest.detail}",
    )


def overlap(one: Finding, other: Finding) -> bool:
    """Tell whether two findings suspect the same channel at the same time."""
    in_time = one.start_s < other.end_s and one.end_s > other.start_s
    return in_time and bool(set(one.suspects) & set(other.suspects))


def _contains(found: Finding, other: Finding) -> bool:
    """Whether another finding is a part of a disagreement rather than a fault of its own."""
    if not set(other.suspects) & set(found.suspects):
        return False
    if other.kind == "mounting":
        return found.start_s < other.start_s and found.end_s > other.end_s
    gap_s = max(other.start_s - found.end_s, found.start_s - other.end_s)
    if other.kind == "noise":
        # At rest, a swing that is too slow to be noise in flight is noise.
        shorter = other.end_s - other.start_s < found.end_s - found.start_s
        return shorter and gap_s < SWING_S
    # Where a disagreement begins and ends is known to a cell.
    return other.kind in SHAPES and gap_s < CELL_S


def _stands_out(
    table: ChannelTable, bias: Finding, found: Finding, known: Sequence[Finding]
) -> bool:
    """Whether a bias is far above what the gyros disagree by, and so no part of that."""
    if bias.kind != "bias" or bias.size is None:
        return False
    explained, doubtful = _without_known(table, [*known, bias])
    channel = table.names.index(bias.suspects[0])
    columns = next(list(block) for block in blocks(table.axes) if channel in block)
    cells = _cells(explained, columns, doubtful)
    if cells is None:
        return False
    error, _ = cells.errors(np.nan_to_num(leave_one_out(table.axes[columns])))
    within = (cells.end_s > found.start_s) & (cells.start_s < found.end_s)
    if not within.any():
        return False
    usual = float(np.quantile(np.abs(error[within, columns.index(channel)]), MOST_CELLS))
    return max(bias.size.low, -bias.size.high) > STANDING_OUT * usual


@dataclass(frozen=True, kw_only=True, eq=False)
class _Cells:
    """The channels of one block in half seconds.

    Parameters
    ----------
    start_s, end_s : (n,)
        Of each cell. [s]
    mean, slope : (n, k)
        Mean readings [rad/s], and their rates of change. [rad/s^2]
    scatter : (n, k, k)
        Covariance of the means, as white noise has it. [rad^2/s^2]
    dof : (n,)
        Its degrees of freedom.
    """

    start_s: Floats
    end_s: Floats
    mean: Floats
    slope: Floats
    scatter: Floats
    dof: Floats

    def errors(self, rows: Floats) -> tuple[Floats, Floats]:
        """Return errors by some rows of comparison, and their standard errors, both (n, k)."""
        variance = np.einsum("ci,nij,cj->nc", rows, self.scatter, rows)
        return self.mean @ rows.T, np.sqrt(np.maximum(variance, 0.0))

    def sure(self, axes: Floats) -> Floats:
        """Tell how many standard errors are sure in each cell, (n,).

        They are more by as much as the errors of this flight are usually larger than white noise
        would make them, within bounds.
        """
        error, sigma = self.errors(np.nan_to_num(leave_one_out(axes)))
        if not len(error):
            return np.zeros(0)
        noisy = sigma > 0.0
        apart = np.abs(error - np.median(error, axis=0))[noisy] / sigma[noisy]
        restless = NORMAL_CONSISTENCY * float(np.median(apart)) if len(apart) else 1.0
        return student_quantile(self.dof, CONFIDENCE) * min(max(restless, 1.0), MOST_RESTLESS)

    def beyond(
        self, axes: Floats, removed: Sequence[int], config: Config, sigmas: Floats | float = SIGMAS
    ) -> Bools | None:
        """Tell in which cells each channel's error is surely beyond tolerance, (n, k).

        Parameters
        ----------
        removed
            Channels that nobody is compared with; nothing if then nothing is compared.
        sigmas : () or (n,)
            By how many standard errors.
        """
        rows = leave_one_out(axes, list(removed))
        tested = np.asarray(np.isfinite(rows).all(axis=1), bool)
        tested[list(removed)] = False
        if not tested.any():
            return None
        error, sigma = self.errors(np.where(tested[:, None], rows, 0.0))
        tolerance = np.sqrt(
            np.radians(config.tolerance.bias_deg_s) ** 2
            + (config.tolerance.scale * (self.mean - error)) ** 2
            + (3.0 * config.noise.time_sigma_s * self.slope) ** 2
        )
        half_width = np.broadcast_to(sigmas, len(sigma))[:, None] * sigma
        return np.asarray(tested & (np.abs(error) - half_width > tolerance), bool)


def disagreements(
    table: ChannelTable, findings: Sequence[Finding], config: Config
) -> Iterator[Finding]:
    """Find disagreements that are left when what is known to be wrong has been taken out."""
    explained, doubtful = _without_known(table, findings)
    for block in blocks(table.axes):
        columns = list(block)
        if len(columns) < 2:
            continue
        cells = _cells(explained, columns, doubtful)
        if cells is None:
            continue
        axes = table.axes[columns]
        beyond = cells.beyond(axes, (), config)
        surely = cells.beyond(axes, (), config, cells.sure(axes))
        if beyond is None or surely is None:
            continue
        for first, last in _spans(np.asarray(beyond.any(axis=1), bool)):
            within = slice(first, last)
            if float(surely[within].any(axis=1).mean()) < LEAST_SHARE:
                continue
            suspects = _suspects(cells, axes, within, config)
            names = tuple(table.names[columns[k]] for k in suspects)
            count = int(beyond[within].any(axis=1).sum())
            yield Finding(
                kind="disagreement",
                suspects=names,
                start_s=float(cells.start_s[first]),
                end_s=float(cells.end_s[last - 1]),
                detectors=(DETECTOR,),
                detail=(
                    f"beyond tolerance for sure in {count} of {last - first} half seconds"
                    f"{UNEXPLAINED}"
                ),
            )


def _without_known(table: ChannelTable, findings: Sequence[Finding]) -> tuple[ChannelTable, Bools]:
    """Take out what is known to be wrong, as far as it has a size.

    Returns
    -------
    table
        With biases, drifts and scale errors taken out of their suspects.
    doubtful : (n_samples, n_channels) bool
        Where a channel has a fault that cannot be taken out.
    """
    rate = table.rate_rad_s.copy()
    doubtful = np.zeros(rate.shape, bool)
    rows_of = leave_one_out(table.axes)
    for finding in findings:
        columns = [table.names.index(name) for name in finding.suspects if name in table.names]
        rows = (table.time_s >= finding.start_s) & (table.time_s <= finding.end_s)
        pair = len(columns) < 3
        if finding.kind == "mounting":
            continue  # turned back already
        if finding.kind not in SHAPES or finding.size is None or not pair or not columns:
            doubtful[:, columns] |= rows[:, None]
            continue
        channel, size = columns[0], finding.size.estimate
        if finding.kind == "bias":
            rate[rows, channel] -= size
        elif finding.kind == "drift":
            rate[rows, channel] -= size * (table.time_s[rows] - finding.start_s)
        else:
            row = rows_of[channel]
            needed = np.flatnonzero(np.nan_to_num(row))
            error = table.rate_rad_s[rows][:, needed] @ row[needed]
            rate[rows, channel] -= (size - 1.0) * (table.rate_rad_s[rows, channel] - error)
    valid = table.valid & np.isfinite(rate)
    return replace(table, rate_rad_s=np.where(valid, rate, np.nan), valid=valid), doubtful


def _cells(table: ChannelTable, columns: list[int], doubtful: Bools) -> _Cells | None:
    """Cut the instants at which all channels of a block are known into cells."""
    whole = np.asarray(table.valid[:, columns].all(axis=1), bool)
    whole &= ~doubtful[:, columns].any(axis=1)
    rows = np.flatnonzero(whole)
    slowest = min(table.channels[k].rate_hz for k in columns)
    length_s = max(CELL_S, FEWEST_SAMPLES / slowest if slowest > 0 else np.inf)
    if not len(rows) or not np.isfinite(length_s):
        return None
    time_s, readings = table.time_s[rows], table.rate_rad_s[rows][:, columns]
    start = np.flatnonzero(np.diff(np.floor(time_s / length_s), prepend=-np.inf) > 0)
    count = np.diff(np.append(start, len(rows)))
    last = start + count - 1
    mean = np.add.reduceat(readings, start, axis=0) / count[:, None]
    scatter = np.empty((len(start), len(columns), len(columns)))
    for i in range(len(columns)):
        for j in range(i + 1):
            square = np.add.reduceat(readings[:, i] * readings[:, j], start) / count
            apart = (square - mean[:, i] * mean[:, j]) / np.maximum(count - 1, 1)
            scatter[:, i, j] = scatter[:, j, i] = apart
    elapsed = np.maximum(time_s[last] - time_s[start], max(table.period_s, SHORTEST_S))[:, None]
    full = count >= max(FEWEST_SAMPLES / 2, float(np.median(count)) / 2)
    return _Cells(
        start_s=time_s[start][full],
        end_s=time_s[last][full],
        mean=mean[full],
        slope=((readings[last] - readings[start]) / elapsed)[full],
        scatter=scatter[full],
        dof=count[full] - 1.0,
    )


def _spans(beyond: Bools) -> list[tuple[int, int]]:
    """Find where far more cells than usual are beyond tolerance: runs of the largest excess."""
    found = []
    todo = [(0, len(beyond))]
    while todo:
        first, last = todo.pop()
        if last - first < FEWEST_BEYOND:
            continue
        excess = beyond[first:last] - USUAL_SHARE
        total = np.concatenate([[0.0], np.cumsum(excess)])
        gained = total - np.minimum.accumulate(total)
        stop = int(gained.argmax())
        start = int(total[: stop + 1].argmin())
        count = int(beyond[first + start : first + stop].sum())
        share = count / max(stop - start, 1)
        if gained[stop] < LEAST_EXCESS or count < FEWEST_BEYOND or share < LEAST_SHARE:
            continue
        found.append((first + start, first + stop))
        todo += [(first, first + start), (first + stop, last)]
    return sorted(found)


def _suspects(cells: _Cells, axes: Floats, within: slice, config: Config) -> list[int]:
    """Name the channels without any one of which the others agree; all if there is none."""
    part = _Cells(
        start_s=cells.start_s[within],
        end_s=cells.end_s[within],
        mean=cells.mean[within],
        slope=cells.slope[within],
        scatter=cells.scatter[within],
        dof=cells.dof[within],
    )
    named = []
    for channel in range(len(axes)):
        left = part.beyond(axes, [channel], config)
        if left is None or float(left.any(axis=1).mean()) <= USUAL_SHARE:
            named.append(channel)
    everyone = part.beyond(axes, (), config)
    if named or everyone is None:
        return named
    return np.flatnonzero(everyone.any(axis=0)).tolist()
