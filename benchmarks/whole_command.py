"""Where the time of a whole `fdilog analyse` goes: a 100 MB DataFlash log, three IMUs at 400 Hz.

python benchmarks/whole_command.py [--megabytes 100]
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from dataflash import write_log


def main() -> None:
    """Run the command as a user would, then once more step by step."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megabytes", type=int, default=100)
    megabytes = parser.parse_args().megabytes
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "three_imus.bin"
        write_log(path, megabytes)
        command = [sys.executable, "-m", "fdilog", "analyse", "--json", str(path)]
        start = time.perf_counter()
        done = subprocess.run(command, capture_output=True, check=False)
        wall_s = time.perf_counter() - start
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        print(f"fdilog analyse --json, {megabytes} MB: exit code {done.returncode}")
        print(f"  {wall_s:.2f} s, {used.ru_utime + used.ru_stime:.2f} s of processor time")
        print(f"  peak memory {used.ru_maxrss / 1024:.0f} MB")
        steps(path)


def steps(path: Path) -> None:
    """Print the processor time between one progress message and the next, in this process."""
    from fdilog.analysis import analyse

    spent: Counter[str] = Counter()
    now = ["start"]
    mark = [time.process_time()]

    def step(name: str) -> None:
        spent[now[0].split(",")[0]] += time.process_time() - mark[0]
        now[0], mark[0] = name, time.process_time()

    analyse(path, progress=step)
    step("end")
    for name, seconds in spent.most_common():
        print(f"  {name:<20} {seconds:6.2f} s")


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    main()
