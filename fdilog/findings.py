"""From evidence to findings: accusations that belong together become one fault with one size."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.edges import Shape, best_ramp, best_scale, best_step
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Interval, Kind, Size
from fdilog.geometry import leave_one_out
from fdilog.isolation import compare, isolate
from fdilog.noise import windowed_mean
from fdilog.student import student_quantile
from fdilog.table import ChannelTable
from fdilog.testimony import Statement
from fdilog.windows import Moments, Survey, spans
from fdilog.witness import SOURCE

Hearing = Callable[[Sequence[int], tuple[int, int]], Statement]
"""Asks the witness which of some gyros was off over a span of samples."""

# Another shape than a step is believed if its likelihood is a thousand times larger, 2 ln 1000.
OTHER_SHAPE = 2.0 * np.log(1000.0)
# Fewer samples have no shape to speak of.
FEWEST_SHAPED = 20
# Manoeuvres take longer than this, vibration is faster. [s]
MANOEUVRE_S = 0.5
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
    open_accusations = next(iter(by_detector.values()), [])
    faults: list[Fault] = []
    while open_accusations:
        left: list[Accusation] = []
        for cluster in clusters(table.time_s, open_accusations):
            spanned = _fault(calibrated, cluster, config)
            faults.append(spanned)
            # What lies apart from the span of the fault is another fault.
            left.extend(
                member
                for member in cluster.members
                if member.stop <= spanned.start or member.start >= spanned.stop
            )
        open_accusations = left if len(left) < len(open_accusations) else []
    findings = []
    for joined in _joined_faults(calibrated, faults, config):
        fault = _heard(calibrated, joined, config, hearing)
        if fault is None:
            continue
        finding = _finding(table, fault, config)
        agree, dissent = _sides(table, evidence, by_detector, fault)
        findings.append(replace(finding, detectors=agree, dissent=dissent))
    return findings


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Suspects, and the shape and span in which they are off; ``removed`` failed meanwhile."""

    suspects: frozenset[int]
    shape: Shape
    longest_s: float
    removed: frozenset[int] = frozenset()
    testimony: Statement | None = None

    @property
    def start(self) -> int:
        """First sample."""
        return self.shape.start

    @property
    def stop(self) -> int:
        """One past the last sample."""
        return self.shape.stop


@dataclass(frozen=True, kw_only=True, eq=False)
class Trace:
    """What one channel is off by, sample by sample, against the others of its block.

    Parameters
    ----------
    rows, last : (n,) int64
        Samples of the table; of means, the first and the last that were averaged.
    time_s, residual, predicted : (n,)
        Their times [s], reading less prediction less the level outside the region [rad/s], and
        prediction [rad/s].
    """

    rows: NDArray[np.int64]
    last: NDArray[np.int64]
    time_s: NDArray[np.float64]
    residual: NDArray[np.float64]
    predicted: NDArray[np.float64]

    def placed(self, shape: Shape) -> Shape:
        """Return a shape found in this trace with its samples counted in the table."""
        start, stop = int(self.rows[shape.start]), int(self.last[shape.stop - 1]) + 1
        return replace(shape, start=start, stop=stop)

    def averaged(self) -> Trace:
        """Return means over `MANOEUVRE_S`, in which motion is left and vibration is not.

        The prediction holds the vibration of the gyros that it is made of, the residual the same
        with the opposite sign: sample by sample, that alone looks like a scale error.
        """
        bins = np.floor(self.time_s / MANOEUVRE_S)
        first = np.flatnonzero(np.concatenate([[True], np.diff(bins) > 0]))
        count = np.diff(np.append(first, len(bins)))
        return Trace(
            rows=self.rows[first],
            last=self.last[first + count - 1],
            time_s=np.add.reduceat(self.time_s, first) / count,
            residual=np.add.reduceat(self.residual, first) / count,
            predicted=np.add.reduceat(self.predicted, first) / count,
        )

    def noise_about(self, shape: Shape) -> tuple[float, float]:
        """Long-run noise variance per sample about a shape of this trace, and its dof."""
        inside = slice(shape.start, shape.stop)
        form = self.form(shape)
        looks = windowed_mean((self.residual[inside] - shape.size * form)[None, :, None])
        return float(looks.covariance[0, 0, 0]) * len(form), float(looks.dof[0])

    def form(self, shape: Shape) -> NDArray[np.float64]:
        """Shape of size one over its own span."""
        inside = slice(shape.start, shape.stop)
        forms = {"drift": self.time_s - self.time_s[shape.start], "scale": self.predicted}
        form: NDArray[np.float64] = forms.get(shape.kind, np.ones(len(self.time_s)))[inside]
        return form


def _trace(
    table: ChannelTable, channel: int, removed: frozenset[int], first: int, last: int
) -> Trace | None:
    """Trace one channel from the first sample up to the last, or nothing if it cannot be."""
    row = leave_one_out(table.axes, sorted(removed))[channel]
    if not bool(np.isfinite(row).all()):
        return None
    needed = np.flatnonzero(row != 0)
    complete = np.asarray(table.valid[:, needed].all(axis=1), bool)
    residual = np.full(len(complete), np.nan)
    residual[complete] = table.rate_rad_s[complete][:, needed] @ row[needed]
    inside = np.zeros(len(complete), bool)
    inside[first:last] = True
    rows = np.flatnonzero(complete & inside)
    if len(rows) < 3:
        return None
    outside = complete & ~inside
    # With little left outside, the usual level is not known and zero is what it should be.
    level = float(np.median(residual[outside])) if outside.sum() >= len(rows) / 4 else 0.0
    return Trace(
        rows=rows,
        last=rows,
        time_s=table.time_s[rows],
        residual=residual[rows] - level,
        predicted=table.rate_rad_s[rows, channel] - residual[rows],
    )


def _region(table: ChannelTable, start: int, stop: int, reach_s: float) -> tuple[int, int]:
    time_s = table.time_s
    first = int(np.searchsorted(time_s, time_s[start] - reach_s))
    return first, int(np.searchsorted(time_s, time_s[stop - 1] + reach_s, side="right"))


def _fault(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the span of a fault, who is accused over just that span, and of what shape it is."""
    first, last = _region(table, cluster.start, cluster.stop, cluster.longest_s / 2)
    trace = _trace(table, min(cluster.suspects), frozenset(), first, last)
    step = Shape(kind="bias", start=cluster.start, stop=cluster.stop, gain=0.0, size=0.0)
    if trace is not None:
        step = trace.placed(best_step(trace.residual))
    fault = Fault(suspects=cluster.suspects, shape=step, longest_s=cluster.longest_s)
    return _shaped(table, _tested(table, fault, config), config)


def _shaped(table: ChannelTable, fault: Fault, config: Config) -> Fault:
    """Return the fault as a drift or a scale error where that explains far more than a step."""
    duration_s = float(table.time_s[fault.stop - 1] - table.time_s[fault.start])
    around = _region(table, fault.start, fault.stop, max(duration_s, fault.longest_s))
    channel = min(fault.suspects)
    trace = _trace(table, channel, fault.removed, *around)
    if trace is None:
        return fault
    found = _other_shape(trace, best_ramp(trace.residual, trace.time_s))
    if found is None:
        # A scale error shows wherever the rate is high, not only where it was noticed.
        whole = _trace(table, channel, fault.removed, 0, len(table.time_s)) or trace
        whole = whole.averaged()
        scale = best_scale(whole.residual, whole.predicted)
        if abs(scale.size) > config.tolerance.scale:
            found = _other_shape(whole, scale)
    return fault if found is None else replace(fault, shape=found)


def _other_shape(trace: Trace, shape: Shape) -> Shape | None:
    """Return a shape, placed in the table, if it explains a trace far better than a step does."""
    if shape.stop - shape.start < FEWEST_SHAPED:
        return None
    noise, dof = trace.noise_about(shape)
    more = shape.gain - best_step(trace.residual).gain
    return trace.placed(shape) if dof > 0 and more > OTHER_SHAPE * noise else None


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


def _heard(
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
        return alone if fault.shape.kind == "bias" else _shaped(table, alone, config)
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
    return kept


def _finding(table: ChannelTable, fault: Fault, config: Config) -> Finding:
    names = tuple(table.names[channel] for channel in sorted(fault.suspects))
    said = fault.testimony
    measure = _size if fault.shape.kind == "bias" else _shaped_size
    return Finding(
        kind=fault.shape.kind,
        suspects=names,
        start_s=float(table.time_s[fault.start]),
        end_s=float(table.time_s[fault.stop - 1]),
        size=measure(table, fault, config),
        witness=SOURCE if said is not None and said.named is not None else None,
        detail=_detail(names, fault.shape.kind) if said is None else _testified(names, said),
    )


def _testified(names: tuple[str, ...], said: Statement) -> str:
    """Detail of a finding on which the witness was heard."""
    if said.named is None:
        return f"{_detail(names, 'bias')}; {said.detail}"
    return f"the attitude tells that it is the one that is off; {said.detail}"


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
    return _interval(
        float(measured.error[0, first]), float(measured.half_width[0, first]), "bias", config
    )


def _shaped_size(table: ChannelTable, fault: Fault, config: Config) -> Size | None:
    """Rate of drift or scale factor of the first suspect, with its Student interval."""
    trace = _trace(table, min(fault.suspects), fault.removed, fault.start, fault.stop)
    if trace is None:
        return None
    if fault.shape.kind == "scale":
        trace = trace.averaged()
    form = trace.form(replace(fault.shape, start=0, stop=len(trace.rows)))
    if fault.shape.kind == "drift":
        # A free level, since the onset is not known to the sample.
        form = form - form.mean()
    power = float((form**2).sum())
    if power <= 0.0:
        return None
    size = float((form * trace.residual).sum()) / power
    left = trace.residual - size * form
    looks = windowed_mean((left - left.mean())[None, :, None])
    if not looks.dof[0] > 0:
        return None
    noise = float(looks.covariance[0, 0, 0]) * len(form)
    quantile = float(student_quantile(looks.dof, config.windows.confidence)[0])
    factor = 1.0 if fault.shape.kind == "scale" else 0.0
    half_width = quantile * float(np.sqrt(noise / power))
    return _interval(factor + size, half_width, fault.shape.kind, config)


def _interval(estimate: float, half_width: float, kind: Kind, config: Config) -> Size:
    return Size(
        estimate=estimate,
        low=estimate - half_width,
        high=estimate + half_width,
        confidence=config.windows.confidence,
        unit=SIZE_UNIT[kind],
    )


def noise_findings(table: ChannelTable, evidence: Sequence[Evidence]) -> list[Finding]:
    """Turn evidence of excess noise into findings, their edges those of the noise itself."""
    from fdilog.detectors.impulse import DEVIATION_GAIN, deviations

    said = [accusation for item in evidence for accusation in accusations(item)]
    if not said:
        return []
    square = (deviations(table) / DEVIATION_GAIN) ** 2
    findings = []
    for cluster in clusters(table.time_s, said):
        channel = min(cluster.suspects)
        first, last = _region(table, cluster.start, cluster.stop, cluster.longest_s / 2)
        rows = first + np.flatnonzero(table.valid[first:last, channel])
        power = square[rows, channel]
        # A few readings of a crash must not hide that the noise began long before. Half the mean
        # of the region parts what is noisy from what is not.
        power = np.minimum(power, 3.0 * float(np.median(power)))
        span = best_step(power - float(power.mean()) / 2.0)
        start, stop = int(rows[span.start]), int(rows[span.stop - 1]) + 1
        findings.append(
            Finding(
                kind="noise",
                suspects=(table.names[channel],),
                start_s=float(table.time_s[start]),
                end_s=float(table.time_s[stop - 1]),
                size=_ratio(evidence, channel, start, stop),
                detectors=tuple(sorted({member.detector for member in cluster.members})),
                detail="noisier than the other gyros that sense its axis",
            )
        )
    return findings


def _ratio(evidence: Sequence[Evidence], channel: int, start: int, stop: int) -> Size:
    """Hull of the ratios in the longest windows that accuse, since noise changes in a flight."""
    longest = max(
        (item for item in evidence if item.accused[:, channel].any()),
        key=lambda item: item.windows.length_s,
    )
    rows = (longest.windows.start < stop) & (longest.windows.stop > start)
    rows &= longest.accused[:, channel] > 0
    rows = rows if rows.any() else longest.accused[:, channel] > 0
    low, high = longest.low[rows, channel], longest.high[rows, channel]
    return Size(
        estimate=float(np.median(np.sqrt(low * high))),
        low=float(low.min()),
        high=float(high.max()),
        confidence=longest.confidence,
        unit=SIZE_UNIT["noise"],
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
    from fdilog.geometry import blocks

    return any(set(block) & one and set(block) & other for block in blocks(table.axes))


_WORDS: dict[Kind, str] = {
    "impulse": "single readings far off, confirmed by no other gyro",
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
