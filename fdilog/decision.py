"""From evidence to findings, channel status and verdict: an interval against a tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Interval, Kind, Size, Status, Verdict
from fdilog.geometry import leave_one_out
from fdilog.isolation import compare, isolate
from fdilog.table import ChannelTable
from fdilog.windows import Moments, Survey, spans

# A channel is healthy only if it was inside tolerance over this share of its valid time (the
# contract's figure).
HEALTHY_COVERAGE = 0.9
# The edges of a fault are first looked for among this many bins, then among samples.
EDGE_BINS = 400
# A fault that single samples show, miss and show again within this time is one fault. [s]
REJOINED_S = 1.0


@dataclass(frozen=True, kw_only=True)
class Accusation:
    """Windows in a row, of one length, in which a detector names the same suspects."""

    kind: Kind
    detector: str
    suspects: frozenset[int]
    start: int
    stop: int
    length_s: float


def accusations(evidence: Evidence) -> Iterator[Accusation]:
    """List what one piece of evidence says, windows in a row taken together."""
    rows = np.flatnonzero(evidence.accused.any(axis=1))
    patterns, which = np.unique(evidence.accused[rows], axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        here = rows[which == number]
        start, stop = evidence.windows.start[here], evidence.windows.stop[here]
        for first, last in _merged(start, stop):
            for group in np.unique(pattern[pattern > 0]):
                yield Accusation(
                    kind=evidence.kind,
                    detector=evidence.detector,
                    suspects=frozenset(np.flatnonzero(pattern == group).tolist()),
                    start=first,
                    stop=last,
                    length_s=evidence.windows.length_s,
                )


def _merged(start: NDArray[np.int64], stop: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Join ranges that touch or overlap."""
    order = np.argsort(start, kind="stable")
    start, stop = start[order], stop[order]
    reach = np.maximum.accumulate(stop)
    fresh = np.concatenate([[True], start[1:] > reach[:-1]]) if len(start) else np.zeros(0, bool)
    first = np.flatnonzero(fresh)
    last = np.append(first[1:], len(start)) - 1
    return [(int(start[a]), int(reach[b])) for a, b in zip(first, last, strict=True)]


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Accusations of one detector that overlap in time and share a suspect.

    The suspects are those that every accusation names; accusations that have none in common are
    never joined.
    """

    suspects: frozenset[int]
    start: int
    stop: int
    longest_s: float
    members: tuple[Accusation, ...]

    @classmethod
    def of(cls, member: Accusation) -> Cluster:
        """Start a cluster from one accusation."""
        return cls(
            suspects=member.suspects,
            start=member.start,
            stop=member.stop,
            longest_s=member.length_s,
            members=(member,),
        )

    def joined(self, other: Cluster) -> Cluster:
        """Return both as one."""
        return Cluster(
            suspects=self.suspects & other.suspects,
            start=min(self.start, other.start),
            stop=max(self.stop, other.stop),
            longest_s=max(self.longest_s, other.longest_s),
            members=(*other.members, *self.members),
        )


def clusters(
    time_s: NDArray[np.float64], accused: Sequence[Accusation], reach_s: float = 0.0
) -> list[Cluster]:
    """Join accusations that share a suspect and are no further apart than their windows reach."""
    found: list[Cluster] = []
    for item in sorted(accused, key=lambda a: (a.start, a.stop, -a.length_s, sorted(a.suspects))):
        merged = Cluster.of(item)
        apart = []
        for other in found:
            gap_s = time_s[merged.start] - time_s[other.stop - 1]
            near = gap_s <= max(merged.longest_s / 2, other.longest_s / 2, reach_s)
            if near and other.suspects & merged.suspects:
                merged = merged.joined(other)
            else:
                apart.append(other)
        found = [*apart, merged]
    return found


def bias_findings(
    table: ChannelTable,
    calibrated: ChannelTable,
    evidence: Sequence[Evidence],
    config: Config,
) -> list[Finding]:
    """Turn comparative evidence into findings, each tested and measured over its own span.

    The first detector leads. A finding names the detectors that accuse its suspects at that time,
    and as dissenting those that accuse nobody then, or somebody else of the same block.
    """
    by_detector: dict[str, list[Accusation]] = {}
    for item in evidence:
        by_detector.setdefault(item.detector, []).extend(accusations(item))
    open_accusations = next(iter(by_detector.values()), [])
    faults: list[Fault] = []
    while open_accusations:
        left: list[Accusation] = []
        for cluster in clusters(table.time_s, open_accusations):
            fault = _fault(calibrated, cluster, config)
            faults.append(fault)
            # What lies apart from the span of the fault is another fault.
            left.extend(
                member
                for member in cluster.members
                if member.stop <= fault.start or member.start >= fault.stop
            )
        open_accusations = left if len(left) < len(open_accusations) else []
    findings = []
    for fault in _joined_faults(calibrated, faults, config):
        finding = _finding(table, fault, config)
        agree, dissent = [], []
        for name, said in by_detector.items():
            named = [a.suspects for a in said if _overlap(table, a, finding)]
            if any(suspects & fault.suspects for suspects in named):
                agree.append(name)
            elif not named or any(_same_block(table, them, fault.suspects) for them in named):
                dissent.append(name)
        findings.append(replace(finding, detectors=tuple(agree), dissent=tuple(dissent)))
    return findings


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Suspects and the samples over which they are off; ``removed`` failed at the same time."""

    suspects: frozenset[int]
    start: int
    stop: int
    longest_s: float
    removed: frozenset[int] = frozenset()


def _fault(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the span of a fault, and who is accused by a test over just that span."""
    start, stop = _edges(table, cluster)
    fault = Fault(suspects=cluster.suspects, start=start, stop=stop, longest_s=cluster.longest_s)
    return _tested(table, fault, config)


def _tested(table: ChannelTable, fault: Fault, config: Config) -> Fault:
    """Narrow the suspects by the joint test over the whole span, the strongest that there is."""
    moments = _moments(table, fault, config)
    if moments is None:
        return fault
    channels = np.array(moments.channels)
    answer = isolate(moments, table.axes[channels], config, fault.longest_s)
    accused = answer.accused[0]
    groups = [
        frozenset(channels[accused == group].tolist()) for group in np.unique(accused[accused > 0])
    ]
    mine = [group & fault.suspects for group in groups if group & fault.suspects]
    suspects = mine[0] if len(mine) == 1 else fault.suspects
    others = frozenset[int]().union(*(group for group in groups if not group & suspects))
    return replace(fault, suspects=suspects, removed=others)


def _moments(table: ChannelTable, fault: Fault, config: Config) -> Moments | None:
    """Return the means of the suspects' block over the span of a fault."""
    windows = spans(table, np.array([fault.start]), np.array([fault.stop]))
    survey = Survey(table=table, windows=windows, config=config)
    return next((m for m in survey.moments if fault.suspects <= set(m.channels)), None)


def _joined_faults(table: ChannelTable, faults: Sequence[Fault], config: Config) -> list[Fault]:
    """Join spans of shared suspects that overlap, or are parted by less than half a window."""
    kept: list[Fault] = []
    for fault in sorted(faults, key=lambda f: (f.start, f.stop)):
        for k, other in enumerate(kept):
            gap_s = table.time_s[fault.start] - table.time_s[other.stop - 1]
            near = gap_s <= max(fault.longest_s, other.longest_s) / 2
            if near and fault.suspects & other.suspects:
                both = Fault(
                    suspects=fault.suspects & other.suspects,
                    start=min(fault.start, other.start),
                    stop=max(fault.stop, other.stop),
                    longest_s=max(fault.longest_s, other.longest_s),
                )
                kept[k] = _tested(table, both, config)
                break
        else:
            kept.append(fault)
    return kept


def _finding(table: ChannelTable, fault: Fault, config: Config) -> Finding:
    names = tuple(table.names[channel] for channel in sorted(fault.suspects))
    return Finding(
        kind="bias",
        suspects=names,
        start_s=float(table.time_s[fault.start]),
        end_s=float(table.time_s[fault.stop - 1]),
        size=_size(table, fault, config),
        detail=_detail(names, "bias"),
    )


def _size(table: ChannelTable, fault: Fault, config: Config) -> Size | None:
    """Mean error of the first suspect over the span, with its Student interval.

    It is measured against the plain least-squares prediction from the sound channels, in the
    readings as logged: the offset that the others agree on is the truth it can be held against.
    """
    moments = _moments(table, fault, config)
    if moments is None:
        return None
    channels = list(moments.channels)
    first = channels.index(min(fault.suspects))
    measured = compare(
        moments,
        table.axes[channels],
        np.ones(len(channels)),
        removed=[channels.index(c) for c in sorted(fault.removed) if c in channels],
        config=config,
        family_confidence=config.windows.confidence,
    )
    if not measured.tested[first]:
        return None
    estimate = float(measured.error[0, first])
    half_width = float(measured.half_width[0, first])
    return Size(
        estimate=estimate,
        low=estimate - half_width,
        high=estimate + half_width,
        confidence=config.windows.confidence,
        unit=SIZE_UNIT["bias"],
    )


def guaranteed_findings(
    table: ChannelTable, evidence: Sequence[Evidence], findings: list[Finding], config: Config
) -> list[Finding]:
    """Add what the guaranteed intervals of single samples say to the findings.

    A finding gets the guaranteed interval of its suspect's mean error over its span: the mean of
    the intervals of the samples. Where a bound is stated, what they accuse is a finding even if no
    window showed it; an estimated bound guarantees too little for that.
    """
    for item in evidence:
        findings = [_with_guarantee(table, item, finding) for finding in findings]
        if config.noise.bound_deg_s > 0.0:
            found = clusters(table.time_s, list(accusations(item)), reach_s=REJOINED_S)
            findings += [
                finding
                for finding in (_guaranteed(table, item, cluster) for cluster in found)
                if not any(_same_fault(finding, other) for other in findings)
            ]
    return findings


def _same_fault(one: Finding, other: Finding) -> bool:
    overlap = one.start_s <= other.end_s and other.start_s <= one.end_s
    return overlap and bool(set(one.suspects) & set(other.suspects))


def _with_guarantee(table: ChannelTable, evidence: Evidence, finding: Finding) -> Finding:
    if finding.kind != "bias" or not finding.isolated:
        return finding
    channel = table.names.index(finding.suspects[0])
    rows = (table.time_s >= finding.start_s) & (table.time_s <= finding.end_s)
    accused = bool((evidence.accused[rows, channel] > 0).any())
    return replace(
        finding,
        guaranteed=_mean_interval(evidence, rows, channel),
        detectors=(*finding.detectors, evidence.detector) if accused else finding.detectors,
    )


def _mean_interval(evidence: Evidence, rows: NDArray[np.bool_], channel: int) -> Interval | None:
    low, high = evidence.low[rows, channel], evidence.high[rows, channel]
    bounded = np.isfinite(low) & np.isfinite(high)
    if not bounded.any():
        return None
    return Interval(low=float(low[bounded].mean()), high=float(high[bounded].mean()))


def _guaranteed(table: ChannelTable, evidence: Evidence, cluster: Cluster) -> Finding:
    channel = min(cluster.suspects)
    rows = np.zeros(len(table.time_s), bool)
    for member in cluster.members:
        rows[member.start : member.stop] = True
    interval = _mean_interval(evidence, rows, channel)
    names = tuple(table.names[k] for k in sorted(cluster.suspects))
    size = None
    if interval is not None:
        size = Size(
            estimate=(interval.low + interval.high) / 2,
            low=interval.low,
            high=interval.high,
            confidence=evidence.confidence,
            unit=SIZE_UNIT["bias"],
        )
    return Finding(
        kind="bias",
        suspects=names,
        start_s=float(table.time_s[cluster.start]),
        end_s=float(table.time_s[cluster.stop - 1]),
        size=size,
        guaranteed=interval,
        detectors=(evidence.detector,),
        detail="beyond tolerance for every healthy error within the stated bound",
    )


def _overlap(table: ChannelTable, said: Accusation, finding: Finding) -> bool:
    start_s, end_s = table.time_s[said.start], table.time_s[said.stop - 1]
    return bool(start_s <= finding.end_s and end_s >= finding.start_s)


def _same_block(table: ChannelTable, one: frozenset[int], other: frozenset[int]) -> bool:
    from fdilog.geometry import blocks

    return any(set(block) & one and set(block) & other for block in blocks(table.axes))


def _edges(table: ChannelTable, cluster: Cluster) -> tuple[int, int]:
    """Where a shift of the mean begins and ends: least squares over both edges.

    The residual of one suspect against all others of its block, less its level outside the
    cluster, is ``f`` inside the fault and 0 outside; the edges that leave the least sum of squares
    are those with the largest ``(sum inside)^2 / samples inside``.
    """
    channel = min(cluster.suspects)
    row = leave_one_out(table.axes)[channel]
    needed = np.flatnonzero(row != 0)
    reach = cluster.longest_s / 2
    time_s = table.time_s
    first = int(np.searchsorted(time_s, time_s[cluster.start] - reach))
    last = int(np.searchsorted(time_s, time_s[cluster.stop - 1] + reach, side="right"))
    complete = np.asarray(table.valid[:, needed].all(axis=1), bool)
    rows = first + np.flatnonzero(complete[first:last])
    if len(rows) < 3:
        return cluster.start, cluster.stop
    residual = table.rate_rad_s[rows][:, needed] @ row[needed]
    outside = (
        np.flatnonzero(complete[:first]).tolist()
        + (last + np.flatnonzero(complete[last:])).tolist()
    )
    level = 0.0
    if len(outside) >= len(rows) / 4:
        level = float(np.median(table.rate_rad_s[outside][:, needed] @ row[needed]))
    total = np.concatenate([[0.0], np.cumsum(residual - level)])
    edges = np.unique(np.linspace(0, len(rows), EDGE_BINS + 1).astype(int))
    a, b = _best_span(total, edges, edges)
    bin_size = int(np.ceil(len(rows) / EDGE_BINS))
    near_a = np.arange(max(0, a - bin_size), min(b, a + bin_size + 1))
    a, b = _best_span(total, near_a, np.array([b]))
    near_b = np.arange(max(a + 1, b - bin_size), min(len(rows), b + bin_size) + 1)
    a, b = _best_span(total, np.array([a]), near_b)
    return int(rows[a]), int(rows[b - 1]) + 1


def _best_span(
    total: NDArray[np.float64], starts: NDArray[np.int64], stops: NDArray[np.int64]
) -> tuple[int, int]:
    inside = total[stops][None, :] - total[starts][:, None]
    length = (stops[None, :] - starts[:, None]).astype(float)
    gain = np.where(length > 0, inside**2 / np.maximum(length, 1.0), -1.0)
    a, b = np.unravel_index(int(gain.argmax()), gain.shape)
    return int(starts[a]), int(stops[b])


_WORDS: dict[Kind, str] = {
    "dead": "reads exactly zero",
    "dropout": "silent while other sources go on",
    "stuck": "repeats one value beyond what its quantisation explains",
}


def _detail(names: tuple[str, ...], kind: Kind) -> str:
    if kind in _WORDS:
        return _WORDS[kind]
    if len(names) == 1:
        return "reads off from what the other gyros that sense its axis agree on"
    return (
        f"{', '.join(names)} disagree and the redundancy of this log cannot tell which of them"
        f" failed; the size is {names[0]}'s error if it is the one"
    )


def self_evident_findings(table: ChannelTable, evidence: Sequence[Evidence]) -> list[Finding]:
    """Turn evidence of detectors that need no comparison into findings, one a channel and run."""
    return [
        Finding(
            kind=said.kind,
            suspects=tuple(table.names[channel] for channel in sorted(said.suspects)),
            start_s=float(table.time_s[said.start]),
            end_s=float(table.time_s[said.stop - 1]),
            size=_own_size(item, said),
            detectors=(said.detector,),
            detail=_detail((), said.kind),
        )
        for item in evidence
        for said in accusations(item)
    ]


def _own_size(evidence: Evidence, said: Accusation) -> Size | None:
    """Hull of the intervals that the accusing windows give the first suspect, if they give any."""
    rows = (evidence.windows.start >= said.start) & (evidence.windows.stop <= said.stop)
    channel = min(said.suspects)
    rows &= evidence.accused[:, channel] > 0
    low, high = evidence.low[rows, channel], evidence.high[rows, channel]
    if evidence.kind not in SIZE_UNIT or not bool(np.isfinite([low, high]).all()):
        return None
    lowest, highest = float(low.min()), float(high.max())
    return Size(
        estimate=(lowest + highest) / 2,
        low=lowest,
        high=highest,
        confidence=evidence.confidence,
        unit=SIZE_UNIT[evidence.kind],
    )


def channel_status(
    table: ChannelTable, evidence: Sequence[Evidence], findings: Sequence[Finding]
) -> tuple[Status, ...]:
    """Say of each channel whether it failed, by the contract's rule.

    Healthy is a channel in no finding whose longest windows (of the greatest length whose windows
    cover at least 90 % of its valid time) all lie inside the tolerance.
    """
    lead = evidence[0].detector if evidence else None
    by_length = sorted(
        (item for item in evidence if item.detector == lead),
        key=lambda item: -item.windows.length_s,
    )
    alone = {f.suspects[0] for f in findings if f.isolated}
    shared = {name for f in findings if not f.isolated for name in f.suspects}
    status: list[Status] = []
    for channel, name in enumerate(table.names):
        if name in alone:
            status.append("failed")
        elif name in shared:
            status.append("suspect")
        elif not any(item.tested[:, channel].any() for item in by_length):
            status.append("insufficient")
        else:
            status.append("healthy" if _healthy(table, by_length, channel) else "undecided")
    return tuple(status)


def _healthy(table: ChannelTable, by_length: Sequence[Evidence], channel: int) -> bool:
    valid = table.valid[:, channel]
    for item in by_length:
        rows = np.flatnonzero(item.tested[:, channel])
        covered = np.zeros(len(valid) + 1, np.int64)
        np.add.at(covered, item.windows.start[rows], 1)
        np.add.at(covered, item.windows.stop[rows], -1)
        inside_one = np.cumsum(covered)[:-1] > 0
        if (inside_one & valid).sum() >= HEALTHY_COVERAGE * valid.sum():
            tolerance = item.tolerance[rows, channel]
            low, high = item.low[rows, channel], item.high[rows, channel]
            return bool(((low > -tolerance) & (high < tolerance)).all())
    return False


def conclude(status: Sequence[Status], *, whole: bool) -> Verdict:
    """Give the verdict on a log, by the contract's rule."""
    if "failed" in status or "suspect" in status:
        return "failed"
    if all(one == "insufficient" for one in status):
        return "insufficient"
    if "undecided" in status or not whole:
        return "undecided"
    return "healthy"
