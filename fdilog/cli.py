"""The command line: thin; one line per known error, never a traceback."""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from fdilog import __version__
from fdilog.errors import FdilogError, UsageError, nearest

if TYPE_CHECKING:
    from fdilog.analysis import Analysis, Part
    from fdilog.config import Config


class _Commands(TyperGroup):
    """The commands; Ctrl-C and closed pipes reach `main`, which answers otherwise than Typer."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        with _past_typer():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        with _past_typer():
            return super().invoke(ctx)


@contextmanager
def _past_typer() -> Iterator[None]:
    try:
        yield
    except KeyboardInterrupt:
        raise _Interrupted from None
    except BrokenPipeError:
        raise _Unheard from None


class _Interrupted(BaseException):
    """Ctrl-C on its way past Typer."""


class _Unheard(BaseException):
    """A closed pipe on its way past Typer, whose exit code would say that a gyro failed."""


app = typer.Typer(
    name="fdilog",
    cls=_Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    help="Post-flight forensics: which gyro failed, when, by how much, and how sure that is.",
)


class ExitCode(IntEnum):
    """What the shell is told."""

    HEALTHY = 0
    FAILED = 1
    NOTHING = 2
    UNDECIDED = 3
    INTERRUPTED = 130
    UNHEARD = 141


MOST_SUMMARIES = 4
"""Logs of which each gets its summary on a terminal; of more, each gets a line."""

Logs = Annotated[
    list[Path],
    typer.Argument(metavar="LOG...", help="Logs; - is standard input.", readable=False),
]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE.toml", help="See `fdilog config`.")
]
Output = Annotated[Path, typer.Option("-o", "--output", metavar="FILE", help="File to write.")]


def main() -> None:
    """Run the command line."""
    warnings.showwarning = _warning
    for stream in (sys.stdout, sys.stderr):
        # A path may hold bytes that are no UTF-8; printing it must not fail.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    with _known_errors():
        app()


@contextmanager
def _known_errors() -> Iterator[None]:
    """Turn what a user can cause into one line and an exit code."""
    try:
        yield
    except FdilogError as error:
        _complain(str(error))
        raise SystemExit(ExitCode.NOTHING) from None
    except (KeyboardInterrupt, _Interrupted):
        _complain("interrupted")
        raise SystemExit(ExitCode.INTERRUPTED) from None
    except (BrokenPipeError, _Unheard):
        # Whoever read our output has gone: what a shell says of those that the signal ends.
        _let_go_of_output()
        raise SystemExit(ExitCode.UNHEARD) from None
    except OSError as error:
        _let_go_of_output()
        _complain(f"{error.filename or 'output'}: {(error.strerror or str(error)).lower()}")
        raise SystemExit(ExitCode.NOTHING) from None


def _let_go_of_output() -> None:
    """Send what is still to be written to standard output nowhere."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _complain(text: str) -> None:
    """Write one line to standard error, whatever the text holds."""
    _note(f"fdilog: {' '.join(text.split())}")


def _note(text: str) -> None:
    """Write a line to standard error."""
    from fdilog.escapes import visible

    typer.echo(visible(text), err=True)


def _print(text: str) -> None:
    """Write lines of text to standard output; JSON goes out as it is."""
    from fdilog.escapes import visible_lines

    typer.echo(visible_lines(text), nl=False)


def _warning(message: Warning | str, *_args: object, **_kwargs: object) -> None:
    _complain(f"warning: {message}")


@app.callback(invoke_without_command=True)
def _options(
    *,
    version: Annotated[bool, typer.Option("--version", help="Show the version and exit.")] = False,
) -> None:
    if version:
        typer.echo(f"fdilog {__version__}")
        raise typer.Exit


@app.command()
def analyse(
    logs: Logs,
    *,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for the report files."),
    ] = None,
    formats: Annotated[
        str, typer.Option("--format", metavar="html,md,json", help="Which reports; all with -o.")
    ] = "",
    pictures: Annotated[
        bool, typer.Option("--pictures", help="Pictures beside the Markdown, in NAME_files.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="JSON on standard output, one object a line.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("-q", "--quiet", help="One line per log, no progress.")
    ] = False,
    config: ConfigFile = None,
    geometry: Annotated[
        str, typer.Option(metavar="NAME|FILE", help="How the gyros point; see the guide.")
    ] = "",
    detectors: Annotated[
        str, typer.Option(metavar="a,b,c", help="Methods to ask; see `fdilog detectors`.")
    ] = "",
    tolerance: Annotated[
        float | None, typer.Option(metavar="DEG_S", help="Gyro error that is a failure. [deg/s]")
    ] = None,
    from_s: Annotated[
        float | None, typer.Option("--from", metavar="T", help="From this flight time on. [s]")
    ] = None,
    to_s: Annotated[
        float | None, typer.Option("--to", metavar="T", help="Up to this flight time. [s]")
    ] = None,
    armed: Annotated[bool, typer.Option("--armed", help="Only what was flown armed.")] = False,
) -> None:
    """Say which gyro failed, when, by how much, and how sure that is.

    Exit code: 0 healthy, 1 a gyro failed, 3 undecided or nothing to compare with, 2 no log could
    be analysed.
    """
    settings = _settings(config, geometry, detectors, tolerance)
    part = _part(from_s, to_s, armed=armed)
    names = _report_names(formats, output, pictures=pictures)
    taken: set[str] = set()
    codes = []
    for number, log in enumerate(logs, start=1):
        try:
            place = f"{number} of {len(logs)}: " if len(logs) > 1 else ""
            with _progress(log, place, shown=not quiet) as step:
                analysis = _analysed(log, settings, part, step)
        except FdilogError as error:
            codes.append(ExitCode.NOTHING)
            _complain(str(error))
            if as_json:
                typer.echo(_error_json(log, error))
            continue
        if as_json:
            typer.echo(analysis.to_json(), nl=False)
        else:
            _summarise(analysis, brief=quiet, place=number, of=len(logs))
        if output is not None:
            for path in _write_reports(analysis, log, output, names, taken, pictures=pictures):
                if not quiet:
                    _note(f"wrote {path}")
        codes.append(_exit_code(analysis))
    raise typer.Exit(_joint_exit_code(codes))


app.command("analyze", hidden=True)(analyse)


def _analysed(log: Path, config: Config, part: Part, step: object) -> Analysis:
    from fdilog.analysis import analyse as analyse_log

    try:
        return analyse_log(log, config, part=part, progress=step)  # type: ignore[arg-type]
    except UsageError as error:
        if str(log) in str(error):
            raise
        raise UsageError(f"{log}: {error}") from None
    except MemoryError:
        raise FdilogError(
            f"{log}: not enough memory; look at a part of it with --from, --to"
        ) from None


def _summarise(analysis: Analysis, *, brief: bool, place: int, of: int) -> None:
    """Print lines on a pipe; on a terminal a summary, or a line a log where they are many."""
    if brief or not sys.stdout.isatty():
        _print(analysis.to_text(brief=brief))
        return
    if of > MOST_SUMMARIES:
        _print(analysis.to_text(brief=True))
        return
    from rich.console import Console

    from fdilog.registry import plugin

    # Width, colours and NO_COLOR are Rich's to find out.
    console = Console(highlight=False, markup=False, emoji=False)
    if place > 1:
        console.print()
    plugin("reports", "text").show(analysis, console)


def _settings(
    config: Path | None, geometry: str, detectors: str, tolerance: float | None
) -> Config:
    """Merge the configuration file and the options that go before it."""
    from fdilog.config import Config, load_config, read_geometry
    from fdilog.registry import plugins

    settings = load_config(config) if config else Config()
    if geometry:
        settings = read_geometry(settings, geometry)
    if detectors:
        settings = settings.replace("detectors", use=tuple(_names(detectors)))
    for name in settings.detectors.use:
        if name not in plugins("detectors"):
            raise UsageError(f"no detector '{name}'{nearest(name, list(plugins('detectors')))}")
    if tolerance is not None:
        if not 0.0 < tolerance < float("inf"):
            raise UsageError(f"--tolerance {tolerance:g} must be above zero")
        settings = settings.replace("tolerance", bias_deg_s=tolerance)
    return settings


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def _part(from_s: float | None, to_s: float | None, *, armed: bool) -> Part:
    from fdilog.analysis import Part

    start = -float("inf") if from_s is None else from_s
    end = float("inf") if to_s is None else to_s
    if not start < end:
        raise UsageError(f"--from {start:g} is not before --to {end:g}")
    return Part(start_s=start, end_s=end, armed=armed)


def _report_names(formats: str, output: Path | None, *, pictures: bool = False) -> list[str]:
    from fdilog.registry import plugin

    if formats and output is None:
        raise UsageError("--format needs a folder: add -o DIR")
    if output is not None and output.exists() and not output.is_dir():
        raise UsageError(f"{output}: is a file, not a folder")
    names = _names(formats) or ["html", "md", "json"]
    for name in names:
        plugin("reports", name)
    if pictures and (output is None or "md" not in names):
        raise UsageError("--pictures are those of the Markdown report: add -o DIR and its format")
    return names


def _write_reports(
    analysis: Analysis,
    log: Path,
    folder: Path,
    names: list[str],
    taken: set[str],
    *,
    pictures: bool,
) -> Iterator[Path]:
    """Write one file per format, named after the log; two logs of one name get a number."""
    from fdilog.registry import plugin

    stem = "stdin" if str(log) == "-" else log.stem or log.name
    number = 1
    unique = stem
    while unique.lower() in taken:
        number += 1
        unique = f"{stem}-{number}"
    taken.add(unique.lower())
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name in names:
            report = plugin("reports", name)
            path = folder / f"{unique}{report.suffix}"
            if pictures and hasattr(report, "render_illustrated"):
                beside = folder / f"{unique}_files"
                text, drawn = report.render_illustrated(analysis, beside.name)
                beside.mkdir(exist_ok=True)
                for file, picture in drawn.items():
                    (beside / file).write_text(picture, encoding="utf-8", newline="\n")
            else:
                text = report.render(analysis)
            path.write_text(text, encoding="utf-8", newline="\n")
            yield path
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise FdilogError(f"{error.filename or folder}: cannot write: {reason}") from None


def _error_json(log: Path, error: FdilogError) -> str:
    from fdilog.analysis import SCHEMA

    # ASCII only: a path may hold bytes that are no UTF-8.
    return json.dumps(
        {"schema": SCHEMA, "log": {"path": str(log)}, "error": str(error), "verdict": None},
        separators=(",", ":"),
    )


def _exit_code(analysis: Analysis) -> ExitCode:
    return {
        "healthy": ExitCode.HEALTHY,
        "failed": ExitCode.FAILED,
        "undecided": ExitCode.UNDECIDED,
        "insufficient": ExitCode.UNDECIDED,
    }[analysis.verdict]


def _joint_exit_code(codes: list[ExitCode]) -> ExitCode:
    """Join the codes of several logs by the contract's rule; that of one log is its own."""
    if all(code is ExitCode.NOTHING for code in codes):
        return ExitCode.NOTHING
    if ExitCode.FAILED in codes:
        return ExitCode.FAILED
    return ExitCode.HEALTHY if set(codes) == {ExitCode.HEALTHY} else ExitCode.UNDECIDED


@contextmanager
def _progress(log: Path, place: str = "", *, shown: bool) -> Iterator[object]:
    """Show the present step on a terminal; on a pipe there is nobody to look."""
    if not (shown and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.text import Text

    from fdilog.escapes import visible

    console = Console(stderr=True)
    name = Text(f"{place}{visible(log.name)}", no_wrap=True, overflow="ellipsis")
    with console.status(name) as status:
        yield lambda step: status.update(Text.assemble(name, ": ", visible(step)))


@app.command()
def inspect(logs: Logs, *, config: ConfigFile = None) -> None:
    """List streams, gyro sources, gaps and problems, and the table that analyse would build."""
    from fdilog.inspection import describe
    from fdilog.registry import read

    settings = _settings(config, "", "", None)
    codes = []
    for log in logs:
        try:
            recording = read(log, [source.topic for source in settings.sources.gyro])
            _print(describe(recording, settings))
            codes.append(ExitCode.HEALTHY)
        except UsageError:
            raise
        except FdilogError as error:
            _complain(str(error))
            codes.append(ExitCode.NOTHING)
    raise typer.Exit(_joint_exit_code(codes))


@app.command()
def export(
    log: Annotated[Path, typer.Argument(metavar="LOG")],
    *,
    output: Output,
    config: ConfigFile = None,
    geometry: Annotated[str, typer.Option(metavar="NAME|FILE")] = "",
) -> None:
    """Write the channel table as .csv, .npz or .parquet, or the gyros as a log of another format.

    The suffix of the file decides. All but .npz can be analysed.
    """
    from fdilog import export as exporting
    from fdilog.registry import read

    settings = _settings(config, geometry, "", None)
    recording = read(log, [source.topic for source in settings.sources.gyro])
    exporting.export(recording, output, settings)


@app.command("config")
def show_config() -> None:
    """Print the default configuration, with a reason on every key."""
    from fdilog.config import default_toml

    typer.echo(default_toml(), nl=False)


@app.command("detectors")
def list_detectors() -> None:
    """List the installed detectors."""
    _list_plugins("detectors")


@app.command("readers")
def list_readers() -> None:
    """List the installed readers and the files they know."""
    _list_plugins("readers")


def _list_plugins(group: str) -> None:
    from fdilog.registry import plugins

    found = plugins(group)
    width = max((len(name) for name in found), default=0)
    for name, loaded in found.items():
        suffixes = " ".join(getattr(loaded, "suffixes", ()))
        typer.echo(f"{name:<{width}}  {loaded.description}{f' ({suffixes})' if suffixes else ''}")


@app.command()
def simulate(
    *,
    output: Output,
    duration_s: Annotated[float, typer.Option("--duration", help="Of the flight. [s]")] = 100.0,
    rate_hz: Annotated[
        float, typer.Option("--rate", help="At which gyros are logged. [Hz]")
    ] = 50.0,
    imus: Annotated[
        int | None, typer.Option(metavar="N", help="How many IMUs; 3 of three axes by default.")
    ] = None,
    geometry: Annotated[
        str, typer.Option(metavar="NAME", help="A unit with skewed gyros, such as matasov.")
    ] = "aligned-triads",
    faults: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            metavar="kind:channel:start:end[:size]",
            help="What fails, in flight time [s]; size in deg/s, deg/s per second, or a factor."
            " May be given again.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same flight.")] = 0,
    attitude: Annotated[
        bool, typer.Option("--attitude/--no-attitude", help="Log the autopilot's attitude as well.")
    ] = True,
) -> None:
    """Write a synthetic flight, with faults or without, and FILE.truth.json beside it.

    The suffix of FILE decides the format.
    """
    from fdilog.experiments.simulate import simulate as fly
    from fdilog.experiments.truth import write_truth
    from fdilog.experiments.typed_fault import parsed_fault
    from fdilog.writing import write

    flight = fly(
        duration_s,
        rate_hz,
        geometry=geometry,
        sources=imus,
        faults=[parsed_fault(text) for text in faults or ()],
        seed=seed,
    )
    write(flight.recording(attitude=attitude), output)
    truth = write_truth(output, {"log": {"path": str(output)}, **flight.truth()})
    _note(f"wrote {output}")
    _note(f"wrote {truth}")


@app.command()
def inject(
    log: Annotated[Path, typer.Argument(metavar="LOG")],
    *,
    output: Output,
    kind: Annotated[
        str,
        typer.Option(
            "--fault",
            metavar="KIND",
            help="bias, drift, scale, noise, impulse, saturated, stuck, dead, dropout or mounting.",
        ),
    ],
    channel: Annotated[
        str, typer.Option(metavar="NAME", help="Such as imu1.y; a source will do for a dropout.")
    ],
    start_s: Annotated[float, typer.Option("--start", metavar="T", help="Flight time. [s]")] = 0.0,
    end_s: Annotated[
        float, typer.Option("--end", metavar="T", help="Flight time; the flight's end. [s]")
    ] = float("inf"),
    size: Annotated[
        float | None,
        typer.Option(
            help="In deg/s (bias, impulse, saturated), deg/s per second (drift), a factor, or deg"
            " (mounting; without it the axis is inverted)."
        ),
    ] = None,
    count: Annotated[int, typer.Option(help="How many impulses, spread evenly.")] = 1,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise that is added.")] = 0,
    config: ConfigFile = None,
) -> None:
    """Write a copy of a log with a known fault in it, and FILE.truth.json beside it.

    In a DataFlash copy of a DataFlash log every byte that the fault does not touch stays as it is;
    else the copy holds one stream of each gyro, under the same names.
    """
    from fdilog.experiments.injection import inject as put
    from fdilog.experiments.truth import injected_truth, write_truth
    from fdilog.experiments.typed_fault import typed_fault
    from fdilog.registry import read
    from fdilog.sources.assembly import channel_table
    from fdilog.writing import write_injected

    settings = _settings(config, "", "", None)
    fault = typed_fault(kind, channel, start_s, end_s, size=size, count=count)
    recording = read(log, [source.topic for source in settings.sources.gyro])
    injection = put(recording, [fault], seed=seed, config=settings)
    truth = injected_truth(injection, channel_table(recording, settings))
    write_injected(injection, log, output)
    beside = write_truth(output, {"log": {"path": str(output), "made_from": str(log)}, **truth})
    _note(f"wrote {output}")
    _note(f"wrote {beside}")


@app.command()
def sensitivity(
    log: Annotated[Path, typer.Argument(metavar="LOG")],
    *,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=".md, .txt, .json or .svg."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
    kinds: Annotated[str, typer.Option(metavar="a,b,c", help="Which kinds; all by default.")] = "",
    channels: Annotated[str, typer.Option(metavar="a,b,c", help="Which channels; all.")] = "",
    duration_s: Annotated[float, typer.Option("--duration", help="Of a fault. [s]")] = 20.0,
    trials: Annotated[int, typer.Option(min=1, help="At how many starts each is tried.")] = 2,
    seed: Annotated[int, typer.Option(min=0, help="Of the starts and of added noise.")] = 0,
    jobs: Annotated[
        int, typer.Option("-j", "--jobs", min=0, help="Processes; 0: one a processor.")
    ] = 0,
    config: ConfigFile = None,
    geometry: Annotated[str, typer.Option(metavar="NAME|FILE")] = "",
) -> None:
    """Say how large a fault of each kind this log would have shown, per channel.

    Known faults are put into the flight in memory, and the smallest one that is found is sought. It
    takes a minute or two; name channels and kinds to be quicker.
    """
    import os

    from fdilog.experiments import sensitivity_report as report
    from fdilog.experiments.sensitivity import sensitivity as seek
    from fdilog.registry import read

    if output is not None:
        report.checked_format(output)
    settings = _settings(config, geometry, "", None)
    recording = read(log, [source.topic for source in settings.sources.gyro])
    with _progress(log, shown=True) as step:
        seen = seek(
            recording,
            settings,
            kinds=_names(kinds),
            channels=_names(channels),
            duration_s=duration_s,
            trials=trials,
            seed=seed,
            jobs=jobs or os.cpu_count() or 1,
            progress=lambda done, of: step(f"{done} of {of}") if callable(step) else None,
        )
    if output is not None:
        report.write_sensitivity(seen, output)
        _note(f"wrote {output}")
    if as_json:
        typer.echo(report.as_json(seen), nl=False)
    elif output is None:
        _print(report.in_words(seen))


@app.command()
def compare(
    before: Annotated[Path, typer.Argument(metavar="A.json")],
    after: Annotated[Path, typer.Argument(metavar="B.json")],
    *,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Say what appeared, vanished and changed between two results of analyse.

    Exit code: 0 nothing, 1 something, 2 a result could not be read.
    """
    from fdilog import comparison

    seen = comparison.compare(comparison.load_result(before), comparison.load_result(after))
    if as_json:
        typer.echo(comparison.as_json(seen), nl=False)
    else:
        _print(comparison.in_words(seen))
    raise typer.Exit(int(bool(seen.differences)))


@app.command()
def reproduce(
    tables: Annotated[
        list[str] | None,
        typer.Argument(metavar="[larin|triads|matasov|observer]...", show_default=False),
    ] = None,
    *,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the random draws.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON on standard output.")] = False,
) -> None:
    """Compute the papers' tables again: printed value, ours, difference, agreement.

    Exit code: 0 all printed values agree, 1 some do not.
    """
    from fdilog import reproduce as papers
    from fdilog.reproduce import report

    for name in tables or ():
        if name not in papers.TABLES:
            raise UsageError(f"no table '{name}'{nearest(name, list(papers.TABLES))}")
    drawn = papers.SEED if seed is None else seed
    rows = {name: papers.reproduce(name, drawn) for name in tables or papers.TABLES}
    text = report.as_json(rows, drawn) if as_json else report.in_words(rows, drawn)
    typer.echo(text, nl=False)
    raise typer.Exit(int(not report.all_agree(rows)))


@app.command()
def audit(
    targets: Annotated[
        list[str],
        typer.Argument(metavar="DIR|GLOB|LOG|URL...", help="Where the logs of the campaign are."),
    ],
    *,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="OUT", help="Folder for results and reports.")
    ],
    jobs: Annotated[
        int, typer.Option("-j", "--jobs", min=0, metavar="N", help="Workers; 0: one a core.")
    ] = 0,
    cluster: Annotated[
        str, typer.Option(metavar="ADDRESS", help="A Dask scheduler: tcp://host:8786.")
    ] = "",
    timeout: Annotated[
        float, typer.Option(min=0.0, metavar="S", help="What one log may take; 0: no limit. [s]")
    ] = 600.0,
    memory: Annotated[
        float | None,
        typer.Option(
            min=0.0, metavar="GB", help="What one worker may take; default: its share; 0: no limit."
        ),
    ] = None,
    fresh: Annotated[bool, typer.Option("--fresh", help="Do logs again that are done.")] = False,
    follow: Annotated[
        bool, typer.Option("--follow", help="Go on looking for new logs, until Ctrl-C.")
    ] = False,
    formats: Annotated[
        str, typer.Option("--format", metavar="html,md,json", help="Which reports of each log.")
    ] = "html,md,json",
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="No progress.")] = False,
    config: ConfigFile = None,
    geometry: Annotated[str, typer.Option(metavar="NAME|FILE")] = "",
    detectors: Annotated[str, typer.Option(metavar="a,b,c")] = "",
    tolerance: Annotated[float | None, typer.Option(metavar="DEG_S")] = None,
) -> None:
    """Analyse every log of a campaign, and say which vehicles and sensors fail or get worse.

    What was done before is not done again. Exit code: 0 all healthy, 1 a gyro failed, 3 some log
    was undecided or could not be analysed, 2 none could.
    """
    from fdilog.campaign.audit import Settings
    from fdilog.campaign.audit import audit as audit_campaign
    from fdilog.campaign.progress import shown_progress, summary_lines

    settings = Settings(
        config=_settings(config, geometry, detectors, tolerance),
        jobs=jobs,
        cluster=cluster,
        timeout_s=timeout,
        memory_bytes=None if memory is None else int(memory * 1e9),
        fresh=fresh,
        formats=tuple(_report_names(formats, output)),
    )
    endless = (lambda: True) if follow else None
    try:
        with shown_progress(quiet=quiet) as progress:
            campaign = audit_campaign(targets, output, settings, progress, follow=endless)
    except KeyboardInterrupt:
        _complain("interrupted; what was done is kept, the same command goes on from here")
        raise typer.Exit(ExitCode.INTERRUPTED) from None
    for line in summary_lines(campaign, output):
        typer.echo(line)
    by_state = {
        "healthy": ExitCode.HEALTHY,
        "failed": ExitCode.FAILED,
        "not analysed": ExitCode.NOTHING,
    }
    states = [state for state, number in campaign.counts.items() if number]
    raise typer.Exit(
        _joint_exit_code([by_state.get(state, ExitCode.UNDECIDED) for state in states])
    )
