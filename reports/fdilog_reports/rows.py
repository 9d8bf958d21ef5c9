"""The rows of the report's tables, as strings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from fdilog.analysis import Analysis
from fdilog.finding import SIZE_UNIT, Finding
from fdilog.recording import Problem
from fdilog.sources.gyros import SourceInfo
from fdilog_reports import sentences
from fdilog_reports.next_steps import next_step
from fdilog_reports.residuals import drawn_evidence, intervals
from fdilog_reports.size_bar import SizeBar, size_bar
from fdilog_reports.words import (
    DEG_PER_RAD,
    SHOWN_TEXT,
    between,
    count,
    figure,
    flight_time,
    listed,
    percent,
    rounded,
    shown,
    size_of,
    utc,
)

MOST_DETECTORS = 40
"""Names of detectors that a card holds."""


@dataclass(frozen=True, kw_only=True)
class Fact:
    """A label and what stands beside it."""

    label: str
    value: str


@dataclass(frozen=True, kw_only=True)
class FindingRow:
    """One finding; ``facts`` is everything known of it, the other fields what a table shows."""

    number: str
    anchor: str
    state: str
    sentence: str
    kind: str
    suspects: str
    when: str
    size: str
    interval: str
    bounds: str
    tolerance: str
    detectors: str
    dissent: str
    bar: SizeBar | None
    facts: tuple[Fact, ...]


@dataclass(frozen=True, kw_only=True)
class ChannelRow:
    """One channel of the table."""

    name: str
    status: str
    source: str
    axis: str
    rate: str
    samples: str
    noise: str
    half_width: str
    remark: str


@dataclass(frozen=True, kw_only=True)
class SourceRow:
    """A stream that was or was not used."""

    name: str
    topic: str
    used: str
    reason: str
    rate: str
    samples: str


@dataclass(frozen=True, kw_only=True)
class LossRow:
    """One problem of the log with its place."""

    what: str
    place: str
    sort: str
    lost: str


@dataclass(frozen=True, kw_only=True)
class ConstantRow:
    """A source's clock offset and its constant differences from the reference source."""

    source: str
    cells: tuple[str, ...]
    note: str


@dataclass(frozen=True, kw_only=True)
class QuoteRow:
    """One thing that the autopilot said of its gyros itself."""

    source: str
    gyro: str
    what: str
    when: str


def finding_row(number: int, finding: Finding, analysis: Analysis) -> FindingRow:
    """Put one finding into words and numbers."""
    flipped = sentences.negated(finding, analysis)
    size = sentences.printed_size(finding, flipped=flipped)
    any_suspect = finding.isolated or sentences.size_is_shared(finding, analysis)
    tolerance = _tolerance(finding, analysis)
    when = flight_time(finding.start_s, finding.end_s)
    interval = f"{size.interval} {size.unit} ({size.confidence})" if size else ""
    if finding.size and finding.size.low == finding.size.high:
        interval = "exact"
    # Impulses that are one finding are of many sizes.
    unsized = "of many" if finding.kind == "impulse" else "not bounded"
    facts = [
        Fact(label="What", value=sentences.KIND_NAME[finding.kind]),
        Fact(
            label="Failed" if finding.isolated else "Suspects",
            value=sentences.suspects(finding),
        ),
        Fact(label="When", value=when),
        Fact(
            label="Size" if any_suspect else f"Size, if {shown(finding.suspects[0])}",
            value=str(size or (unsized if finding.kind in SIZE_UNIT else "")),
        ),
        Fact(label="Interval", value=interval),
        Fact(label="Tolerance", value=tolerance),
        Fact(label="UTC", value=utc(analysis.log.start_utc, finding.start_s, finding.end_s)),
        Fact(label="Guaranteed", value=_guaranteed(finding, analysis)),
        Fact(label="Agree", value=_counted(finding.detectors)),
        Fact(label="Dissent", value=_counted(finding.dissent)),
        Fact(label="Witness", value=_witness(finding)),
        Fact(label="Detail", value=shown(finding.detail, SHOWN_TEXT)),
        Fact(label="Next", value=next_step(finding, analysis)),
    ]
    return FindingRow(
        number=str(number),
        anchor=f"finding-{number}",
        state="failed" if finding.isolated else "suspect",
        sentence=sentences.finding_sentence(finding, analysis),
        kind=sentences.KIND_NAME[finding.kind],
        suspects=sentences.suspects(finding),
        when=when,
        size=str(size) if size else "",
        interval=interval,
        bounds="" if size is None or interval == "exact" else f"{size.interval}; {size.confidence}",
        tolerance=tolerance,
        detectors=listed([shown(name) for name in finding.detectors]),
        dissent=listed([shown(name) for name in finding.dissent]),
        bar=size_bar(finding, analysis.config.tolerance, flipped=flipped),
        facts=tuple(fact for fact in facts if fact.value),
    )


def _counted(detectors: Sequence[str]) -> str:
    """Name all detectors, and say how many they are."""
    names = [shown(name) for name in detectors]
    return f"{len(names)}: {listed(names, limit=MOST_DETECTORS)}" if names else "none"


def _witness(finding: Finding) -> str:
    """Say who decided between suspects that the gyros alone could not tell apart."""
    if finding.witness:
        return f"{shown(finding.witness)} decided" if finding.isolated else shown(finding.witness)
    return "none was needed" if finding.isolated else "none could decide"


def _tolerance(finding: Finding, analysis: Analysis) -> str:
    """Print what a finding of this kind is held against, as configured."""
    tolerance = analysis.config.tolerance
    return {
        "bias": f"\u00b1{figure(tolerance.bias_deg_s)} deg/s",
        "drift": f"\u00b1{figure(tolerance.bias_deg_s)} deg/s in all",
        "impulse": f"\u00b1{figure(tolerance.impulse_deg_s)} deg/s",
        "scale": f"\u00b1{percent(tolerance.scale)}",
        "noise": f"{figure(tolerance.noise_factor)} times",
        "dropout": f"{figure(tolerance.dropout_s)} s",
    }.get(finding.kind, "")


def _guaranteed(finding: Finding, analysis: Analysis) -> str:
    if finding.guaranteed is None:
        return ""
    low, high = finding.guaranteed.low, finding.guaranteed.high
    ends = rounded(DEG_PER_RAD * low, DEG_PER_RAD * high, DEG_PER_RAD * (low + high) / 2.0)
    text = between(ends[0], ends[1])
    unit = "" if text == "unbounded" else " deg/s"
    bound = (
        "stated bound" if analysis.config.noise.bound_deg_s > 0 else "bound estimated from this log"
    )
    return f"{text}{unit} as long as the {bound} holds"


# --- channels, sources, losses ------------------------------------------------------------------


def channel_rows(analysis: Analysis) -> tuple[tuple[ChannelRow, ...], str]:
    """Rows of the channel table, and the title of its column of interval half-widths."""
    drawn = drawn_evidence(analysis)
    rows = []
    for column, channel in enumerate(analysis.table.channels):
        bars = intervals(drawn, column)
        sigma = analysis.sigma_rad_s[column]
        rows.append(
            ChannelRow(
                name=shown(channel.name),
                status=analysis.status[column],
                source=shown(channel.source),
                axis=" ".join(figure(component, 4) for component in channel.axis),
                rate=rate(channel.rate_hz),
                samples=count(channel.samples),
                noise=figure(DEG_PER_RAD * sigma),
                half_width=figure(DEG_PER_RAD * bars.median_half_width, 2) if bars else "none",
                remark="derived: a witness, never accused" if channel.derived else "",
            )
        )
    return tuple(rows), f"{figure(drawn.windows.length_s)} s" if drawn is not None else ""


def source_row(source: SourceInfo) -> SourceRow:
    """Say whether a stream was used, and why."""
    return SourceRow(
        name=shown(source.name),
        topic=shown(source.topic),
        used=("used, derived" if source.derived else "used") if source.used else "not used",
        reason=shown(source.reason, SHOWN_TEXT),
        rate=rate(source.rate_hz),
        samples=count(source.samples),
    )


def rate(rate_hz: float) -> str:
    """Print a rate of samples."""
    return f"{figure(rate_hz)} Hz" if rate_hz > 0 else "unknown"


def amount_lost(bytes_lost: int | None, seconds_lost: float | None) -> str:
    """Print how much a problem cost, as far as that is known."""
    parts = []
    if bytes_lost:
        parts.append(size_of(bytes_lost))
    if seconds_lost:
        parts.append(f"{figure(seconds_lost)} s")
    return f"{listed(parts)} lost" if parts else "how much was lost is not known"


def loss_row(problem: Problem) -> LossRow:
    """Say what was wrong, where, and what it cost."""
    place = "" if problem.offset is None else f"byte {count(problem.offset)}"
    unknown = "" if problem.note else "how much is not known"
    known = problem.bytes_lost or problem.seconds_lost
    return LossRow(
        sort="note" if problem.note else "loss",
        place=place,
        what=shown(problem.what, SHOWN_TEXT),
        lost=amount_lost(problem.bytes_lost, problem.seconds_lost).removesuffix(" lost")
        if known
        else unknown,
    )


def clock_rows(analysis: Analysis) -> tuple[ConstantRow, ...]:
    """Print clock offsets in milliseconds."""
    rows = []
    for clock in analysis.clocks:
        low, high, offset = rounded(1e3 * clock.low, 1e3 * clock.high, 1e3 * clock.offset_s)
        rows.append(
            ConstantRow(source=shown(clock.source), cells=(offset, between(low, high)), note="")
        )
    return tuple(rows)


def calibration_rows(analysis: Analysis) -> tuple[ConstantRow, ...]:
    """Print rotations in degrees and biases in degrees per second."""
    return tuple(
        ConstantRow(
            source=shown(constant.source),
            cells=(
                ", ".join(f"{angle:.2f}" for angle in constant.rotation_deg),
                ", ".join(f"{factor:.4f}" for factor in constant.scale),
                ", ".join(f"{DEG_PER_RAD * bias:.3f}" for bias in constant.bias_rad_s),
            ),
            note=shown(constant.note or "", SHOWN_TEXT),
        )
        for constant in analysis.calibration
    )


def quote_rows(analysis: Analysis) -> tuple[QuoteRow, ...]:
    """Quote the autopilot, in order of time."""
    return tuple(
        QuoteRow(
            source=shown(note.source),
            gyro=shown(note.gyro or ""),
            what=shown(note.what, SHOWN_TEXT),
            when=flight_time(note.start_s, note.end_s),
        )
        for note in analysis.autopilot
    )
