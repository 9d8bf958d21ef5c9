"""What an audit costs beside the analyses themselves, and what a second worker brings.

python benchmarks/audit.py                 # 300 logs, then 1000 small ones: half an hour
python benchmarks/audit.py --scale 0.1     # 30 and 100

Every figure is the median of rounds in which the ways of doing it take turns.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from fdilog.faults import Fault
from fdilog.simulate import simulate
from fdilog.writing import Writer, write

ROUNDS = 3
DAMAGED = 0.1

LOOP = """
import sys
from pathlib import Path
import fdilog
from fdilog.errors import FdilogError
from fdilog.registry import plugin
reports = [plugin("reports", name) for name in ("html", "md", "json")]
for path in sys.stdin.read().split("\\0"):
    try:
        analysis = fdilog.analyse(path)
    except FdilogError:
        continue
    for report in reports:
        target = Path(sys.argv[1]) / (Path(path).name + report.suffix)
        target.write_text(report.render(analysis), encoding="utf-8")
"""


def suffixes() -> list[str]:
    from fdilog.registry import plugins

    writers: dict[str, Writer] = plugins("writers")
    return sorted({writer.suffix for writer in writers.values()} - {".parquet"})


def generate(folder: Path, number: int, duration_s: float, *, damaged: float) -> list[Path]:
    """Write flights of three sources in every format that can be written; some are cut."""
    made = []
    kinds = suffixes()
    for k in range(number):
        fault = Fault(kind="bias", channel="imu1.y", start_s=duration_s / 2, size=0.1)
        faults = [fault] if k % 7 == 0 else []
        path = folder / f"vehicle{k % 5}" / f"{k:04d}{kinds[k % len(kinds)]}"
        path.parent.mkdir(parents=True, exist_ok=True)
        flight = simulate(duration_s, 25.0, sources=3, seed=k, faults=faults)
        write(flight.recording(), path)
        if path.is_file() and (k % 10) < 10 * damaged:
            content = path.read_bytes()
            path.write_bytes(content[: len(content) * 2 // 3] if k % 20 else b"")
        made.append(path)
    return made


def single_threaded() -> dict[str, str]:
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    return {**os.environ, **dict.fromkeys(names, "1")}


def bare(logs: list[Path], processes: int, output: Path) -> None:
    """Loop over analyse and its reports in so many processes, each with its share of the logs."""
    output.mkdir()
    by_size = sorted(logs, key=lambda path: -path.stat().st_size)
    started = []
    for k in range(processes):
        process = subprocess.Popen(
            [sys.executable, "-W", "ignore", "-c", LOOP, str(output)],
            stdin=subprocess.PIPE,
            env=single_threaded(),
            text=True,
        )
        if process.stdin is not None:
            process.stdin.write("\0".join(str(path) for path in by_size[k::processes]))
            process.stdin.close()
        started.append(process)
    for process in started:
        if process.wait():
            raise SystemExit("a bare loop failed")


def audit(folder: Path, workers: int, output: Path) -> None:
    command = [sys.executable, "-m", "fdilog", "audit", str(folder), "-o", str(output)]
    done = subprocess.run(
        [*command, "-q", "-j", str(workers)], check=False, stdout=subprocess.DEVNULL
    )
    if done.returncode not in {0, 1, 3}:
        raise SystemExit(f"the audit ended with {done.returncode}")


def seconds(way: Callable[[Path], None], scratch: Path) -> float:
    output = scratch / "output"
    shutil.rmtree(output, ignore_errors=True)
    begun = time.perf_counter()
    way(output)
    return time.perf_counter() - begun


def medians(ways: dict[str, Callable[[Path], None]], scratch: Path) -> dict[str, float]:
    taken: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(ROUNDS):
        for name, way in ways.items():
            taken[name].append(seconds(way, scratch))
    for name, values in taken.items():
        print(f"  {name:28} {' '.join(f'{value:7.1f}' for value in values)} s")
    return {name: statistics.median(values) for name, values in taken.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scale", type=float, default=1.0, help="1: 300 and 1000 logs")
    scale = parser.parse_args().scale
    many, small = max(10, round(300 * scale)), max(20, round(1000 * scale))
    with tempfile.TemporaryDirectory(prefix="fdilog-benchmark-") as name:
        scratch = Path(name)
        logs = generate(scratch / "many", many, 120.0, damaged=DAMAGED)
        print(f"{many} logs of two minutes ({', '.join(suffixes())}), a tenth damaged")
        took = medians(
            {
                "audit, one worker": lambda out: audit(scratch / "many", 1, out),
                "audit, two workers": lambda out: audit(scratch / "many", 2, out),
                "two bare loops": lambda out: bare(logs, 2, out),
            },
            scratch,
        )
        one, two = took["audit, one worker"], took["audit, two workers"]
        print(f"  two workers against one: {one / two:.2f} (at least 1.7 wanted)")
        print(f"  against two bare loops: {took['two bare loops'] / two:.2f} (at least 0.9 wanted)")

        logs = generate(scratch / "small", small, 5.0, damaged=0.0)
        print(f"{small} logs of five seconds")
        took = medians(
            {
                "audit, one worker": lambda out: audit(scratch / "small", 1, out),
                "one bare loop": lambda out: bare(logs, 1, out),
            },
            scratch,
        )
        over = (took["audit, one worker"] - took["one bare loop"]) / small
        print(f"  overhead: {1e3 * over:.1f} ms a log (at most 50 wanted)")


if __name__ == "__main__":
    main()
