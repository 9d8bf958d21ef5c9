"""What an audit costs beside the analyses themselves, and what a second worker brings.

python benchmarks/audit.py                 # 300 logs, then 1000 small ones: an hour
python benchmarks/audit.py --scale 0.1     # 30 and 100

Every figure is the median of rounds in which the ways of doing it take turns, on the clock and of
the processor: on a machine that others use, the latter says more of what is overhead. Every audit's
verdicts are held against those of the bare loop. Ends with 1 if one differs, or below a goal.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import resource
import shutil
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fdilog.experiments.faults import Fault
from fdilog.experiments.simulate import simulate
from fdilog.writing import Writer, write

ROUNDS = 3
DAMAGED = 0.1
SPEED_UP, OF_BARE, OVERHEAD_S = 1.7, 0.9, 0.050

LOOP = """
import json, sys
from pathlib import Path
import fdilog
from fdilog.errors import FdilogError
from fdilog.registry import plugin
reports = [plugin("reports", name) for name in sys.argv[2:]]
verdicts = {}
for path in sys.stdin.read().split("\\0"):
    try:
        analysis = fdilog.analyse(path)
    except FdilogError:
        verdicts[path] = None
        continue
    verdicts[path] = analysis.verdict
    for report in reports:
        target = Path(sys.argv[1]) / (Path(path).name + report.suffix)
        target.write_text(report.render(analysis), encoding="utf-8")
print(json.dumps(verdicts))
"""

Verdicts = dict[str, str | None]


def suffixes() -> list[str]:
    from fdilog.registry import plugins

    writers: dict[str, Writer] = plugins("writers")
    return sorted({writer.suffix for writer in writers.values()} - {".parquet"})


def generate(folder: Path, number: int, duration_s: float, *, damaged: float) -> list[Path]:
    """Write flights of three sources in every format that can be written, and damage some."""
    made = []
    kinds = suffixes()
    random = np.random.default_rng(1)
    for k in range(number):
        fault = Fault(kind="bias", channel="imu1.y", start_s=duration_s / 2, size=0.1)
        faults = [fault] if k % 7 == 0 else []
        path = folder / f"vehicle{k % 5}" / f"{k:04d}{kinds[k % len(kinds)]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        flight = simulate(duration_s, 25.0, sources=3, seed=k, faults=faults)
        write(flight.recording(), path)
        if path.is_file() and (k % 10) < 10 * damaged:
            damage(path, k // 10 % 5, random)
        made.append(path)
    return made


def damage(path: Path, how: int, random: np.random.Generator) -> None:
    """Empty a log, cut it, make a hole in it, or leave nothing but random bytes."""
    content = bytearray(path.read_bytes())
    at, hole = len(content) // 2, min(4096, len(content) // 4)
    if how == 0:
        content = bytearray()
    elif how == 1:
        del content[len(content) * 2 // 3 :]
    elif how == 2:
        content[at : at + hole] = bytes(hole)
    elif how == 3:
        content[at : at + hole] = random.bytes(hole)
    else:
        content = bytearray(random.bytes(len(content)))
    path.write_bytes(content)


def single_threaded() -> dict[str, str]:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    return {**os.environ, **dict.fromkeys(names, "1")}


def bare(logs: list[Path], processes: int, output: Path, *reports: str) -> Verdicts:
    """Loop over analyse in so many processes, each with its share of the logs."""
    output.mkdir()
    by_size = sorted(logs, key=lambda path: -path.stat().st_size)
    started = []
    for k in range(processes):
        process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", LOOP, str(output), *reports],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=single_threaded(),
            text=True,
        )
        if process.stdin is not None:
            process.stdin.write("\0".join(str(path) for path in by_size[k::processes]))
            process.stdin.close()
        started.append(process)
    verdicts: Verdicts = {}
    for process in started:
        if process.stdout is not None:
            verdicts |= json.loads(process.stdout.read())
        if process.wait():
            raise SystemExit("a bare loop failed")
    return verdicts


def audit(folder: Path, workers: int, output: Path) -> Verdicts:
    command = [sys.executable, "-m", "fdilog", "audit", str(folder), "-o", str(output)]
    done = subprocess.run(
        [*command, "-q", "-j", str(workers)], check=False, stdout=subprocess.DEVNULL
    )
    if done.returncode not in {0, 1, 3}:
        raise SystemExit(f"the audit ended with {done.returncode}")
    with sqlite3.connect(output / "audit.sqlite") as db:
        return dict(db.execute("SELECT path, verdict FROM flights").fetchall())


@dataclass(frozen=True)
class Seconds:
    """What a way took, on the clock and of the processor. [s]"""

    wall: float
    processor: float


Way = Callable[[Path], Verdicts]


def adopt_orphans() -> None:
    """Let the processes that an audit leaves to themselves count as ours. (Linux)"""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def _processor_s() -> float:
    with contextlib.suppress(ChildProcessError):
        while True:
            os.wait()
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def timed(way: Way, scratch: Path) -> tuple[Seconds, Verdicts]:
    output = scratch / "output"
    shutil.rmtree(output, ignore_errors=True)
    processor, wall = _processor_s(), time.perf_counter()
    verdicts = way(output)
    wall = time.perf_counter() - wall
    return Seconds(wall, _processor_s() - processor), verdicts


def in_turn(ways: dict[str, Way], scratch: Path, rounds: int) -> tuple[dict[str, Seconds], bool]:
    """Return the medians of some ways, and whether all came to the same verdicts."""
    taken: dict[str, list[Seconds]] = {name: [] for name in ways}
    answers: list[Verdicts] = []
    for _ in range(rounds):
        for name, way in ways.items():
            seconds, verdicts = timed(way, scratch)
            taken[name].append(seconds)
            answers.append(verdicts)
    same = all(answer == answers[0] for answer in answers)
    print(f"  {len(answers[0])} rows; verdicts {'are the same' if same else 'DIFFER'}")
    medians = {}
    for name, runs in taken.items():
        medians[name] = Seconds(
            statistics.median(run.wall for run in runs),
            statistics.median(run.processor for run in runs),
        )
        walls = " ".join(f"{run.wall:7.1f}" for run in runs)
        processors = " ".join(f"{run.processor:7.1f}" for run in runs)
        print(f"  {name:34} clock {walls} s   processor {processors} s", flush=True)
    return medians, same


def two_workers(scratch: Path, number: int, rounds: int) -> bool:
    """Say what a second worker brings, and hold the audit against two bare loops."""
    folder = scratch / "many"
    logs = generate(folder, number, 120.0, damaged=DAMAGED)
    print(f"{number} logs of two minutes ({', '.join(suffixes())}), a tenth damaged")
    took, same = in_turn(
        {
            "audit, one worker": lambda out: audit(folder, 1, out),
            "audit, two workers": lambda out: audit(folder, 2, out),
            "two bare loops, with reports": lambda out: bare(logs, 2, out, "html", "md", "json"),
            "two bare loops, analyse alone": lambda out: bare(logs, 2, out),
        },
        scratch,
        rounds,
    )
    one, two, full, alone = took.values()
    speed_up, of_bare = one.wall / two.wall, full.wall / two.wall
    print(f"  two workers against one: {speed_up:.2f} (at least {SPEED_UP} wanted)")
    print(
        f"  of what two bare loops reach: {of_bare:.0%} (at least {OF_BARE:.0%} wanted;"
        f" by processor {full.processor / two.processor:.0%});"
        f" of what they reach without writing reports: {alone.wall / two.wall:.0%}"
    )
    return same and speed_up >= SPEED_UP and of_bare >= OF_BARE


def small_logs(scratch: Path, number: int, rounds: int) -> bool:
    """Say what the audit adds to a log whose analysis takes next to nothing."""
    folder = scratch / "small"
    logs = generate(folder, number, 5.0, damaged=0.0)
    print(f"{number} logs of five seconds")
    took, same = in_turn(
        {
            "audit, one worker": lambda out: audit(folder, 1, out),
            "one bare loop, with reports": lambda out: bare(logs, 1, out, "html", "md", "json"),
        },
        scratch,
        rounds,
    )
    ours, theirs = took.values()
    over_s = (ours.wall - theirs.wall) / number
    of_processor_s = (ours.processor - theirs.processor) / number
    print(
        f"  overhead: {1e3 * over_s:.1f} ms a log (at most {1e3 * OVERHEAD_S:.0f} wanted;"
        f" by processor {1e3 * of_processor_s:.1f} ms)"
    )
    return same and over_s <= OVERHEAD_S


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="1: 300 and 1000 logs")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="how often they take turns")
    arguments = parser.parse_args()
    many, small = max(10, round(300 * arguments.scale)), max(20, round(1000 * arguments.scale))
    adopt_orphans()
    with tempfile.TemporaryDirectory(prefix="fdilog-benchmark-") as name:
        good = two_workers(Path(name), many, arguments.rounds)
        good &= small_logs(Path(name), small, arguments.rounds)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
