"""The joint window test on the draws of [Triads]: exact, and with sensor noise as a curve.

python benchmarks/joint.py                 # the table of docs/detectors/joint.md, half a minute
python benchmarks/joint.py --svg FILE      # and its picture

A window holds 100 random rates of one unit. The alarm level of each line is that which 1 % of the
windows of healthy units exceed; the noise is known to the test, as its standard deviation.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fdilog.detectors.joint import joint_suspects, joint_test
from fdilog.maths.geometry import named_axes
from fdilog.reproduce.triads import (
    BIAS_SIGMA_DEG_S,
    GEOMETRY,
    NO_NOISE_DEG_S,
    SCALE_SIGMA,
    Draws,
    draw_units,
)

RATES_PER_WINDOW = 100
FAILED, HEALTHY, BATCH = 20_000, 40_000, 5_000
FALSE_ALARMS = 0.01
NOISES_DEG_S = (0.0, 0.003, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3)
SEED = 15


@dataclass(frozen=True)
class Point:
    """Shares of windows at one noise: of failed units by whom they name, of healthy at 99 %."""

    noise_deg_s: float
    right: float
    with_others: float
    wrong: float
    missed: float
    healthy_at_99: float


def batches(rng: np.random.Generator, windows: int, *, fail: bool) -> list[Draws]:
    """Draw so many windows and a few more, in parts that stay small in memory."""
    drawn: list[Draws] = []
    while sum(len(draws.failed) for draws in drawn) < windows:
        drawn.append(draw_units(rng, BATCH, RATES_PER_WINDOW, fail=fail))
    return drawn


def measured(noise_deg_s: float, failed: list[Draws], healthy: list[Draws]) -> Point:
    rng = np.random.default_rng(SEED + 1)
    axes = named_axes(GEOMETRY)

    def tested(draws: Draws):  # noqa: ANN202
        noisy = draws.readings + noise_deg_s * rng.standard_normal(draws.readings.shape)
        sigma = max(noise_deg_s, NO_NOISE_DEG_S)
        return joint_test(noisy, axes, sigma, BIAS_SIGMA_DEG_S, SCALE_SIGMA)

    largest = np.concatenate([tested(draws).single.max(axis=1) for draws in healthy])
    alarm = np.quantile(largest, 1.0 - FALSE_ALARMS)
    # The confidence whose threshold, 2 ln(n / (1 - confidence)), is that level.
    confidence = 1.0 - len(axes) * np.exp(-alarm / 2.0)
    named, several = [], []
    for draws in failed:
        suspects = joint_suspects(tested(draws), confidence)
        named.append(suspects[np.arange(len(suspects)), draws.failed])
        several.append(suspects.sum(axis=1))
    right, count = np.concatenate(named), np.concatenate(several)
    return Point(
        noise_deg_s=noise_deg_s,
        right=float((right & (count == 1)).mean()),
        with_others=float((right & (count > 1)).mean()),
        wrong=float((~right & (count > 0)).mean()),
        missed=float((count == 0).mean()),
        healthy_at_99=float((largest > 2.0 * np.log(len(axes) / FALSE_ALARMS)).mean()),
    )


def picture(points: list[Point]) -> str:
    """Draw the shares over the noise, on a logarithmic scale with the exact draws at its left."""
    wide, high, left, top = 640, 260, 52, 16
    noises = np.array([point.noise_deg_s for point in points])
    shown = np.log10(np.maximum(noises, 0.001))
    x = left + (shown - shown[0]) / (shown[-1] - shown[0]) * (wide - left - 130)

    def line(shares: list[float], colour: str, word: str, at: float) -> str:
        y = top + (1.0 - np.array(shares)) * (high - top - 40)
        path = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
        return (
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'
            f'<text x="{x[-1] + 6:.0f}" y="{at:.0f}" fill="{colour}">{word}</text>'
        )

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}"',
        f' height="{high}" font-family="sans-serif" font-size="12">',
        f'<rect width="{wide}" height="{high}" fill="#ffffff"/>',
    ]
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        y = top + (1.0 - share) * (high - top - 40)
        parts.append(
            f'<line x1="{left}" x2="{x[-1]:.0f}" y1="{y:.1f}" y2="{y:.1f}" stroke="#dddddd"/>'
            f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end" fill="#444444">'
            f"{share:.0%}</text>"
        )
    for at, noise in zip(x, noises, strict=True):
        if noise in (0.0, 0.003, 0.01, 0.03, 0.1, 0.3):
            parts.append(
                f'<text x="{at:.0f}" y="{high - 24}" text-anchor="middle" fill="#444444">'
                f"{noise:g}</text>"
            )
    parts.append(
        f'<text x="{(left + x[-1]) / 2:.0f}" y="{high - 6}" text-anchor="middle" fill="#444444">'
        f"noise of one reading, deg/s (healthy biases: {BIAS_SIGMA_DEG_S:g} deg/s)</text>"
    )
    # From the bottom upwards, a line of print apart.
    ends = [points[-1].wrong, points[-1].with_others, points[-1].right, points[-1].missed]
    at = [top + (1.0 - end) * (high - top - 40) + 4 for end in ends]
    for k in range(1, len(at)):
        at[k] = min(at[k], at[k - 1] - 14)
    parts += [
        line([p.wrong for p in points], "#cf222e", "wrong channel", at[0]),
        line([p.with_others for p in points], "#9a6700", "with others", at[1]),
        line([p.right for p in points], "#1a7f37", "right channel", at[2]),
        line([p.missed for p in points], "#57606a", "missed", at[3]),
    ]
    return "\n".join([*parts, "</svg>\n"])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--svg", type=Path)
    asked = parser.parse_args()
    rng = np.random.default_rng(SEED)
    failed = batches(rng, FAILED, fail=True)
    healthy = batches(rng, HEALTHY, fail=False)
    kept = sum(len(draws.failed) for draws in failed)
    windows = sum(len(draws.failed) for draws in healthy)
    print(
        f"{kept} failed and {windows} healthy units, {RATES_PER_WINDOW} rates a window, seed {SEED}"
    )
    print(f"shares at {FALSE_ALARMS:.0%} false alarms; healthy alarms at the level for 99 %\n")
    print("| noise, deg/s | right | with others | wrong | missed | healthy at 99 % |")
    print("|---|---|---|---|---|---|")
    points = []
    for noise in NOISES_DEG_S:
        point = measured(noise, failed, healthy)
        points.append(point)
        print(
            f"| {noise:g} | {point.right:.2%} | {point.with_others:.2%} | {point.wrong:.3%}"
            f" | {point.missed:.2%} | {point.healthy_at_99:.2%} |",
            flush=True,
        )
    if asked.svg:
        asked.svg.write_text(picture(points), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main()
