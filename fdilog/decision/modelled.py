"""What a model of the vehicle adds to a judgement: findings of its own, or a voice to others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from fdilog.config import Config
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Size, Status
from fdilog.sources.signals import Signal
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, spans

if TYPE_CHECKING:
    from fdilog.decision.judgement import Judgement


def with_model(
    judged: Judgement,
    table: ChannelTable,
    signals: Mapping[str, Signal],
    config: Config,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Judgement, list[str]]:
    """Ask the detectors that hold sensors against a model, and add what they say.

    What they accuse is a finding of its own unless the gyros have found it already: then the
    finding names the detector among those that agree. Where a gyro was compared with others and
    these bound its error elsewhere, they are believed and the model is not. It changes no
    comparison of the gyros, and nobody is healthy on its word.

    Returns
    -------
    judgement, notes
        What is concluded, and what a reader should know of the answers.
    """
    from fdilog.registry import detectors, plugins

    names = config.detectors.use or sorted(plugins("detectors"))
    chosen = [(name, one) for name, one in detectors(names) if one.stage == "model"]
    if not chosen:
        return judged, []
    windows = spans(table, np.array([0]), np.array([len(table.time_s)]))
    survey = Survey(table=table, windows=windows, config=config, signals=signals)
    evidence: list[Evidence] = []
    notes = []
    for name, detector in chosen:
        progress(name)
        found = detector.detect(survey)
        if not found and name in config.detectors.use:
            notes.append(f"{name}: not asked: the configuration gives it no model")
        evidence.extend(found)
    notes += [item.note for item in evidence if item.note]
    findings, added = list(judged.findings), []
    for item in evidence:
        for row, finding in _findings(table, item):
            if _contradicted(judged.evidence, item, row):
                notes.append(
                    f"{item.detector}: not believed from {finding.start_s:.1f} to"
                    f" {finding.end_s:.1f} s: what the gyros say of one another contradicts that"
                    f" {' or '.join(finding.suspects)} failed"
                )
                continue
            known = [k for k, other in enumerate(findings) if _same_fault(finding, other)]
            for k in known:
                agreed = dict.fromkeys((*findings[k].detectors, item.detector))
                findings[k] = replace(findings[k], detectors=tuple(agreed))
            if not known:
                added.append(finding)
    findings = sorted([*findings, *added], key=lambda f: (f.start_s, f.end_s, f.kind, f.suspects))
    return (
        replace(
            judged,
            findings=tuple(findings),
            status=_status(table, judged.status, added),
            evidence=(*judged.evidence, *evidence),
        ),
        notes,
    )


def _contradicted(judged: Sequence[Evidence], evidence: Evidence, row: int) -> bool:
    """Tell whether comparisons within the window bound the error of an accused gyro elsewhere.

    The longest windows that lie in it know it best; most of them must say so.
    """
    start, stop = evidence.windows.start[row], evidence.windows.stop[row]
    for channel in np.flatnonzero(evidence.accused[row]):
        low, high = evidence.low[row, channel], evidence.high[row, channel]
        said = []
        for item in judged:
            inside = (item.windows.start >= start) & (item.windows.stop <= stop)
            inside &= item.tested[:, channel]
            least, most = item.low[inside, channel], item.high[inside, channel]
            bounded = np.isfinite(least) & np.isfinite(most)
            if item.kind == evidence.kind and bounded.any():
                elsewhere = (least[bounded] > high) | (most[bounded] < low)
                said.append((item.windows.length_s, float(elsewhere.mean())))
        if said and max(said)[1] > 0.5:
            return True
    return False


def _findings(table: ChannelTable, evidence: Evidence) -> list[tuple[int, Finding]]:
    """Turn accusing windows into findings; a gyro's is sized, another sensor's only named."""
    findings = []
    for row in range(len(evidence.windows)):
        accused = np.flatnonzero(evidence.accused[row])
        beside = evidence.beside[row] if evidence.beside else ()
        if not len(accused) and not beside:
            continue
        gyros_only = not beside
        finding = Finding(
            kind=evidence.kind if gyros_only else "disagreement",
            suspects=(*(table.names[k] for k in accused), *beside),
            start_s=float(evidence.windows.start_s[row]),
            end_s=float(evidence.windows.end_s[row]),
            size=_size(evidence, row, int(accused[0])) if gyros_only else None,
            detectors=(evidence.detector,),
            detail=evidence.details[row] if evidence.details else "",
        )
        findings.append((row, finding))
    return findings


def _size(evidence: Evidence, row: int, channel: int) -> Size | None:
    low, high = float(evidence.low[row, channel]), float(evidence.high[row, channel])
    if evidence.kind not in SIZE_UNIT or not bool(np.isfinite([low, high]).all()):
        return None
    return Size(
        estimate=(low + high) / 2,
        low=low,
        high=high,
        confidence=evidence.confidence,
        unit=SIZE_UNIT[evidence.kind],
    )


def _same_fault(one: Finding, other: Finding) -> bool:
    meet = one.start_s <= other.end_s and other.start_s <= one.end_s
    return meet and set(one.suspects) == set(other.suspects)


def _status(
    table: ChannelTable, status: Sequence[Status], findings: Sequence[Finding]
) -> tuple[Status, ...]:
    alone = {f.suspects[0] for f in findings if len(f.suspects) == 1}
    shared = {name for f in findings if len(f.suspects) > 1 for name in f.suspects}
    said: list[Status] = []
    for name, own in zip(table.names, status, strict=True):
        if name in alone:
            said.append("failed")
        elif name in shared and own != "failed":
            said.append("suspect")
        else:
            said.append(own)
    return tuple(said)
