"""From evidence to findings: what a channel shows by itself, and what is guaranteed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.accusations import Accusation, Cluster, accusations, clusters
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Interval, Kind, Size
from fdilog.table import ChannelTable

# A fault that single samples show, miss and show again within this time is one fault. [s]
REJOINED_S = 1.0
# Turns that are too fast for a gyro and no further apart than this are told as one. [s]
TURNS_S = 60.0
# So many impulses, silences or held values, no further apart than that, are one gyro or source that
# fails again and again; the instant and size of each of a few are worth a look.
FEWEST_TOGETHER: dict[Kind, int] = {
    "saturated": 1,
    "impulse": 10,
    "dropout": 10,
    "stuck": 10,
    "dead": 10,
}
_WORDS: dict[Kind, str] = {
    "impulse": "one reading or a few far off, which nothing else confirms",
    "dead": "reads exactly zero",
    "dropout": "silent while other sources go on",
    "saturated": "reads its full scale, and may have turned faster",
    "stuck": "repeats one value beyond what its quantisation explains",
}


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


def self_evident_findings(table: ChannelTable, evidence: Sequence[Evidence]) -> list[Finding]:
    """Turn evidence of detectors that need no comparison into findings.

    There is one a channel and run, one for all the turns of some minutes that were too fast, and
    one for a gyro or source that fails again and again.
    """
    said = {accusation: item for item in evidence for accusation in accusations(item)}
    repeated = [
        cluster
        for kind, fewest in FEWEST_TOGETHER.items()
        for cluster in clusters(table.time_s, [one for one in said if one.kind == kind], TURNS_S)
        if len(cluster.members) >= fewest
    ]
    together = {one for cluster in repeated for one in cluster.members}
    findings = [
        Finding(
            kind=one.kind,
            suspects=tuple(table.names[channel] for channel in sorted(one.suspects)),
            start_s=float(table.time_s[one.start]),
            end_s=float(table.time_s[one.stop - 1]),
            size=_own_size(item, one),
            detectors=(one.detector,),
            detail=_WORDS.get(one.kind, ""),
        )
        for one, item in said.items()
        if one not in together
    ]
    return findings + [_of_many(table, cluster, said) for cluster in repeated]


def _of_many(table: ChannelTable, cluster: Cluster, said: Mapping[Accusation, Evidence]) -> Finding:
    """Make one finding, without a size of its own, of what a channel shows many times."""
    members, kind = cluster.members, cluster.members[0].kind
    if kind == "impulse":
        sizes = [_own_size(said[one], one) for one in members]
        far = np.degrees([abs(size.estimate) for size in sizes if size is not None])
        detail = f"{len(far)} times {_WORDS[kind]}: by {far.min():.3g} to {far.max():.3g} deg/s"
    else:
        # What it did in a hole of the log is not known.
        held_s = sum(one.stop - one.start for one in members) * table.period_s
        times = f"{len(members)} times, " if len(members) > 1 else ""
        detail = f"{_WORDS[kind]}; {times}{held_s:.3g} s in all"
    return Finding(
        kind=kind,
        suspects=tuple(table.names[channel] for channel in sorted(cluster.suspects)),
        start_s=float(table.time_s[cluster.start]),
        end_s=float(table.time_s[cluster.stop - 1]),
        size=None,
        detectors=tuple(sorted({one.detector for one in members})),
        detail=detail,
    )


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
