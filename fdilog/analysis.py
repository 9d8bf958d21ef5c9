"""From a log to an analysis: the one call behind the command line, the campaign and notebooks."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from fdilog.config import Config
from fdilog.finding import Evidence, Finding, Status, Verdict
from fdilog.recording import Problem
from fdilog.table import ChannelTable

SCHEMA = "fdilog/1"


@dataclass(frozen=True, kw_only=True)
class LogInfo:
    """Which file this is about."""

    path: str
    format: str
    bytes: int
    sha256: str
    start_utc: str | None
    duration_s: float
    vehicle: dict[str, str] | None


@dataclass(frozen=True, kw_only=True)
class Completeness:
    """What of the log was lost; ``whole`` only if nothing was, as far as its format can tell."""

    whole: bool
    bytes_lost: int
    seconds_lost: float
    problems: tuple[Problem, ...]


@dataclass(frozen=True, kw_only=True)
class SourceInfo:
    """A stream that could have been used as a gyro, and why it was or was not."""

    name: str
    topic: str
    used: bool
    reason: str
    rate_hz: float
    samples: int
    derived: bool


@dataclass(frozen=True, kw_only=True)
class ClockOffset:
    """By how much a source's stamps run late against the reference source. [s]"""

    source: str
    offset_s: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Constant differences of a source from the reference source."""

    source: str
    rotation_deg: tuple[float, float, float]
    scale: tuple[float, float, float]
    bias_rad_s: tuple[float, float, float]
    note: str | None = None


@dataclass(frozen=True, kw_only=True)
class Isolability:
    """What the redundancy can tell: channels that are compared, and those told apart by nothing."""

    detectable: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, kw_only=True, eq=False)
class Analysis:
    """The result of analysing one log; ``to_json`` gives the stable form of it.

    Parameters
    ----------
    status, sigma_rad_s
        For each channel of the table, in its order.
    evidence
        Every detector's answers, for pictures and for whoever wants to know why.
    """

    log: LogInfo
    completeness: Completeness
    sources: tuple[SourceInfo, ...]
    table: ChannelTable
    status: tuple[Status, ...]
    sigma_rad_s: tuple[float, ...]
    clocks: tuple[ClockOffset, ...]
    calibration: tuple[Calibration, ...]
    isolability: Isolability
    verdict: Verdict
    findings: tuple[Finding, ...]
    evidence: tuple[Evidence, ...]
    config: Config = field(default_factory=Config)

    def to_json(self) -> str:
        """Return the JSON result, the same bytes for the same log and configuration."""
        return self._render("json")

    def to_markdown(self) -> str:
        """Return the Markdown report."""
        return self._render("md")

    def to_html(self, path: str | Path) -> None:
        """Write the self-contained HTML report."""
        Path(path).write_text(self._render("html"), encoding="utf-8", newline="\n")

    def _render(self, name: str) -> str:
        from fdilog.registry import plugin

        text: str = plugin("reports", name).render(self)
        return text

