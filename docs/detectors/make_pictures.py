# ruff: noqa: INP001  a script, not a package
"""Draw every detector at work on a sample log: ``python docs/detectors/make_pictures.py``.

Shaded is where the log has its fault, red what the detector accuses. The pictures are the same
bytes each time. The observer has a log of its own, `vessel.csv` with `vessel.toml`, which is
written beside the pages.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from plot import ANOTHER, ONE, OTHER, Floats, Line, Panel, svg

from fdilog.config import Config, load_config
from fdilog.detectors.baselines import least_absolute_errors
from fdilog.detectors.determinants import struck_conditions, struck_determinants
from fdilog.detectors.flatline import longest_ordinary_run, runs_of_equal
from fdilog.detectors.joint_windows import _block, _threshold
from fdilog.detectors.kalman import last_innovation_ratio
from fdilog.detectors.observer_evidence import alarms
from fdilog.detectors.observer_watch import watched
from fdilog.detectors.one_norm import one_norm_errors
from fdilog.detectors.searches import mean_modulus, mean_square, mean_square_rate_deviation
from fdilog.finding import Evidence
from fdilog.registry import plugin, read
from fdilog.reproduce import SEED
from fdilog.reproduce.observer import FAILURES, vessel, voyage
from fdilog.sources.assembly import assemble
from fdilog.sources.signals import find_signals
from fdilog.windows.calibration import calibrate
from fdilog.windows.survey import Survey, cut, spans

HERE = Path(__file__).parent
SAMPLES = HERE.parents[1] / "sample_logs"
MOST_BYTES = 60_000
# No healthy gyro of that log is ever off by more: vibration that each feels for itself.
BOUND_DEG_S = 1.0


class Flight:
    """A sample log: its table, and what is true of it."""

    def __init__(self, name: str, geometry: str = "") -> None:
        self.name = name
        self.config = Config().replace("geometry", name=geometry)
        table = assemble(read(SAMPLES / name), self.config).table
        self.logged = table.gyros
        self.table, _ = calibrate(self.logged, self.config)
        truth = json.loads((SAMPLES / "truth.json").read_text(encoding="utf-8"))[name]
        end = float(self.table.time_s[-1])
        self.faults = list(
            dict.fromkeys((f["start_s"], f["end_s"] or end) for f in truth["faults"])
        )

    def survey(self, length_s: float) -> Survey:
        """Show the windows of one length."""
        family = cut(self.table, self.config.replace("windows", lengths_s=(length_s,)))
        return Survey(table=self.table, windows=family[0], config=self.config)

    def asked(self, name: str, length_s: float) -> tuple[Survey, Evidence]:
        """Ask a detector of windows."""
        survey = self.survey(length_s)
        return survey, plugin("detectors", name)().detect(survey)[0]

    def alone(self, name: str) -> Evidence:
        """Ask a detector that judges each channel by itself."""
        rows = np.array([0]), np.array([len(self.logged.time_s)])
        survey = Survey(table=self.logged, windows=spans(self.logged, *rows), config=self.config)
        found: list[Evidence] = plugin("detectors", name)().detect(survey)
        return found[0]


def middles(evidence: Evidence | Survey) -> Floats:
    """Return the middles of windows. [s]"""
    windows = evidence.windows
    middle: Floats = (windows.start_s + windows.end_s) / 2
    return middle


def accused(evidence: Evidence, channel: int) -> list[tuple[float, float]]:
    """List where a channel is accused, alone or with others."""
    windows, hits = evidence.windows, np.flatnonzero(evidence.accused[:, channel])
    merged: list[tuple[float, float]] = []
    for start, end in zip(
        windows.start_s[hits].tolist(), windows.end_s[hits].tolist(), strict=True
    ):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


def interval(name: str, flight: Flight, channel: str, length_s: float) -> list[Panel]:
    """Draw the interval of a channel's error against the tolerance."""
    _, evidence = flight.asked(name, length_s)
    k = flight.table.names.index(channel)
    t = middles(evidence)
    lines = [
        Line(
            time_s=t,
            value=np.degrees(evidence.low[:, j]),
            high=np.degrees(evidence.high[:, j]),
            word=word,
            colour=colour,
        )
        for j, word, colour in (
            ((k + 3) % len(flight.table.channels), "another gyro", OTHER),
            (k, channel, ONE),
        )
    ]
    tolerance = float(np.degrees(np.median(evidence.tolerance[:, k])))
    return [
        Panel(
            title=f"{name}: error by {length_s:g} s windows, {flight.name}",
            unit="deg/s",
            lines=lines,
            faults=flight.faults,
            levels=[(tolerance, "tolerance"), (-tolerance, "")],
            marks=accused(evidence, k),
            least=-8.0,
            most=10.0,
        )
    ]


def statistic(
    name: str,
    flight: Flight,
    channels: tuple[str, ...],
    formula: Callable[[Floats, Floats], Floats],
    unit: str,
    *,
    scale: float = 1.0,
    logarithmic: bool = False,
    least: float | None = None,
    most: float | None = None,
    length_s: float = 1.0,
) -> list[Panel]:
    """Draw what a search compares, on the mean readings of windows; it looks for the extreme."""
    survey, evidence = flight.asked(name, length_s)
    (moments,) = survey.moments
    values = formula(moments.mean, flight.table.axes[list(moments.channels)]) * scale
    t = middles(survey)[moments.windows]
    names = [flight.table.names[k] for k in moments.channels]
    lines = [
        Line(time_s=t, value=values[:, k], word="the others" if k == 0 else "")
        for k, one in enumerate(names)
        if one not in channels
    ]
    lines += [
        Line(time_s=t, value=values[:, names.index(one)], word=one, colour=colour)
        for one, colour in zip(channels, (ONE, ANOTHER), strict=False)
    ]
    return [
        Panel(
            title=f"{name}: {length_s:g} s windows, {flight.name}",
            unit=unit,
            lines=lines,
            faults=flight.faults,
            marks=accused(evidence, flight.table.names.index(channels[0])),
            logarithmic=logarithmic,
            least=least,
            most=most,
        )
    ]


def joint() -> list[Panel]:
    """Draw the likelihood ratio of every gyro along x of three IMUs, and its threshold."""
    flight = Flight("scale.bin")
    # A scale error as large as this one is the same in every window: shorter ones see it too.
    survey, evidence = flight.asked("joint", 10.0)
    moments = next(m for m in survey.moments if flight.table.names[m.channels[0]] == "imu0.x")
    block, known = _block(moments, survey)
    assert block is not None  # noqa: S101  the log is long enough
    ratios = block.ratios(known, np.arange(len(moments.channels)))
    t = middles(survey)[moments.windows[known]]
    names = [flight.table.names[k] for k in moments.channels]
    colours = {"imu2.x": ONE}
    threshold = _threshold(len(names), 1.0 - flight.config.windows.confidence)
    return [
        Panel(
            title="joint: likelihood ratio in 10 s windows, scale.bin (imu2.x: 1.2)",
            unit="ratio",
            lines=[
                Line(time_s=t, value=ratios[:, k], word=one, colour=colours.get(one, OTHER))
                for k, one in enumerate(names)
            ],
            faults=[],
            levels=[(threshold, "threshold")],
            marks=accused(evidence, flight.table.names.index("imu2.x")),
            logarithmic=True,
            least=0.1,
        )
    ]


def guaranteed() -> list[Panel]:
    """Draw the guaranteed intervals of every sample of two gyros that fail together."""
    flight = Flight("skewed_two_faults.csv", "matasov")
    config = flight.config.replace("noise", bound_deg_s=BOUND_DEG_S)
    each = np.arange(len(flight.table.time_s))
    survey = Survey(table=flight.table, windows=spans(flight.table, each, each + 1), config=config)
    (evidence,) = plugin("detectors", "guaranteed")().detect(survey)
    thin = slice(None, None, 5)
    lines = []
    for name, colour in (("g2", ONE), ("g3", ANOTHER)):
        k = flight.table.names.index(name)
        low, high = (np.degrees(v[thin, k]) for v in (evidence.low, evidence.high))
        lines.append(
            Line(time_s=flight.table.time_s[thin], value=low, high=high, word=name, colour=colour)
        )
    tolerance = flight.config.tolerance.bias_deg_s
    return [
        Panel(
            title=f"guaranteed: error, bound {BOUND_DEG_S:g} deg/s, skewed_two_faults.csv",
            unit="deg/s",
            lines=lines,
            faults=flight.faults,
            levels=[(tolerance, "tolerance"), (-tolerance, "")],
            marks=accused(evidence, flight.table.names.index("g2")),
        )
    ]


def flatline() -> list[Panel]:
    """Draw for how long a gyro has repeated its value, and how long one may."""
    flight = Flight("stuck.bin")
    table, evidence = flight.logged, flight.alone("flatline")
    lines, limit_s = [], 0.0
    for name, colour in (("imu1.z", OTHER), ("imu0.z", ONE)):
        k = table.names.index(name)
        rows = np.flatnonzero(table.valid[:, k])
        start, stop = runs_of_equal(table.rate_rad_s[rows, k])
        time_s = table.time_s[rows]
        held = time_s - np.repeat(time_s[start], stop - start) + table.period_s
        limit_s = longest_ordinary_run(stop - start) * table.period_s
        lines.append(Line(time_s=time_s, value=held, word=name, colour=colour))
    return [
        Panel(
            title="flatline: one value repeated for, stuck.bin",
            unit="s",
            lines=lines,
            faults=flight.faults,
            levels=[(limit_s, "what quantisation explains")],
            marks=accused(evidence, table.names.index("imu0.z")),
            logarithmic=True,
        )
    ]


def dropout() -> list[Panel]:
    """Draw for how long each source has been silent."""
    flight = Flight("dropout.bin")
    table, evidence = flight.logged, flight.alone("dropout")
    lines = []
    for source, colour in (("imu0", OTHER), ("imu2", OTHER), ("imu1", ONE)):
        rows = np.flatnonzero(table.valid[:, table.names.index(f"{source}.x")])
        last = np.maximum(np.searchsorted(rows, np.arange(len(table.time_s)), "right") - 1, 0)
        silent = np.maximum(table.time_s - table.time_s[rows[last]], 0.0)
        lines.append(Line(time_s=table.time_s, value=silent, word=source, colour=colour))
    return [
        Panel(
            title="dropout: time since the last reading, dropout.bin",
            unit="s",
            lines=lines,
            faults=flight.faults,
            levels=[(flight.config.tolerance.dropout_s, "tolerance.dropout_s")],
            marks=accused(evidence, table.names.index("imu1.x")),
        )
    ]


def impulse() -> list[Panel]:
    """Draw what a gyro differs by from the two others of its axis."""
    flight = Flight("impulses.bin")
    table, evidence = flight.logged, flight.alone("impulse")
    k = table.names.index("imu0.x")
    peers = np.flatnonzero(table.along(k))
    off = np.degrees(table.rate_rad_s[:, k] - table.rate_rad_s[:, peers].mean(axis=1))
    known = np.isfinite(off)
    hits = accused(evidence, k)
    return [
        Panel(
            title="impulse: imu0.x less the mean of imu1.x and imu2.x, impulses.bin",
            unit="deg/s",
            lines=[Line(time_s=table.time_s[known], value=off[known], colour=ONE)],
            faults=[],
            levels=[(flight.config.tolerance.impulse_deg_s, "tolerance.impulse_deg_s")],
            marks=hits,
        )
    ]


def noise() -> list[Panel]:
    """Draw the ratio of a gyro's noise to that of the others."""
    flight = Flight("noise.bin")
    _, evidence = flight.asked("noise", 10.0)
    t = middles(evidence)
    lines = []
    for name, colour in (("imu1.x", OTHER), ("imu2.x", ONE)):
        k = flight.table.names.index(name)
        low, high = evidence.low[:, k], evidence.high[:, k]
        lines.append(Line(time_s=t, value=low, high=high, word=name, colour=colour))
    return [
        Panel(
            title="noise: ratio to the other gyros by 10 s windows, noise.bin",
            unit="factor",
            lines=lines,
            faults=flight.faults,
            levels=[(flight.config.tolerance.noise_factor, "tolerance.noise_factor")],
            marks=accused(evidence, flight.table.names.index("imu2.x")),
            logarithmic=True,
        )
    ]


def write_vessel(folder: Path) -> None:
    """Write the log of the observer, and the configuration that goes with it."""
    sailed = voyage(SEED)
    rows = ["time_s,gyro.z,boat.sway [m/s],boat.rudder [rad]"]
    columns = (sailed.time_s, sailed.measured[:, 1], sailed.measured[:, 0], sailed.rudder_rad)
    rows += [
        f"{time_s:.2f},{rate:.5f},{sway:.4f},{rudder:.4f}"
        for time_s, rate, sway, rudder in zip(*columns, strict=True)
    ]
    dynamics, inputs = (np.round(matrix, 6).tolist() for matrix in vessel())
    text = f"""\
# fdilog analyse vessel.csv --config vessel.toml
[observer]
outputs = ["boat.sway", "gyro.z"]
inputs = ["boat.rudder"]
A = {dynamics}
B = {inputs}
healthy_s = [0, 19]
"""
    (folder / "vessel.csv").write_text("\n".join(rows) + "\n", encoding="utf-8", newline="\n")
    (folder / "vessel.toml").write_text(text, encoding="utf-8", newline="\n")


def observer(folder: Path) -> list[Panel]:
    """Draw the length of the residual, and on whose line it lies."""
    write_vessel(folder)
    config = load_config(folder / "vessel.toml")
    recording = read(folder / "vessel.csv")
    assembly = assemble(recording, config)
    signals, _ = find_signals(recording, ["boat.sway", "boat.rudder"], assembly.zero_ns)
    whole = spans(assembly.table, np.array([0]), np.array([len(assembly.table.time_s)]))
    watch = watched(Survey(table=assembly.table, windows=whole, config=config, signals=signals))
    found = alarms(watch, config)
    faults = [(start_s, end_s) for _, start_s, end_s, _ in FAILURES]
    length = np.linalg.norm(watch.residual, axis=1)
    beside = np.sqrt(np.maximum(length[:, None] ** 2 - (watch.residual @ watch.lines.T) ** 2, 0.0))
    return [
        Panel(
            title="observer: length of the residual, vessel.csv (gyro 20-30 s, speed 50-70 s)",
            unit="noise",
            lines=[Line(time_s=watch.time_s, value=length, colour=ONE)],
            faults=faults,
            levels=[(watch.threshold, "threshold")],
            marks=[(alarm.start_s, alarm.end_s) for alarm in found],
        ),
        Panel(
            title="what lies beside the line of each sensor: the failed one has the least",
            unit="noise",
            lines=[
                Line(time_s=watch.time_s, value=beside[:, 0], word="speed", colour=ANOTHER),
                Line(time_s=watch.time_s, value=beside[:, 1], word="gyro", colour=ONE),
            ],
            faults=faults,
            most=6.0,
            least=0.0,
        ),
    ]


def pictures(folder: Path) -> dict[str, list[Panel]]:
    """Draw all of them."""
    aligned = Flight("three_imus_bias.bin")
    skewed = Flight("skewed_bias.csv", "mirrored-triads")
    deg, g2 = float(np.degrees(1.0)), ("g2",)
    return {
        "parity": interval("parity", aligned, "imu1.y", 5.0),
        "difference": interval("difference", skewed, "g2", 1.0),
        "least-squares": interval("least-squares", skewed, "g2", 5.0),
        "mean-modulus": statistic(
            "mean-modulus", skewed, g2, lambda z, h: mean_modulus(z, h)[0], "deg/s", scale=deg
        ),
        "mean-square": statistic(
            "mean-square", skewed, g2, lambda z, h: mean_square(z, h)[0], "(deg/s)²",
            scale=deg**2, logarithmic=True,
        ),
        "rate-deviation": statistic(
            "rate-deviation", skewed, g2, lambda z, h: mean_square_rate_deviation(z, h)[0],
            "(deg/s)²", scale=deg**2, logarithmic=True,
        ),
        "kalman": statistic(
            "kalman", skewed, g2, last_innovation_ratio, "ratio", logarithmic=True,
            least=1e-4, most=1e6,
        ),
        "determinants": statistic("determinants", skewed, g2, struck_determinants, "distance"),
        "condition": statistic(
            "condition", skewed, g2, struck_conditions, "cond", logarithmic=True
        ),
        "one-norm": statistic("one-norm", skewed, g2, one_norm_errors, "deg/s", scale=deg),
        "least-absolute": statistic(
            "least-absolute", skewed, g2, least_absolute_errors, "deg/s", scale=deg
        ),
        "joint": joint(),
        "guaranteed": guaranteed(),
        "flatline": flatline(),
        "dropout": dropout(),
        "impulse": impulse(),
        "noise": noise(),
        "observer": observer(folder),
    }  # fmt: skip


def main(folder: Path) -> None:
    """Write every picture."""
    (folder / "pictures").mkdir(parents=True, exist_ok=True)
    for name, panels in pictures(folder).items():
        text = svg(panels)
        if len(text.encode()) > MOST_BYTES:
            raise SystemExit(f"{name}: {len(text)} bytes")
        path = folder / "pictures" / f"{name}.svg"
        path.write_text(text, encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE)
