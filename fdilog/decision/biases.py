"""From comparative evidence to findings of bias, drift and scale, each over its own span."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.accusations import Accusation, Cluster, accusations, spanned
from fdilog.decision.shapes import Fault, disagreement, shaped, shaped_size, size_of
from fdilog.decision.steps import step_of
from fdilog.decision.testimony import Statement
from fdilog.finding import Evidence, Finding, Size
from fdilog.maths.geometry import leave_one_out
from fdilog.maths.noise import windowed_mean
from fdilog.sources.witness import SOURCE
from fdilog.table import ChannelTable
from fdilog.windows.isolation import isolate
from fdilog.windows.survey import FEWEST_PRESENT, Moments, Survey, spans
from fdilog.windows.traces import trace_of
from fdilog.windows.usual import usual

# A second whose noise has less than twice the usual spread is quiet.
QUIET = 0.25
# Where noise hides the sign, begin and end are known to an eighth of the span, not better.
EDGE = 8
Hearing = Callable[[Sequence[int], tuple[int, int]], Statement]
"""Asks the witness which of some gyros was off over a span of samples."""


def bias_findings(
    table: ChannelTable,
    calibrated: ChannelTable,
    evidence: Sequence[Evidence],
    config: Config,
    hearing: Hearing | None = None,
) -> list[Finding]:
    """Turn comparative evidence into findings, each tested and measured over its own span.

    The first detector leads. A finding names the detectors that accuse its suspects at that time,
    and as dissenting those that accuse nobody then, or somebody else of the same block. Where the
    gyros leave several suspects, the witness is heard; it is never a suspect itself.
    """
    by_detector: dict[str, list[Accusation]] = {}
    for item in evidence:
        by_detector.setdefault(item.detector, []).extend(accusations(item))
    leading = next(iter(by_detector.values()), [])
    faults = list(
        spanned(table.time_s, leading, lambda cluster: _fault(calibrated, cluster, config))
    )
    findings = []
    for joined in _joined_faults(calibrated, faults, config):
        fault = heard(calibrated, joined, config, hearing)
        if fault is None:
            continue
        finding = finding_of(table, fault, config)
        if within(finding, config):
            continue
        agree, dissent = _sides(table, evidence, by_detector, fault)
        findings.append(replace(finding, detectors=agree, dissent=dissent))
    return findings


def _fault(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the span of a fault, who is accused over just that span, and of what shape it is."""
    return shaped(table, _tested(table, step_of(table, cluster, config), config), config)


def _tested(table: ChannelTable, fault: Fault, config: Config) -> Fault:
    """Hold the suspects against the joint test over the whole span, the strongest there is."""
    moments = _moments(table, fault, config)
    if moments is None:
        return fault
    channels = np.array(moments.channels)
    answer = isolate(
        moments, table.axes[channels], config, fault.longest_s, usual(table).offset[channels]
    )
    accused = answer.accused[0]
    groups = [
        frozenset(channels[accused == group].tolist()) for group in np.unique(accused[accused > 0])
    ]
    mine = [group for group in groups if group & fault.suspects]
    suspects = fault.suspects
    if len(mine) == 1:
        # One window may have named fewer only because it knew too little of the others.
        suspects = mine[0] if mine[0] > suspects else mine[0] & suspects
    others = frozenset[int]().union(*(group for group in groups if not group & suspects))
    return replace(fault, suspects=suspects, removed=others)


def _moments(table: ChannelTable, fault: Fault, config: Config) -> Moments | None:
    """Return the means of the suspects' block over the span of a fault."""
    windows = spans(table, np.array([fault.start]), np.array([fault.stop]))
    return Survey(table=table, windows=windows, config=config).moments_of(fault.suspects)


def heard(
    table: ChannelTable, fault: Fault, config: Config, hearing: Hearing | None
) -> Fault | None:
    """Let the witness say which of several suspects failed.

    What only the witness could have shown, and nothing confirms, is a fault of nobody.
    """
    accused = sorted(k for k in fault.suspects if not table.channels[k].derived)
    if len(fault.suspects) == 1 or hearing is None:
        return fault if len(accused) == len(fault.suspects) else None
    said = hearing(accused, (fault.start, fault.stop))
    if said.named is not None:
        alone = replace(fault, suspects=frozenset({said.named}), testimony=said)
        return alone if fault.shape.kind == "bias" else shaped(table, alone, config)
    return replace(fault, testimony=said) if len(accused) == len(fault.suspects) else None


def _joined_faults(table: ChannelTable, faults: Sequence[Fault], config: Config) -> list[Fault]:
    """Join spans of shared suspects that overlap, or are parted by less than half a window."""
    kept: list[Fault] = []
    for fault in sorted(faults, key=lambda f: (f.start, f.stop)):
        for k, other in enumerate(kept):
            gap_s = table.time_s[fault.start] - table.time_s[other.stop - 1]
            near = gap_s <= max(fault.longest_s, other.longest_s) / 2
            if near and fault.suspects & other.suspects:
                # A shape that explains the most keeps its edges; two steps become one.
                shape = max(fault.shape, other.shape, key=lambda s: (s.kind != "bias", s.gain))
                if shape.kind == "bias":
                    start, stop = min(fault.start, other.start), max(fault.stop, other.stop)
                    shape = replace(shape, start=start, stop=stop)
                both = Fault(
                    suspects=fault.suspects & other.suspects,
                    shape=shape,
                    longest_s=max(fault.longest_s, other.longest_s),
                )
                kept[k] = _tested(table, both, config)
                break
        else:
            kept.append(fault)
    return _bridged(table, kept, config)


def _bridged(table: ChannelTable, faults: Sequence[Fault], config: Config) -> list[Fault]:
    """Join biases of the same suspects if nothing shows that they were sound in between.

    What is known badly for a while, in hard vibration say, leaves a hole in the middle of a fault.
    It is one fault if the readings in the hole could be off by what they are off by on both sides,
    and cannot be shown to be within tolerance.
    """
    kept: list[Fault] = []
    for fault in faults:
        # The last of the same suspects: with another in the hole, it is no hole.
        last = max((k for k, one in enumerate(kept) if one.suspects == fault.suspects), default=-1)
        whole = None if last < 0 else _one_bias(table, kept[last], fault, config)
        if whole is None:
            kept.append(fault)
        else:
            kept[last] = whole
    return kept


def _one_bias(table: ChannelTable, one: Fault, next_one: Fault, config: Config) -> Fault | None:
    """Join two biases and the hole between them, if they are one."""
    if {one.shape.kind, next_one.shape.kind} != {"bias"} or next_one.start <= one.stop:
        return None
    whole = replace(
        one,
        shape=replace(one.shape, stop=max(one.stop, next_one.stop)),
        longest_s=max(one.longest_s, next_one.longest_s),
        removed=one.removed & next_one.removed,
    )
    hole = replace(one, shape=replace(one.shape, start=one.stop, stop=next_one.start))
    low, high = -np.inf, np.inf
    for part in (one, next_one, hole):
        size = _size(table, part, config)
        if size is None:
            return None
        low, high = max(low, size.low), min(high, size.high)
        if low > high:
            return None
        inside = size
    tolerance = np.radians(config.tolerance.bias_deg_s)
    all_of_it = _size(table, whole, config)
    if all_of_it is None or max(abs(inside.low), abs(inside.high)) <= tolerance:
        return None
    return whole if max(all_of_it.low, -all_of_it.high) > tolerance else None


def finding_of(table: ChannelTable, fault: Fault, config: Config) -> Finding:
    """Put a fault into words and figures."""
    names = tuple(table.names[channel] for channel in sorted(fault.suspects))
    said = fault.testimony
    measure = _size if fault.shape.kind == "bias" else shaped_size
    return Finding(
        kind=fault.shape.kind,
        suspects=names,
        start_s=float(table.time_s[fault.start]),
        end_s=float(table.time_s[fault.stop - 1]),
        size=measure(table, fault, config),
        witness=SOURCE if said is not None and said.named is not None else None,
        detail=disagreement(names) if said is None else _testified(names, said),
    )


def within(finding: Finding, config: Config) -> bool:
    """Whether what is measured of a bias in the readings as logged is within tolerance after all.

    It was beyond it in the readings less what is in proportion to the rate, and so by what was
    fitted of that. The size of a suspect among several is that of the pair's difference in part:
    then the whole interval must be within, or hold zero besides.
    """
    size = finding.size
    if finding.kind != "bias" or size is None:
        return False
    told = finding.isolated or size.low < 0.0 < size.high
    largest = abs(size.estimate) if told else max(-size.low, size.high)
    return bool(largest <= np.radians(config.tolerance.bias_deg_s))


def _testified(names: tuple[str, ...], said: Statement) -> str:
    """Detail of a finding on which the witness was heard."""
    if said.named is None:
        return f"{disagreement(names)}; {said.detail}"
    return f"the attitude tells that it is the one that is off; {said.detail}"


def _size(table: ChannelTable, fault: Fault, config: Config) -> Size | None:
    """Mean error of the first suspect over the span, with its Student interval.

    Where hard vibration in a part of the span leaves not even the sign known, the longest stretch
    without it is measured, or what is left of the span if it began later and ended earlier.
    """
    size = _mean_error(table, fault, config)
    if size is None or _signed(size):
        return size
    trace = trace_of(table, min(fault.suspects), fault.removed, fault.start, fault.stop)
    if trace is None:
        return size
    n, edge = len(trace.rows), len(trace.rows) // EDGE
    known = []
    for first, last in (_longest(trace.weight() > QUIET), (edge, n - edge)):
        start, stop = int(trace.rows[first]), int(trace.rows[last - 1]) + 1
        part = replace(fault, shape=replace(fault.shape, start=start, stop=stop))
        measured = _mean_error(table, part, config)
        known += [] if measured is None else [measured]
    return next((one for one in known if _signed(one)), known[0] if known else size)


def _signed(size: Size) -> bool:
    """Whether an interval tells at least on which side of zero a size lies."""
    return size.low > 0.0 or size.high < 0.0


def _longest(these: NDArray[np.bool_]) -> tuple[int, int]:
    """Return the longest run of ones: its first sample, and one past its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], these, [False]]).astype(np.int8)))
    runs = edges.reshape(-1, 2)
    first, last = runs[int((runs[:, 1] - runs[:, 0]).argmax())]
    return int(first), int(last)


def _mean_error(table: ChannelTable, fault: Fault, config: Config) -> Size | None:
    """Mean error of the first suspect over the span, with its Student interval.

    It is measured against the plain least-squares prediction from the sound channels, in the
    readings as logged: the offset that the others agree on is the truth it can be held against.
    """
    channel = min(fault.suspects)
    span = slice(fault.start, fault.stop)
    absent = np.flatnonzero(table.valid[span].mean(axis=0) < FEWEST_PRESENT)
    row = leave_one_out(table.axes, sorted(fault.removed.union(absent.tolist())))[channel]
    if not bool(np.isfinite(row).all()):
        return None
    needed = np.flatnonzero(row != 0.0)
    complete = table.valid[span, needed].all(axis=1)
    looks = windowed_mean((table.rate_rad_s[span, needed][complete] @ row[needed])[None, :, None])
    if not looks.dof[0] > 0.0:
        return None
    half_width = float(looks.half_width(np.ones(1), config.windows.confidence)[0])
    return size_of(float(looks.mean[0, 0]), half_width, "bias", config)


def _sides(
    table: ChannelTable,
    evidence: Sequence[Evidence],
    by_detector: Mapping[str, Sequence[Accusation]],
    fault: Fault,
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Name the detectors that accuse the suspects meanwhile, and those that looked and do not.

    A detector that could not test them, or that accuses channels of another block, is on neither
    side.
    """
    suspects = sorted(fault.suspects)
    agree, dissent = [], []
    for name, said in by_detector.items():
        named = [a.suspects for a in said if a.start < fault.stop and a.stop > fault.start]
        looked = any(
            item.tested[meanwhile][:, suspects].any()
            for item in evidence
            if item.detector == name
            and (
                meanwhile := (item.windows.start < fault.stop) & (item.windows.stop > fault.start)
            ).any()
        )
        if any(them & fault.suspects for them in named):
            agree.append(name)
        elif looked and (
            not named or any(_same_block(table, them, fault.suspects) for them in named)
        ):
            dissent.append(name)
    return tuple(agree), tuple(dissent)


def _same_block(table: ChannelTable, one: frozenset[int], other: frozenset[int]) -> bool:
    from fdilog.maths.geometry import blocks

    return any(set(block) & one and set(block) & other for block in blocks(table.axes))
