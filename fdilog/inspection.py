"""What is in a log, in plain text: streams, sources, gaps, problems, and the table."""

from __future__ import annotations

from collections.abc import Sequence

from fdilog.config import Config
from fdilog.errors import NoGyroError
from fdilog.recording import Problem, Recording
from fdilog.sources.assembly import Assembly, assemble

LONGEST_NAME = 60


def describe(recording: Recording, config: Config) -> str:
    """Describe a recording, and the table that analyse would make of it."""
    lines = [f"{recording.path}: {recording.format}, {recording.bytes:,} bytes"]
    for key, value in (recording.vehicle or {}).items():
        lines.append(f"  {_safe(key)}: {_safe(value)}")
    rows = [("stream", "records", "rate Hz", "clock")]
    rows += [
        (
            _safe(stream.name),
            f"{stream.count:,}",
            f"{stream.rate_hz:.2f}" if stream.rate_hz else "",
            _safe(stream.clock),
        )
        for stream in recording.streams
    ]
    lines += ["", *_columns(rows)]
    try:
        assembly = assemble(recording, config)
    except NoGyroError as error:
        lines += ["", f"no table: {_safe(str(error), 400)}"]
        lines += _problem_lines(recording.problems)
        return "\n".join(lines) + "\n"
    lines += ["", *_source_lines(assembly), "", *_table_lines(assembly)]
    lines += _problem_lines((*recording.problems, *assembly.problems))
    return "\n".join(lines) + "\n"


def _source_lines(assembly: Assembly) -> list[str]:
    rows = [("source", "from", "used", "samples", "why")]
    rows += [
        (
            _safe(source.name),
            _safe(source.topic),
            "yes" if source.used else "no",
            f"{source.samples:,}",
            _safe(source.reason, 120),
        )
        for source in assembly.sources
    ]
    return _columns(rows)


def _table_lines(assembly: Assembly) -> list[str]:
    table = assembly.table
    rate = f"{1.0 / table.period_s:.2f} Hz" if table.period_s else "one instant"
    rows = [("channel", "axis", "rate Hz", "samples", "valid", "step rad/s")]
    rows += [
        (
            _safe(channel.name),
            " ".join(f"{part:+.3f}" for part in channel.axis),
            f"{channel.rate_hz:.2f}",
            f"{channel.samples:,}",
            f"{table.valid[:, k].mean():.1%}",
            f"{channel.step_rad_s:.3g}",
        )
        for k, channel in enumerate(table.channels)
    ]
    head = f"table: {len(table.time_s):,} samples, {table.duration_s:.3f} s, {rate}"
    return [head, *_columns(rows)]


def _problem_lines(problems: tuple[Problem, ...]) -> list[str]:
    if not problems:
        return ["", "no problems"]
    lines = ["", "problems:"]
    for problem in problems:
        where = "" if problem.offset is None else f" at byte {problem.offset:,}"
        lost = "" if problem.bytes_lost is None else f", {problem.bytes_lost:,} bytes"
        time = "" if problem.seconds_lost is None else f", {problem.seconds_lost:.3f} s"
        kind = "note" if problem.note else "loss"
        lines.append(f"  {kind}{where}: {_safe(problem.what, 200)}{lost}{time}")
    return lines


def _columns(rows: Sequence[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]


def _safe(text: str, longest: int = LONGEST_NAME) -> str:
    """Make a string of the log harmless to a terminal, and no longer than it should be."""
    printable = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text[:2000])
    return printable if len(printable) <= longest else printable[: longest - 1] + "…"
