"""From a log to an analysis: the one call behind the command line, the campaign and notebooks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config, load_config
from fdilog.decision.autopilot import (
    MOST_NOTES,
    STREAMS,
    AutopilotNote,
    autopilot_notes,
    with_quotes,
)
from fdilog.decision.judgement import Judgement, judge
from fdilog.errors import NoGyroError, UsageError
from fdilog.finding import Evidence, Finding, Status, Verdict
from fdilog.recording import Problem, Recording
from fdilog.sources.assembly import Assembly, assemble
from fdilog.sources.gyros import SourceInfo
from fdilog.sources.offsets import ClockOffset
from fdilog.sources.temperature import temperature_notes, temperatures
from fdilog.table import ChannelTable
from fdilog.windows.calibration import Calibration, with_notes

if TYPE_CHECKING:
    import pandas as pd

    from fdilog.decision.revealed import Revealed

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
class Isolability:
    """What the redundancy can tell: channels that are compared, and those told apart by nothing."""

    detectable: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, kw_only=True)
class Part:
    """Which part of a flight to look at; times are seconds of flight time."""

    start_s: float = -np.inf
    end_s: float = np.inf
    armed: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Analysis:
    """The result of analysing one log; ``to_json`` gives the stable form of it.

    Parameters
    ----------
    status, sigma_rad_s
        For each channel of the table, in its order.
    evidence
        Every detector's answers, for pictures and for whoever wants to know why.
    part
        Which part of the flight was asked for.
    autopilot
        What the autopilot said of its gyros itself; nothing follows from it.
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
    part: Part = field(default_factory=Part)
    autopilot: tuple[AutopilotNote, ...] = ()

    @cached_property
    def revealed(self) -> tuple[Revealed, ...]:
        """What a constant error would have had to be to show, for each group of channels."""
        from fdilog.decision.revealed import revealed

        return revealed(self.table, self.evidence)

    def to_json(self) -> str:
        """Return the JSON result, the same bytes for the same log and configuration."""
        return self._render("json")

    def to_markdown(self) -> str:
        """Return the Markdown report."""
        return self._render("md")

    def to_text(self, *, brief: bool = False) -> str:
        """Return the summary for a terminal: some lines, or just one."""
        from fdilog.registry import plugin

        text: str = plugin("reports", "text").render(self, brief=brief)
        return text

    def to_html(self, path: str | Path) -> None:
        """Write the self-contained HTML report."""
        Path(path).write_text(self._render("html"), encoding="utf-8", newline="\n")

    def findings_frame(self) -> pd.DataFrame:
        """Return the findings as a pandas table, one row each; see `fdilog.frames`."""
        from fdilog.frames import findings_frame

        return findings_frame(self)

    def channels_frame(self) -> pd.DataFrame:
        """Return the channels as a pandas table, one row each, indexed by name."""
        from fdilog.frames import channels_frame

        return channels_frame(self)

    def plot(self) -> Any:
        """Return the linked plots; a notebook shows them, ``.save(path)`` writes a page."""
        from fdilog.registry import plugin

        return plugin("reports", "notebook").figure(self)

    def _repr_html_(self) -> str:
        """Show verdict, findings and timeline in a notebook."""
        return self._render("notebook")

    def __repr__(self) -> str:
        findings = f"{len(self.findings)} finding{'s' * (len(self.findings) != 1)}"
        return f"<Analysis of {self.log.path!r}: {self.verdict}, {findings}>"

    def _render(self, name: str) -> str:
        from fdilog.registry import plugin

        text: str = plugin("reports", name).render(self)
        return text


def analyse(
    path: str | Path,
    config: Config | str | Path | None = None,
    *,
    part: Part | None = None,
    progress: Callable[[str], None] | None = None,
) -> Analysis:
    """Analyse one log: which gyro failed, when, by how much, and how sure that is.

    Parameters
    ----------
    config
        Settings, or the path of a TOML file that holds them.
    part
        Which part of the flight; all of it by default.
    progress
        Called with the name of each step as it begins.

    Raises
    ------
    UnreadableLogError
        If nothing can be read from the log.
    NoGyroError
        If it holds no gyro, or none in the part asked for.
    UsageError
        If the configuration does not fit the log.
    """
    from fdilog.opening import opened
    from fdilog.registry import read_opened

    settings = config if isinstance(config, Config) else Config()
    if isinstance(config, str | Path):
        settings = load_config(Path(config))
    say = progress or (lambda _: None)
    say("reading")
    with opened(Path(path)) as log:
        recording = read_opened(log, _asked_for(settings))
        sha256 = log.sha256
    return analyse_recording(recording, settings, sha256=sha256, part=part, progress=say)


def analyse_recording(
    recording: Recording,
    config: Config,
    *,
    sha256: str = "",
    part: Part | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Analysis:
    """Analyse what a reader found; see `analyse`."""
    progress("choosing gyros")
    part = part or Part()
    assembly = assemble(recording, config)
    table = _part_of(assembly, recording, part)
    judged = judge(table, config, progress, assembly.witness, assembly.shocks)
    judged, notes = _held_against_model(
        judged, recording, table, config, zero_ns=assembly.zero_ns, progress=progress
    )
    completeness = _completeness(recording, assembly, notes)
    calibration = judged.calibration
    if not any(finding.kind == "mounting" for finding in judged.findings):
        measured = temperatures(recording, assembly.sources, assembly.zero_ns)
        warmth = temperature_notes(judged.table, measured, config.windows.confidence)
        calibration = with_notes(calibration, warmth)
    quoted = autopilot_notes(
        recording,
        assembly.zero_ns,
        (float(table.time_s[0]), float(table.time_s[-1])),
        [source.name for source in assembly.sources if source.used],
    )
    return Analysis(
        log=_log_info(recording, assembly, sha256),
        completeness=completeness,
        sources=assembly.sources,
        table=table,
        status=judged.status,
        sigma_rad_s=tuple(_sigma(table, channel) for channel in range(len(table.channels))),
        clocks=assembly.clocks,
        calibration=calibration,
        isolability=_isolability(table),
        verdict=_verdict(table, judged.status, whole=completeness.whole),
        findings=with_quotes(judged.findings, quoted, recording),
        evidence=judged.evidence,
        config=config,
        part=part,
        autopilot=quoted[:MOST_NOTES],
    )


def _asked_for(config: Config) -> list[str]:
    """List the streams that the configuration names, and those of the autopilot's own opinion."""
    from fdilog.sources.signals import streams_of

    named = (*config.observer.outputs, *config.observer.inputs)
    return [*(source.topic for source in config.sources.gyro), *streams_of(named), *STREAMS]


def _held_against_model(
    judged: Judgement,
    recording: Recording,
    table: ChannelTable,
    config: Config,
    *,
    zero_ns: int,
    progress: Callable[[str], None],
) -> tuple[Judgement, list[str]]:
    """Add what a model of the vehicle says, with what a reader should know of it."""
    from fdilog.decision.modelled import with_model
    from fdilog.sources.signals import find_signals

    named = dict.fromkeys((*config.observer.outputs, *config.observer.inputs))
    beside = [name for name in named if name not in table.names]
    signals, complaints = find_signals(recording, beside, zero_ns)
    if complaints:
        return judged, [f"observer: not asked: {'; '.join(complaints)}"]
    return with_model(judged, table, signals, config, progress)


def _part_of(assembly: Assembly, recording: Recording, part: Part) -> ChannelTable:
    table = assembly.table
    keep = (table.time_s >= part.start_s) & (table.time_s <= part.end_s)
    if part.armed:
        if recording.armed is None:
            raise UsageError(f"{recording.path}: the log does not say when it was armed")
        keep &= _armed(table.time_s, assembly.zero_ns, recording.armed)
    if bool(keep.all()):
        return table
    if not bool(keep.any()):
        raise NoGyroError(
            f"{recording.path}: no gyro samples in the part asked for;"
            f" the log holds 0 to {table.duration_s:.3f} s"
        )
    return table.only(keep)


def _armed(
    time_s: NDArray[np.float64], zero_ns: int, spans_ns: Sequence[tuple[int, int]]
) -> NDArray[np.bool_]:
    armed = np.zeros(len(time_s), bool)
    for start, end in spans_ns:
        armed |= (time_s >= (start - zero_ns) / 1e9) & (time_s <= (end - zero_ns) / 1e9)
    return armed


def _completeness(
    recording: Recording, assembly: Assembly, notes: Sequence[str] = ()
) -> Completeness:
    said = (Problem(what=note, note=True) for note in notes)
    problems = (*recording.problems, *assembly.problems, *said)
    losses = [problem for problem in problems if not problem.note]
    return Completeness(
        whole=not losses,
        bytes_lost=sum(problem.bytes_lost or 0 for problem in losses),
        seconds_lost=float(sum(problem.seconds_lost or 0.0 for problem in losses)),
        problems=problems,
    )


def _log_info(recording: Recording, assembly: Assembly, sha256: str) -> LogInfo:
    start_utc = None
    if recording.utc_at_zero_ns is not None:
        seconds = (recording.utc_at_zero_ns + assembly.zero_ns) / 1e9
        try:
            moment = datetime.fromtimestamp(seconds, UTC)
            start_utc = moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
        except (OverflowError, ValueError, OSError):
            start_utc = None  # a stamp beyond any calendar is no date
    return LogInfo(
        path=recording.path,
        format=recording.format,
        bytes=recording.bytes,
        sha256=sha256,
        start_utc=start_utc,
        duration_s=assembly.table.duration_s,
        vehicle=dict(recording.vehicle) if recording.vehicle else None,
    )


def _isolability(table: ChannelTable) -> Isolability:
    from fdilog.maths.geometry import detectable, isolability_groups

    names = table.names
    compared = detectable(table.axes)
    # A derived channel is no suspect, so what only it is confused with is isolated.
    gyros = {k for k, channel in enumerate(table.channels) if not channel.derived}
    groups = [sorted(gyros & set(group)) for group in isolability_groups(table.axes)]
    return Isolability(
        detectable=tuple(names[k] for k in sorted(gyros) if compared[k]),
        groups=tuple(tuple(names[k] for k in group) for group in groups if len(group) > 1),
    )


def _verdict(table: ChannelTable, status: Sequence[Status], *, whole: bool) -> Verdict:
    from fdilog.decision.verdict import conclude

    gyros = [
        one for one, channel in zip(status, table.channels, strict=True) if not channel.derived
    ]
    return conclude(gyros, whole=whole)


def _sigma(table: ChannelTable, channel: int) -> float:
    """Noise of one channel: robust sigma of its steps, as white noise would give them. [rad/s]"""
    from fdilog.maths.noise import robust_sigma

    readings = table.rate_rad_s[table.valid[:, channel], channel]
    if len(readings) < 3:
        return float("nan")
    return float(robust_sigma(np.diff(readings)) / np.sqrt(2.0))
