"""Guaranteed intervals in closed form against the linear programs that they replace.

python benchmarks/guaranteed.py                 # samples per second of both, and peak memory
python benchmarks/guaranteed.py --check 2000    # that many random instances per n against HiGHS
python benchmarks/guaranteed.py --channels      # samples per second by the number of skewed gyros
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdilog.detectors.guaranteed import guaranteed_intervals
from fdilog.maths.geometry import named_axes

Floats = NDArray[np.float64]

SAMPLES = 1_000_000
REPEATS = 5
BOUND = 1.0
FLIGHTS = {
    "healthy": [],
    "one gyro fails at half time": [(0.5, 1, 20.0)],
    "a second one at three quarters": [(0.5, 1, 20.0), (0.75, 2, -51.0)],
}
"""Faults as (share of the flight after which it is there, channel, size)."""
KIBIBYTE = 1024


def flight(faults: list[tuple[float, int, float]], n_samples: int) -> Floats:
    """Make readings (n_samples, 6) of the unit of [Matasov24], noise a quarter of its bound."""
    rng = np.random.default_rng(0)
    z = rng.normal(0.0, 50.0, (n_samples, 3)) @ named_axes("matasov").T
    z += np.clip(rng.normal(0.0, BOUND / 4.0, z.shape), -BOUND, BOUND)
    for share, channel, size in faults:
        z[int(share * n_samples) :, channel] += size
    return z


def ours(name: str) -> dict[str, float]:
    """Run alone in this process: samples per second, and the peak memory."""
    z, axes = flight(FLIGHTS[name], SAMPLES), named_axes("matasov")
    seconds = []
    for _ in range(REPEATS):
        start = time.process_time()
        guaranteed_intervals(z, axes, BOUND)
        seconds.append(time.process_time() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * KIBIBYTE
    return {"best": SAMPLES / min(seconds), "median": SAMPLES / np.median(seconds), "peak": peak}


def one_by_one(z: Floats, axes: Floats) -> tuple[Floats, Floats]:
    """Solve an instant as the paper does: 15 pairs, 6 targets, 2 ends, a program each."""
    from scipy.optimize import linprog

    low, high = np.full(6, np.inf), np.full(6, -np.inf)
    for pair in combinations(range(6), 2):
        left = [i for i in range(6) if i not in pair]
        matrix = np.concatenate([axes[left], -axes[left]])
        limit = np.concatenate([z[left] + BOUND, BOUND - z[left]])
        for channel in range(6):
            for sign in (1.0, -1.0):
                cost = sign * axes[channel]
                answer = linprog(cost, A_ub=matrix, b_ub=limit, bounds=(None, None))
                if answer.status == 0 and sign > 0.0:
                    low[channel] = min(low[channel], answer.fun)
                elif answer.status == 0:
                    high[channel] = max(high[channel], -answer.fun)
    return low, high


def compare_speed(n_programs: int) -> None:
    axes = named_axes("matasov")
    # First, while this process is small: a child's peak counts what its parent held at the fork.
    closed = {}
    for name in FLIGHTS:
        command = [sys.executable, __file__, "--alone", name]
        answer = subprocess.run(command, check=True, capture_output=True)
        closed[name] = json.loads(answer.stdout)
    print("Samples per second of processor time, one thread; of the closed form, millions over")
    print(f"{SAMPLES} samples, median and best of {REPEATS}; the ratio is that of the median.")
    print(f"{'flight':32}{'180 programs':>12}{'closed form':>15}{'best':>7}{'ratio':>14}", end="")
    print(f"{'peak [MB]':>10}{'differ by':>12}")
    for name, faults in FLIGHTS.items():
        z = flight(faults, SAMPLES)[:: SAMPLES // n_programs][:n_programs]
        one_by_one(z[0], axes)
        start = time.process_time()
        programs = [one_by_one(row, axes) for row in z]
        rate = len(z) / (time.process_time() - start)
        low, high, _ = guaranteed_intervals(z, axes, BOUND)
        apart = max(
            max(np.abs(low[i] - one[0]).max(), np.abs(high[i] - one[1]).max())
            for i, one in enumerate(programs)
        )
        alone = closed[name]
        print(
            f"{name:32}{rate:12.2f}{alone['median'] / 1e6:15.2f}{alone['best'] / 1e6:7.2f}"
            f"{alone['median'] / rate:14,.0f}{alone['peak'] / 1e6:10.0f}{apart:12.0e}"
        )


def by_channels() -> None:
    """Time units of random skewed axes, two failures allowed."""
    print("skewed gyros, samples per second, seconds for an hour at 200 Hz")
    for channels, samples in ((5, 200_000), (6, 200_000), (8, 50_000), (9, 20_000), (10, 10_000)):
        rng = np.random.default_rng(0)
        axes = rng.normal(size=(channels, 3))
        axes /= np.linalg.norm(axes, axis=1)[:, None]
        z = rng.normal(0.0, 50.0, (samples, 3)) @ axes.T
        z += np.clip(rng.normal(0.0, BOUND / 4.0, z.shape), -BOUND, BOUND)
        guaranteed_intervals(z[:1], axes, BOUND)
        seconds = []
        for _ in range(REPEATS):
            start = time.process_time()
            guaranteed_intervals(z, axes, BOUND)
            seconds.append(time.process_time() - start)
        rate = samples / float(np.median(seconds))
        print(f"{channels:12}{rate:20,.0f}{3600 * 200 / rate:34.1f}")


def check(n_instances: int) -> bool:
    """Compare with the linear programs on random instances, half of them with aligned axes."""
    from tests.oracles import EDGE, SCALE, guaranteed_by_programs, random_instance

    good = True
    for n_channels in (4, 5, 6, 8, 9):
        rng = np.random.default_rng(n_channels)
        worst, aside, infeasible, unbounded, wrong = 0.0, 0, 0, 0, 0
        for number in range(n_instances):
            z, axes, bound, k = random_instance(rng, n_channels, aligned=bool(number % 2))
            low, high, feasible, edge = guaranteed_by_programs(z, axes, bound, k)
            if edge < EDGE * SCALE:
                aside += 1
                continue
            answer = guaranteed_intervals(z[None], axes, bound, k)
            ends, theirs = np.concatenate(answer[:2], axis=1)[0], np.concatenate([low, high])
            finite = np.isfinite(theirs)
            same = np.array_equal(answer[2][0], feasible)
            same &= np.array_equal(ends[~finite], theirs[~finite], equal_nan=True)
            wrong += not same
            if same and finite.any():
                # An end that nearly coplanar axes put far beyond the readings is its own scale.
                scale = np.maximum(SCALE, np.abs(theirs[finite]))
                worst = max(worst, float((np.abs(ends[finite] - theirs[finite]) / scale).max()))
            infeasible += not feasible.all()
            unbounded += bool(np.isinf(low).any())
        print(
            f"n = {n_channels}: {n_instances} instances, {aside} set aside, {infeasible} with an "
            f"infeasible subset, {unbounded} unbounded; {wrong} differ in kind, "
            f"ends within {worst:.1e} of the scale"
        )
        good &= wrong == 0 and worst < 1e-9
    return good


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", type=int, metavar="INSTANCES")
    parser.add_argument("--channels", action="store_true")
    parser.add_argument("--programs", type=int, default=8, help="samples solved as programs")
    parser.add_argument("--alone", choices=FLIGHTS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    sys.path.insert(0, str(Path(__file__).parent.parent))
    if options.alone:
        print(json.dumps(ours(options.alone)))
        return 0
    if options.channels:
        by_channels()
        return 0
    if options.check:
        return 0 if check(options.check) else 1
    compare_speed(options.programs)
    return 0


if __name__ == "__main__":
    sys.exit(main())
