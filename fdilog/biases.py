"""From comparative evidence to findings of bias, drift and scale, each over its own span."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.accusations import Accusation, Cluster, accusations, clusters, region
from fdilog.calibration import Calibration
from fdilog.config import Config
from fdilog.edges import Shape, best_ramp, best_scale, best_step
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Kind, Size
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


def _fault(table: ChannelTable, cluster: Cluster, config: Config) -> Fault:
    """Find the span of a fault, who is accused over just that span, and of what shape it is."""
    first, last = region(table, cluster.start, cluster.stop, cluster.longest_s / 2)
    trace = _trace(table, min(cluster.suspects), frozenset(), first, last)
    step = Shape(kind="bias", start=cluster.start, stop=cluster.stop, gain=0.0, size=0.0)
    if trace is not None:
        step = trace.placed(best_step(trace.residual))
    fault = Fault(suspects=cluster.suspects, shape=step, longest_s=cluster.longest_s)
    return _shaped(table, _tested(table, fault, config), config)


def scale_findings(
    table: ChannelTable,
    calibrated: ChannelTable,
    calibration: Sequence[Calibration],
    known: Sequence[Finding],
    config: Config,
) -> list[Finding]:
    """Find scale errors of a whole flight, which no window need show as a bias.

    The calibration leaves in what is beyond the scale tolerance. Of several sources of an axis the
    one that is off from their median alone is isolated; two are both suspects. The finding stands
    if a scale error explains the residual far better than a step, and its interval lies beyond the
    tolerance.
    """
    findings = []
    for axis in range(3):
        column = np.eye(3)[axis]
        columns = [
            k
            for k, c in enumerate(table.channels)
            if not c.derived and np.array_equal(c.axis, column)
        ]
        relative = {c.source: c.scale[axis] for c in calibration}
        scales = np.array([relative.get(table.channels[k].source, 1.0) for k in columns])
        if len(columns) < 2 or len(relative) < len(columns) - 1:
            continue
        off = np.abs(scales / np.median(scales) - 1.0) > config.tolerance.scale
        pair = len(columns) == 2 and abs(scales[1] / scales[0] - 1.0) > config.tolerance.scale
        suspects = frozenset(columns if pair else np.array(columns)[off].tolist())
        if not suspects or (len(suspects) > 1 and not pair):
            continue
        trace = _trace(calibrated, min(suspects), frozenset(), 0, len(table.time_s))
        names = {table.names[k] for k in suspects}
        if trace is None or any(names & set(finding.suspects) for finding in known):
            continue
        means = trace.averaged()
        shape = _other_shape(means, best_scale(means.residual, means.predicted))
        if shape is None:
            continue
        fault = Fault(suspects=suspects, shape=shape, longest_s=0.0)
        finding = _finding(table, fault, config)
        size = finding.size
        least = 0.0 if size is None else max(size.low - 1.0, 1.0 - size.high)
        if least > config.tolerance.scale:
            findings.append(replace(finding, detectors=("parity",)))
    return findings


def _shaped(table: ChannelTable, fault: Fault, config: Config) -> Fault:
    """Return the fault as a drift or a scale error where that explains far more than a step."""
    duration_s = float(table.time_s[fault.stop - 1] - table.time_s[fault.start])
    around = region(table, fault.start, fault.stop, max(duration_s, fault.longest_s))
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
        detail=_detail(names) if said is None else _testified(names, said),
    )


def _testified(names: tuple[str, ...], said: Statement) -> str:
    """Detail of a finding on which the witness was heard."""
    if said.named is None:
        return f"{_detail(names)}; {said.detail}"
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


def _detail(names: tuple[str, ...]) -> str:
    if len(names) == 1:
        return "reads off from what the other gyros that sense its axis agree on"
    return (
        f"{', '.join(names)} disagree and the redundancy of this log cannot tell which of them"
        f" failed; the size is {names[0]}'s error if it is the one"
    )
