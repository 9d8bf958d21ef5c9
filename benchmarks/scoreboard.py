"""What is found of faults put into recorded flights, and what is found that nobody put there.

python benchmarks/scoreboard.py                          # three trials of each case on each log
python benchmarks/scoreboard.py --trials 10 --kinds bias,noise
python benchmarks/scoreboard.py --details trials.jsonl   # one line for every trial

The logs are those of FDILOG_REAL_LOGS (default ../shared/logs) that last a minute or longer and
hold two gyro sources or more, or one and an attitude. Each trial draws channel, start and sign from
a seed of its own, so that any one of them can be repeated alone. Only detectors that can make a
finding are asked; those that merely agree or dissent change none of these counts.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small products: threads only wait for one another

import argparse
import json
import sys
import warnings
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.errors import FdilogError
from fdilog.experiments.faults import SIZE_UNITS, Fault, FaultKind
from fdilog.experiments.injection import inject
from fdilog.finding import Finding, Kind
from fdilog.maths.geometry import leave_one_out
from fdilog.recording import Recording
from fdilog.registry import plugins, read
from fdilog.table import ChannelTable
from fdilog.text_table import text_table
from fdilog.windows.slopes import scale_over

ROOT = Path(__file__).parent.parent
SUFFIXES = {".bin", ".tlog", ".ulg", ".bag", ".mcap", ".db3"}
CONFIG = Config().replace("detectors", use=("parity", "impulse", "dropout", "flatline", "noise"))
SHORTEST_FLIGHT_S = 60.0
# Logged more slowly than this, a flight shows its manoeuvres but not its vibration.
SLOW_HZ = 10.0
# Faults keep this far from the ends of the log, and from what its untouched form already shows.
MARGIN_S = 5.0
# A fault of fewer readings is nothing to look for.
FEWEST_PERIODS = 4.0
# A bias that is shorter may be fewer readings than a window needs.
BRIEF_S = 0.3
# A start that is further off than this is listed among the failures.
LATE_S = 2.0
# Not to be counted as false: one IMU really comes loose, one gyro really is dead (see the folder's
# README).
REAL_FAULTS = ("copter_3imu_vibration_crash.bin", "rover_dead_gyro.bin")


@dataclass(frozen=True)
class Case:
    """A kind of fault, its size in degrees where it is an angle, and how long it lasts."""

    kind: FaultKind
    size: float | None
    duration_s: float

    @property
    def name(self) -> str:
        """What a table calls it."""
        unit = {"rad/s": " deg/s", "rad/s^2": " deg/s/s", "1": " times"}
        size = "" if self.size is None else f" {self.size:g}{unit[SIZE_UNITS[self.kind]]}"
        return f"{self.kind}{size}{f', {self.duration_s:g} s' if self.duration_s else ''}"

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What it may rightly be called: too few readings for a window are an impulse."""
        brief = self.kind == "bias" and self.duration_s < BRIEF_S
        return ("bias", "impulse") if brief else (self.kind,)


CASES = (
    *(Case("bias", size, 20.0) for size in (1.5, 2.0, 3.0, 5.0, 50.0)),
    *(Case("bias", size, 0.5) for size in (50.0, 200.0)),
    Case("bias", 50.0, 0.2),
    Case("drift", 0.2, 20.0),
    Case("scale", 1.2, 20.0),
    Case("noise", 5.0, 20.0),
    Case("impulse", 20.0, 0.0),
    Case("impulse", 60.0, 0.0),
    Case("stuck", None, 20.0),
    Case("dead", None, 20.0),
    Case("dropout", None, 1.0),
)


@dataclass(frozen=True)
class Trial:
    """One fault in one log and what came of it.

    Parameters
    ----------
    effect_deg_s
        Root mean square of the change of the readings that the fault changes.
    found, right_kind, alone
        Whether a new finding names the channel in the fault's span; with its kind; alone.
    others
        New findings that name only channels without a fault.
    start_error_s
        Start of the first right finding less that of the fault.
    size, low, high
        Size that the finding should hold [SI], the untouched log's own offset included, and its
        interval; None if nothing of the right kind was found, or it gives none.
    """

    log: str
    group: str
    case: str
    seed: tuple[int, ...]
    channel: str
    start_s: float
    effect_deg_s: float
    found: bool
    right_kind: bool
    alone: bool
    kinds: tuple[str, ...]
    others: tuple[str, ...]
    start_error_s: float | None
    size: float | None
    low: float | None
    high: float | None

    @property
    def covered(self) -> bool | None:
        """Whether the interval holds the truth; None where there is none."""
        if self.size is None or self.low is None or self.high is None:
            return None
        return self.low <= self.size <= self.high


def logs(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.suffix in SUFFIXES)


@cache
def opened(path: Path) -> tuple[Recording, Analysis] | None:
    """Read a log and analyse it untouched; None if it is none of ours."""
    try:
        recording = read(path)
        untouched = analyse_recording(recording, CONFIG)
    except FdilogError:
        return None
    table = untouched.table
    sources = {channel.source for channel in table.channels}
    sound = any(one != "insufficient" for one in untouched.status)
    enough = table.duration_s >= SHORTEST_FLIGHT_S and len(sources) >= 2 and sound
    return (recording, untouched) if enough else None


def group(table: ChannelTable) -> str:
    """Name the logs in which the same can be hoped for."""
    if table.period_s > 1.0 / SLOW_HZ:
        return "logged below 10 Hz"
    sources = {channel.source for channel in table.channels if not channel.derived}
    if len(sources) == 1:
        return "one gyro an axis, and an attitude"
    return "two gyros an axis" if len(sources) == 2 else "three gyros an axis"


def try_log(path: Path, cases: Sequence[Case], trials: int, seed: int) -> list[Trial]:
    """Run all trials of some cases on one log."""
    pair = opened(path)
    if pair is None:
        return []
    found = []
    for case in cases:
        for trial in range(trials):
            key = (seed, zlib.crc32(path.name.encode()), zlib.crc32(case.name.encode()), trial)
            one = attempt(*pair, case, path.name, key)
            if one is not None:
                found.append(one)
    return found


def attempt(
    recording: Recording, untouched: Analysis, case: Case, name: str, key: tuple[int, ...]
) -> Trial | None:
    """Put one fault into a flight, analyse it, and hold the findings against the truth."""
    rng = np.random.default_rng(key)
    table = untouched.table
    fault = drawn(rng, table, untouched.findings, case)
    if fault is None:
        return None
    changed = inject(recording, [fault], seed=key[-1]).recording
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        analysis = analyse_recording(changed, CONFIG)
    new = [f for f in analysis.findings if not any(alike(f, old) for old in untouched.findings)]
    concerned = {c.name for c in table.channels if fault.channel in (c.name, c.source)}
    mine = [
        finding
        for finding in new
        if concerned & set(finding.suspects)
        and finding.start_s <= fault.end_s + table.period_s
        and finding.end_s >= fault.start_s - table.period_s
    ]
    right = [finding for finding in mine if finding.kind in case.kinds]
    measured = next((f for f in right if f.size is not None), None)
    sized = None if measured is None else measured.size
    return Trial(
        log=name,
        group=group(table),
        case=case.name,
        seed=key,
        channel=fault.channel,
        start_s=fault.start_s,
        effect_deg_s=effect(table, analysis.table, fault),
        found=bool(mine),
        right_kind=bool(right),
        alone=bool(mine) and all(set(finding.suspects) <= concerned for finding in mine),
        kinds=tuple(finding.kind for finding in mine),
        others=tuple(
            f"{f.kind} {'|'.join(f.suspects)} {f.start_s:.1f}-{f.end_s:.1f}"
            for f in new
            if not concerned & set(f.suspects)
        ),
        start_error_s=min(f.start_s for f in mine) - fault.start_s if mine else None,
        size=truth(table, fault, measured),
        low=None if sized is None else sized.low,
        high=None if sized is None else sized.high,
    )


def drawn(
    rng: np.random.Generator, table: ChannelTable, findings: Iterable[Finding], case: Case
) -> Fault | None:
    """Draw channel, start and sign; the span is recorded whole and shows nothing by itself."""
    first, last = float(table.time_s[0]) + MARGIN_S, float(table.time_s[-1]) - MARGIN_S
    gyros = np.array([not channel.derived for channel in table.channels])
    own = [channel for channel in table.channels if not channel.derived]
    if case.kind == "dropout" and len({channel.source for channel in own}) == 1:
        return None  # of a single source, it is a hole of the log
    if case.duration_s and case.duration_s < FEWEST_PERIODS / min(c.rate_hz for c in own):
        return None
    for _ in range(100):
        channel = own[rng.integers(len(own))]
        start_s = float(rng.uniform(first, last - case.duration_s))
        size = None
        if case.size is not None:
            unit = SIZE_UNITS[case.kind]
            signed = case.size * float(rng.choice([-1.0, 1.0]))
            size = float(np.radians(signed)) if unit.startswith("rad") else case.size
        column = table.names.index(channel.name)
        rows = np.flatnonzero(table.valid[:, column] & (table.time_s >= start_s))
        if not len(rows):
            continue
        # The first reading that is touched is where the fault begins.
        start_s = float(table.time_s[rows[0]])
        # A single reading is one of the channel's own, which may be stamped a little later.
        end_s = start_s + (case.duration_s or 1.5 / channel.rate_hz)
        inside = (table.time_s >= start_s) & (table.time_s <= end_s)
        gaps = np.diff(table.time_s[inside])
        whole = bool(table.valid[np.ix_(inside, gyros)].all())
        whole &= bool((gaps < CONFIG.tolerance.dropout_s).all())
        if not whole and table.period_s < CONFIG.tolerance.dropout_s / 2:
            continue
        if any(f.start_s - MARGIN_S < end_s and f.end_s + MARGIN_S > start_s for f in findings):
            continue
        return Fault(
            kind=case.kind,
            channel=channel.source if case.kind == "dropout" else channel.name,
            start_s=start_s,
            end_s=end_s,
            size=size,
        )
    return None


def alike(one: Finding, other: Finding) -> bool:
    together = one.start_s <= other.end_s and other.start_s <= one.end_s
    return together and one.kind == other.kind and bool(set(one.suspects) & set(other.suspects))


def effect(before: ChannelTable, after: ChannelTable, fault: Fault) -> float:
    """Root mean square of what the fault changes where it changes anything. [deg/s]"""
    if fault.kind == "dropout" or len(before.time_s) != len(after.time_s):
        return float("nan")
    column = before.names.index(fault.channel)
    apart = (after.gyros.rate_rad_s - before.gyros.rate_rad_s)[:, column]
    changed = np.nan_to_num(apart) != 0.0
    return float(np.degrees(np.sqrt((apart[changed] ** 2).mean()))) if changed.any() else 0.0


def truth(table: ChannelTable, fault: Fault, finding: Finding | None) -> float | None:
    """Size that the finding should hold; it is that of its first suspect. [SI]"""
    if finding is None:
        return None
    first = fault.kind == "dropout" or finding.suspects[0] == fault.channel
    size = own_truth(table, fault)
    if first or size is None:
        return size
    return 1.0 / size if fault.kind == "scale" else -size


def own_truth(table: ChannelTable, fault: Fault) -> float | None:
    """Size of the fault: a bias adds to the channel's own offset over that span. [SI]"""
    if fault.kind == "dropout":
        return fault.end_s - fault.start_s
    if fault.kind == "scale":
        # A channel's own scale error over that span multiplies it, as far as the flight shows it.
        first, last = np.searchsorted(table.time_s, [fault.start_s, fault.end_s])
        span = (int(first), int(last) + 1)
        own = scale_over(table.gyros, table.gyros.names.index(fault.channel), span, CONFIG)
        return (fault.size or 1.0) * (1.0 + (0.0 if own is None else float(own.slope[0])))
    if fault.kind != "bias":
        # What a multiple of noise is relative to is another gyro's, and not known here.
        return fault.size if fault.kind in ("drift", "impulse") else None
    derived = [k for k, channel in enumerate(table.channels) if channel.derived]
    if len({channel.source for channel in table.channels}) == 2:
        derived = []  # nothing else checks a single source
    row = leave_one_out(table.axes, derived)[table.names.index(fault.channel)]
    inside = (table.time_s >= fault.start_s) & (table.time_s <= fault.end_s)
    own = table.rate_rad_s[inside][:, row != 0] @ row[row != 0]
    return (fault.size or 0.0) + float(np.nanmean(own))


def board(trials: Sequence[Trial]) -> str:
    """Lay out the counts, one table a group of logs."""
    parts = []
    for name in dict.fromkeys(trial.group for trial in trials):
        members = [trial for trial in trials if trial.group == name]
        files = len({trial.log for trial in members})
        rows = [
            counts(case, [trial for trial in members if trial.case == case])
            for case in dict.fromkeys(trial.case for trial in members)
        ]
        head = [
            "fault", "trials", "effect [deg/s]", "found", "right kind", "that channel alone",
            "another accused", "start error, median", "max [s]", "covered",
        ]  # fmt: skip
        parts.append(f"{name}: {files} logs\n\n{text_table(head, rows, markdown=True)}")
    return "\n".join(parts)


def counts(case: str, trials: Sequence[Trial]) -> list[str]:
    def share(told: Callable[[Trial], bool]) -> str:
        return str(sum(told(trial) for trial in trials))

    late = np.array([t.start_error_s for t in trials if t.start_error_s is not None])
    covered = [t.covered for t in trials if t.covered is not None]
    effects = [t.effect_deg_s for t in trials if np.isfinite(t.effect_deg_s)]
    return [
        case,
        str(len(trials)),
        f"{float(f'{np.median(effects):.2g}'):g}" if effects else "-",
        share(lambda t: t.found),
        share(lambda t: t.right_kind),
        share(lambda t: t.alone),
        share(lambda t: bool(t.others)),
        f"{np.median(np.abs(late)):.2f}" if len(late) else "-",
        f"{np.abs(late).max():.1f}" if len(late) else "-",
        f"{sum(covered)}/{len(covered)}" if covered else "-",
    ]


def failures(trials: Sequence[Trial]) -> Iterator[str]:
    """List what went wrong, so that it can be looked at one by one."""
    for trial in trials:
        wrong = []
        if not trial.found:
            wrong.append("missed")
        elif not trial.right_kind:
            wrong.append(f"taken for {', '.join(trial.kinds)}")
        if trial.others:
            wrong.append(f"accused: {', '.join(trial.others)}")
        if trial.covered is False:
            wrong.append(f"{trial.size:.4g} not in {trial.low:.4g} to {trial.high:.4g}")
        if trial.start_error_s is not None and abs(trial.start_error_s) > LATE_S:
            wrong.append(f"begins {trial.start_error_s:+.1f} s off")
        if wrong:
            yield (
                f"{trial.case}: {trial.log} {trial.channel} at {trial.start_s:.3f} s"
                f" (effect {trial.effect_deg_s:.2g} deg/s, seed {trial.seed}): {'; '.join(wrong)}"
            )


def untouched_lines(paths: Sequence[Path]) -> Iterator[str]:
    """Say what is found in the logs as they were recorded."""
    hours = false = 0.0
    for path in paths:
        pair = opened(path)
        if pair is None:
            continue
        analysis = pair[1]
        real = path.name in REAL_FAULTS
        if not real:
            hours += analysis.table.duration_s / 3600.0
            false += len(analysis.findings)
        for f in analysis.findings:
            yield (
                f"{path.name}: {f.kind} of {', '.join(f.suspects)},"
                f" {f.start_s:.1f} to {f.end_s:.1f} s{' (real)' if real else ''}"
            )
    yield f"untouched logs without a known fault: {false:g} findings in {hours:.2f} hours"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=3, help="of each case on each log")
    parser.add_argument("--kinds", default="", help="bias,noise: only these")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--logs", default="", help="only logs whose name holds this")
    parser.add_argument("--failures", action="store_true", help="list them, with their seeds")
    parser.add_argument("--details", type=Path, help="file for one line of JSON a trial")
    arguments = parser.parse_args()
    folder = Path(os.environ.get("FDILOG_REAL_LOGS", ROOT.parent / "shared" / "logs"))
    kinds = [kind for kind in arguments.kinds.split(",") if kind]
    cases = [case for case in CASES if not kinds or case.kind in kinds]
    plugins("readers")
    paths = [path for path in logs(folder) if arguments.logs in path.name and opened(path)]
    if not paths:
        sys.exit(
            f"{folder}: no log of a minute whose gyros are compared; FDILOG_REAL_LOGS names it"
        )
    with ProcessPoolExecutor(arguments.jobs) as pool:
        done = [
            pool.submit(try_log, path, [case], arguments.trials, arguments.seed)
            for path in paths
            for case in cases
        ]
        trials = [trial for future in done for trial in future.result()]
    order = {case.name: k for k, case in enumerate(cases)}
    trials.sort(key=lambda trial: (trial.group, order[trial.case]))
    if arguments.details:
        lines = [json.dumps(asdict(trial)) + "\n" for trial in trials]
        arguments.details.write_text("".join(lines), encoding="utf-8")
    print(board(trials))
    print("\n".join(untouched_lines(paths)))
    if arguments.failures:
        print("\n".join(["", *failures(trials)]))


if __name__ == "__main__":
    main()
