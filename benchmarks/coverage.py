"""How often the interval of a windowed mean covers, and how wide it is: the table of the docs.

python benchmarks/coverage.py            # one minute, 100 000 windows a row
python benchmarks/coverage.py --quick    # 10 000 windows a row
python benchmarks/coverage.py --speed    # seconds for an hour at 200 Hz
python benchmarks/coverage.py --guaranteed    # how often a guaranteed interval holds the truth
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from fdilog.detectors.guaranteed import guaranteed_intervals
from fdilog.maths.geometry import named_axes
from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile

Floats = NDArray[np.float64]
Noise = Callable[[np.random.Generator, tuple[int, int]], Floats]

BLOCK = 5000
NORMAL_95 = 1.959964
NORMAL_999 = 3.290527


def coloured(innovations: Floats, rho: float) -> Floats:
    """Stationary first-order autoregression (windows, samples) of variance 1 / (1 - rho^2)."""
    n = innovations.shape[1]
    lag = np.abs(np.arange(n)[:, None] - np.arange(n))
    return innovations @ np.linalg.cholesky(rho**lag / (1.0 - rho**2)).T


def autoregressive(rho: float) -> Noise:
    return lambda rng, shape: coloured(rng.standard_normal(shape), rho)


def autoregressive_plus_white(rho: float) -> Noise:
    """Autoregression and white noise of equal variance."""
    scale = np.sqrt(1.0 - rho**2)
    return lambda rng, shape: (
        scale * coloured(rng.standard_normal(shape), rho) + rng.standard_normal(shape)
    )


def heavy_tailed(rho: float) -> Noise:
    """Autoregression driven by Student t with three degrees of freedom."""
    return lambda rng, shape: coloured(rng.standard_t(3, shape), rho)


def sinusoid(low: float, high: float) -> Noise:
    """Pure sine of random phase; so many periods a window at least, cycles a sample at most."""

    def make(rng: np.random.Generator, shape: tuple[int, int]) -> Floats:
        n_windows, n = shape
        cycles = rng.uniform(low / n, high, (n_windows, 1))
        return np.sin(2.0 * np.pi * (cycles * np.arange(n) + rng.random((n_windows, 1))))

    return make


KINDS: dict[str, Noise] = {
    "white": autoregressive(0.0),
    "Student t(3)": heavy_tailed(0.0),
    "AR(1) 0.6": autoregressive(0.6),
    "AR(1) 0.9": autoregressive(0.9),
    "AR(1) 0.9 + white": autoregressive_plus_white(0.9),
    "AR(1) 0.9 of t(3)": heavy_tailed(0.9),
    "AR(1) -0.6": autoregressive(-0.6),
    "sinusoid": sinusoid(1.0, 0.5),
    "sinusoid, 1 to 2.5 periods": sinusoid(1.0, 0.02),
    "sinusoid, half a period": sinusoid(0.5, 0.004),
}

# A mixing matrix turns independent sources (rows) into the series that are measured (columns); the
# combination that is judged is random in every window, or the one given.
MIXED: dict[str, tuple[tuple[str, ...], Floats, tuple[float, ...] | None]] = {
    "3 white": (("white",) * 3, np.eye(3), None),
    "6 white": (("white",) * 6, np.eye(6), None),
    "3 AR(1) 0.9": (("AR(1) 0.9",) * 3, np.eye(3), None),
    "AR(1) 0.9 and 2 white, mixed": (
        ("AR(1) 0.9", "white", "white"),
        np.diag([0.436, 1.0, 1.0])
        @ np.array([[0.8, 0.6, 0.0], [-0.48, 0.64, 0.6], [0.36, -0.48, 0.8]]),
        None,
    ),
    "AR(1) 0.9 hidden under 5 times as much common white noise": (
        ("AR(1) 0.9", "white", "white"),
        np.array([[0.087, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
        (1.0, -1.0, 0.0),
    ),
}


class Count:
    """Counts over blocks of windows, of one linear combination of the series each."""

    def __init__(self) -> None:
        self.covered = 0
        self.far = {0.999: 0, 1 - 1e-5: 0, 1 - 1e-7: 0}
        self.columns: list[Floats] = []

    def add(self, x: Floats, combination: Floats) -> None:
        """Count windows (windows, samples, series) whose true mean is zero."""
        n = x.shape[1]
        answer = windowed_mean(x)
        judged = np.einsum("wnq,wq->wn", x, combination)
        mean = judged.mean(axis=1)
        half = answer.half_width(combination, 0.95)
        self.covered += int((np.abs(mean) <= half).sum())
        for confidence in self.far:
            missed = np.abs(mean) > answer.half_width(combination, confidence)
            self.far[confidence] += int(missed.sum())
        plain = student_quantile(n - 1.0, 0.95) * judged.std(axis=1, ddof=1) / np.sqrt(n)
        half_999 = answer.half_width(combination, 0.999)
        norm = np.linalg.norm(combination, axis=1)
        self.columns.append(
            np.stack([mean / norm, half / norm, half_999 / norm, half / plain, answer.dof])
        )

    def row(self) -> str:
        """Return the cells of the table after the names."""
        mean, half, half_999, ratio, dof = np.concatenate(self.columns, axis=1)
        return (
            f"{100 * self.covered / len(mean):.1f}"
            f" | {1000 * self.far[0.999] / len(mean):.2f}"
            f" | {self.far[1 - 1e-5]} | {self.far[1 - 1e-7]} of {len(mean)}"
            f" | {np.median(half) / mean.std() / NORMAL_95:.2f}"
            f" | {np.median(half_999) / mean.std() / NORMAL_999:.2f}"
            f" | {np.median(ratio):.2f}"
            f" | {np.quantile(dof, 0.05):.1f} | {np.median(dof):.1f} |"
        )


def coverage(n_windows: int) -> None:
    print(
        "| noise | samples | 95 % covers, % | 99.9 % misses, per 1000 | misses at 1e-5 | at 1e-7"
        " | width / ideal at 95 % | at 99.9 % | width / white formula | dof, 5 % | dof, median |"
    )
    print("|" + "---|" * 11)
    for name, noise in KINDS.items():
        for n in (6, 25, 125, 500) if "sinusoid" not in name else (125, 500):
            rng = np.random.default_rng(20_240 + n)
            count = Count()
            for _ in range(max(1, n_windows // BLOCK // (5 if n > 125 else 1))):
                count.add(noise(rng, (BLOCK, n))[:, :, None], np.ones((BLOCK, 1)))
            print(f"| {name} | {n} | {count.row()}")
    for name, (sources, mixing, fixed) in MIXED.items():
        for n in (25, 125):
            rng = np.random.default_rng(20_240 + n)
            count = Count()
            for _ in range(max(1, n_windows // BLOCK // 2)):
                x = np.stack([KINDS[k](rng, (BLOCK, n)) for k in sources], axis=2) @ mixing
                c = rng.standard_normal((BLOCK, len(sources)))
                count.add(x, c if fixed is None else np.broadcast_to(fixed, c.shape))
            print(f"| {name} | {n} | {count.row()}")


def speed() -> None:
    rng = np.random.default_rng(0)
    for q in (3, 6):
        x = rng.standard_normal((720_000, q))
        total = 0.0
        for n in (20, 200, 1000, 6000, 12_000):
            windows = np.lib.stride_tricks.sliding_window_view(x, n, axis=0)[:: n // 2]
            taken = np.inf
            for _ in range(3):  # the best of three: other work on the machine only adds
                start = time.perf_counter()
                answer = windowed_mean(np.moveaxis(windows, 2, 1))
                student_quantile(answer.dof, 0.999)
                taken = min(taken, time.perf_counter() - start)
            total += taken
            print(f"{q} series, {len(windows)} windows of {n}: {taken:.3f} s")
        print(f"{q} series, one hour at 200 Hz, all lengths: {total:.2f} s")


UNITS = (("matasov", 6, 2), ("dodecahedron", 6, 2), ("mirrored-triads", 6, 2),
         ("aligned-triads", 9, 2), ("pentagon", 5, 1))  # fmt: skip
ROUNDING = 1e-12


def guaranteed(samples: int) -> None:
    """Count guaranteed intervals that miss: errors up to the very bound, failures of any size."""
    print("| unit | failures | errors | intervals | that miss | median half-width / bound |")
    print("|---|---|---|---|---|---|")
    for name, channels, most in UNITS:
        axes = named_axes(name, channels)
        for failures in range(most + 1):
            for errors in ("uniform", "at the bound"):
                rng = np.random.default_rng(7)
                off = rng.uniform(-1.0, 1.0, (samples, channels))
                off = np.sign(off) if errors == "at the bound" else off
                order = rng.random((samples, channels)).argsort(axis=1)[:, :failures]
                size = rng.normal(0.0, 1.0, order.shape) * 10.0 ** rng.uniform(0, 3, order.shape)
                np.put_along_axis(off, order, size, axis=1)
                true = rng.normal(0.0, 100.0, (samples, 3)) @ axes.T
                low, high, _ = guaranteed_intervals(true + off, axes, 1.0, most)
                slack = ROUNDING * np.abs(true).max()
                missed = ~((low <= true + slack) & (true - slack <= high))
                half = (high - low) / 2.0
                print(
                    f"| {name}, {channels} | {failures} | {errors} | {low.size} |"
                    f" {int(missed.sum())} | {np.median(half):.2f} |"
                )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--speed", action="store_true")
    parser.add_argument("--guaranteed", action="store_true")
    chosen = parser.parse_args()
    if chosen.speed:
        speed()
    elif chosen.guaranteed:
        guaranteed(2_000 if chosen.quick else 20_000)
    else:
        coverage(10_000 if chosen.quick else 100_000)


if __name__ == "__main__":
    main()
