"""What is found in simulated flights in which nothing is wrong.

python benchmarks/false_alarms.py                # two hours
python benchmarks/false_alarms.py --hours 20

Each flight has its own seed, and from it draws how many IMUs there are and how fast they are
logged, how it is flown and how it shakes, biases, scale errors, mountings, noise, jitter and
offsets of the stamps, biases that wander by a tenth of a deg/s as the gyros warm up, and holes in
the log. All of it is healthy by the default tolerances: biases of 0.1, 0.2 and at most three times
that, scale errors of half a per cent. Only detectors that can make a finding are asked.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small products: threads only wait for one another

import argparse
import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from witness import TIME_CONSTANTS_S, misled

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.experiments.motion import Airframe
from fdilog.experiments.simulate import GyroErrors, Timing, simulate
from fdilog.recording import Recording, Stream
from fdilog.text_table import text_table

CONFIG = Config().replace("detectors", use=("parity", "impulse", "dropout", "flatline", "noise"))
FLIGHT_S = 600.0
# A gyro's bias follows its temperature, which settles within a minute or two of power-up.
WARM_UP_S = 60.0
WARM_UP_DEG_S = 0.1
# A filter that is started in flight knows its attitude badly, and its heading not at all.
UPSETS = 1.0
UPSET_RAD = 0.7
# Lost records come in bursts, when the card is slow.
HOLE_S = (0.05, 3.0)


@dataclass(frozen=True)
class Result:
    """What was found in one flight."""

    setting: str
    seed: int
    duration_s: float
    verdict: str
    findings: tuple[str, ...]


def healthy(seed: int) -> tuple[str, Recording]:
    """Draw a flight, and say in a few words of what sort it is."""
    rng = np.random.default_rng((seed, 1))
    imus = int(rng.choice([1, 2, 3]))
    rate_hz = float(rng.choice([10.0, 25.0, 50.0, 100.0]))
    vibration_deg_s = float(rng.choice([0.5, 2.0, 6.0]))
    shared = bool(rng.random() < 0.7)
    flight = simulate(
        FLIGHT_S,
        rate_hz,
        sources=imus,
        seed=seed,
        airframe=Airframe(
            tilt_rad=float(np.radians(rng.uniform(2.0, 10.0))),
            heading_rad=float(np.radians(rng.uniform(5.0, 60.0))),
            doublet_rad=float(np.radians(rng.uniform(0.0, 30.0))),
            vibration_rad_s=float(np.radians(vibration_deg_s)),
            own_share=float(rng.uniform(0.05, 0.3)),
            motor_hz=float(rng.uniform(40.0, 150.0)),
        ),
        errors=GyroErrors(noise_rad_s=float(np.radians(rng.uniform(0.02, 0.3)))),
        timing=Timing(
            jitter_s=float(rng.uniform(0.0, 0.002)),
            offset_s=float(rng.choice([0.0005, 0.002])),
            shared=shared,
        ),
    )
    recording = flight.recording()
    warm = [stream if not stream.gyro else _warmed(stream, rng) for stream in recording.streams]
    holes = _holes(rng)
    recording = replace(recording, streams=tuple(_with_holes(stream, holes) for stream in warm))
    if imus == 1:
        # What a filter of this very gyro says is no truth, least of all where it starts anew.
        tau_s = float(rng.uniform(*TIME_CONSTANTS_S))
        upsets = [
            (float(rng.uniform(0.0, FLIGHT_S)), rng.normal(0.0, UPSET_RAD, 3))
            for _ in range(rng.poisson(UPSETS))
        ]
        recording = misled(recording, "imu0", tau_s, upsets)
    kind = "1 IMU" if imus == 1 else f"{imus} IMUs"
    return f"{kind}, {rate_hz:g} Hz, vibration {vibration_deg_s:g} deg/s", recording


def _warmed(stream: Stream, rng: np.random.Generator) -> Stream:
    """Let the biases settle while the gyro warms up."""
    time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
    columns = dict(stream.columns)
    for name in stream.gyro:
        change = float(np.radians(WARM_UP_DEG_S * np.clip(rng.standard_normal(), -2.0, 2.0)))
        columns[name] = columns[name] + change * np.exp(-time_s / WARM_UP_S)
    return replace(stream, columns=columns)


def _holes(rng: np.random.Generator) -> list[tuple[int, int]]:
    """Draw when nothing was recorded, a few times in every other flight. [ns since the start]"""
    starts = rng.uniform(0.0, FLIGHT_S, rng.poisson(3) if rng.random() < 0.5 else 0)
    return [(int(s * 1e9), int((s + rng.uniform(*HOLE_S)) * 1e9)) for s in starts]


def _with_holes(stream: Stream, holes: list[tuple[int, int]]) -> Stream:
    since = stream.time_ns - stream.time_ns[0]
    kept = np.ones(len(since), bool)
    for start, end in holes:
        kept &= (since < start) | (since > end)
    return replace(
        stream,
        time_ns=stream.time_ns[kept],
        columns={name: column[kept] for name, column in stream.columns.items()},
        count=int(kept.sum()),
    )


def fly(seed: int) -> Result:
    """Analyse one flight."""
    setting, recording = healthy(seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        analysis = analyse_recording(recording, CONFIG)
    return Result(
        setting=setting,
        seed=seed,
        duration_s=analysis.table.duration_s,
        verdict=analysis.verdict,
        findings=tuple(
            f"{f.kind} of {'|'.join(f.suspects)}, {f.start_s:.1f} to {f.end_s:.1f} s"
            for f in analysis.findings
        ),
    )


def rows(results: list[Result]) -> Iterator[list[str]]:
    for name in [*sorted({result.setting for result in results}), ""]:
        members = [result for result in results if name in ("", result.setting)]
        hours = sum(result.duration_s for result in members) / 3600.0
        false = sum(len(result.findings) for result in members)
        verdicts = Counter(result.verdict for result in members)
        yield [
            name or "all",
            f"{hours:.1f}",
            str(false),
            f"{false / hours:.2f}",
            *(str(verdicts[verdict]) for verdict in ("healthy", "undecided", "failed")),
        ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=0, help="of the first flight; then the next")
    parser.add_argument("--jobs", type=int, default=2)
    arguments = parser.parse_args()
    flights = max(1, round(arguments.hours * 3600.0 / FLIGHT_S))
    with ProcessPoolExecutor(arguments.jobs) as pool:
        results = list(pool.map(fly, range(arguments.seed, arguments.seed + flights)))
    head = ["flights", "hours", "findings", "an hour", "healthy", "undecided", "failed"]
    print(text_table(head, list(rows(results)), markdown=True))
    for result in results:
        for finding in result.findings:
            print(f"seed {result.seed} ({result.setting}): {finding}")


if __name__ == "__main__":
    main()
