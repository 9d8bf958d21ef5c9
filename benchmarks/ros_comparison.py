"""Two ways to read one recording, timed in one run and compared to the last bit."""

from __future__ import annotations

import gc
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROUNDS = 3
OURS_A_ROUND = 3

# Topic to time stamps, gyro x, y and z.
Arrays = dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]
Rows = dict[str, list[tuple[int, float, float, float]]]


@dataclass(frozen=True)
class Case:
    """One file, how it is read by the library of its format, and the goal for the ratio."""

    name: str
    path: Path
    reader: str
    official: Callable[[Path], Arrays]
    goal: float


def arrays(rows: Rows) -> Arrays:
    """Make arrays of what a message loop has collected."""
    return {
        topic: (
            np.array([row[0] for row in found], np.int64),
            np.array([row[1:] for row in found], np.float64),
        )
        for topic, found in rows.items()
    }


def ours(reader: str, path: Path) -> Arrays:
    """Read with this project: the same arrays, and accelerations and orientations beside them."""
    import importlib

    module = importlib.import_module(f"fdilog_readers.{reader}")
    streams = [s for s in module.read(path).streams if s.gyro and s.origin == "sensor"]
    return {s.name: (s.time_ns, np.column_stack([s.columns[g] for g in s.gyro])) for s in streams}


@dataclass(frozen=True)
class Seconds:
    """What reading took, on the clock and of the processor. [s]"""

    wall: float
    processor: float


def timed(read: Callable[[], Arrays]) -> tuple[Seconds, Arrays]:
    """Read once."""
    gc.collect()
    wall, processor = time.perf_counter(), time.process_time()
    found = read()
    return Seconds(time.perf_counter() - wall, time.process_time() - processor), found


def median(runs: Sequence[Seconds]) -> Seconds:
    """Median on each clock."""
    return Seconds(
        statistics.median(run.wall for run in runs),
        statistics.median(run.processor for run in runs),
    )


MEMORY = """
import sys
from importlib import import_module
from pathlib import Path
def megabytes(key):  # Linux; of this process alone
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) / 1024
reader = import_module("fdilog_readers." + sys.argv[1])
before = megabytes("VmRSS")
streams = [s for s in reader.read(Path(sys.argv[2])).streams if s.columns]
arrays = [a for s in streams for a in (s.time_ns, *s.columns.values())]
print(megabytes("VmHWM") - before, sum(a.nbytes for a in arrays) / 2**20)
"""


def compare(case: Case, rounds: int) -> bool:
    """Print one line, and tell whether the goal is met and both ways agree.

    Both ways take turns, so that whatever else the machine does meets both of them; the ratio is
    that of the medians, and beside it stand the least and the largest of a single round.
    """
    timed(lambda: ours(case.reader, case.path))  # into the page cache, past the imports
    fast, slow, ratios = [], [], []
    for _ in range(rounds):
        own = []
        for _ in range(OURS_A_ROUND):
            seconds, found = timed(lambda: ours(case.reader, case.path))
            own.append(seconds)
        seconds, expected = timed(lambda: case.official(case.path))
        slow.append(seconds)
        fast += own
        ratios.append(seconds.wall / median(own).wall)
    ratio = median(slow).wall / median(fast).wall
    processor_ratio = median(slow).processor / median(fast).processor
    command = [sys.executable, "-c", MEMORY, case.reader, str(case.path)]
    out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    peak_mib, columns_mib = map(float, out.split())
    same = found.keys() == expected.keys() and all(
        np.array_equal(a, b)
        for topic in expected
        for a, b in zip(expected[topic], found[topic], strict=True)
    )
    files = case.path.rglob("*") if case.path.is_dir() else [case.path]
    size_mb = sum(file.stat().st_size for file in files) / 1e6
    print(
        f"{case.name:18} {size_mb:4.0f} MB  {median(slow).wall:6.2f} s  {median(fast).wall:6.3f} s"
        f"  x {ratio:5.1f} ({min(ratios):.1f} to {max(ratios):.1f})"
        f"  processor {median(slow).processor:6.2f} s, {median(fast).processor:6.3f} s,"
        f" x {processor_ratio:5.1f}  goal {case.goal:g}"
        f"  {peak_mib:4.0f} MiB, {columns_mib:.0f} of it columns"
        f"{'' if same else '  THE NUMBERS DIFFER'}",
        flush=True,
    )
    # Both ways do the same amount of work however many others use the machine: its processor time
    # is the fairer measure where it is shared, the clock where it is not.
    return same and max(ratio, processor_ratio) >= case.goal
