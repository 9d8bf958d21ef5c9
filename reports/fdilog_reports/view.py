"""The report view: an analysis as words and numbers ready to print, the same for every format.

All arithmetic, rounding and conversion of units ends here; templates only place what they are
given. Every string of a log's or a path's has passed through `words.shown`.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import PurePath

import fdilog
from fdilog.analysis import Analysis, Completeness
from fdilog_reports import provenance, sentences
from fdilog_reports.agreement import Agreement, agreement
from fdilog_reports.detectability import Detectability, detectability
from fdilog_reports.rows import (
    ChannelRow,
    ConstantRow,
    Fact,
    FindingRow,
    LossRow,
    QuoteRow,
    SourceRow,
    amount_lost,
    calibration_rows,
    channel_rows,
    clock_rows,
    finding_row,
    loss_row,
    quote_rows,
    source_row,
)
from fdilog_reports.words import (
    SHOWN_TEXT,
    figure,
    listed,
    several,
    shown,
    size_of,
    utc,
)

MOST_FINDINGS = 200
MOST_PROBLEMS = 500
"""Rows beyond these are in the JSON only; a report of a thousand pages is read by nobody."""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """The answer: a word, a sentence, and what else must be known to read it rightly."""

    state: str
    word: str
    sentence: str
    notes: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Everything a report prints, as strings."""

    title: str
    log_name: str
    version: str
    verdict: Verdict
    facts: tuple[Fact, ...]
    findings: tuple[FindingRow, ...]
    findings_left_out: str
    channels: tuple[ChannelRow, ...]
    half_width_title: str
    sources: tuple[SourceRow, ...]
    completeness: str
    losses: tuple[LossRow, ...]
    losses_left_out: str
    agreement: Agreement
    detectability: Detectability
    blind_spots: tuple[str, ...]
    limits: tuple[str, ...]
    slow: bool
    clocks: tuple[ConstantRow, ...]
    calibration: tuple[ConstantRow, ...]
    autopilot: tuple[QuoteRow, ...]
    provenance: tuple[Fact, ...]
    command: str
    configuration: str
    config_file: str
    json_name: str


def report(analysis: Analysis) -> Report:
    """Put an analysis into words and numbers."""
    log = analysis.log
    name = "standard input" if log.path == "-" else shown(PurePath(log.path).name or log.path)
    verdict = _verdict(analysis)
    findings = tuple(
        finding_row(number, finding, analysis)
        for number, finding in enumerate(analysis.findings[:MOST_FINDINGS], start=1)
    )
    problems = analysis.completeness.problems
    channels, half_width_title = channel_rows(analysis)
    return Report(
        title=f"{verdict.word}: {name}",
        log_name=name,
        version=fdilog.__version__,
        verdict=verdict,
        facts=_facts(analysis),
        findings=findings,
        findings_left_out=_left_out(len(analysis.findings) - len(findings), "finding"),
        channels=channels,
        half_width_title=half_width_title,
        sources=tuple(source_row(source) for source in analysis.sources),
        completeness=_completeness(analysis),
        losses=tuple(loss_row(problem) for problem in problems[:MOST_PROBLEMS]),
        losses_left_out=_left_out(len(problems) - MOST_PROBLEMS, "problem"),
        agreement=agreement(analysis),
        detectability=detectability(analysis),
        blind_spots=tuple(sentences.blind_spots(analysis)),
        limits=tuple(sentences.limits(analysis)),
        slow=sentences.is_slow(analysis),
        clocks=clock_rows(analysis),
        calibration=calibration_rows(analysis),
        autopilot=quote_rows(analysis),
        provenance=(
            Fact(label="Log", value=shown(log.path, SHOWN_TEXT)),
            Fact(label="SHA-256 of the log", value=shown(log.sha256, SHOWN_TEXT)),
            Fact(label="SHA-256 of the configuration", value=analysis.config.sha256),
            *(
                Fact(label=f"Vehicle: {shown(key)}", value=shown(value, SHOWN_TEXT))
                for key, value in (log.vehicle or {}).items()
            ),
            Fact(label="fdilog", value=fdilog.__version__),
            Fact(
                label="Detectors",
                value=", ".join(sorted({shown(e.detector) for e in analysis.evidence})) or "none",
            ),
        ),
        command=provenance.command(log.path, analysis.config, analysis.part),
        configuration=provenance.configuration(analysis.config),
        config_file=provenance.CONFIG_FILE,
        json_name=_json_name(log.path),
    )


def _left_out(number: int, noun: str) -> str:
    return f"{several(number, f'further {noun}')}: see the JSON result." if number > 0 else ""


def _json_name(path: str) -> str:
    stem = re.sub(r"[^A-Za-z0-9._-]+", "_", PurePath(path).name)[-SHOWN_TEXT // 4 :].lstrip(".")
    return f"{stem or 'log'}.fdilog.json"


def _verdict(analysis: Analysis) -> Verdict:
    notes = []
    lost = analysis.completeness
    if not lost.whole:
        notes.append(
            f"The log is not whole: {_loss(lost)}. What happened in the missing part is not known."
        )
    unseen = _never_compared(analysis)
    if unseen and analysis.verdict != "insufficient":
        notes.append(f"Never compared with anything: {listed(unseen)}.")
    return Verdict(
        state=analysis.verdict,
        word=sentences.VERDICT_WORD[analysis.verdict],
        sentence=sentences.verdict_sentence(analysis),
        notes=tuple(notes),
    )


def _facts(analysis: Analysis) -> tuple[Fact, ...]:
    log, table = analysis.log, analysis.table
    first = float(table.time_s[0]) if len(table.time_s) else 0.0
    gyros = [channel for channel in table.channels if not channel.derived]
    sources = list(dict.fromkeys(channel.source for channel in gyros))
    facts = [
        Fact(label="Analysed", value=_analysed(analysis)),
        Fact(label="Began", value=utc(log.start_utc, first) or shown(log.start_utc or "not known")),
        Fact(
            label="Gyros",
            value=f"{several(len(gyros), 'channel')} of {several(len(sources), 'source')}",
        ),
        Fact(label="Log", value=f"{shown(log.format)}, {size_of(log.bytes)}"),
        Fact(label="Missing", value=_missing(analysis)),
    ]
    if log.vehicle:
        facts.append(Fact(label="Vehicle", value=shown(next(iter(log.vehicle.values())))))
    return tuple(facts)


def _analysed(analysis: Analysis) -> str:
    table, whole = analysis.table, analysis.log.duration_s
    if not len(table.time_s):
        return "no sample"
    part = table.duration_s
    of = f" of {figure(whole, 5)} s" if whole - part > max(1.0, 0.01 * whole) else ""
    asked = _asked(analysis)
    return f"{figure(part, 5)} s{of}{asked}, {several(len(table.time_s), 'sample')}"


def _asked(analysis: Analysis) -> str:
    """Say which part of the flight was asked for."""
    part, words = analysis.part, []
    if math.isfinite(part.start_s):
        words.append(f"from {figure(part.start_s, 5)} s")
    if math.isfinite(part.end_s):
        words.append(f"to {figure(part.end_s, 5)} s")
    if part.armed:
        words.append("while armed")
    return f" ({' '.join(words)})" if words else ""


def _missing(analysis: Analysis) -> str:
    """Say in a few words what is not in the log or was not compared."""
    lost = analysis.completeness
    parts = [] if lost.whole else [_loss(lost)]
    gyros = sum(not channel.derived for channel in analysis.table.channels)
    unseen = _never_compared(analysis)
    if unseen:
        parts.append(f"never compared: {'all' if len(unseen) == gyros else listed(unseen)}")
    return "; ".join(parts) or "nothing, as far as the format can tell"


def _never_compared(analysis: Analysis) -> list[str]:
    """List the gyros that nothing was compared with, whatever they show of themselves."""
    compared = set(analysis.isolability.detectable)
    return [
        shown(channel.name)
        for channel, status in zip(analysis.table.channels, analysis.status, strict=True)
        if not channel.derived and (status == "insufficient" or channel.name not in compared)
    ]


def _completeness(analysis: Analysis) -> str:
    lost = analysis.completeness
    if lost.whole:
        return "The log is whole as far as its format can tell."
    losses = sum(not problem.note for problem in lost.problems)
    at = f" in {several(losses, 'place')}" if lost.bytes_lost or lost.seconds_lost else ""
    return f"The log is not whole: {_loss(lost)}{at}."


def _loss(lost: Completeness) -> str:
    """Say how much is lost; if that is no piece of the log, what is."""
    losses = [problem for problem in lost.problems if not problem.note]
    if lost.bytes_lost or lost.seconds_lost or not losses:
        return amount_lost(lost.bytes_lost, lost.seconds_lost)
    more = f", and {several(len(losses) - 1, 'more loss', 'more losses')}" if losses[1:] else ""
    return f"{shown(losses[0].what, SHOWN_TEXT)}{more}"
