"""Which detectors agree with which finding, which dissent, and how often each accused at all."""

from __future__ import annotations

from dataclasses import dataclass

from fdilog.analysis import Analysis
from fdilog_reports.words import SHOWN_TEXT, count, several, shown

MOST_COLUMNS = 12
"""Findings that stand beside one another; more do not fit on a screen."""


@dataclass(frozen=True, kw_only=True)
class DetectorRow:
    """One detector: how much it looked at, how often it accused, and its answer to each finding.

    An answer is "agrees", "dissents" or, where it could not or did not look, "silent".
    """

    name: str
    description: str
    looked: str
    accused: str
    answers: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """All detectors against all findings."""

    findings: tuple[str, ...]
    rows: tuple[DetectorRow, ...]
    left_out: str


def agreement(analysis: Analysis) -> Agreement:
    """Lay the detectors out against the findings."""
    findings = analysis.findings[:MOST_COLUMNS]
    names = {item.detector for item in analysis.evidence}
    names |= {name for f in analysis.findings for name in (*f.detectors, *f.dissent)}
    left_out = len(analysis.findings) - len(findings)
    return Agreement(
        findings=tuple(str(number) for number in range(1, len(findings) + 1)),
        rows=tuple(
            DetectorRow(
                name=shown(name),
                description=shown(_description(name), SHOWN_TEXT),
                looked=_windows(analysis, name, accused=False),
                accused=_windows(analysis, name, accused=True),
                answers=tuple(
                    "agrees"
                    if name in finding.detectors
                    else "dissents"
                    if name in finding.dissent
                    else "silent"
                    for finding in findings
                ),
            )
            for name in sorted(names)
        ),
        left_out=f"{several(left_out, 'further finding')}: see the cards." if left_out > 0 else "",
    )


def _description(name: str) -> str:
    """Return what a detector says of itself; nothing of one that is not installed here."""
    from fdilog.registry import plugins

    return str(getattr(plugins("detectors").get(name), "description", ""))


def _windows(analysis: Analysis, name: str, *, accused: bool) -> str:
    """Count the windows, of all lengths, that a detector tested or accused somebody in."""
    items = [item for item in analysis.evidence if item.detector == name]
    marks = [item.accused > 0 if accused else item.tested for item in items]
    return count(sum(int(mark.any(axis=1).sum()) for mark in marks))
