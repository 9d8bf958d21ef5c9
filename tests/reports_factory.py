"""Builds `Analysis` objects by hand, so that reports are tested without any detector."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.analysis import Analysis, ClockOffset, Completeness, Isolability, LogInfo
from fdilog.config import Config
from fdilog.finding import Evidence, Finding, Interval, Size, Windows
from fdilog.maths.geometry import blocks, detectable, isolability_groups, leave_one_out
from fdilog.recording import Problem
from fdilog.sources.gyros import SourceInfo
from fdilog.table import Channel, ChannelTable
from fdilog.windows.calibration import Calibration

DEG = np.pi / 180.0


def channels(sources: int, rate_hz: float, samples: int) -> tuple[Channel, ...]:
    return tuple(
        Channel(
            name=f"imu{source}.{axis}",
            source=f"imu{source}",
            axis=tuple(float(k == place) for k in range(3)),  # type: ignore[arg-type]
            rate_hz=rate_hz,
            samples=samples,
        )
        for source in range(sources)
        for place, axis in enumerate("xyz")
    )


def table(
    *, sources: int = 3, duration_s: float = 120.0, rate_hz: float = 50.0, noise_deg_s: float = 0.5
) -> ChannelTable:
    """Aligned triads on one motion, with white noise."""
    random = np.random.default_rng(1)
    time_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    motion = 20.0 * DEG * np.sin(time_s[:, None] * np.array([0.7, 1.1, 0.3]))
    rate = np.tile(motion, (1, sources))
    rate += random.normal(0.0, noise_deg_s * DEG, rate.shape)
    return ChannelTable(
        time_s=time_s,
        rate_rad_s=rate,
        valid=np.ones(rate.shape, bool),
        channels=channels(sources, rate_hz, len(time_s)),
        period_s=1.0 / rate_hz,
    )


def with_error(
    made: ChannelTable, channel: str, start_s: float, end_s: float, error_deg_s: float
) -> ChannelTable:
    """Add a constant to one channel for a while."""
    rate = made.rate_rad_s.copy()
    rows = (made.time_s >= start_s) & (made.time_s <= end_s)
    rate[rows, made.names.index(channel)] += error_deg_s * DEG
    return dataclasses.replace(made, rate_rad_s=rate)


def without(made: ChannelTable, names: list[str], start_s: float, end_s: float) -> ChannelTable:
    """Take away some channels' readings for a while."""
    rate, valid = made.rate_rad_s.copy(), made.valid.copy()
    rows = (made.time_s >= start_s) & (made.time_s <= end_s)
    columns = [made.names.index(name) for name in names]
    rate[np.ix_(rows, columns)] = np.nan
    valid[np.ix_(rows, columns)] = False
    return dataclasses.replace(made, rate_rad_s=rate, valid=valid)


def windows(made: ChannelTable, length_s: float) -> Windows:
    """Windows that overlap by half."""
    n = len(made.time_s)
    width = max(1, round(length_s / made.period_s)) if made.period_s > 0 else 1
    start = np.arange(0, max(1, n - width + 1), max(1, width // 2)) if n else np.zeros(0, int)
    stop = np.minimum(start + width, n)
    return Windows(
        length_s=length_s,
        start=start.astype(np.int64),
        stop=stop.astype(np.int64),
        start_s=made.time_s[start],
        end_s=made.time_s[stop - 1],
    )


def evidence(
    made: ChannelTable, length_s: float = 5.0, *, detector: str = "difference"
) -> Evidence:
    """Windowed means of leave-one-out residuals with an interval of three standard errors."""
    cut = windows(made, length_s)
    rows = np.nan_to_num(leave_one_out(made.axes))
    residual = made.rate_rad_s @ rows.T
    shape = (len(cut), len(made.channels))
    low, high = np.full(shape, np.nan), np.full(shape, np.nan)
    for k in range(len(cut)):
        part = residual[cut.start[k] : cut.stop[k]]
        half = 3.3 * part.std(axis=0) / np.sqrt(max(1, len(part) / 5))
        low[k], high[k] = part.mean(axis=0) - half, part.mean(axis=0) + half
    known = np.isfinite(low) & detectable(made.axes)
    low, high = np.where(known, low, -np.inf), np.where(known, high, np.inf)
    tolerance = np.full(shape, 1.0 * DEG)
    return Evidence(
        detector=detector,
        kind="bias",
        windows=cut,
        tested=known,
        low=low,
        high=high,
        tolerance=tolerance,
        accused=((low > tolerance) | (high < -tolerance)).astype(np.int8),
        confidence=0.999,
    )


def bias(
    suspects: tuple[str, ...] = ("imu1.y",),
    deg_s: float = 2.0,
    half_deg_s: float = 0.3,
    **more: Any,
) -> Finding:
    values: dict[str, Any] = {
        "kind": "bias",
        "suspects": suspects,
        "start_s": 40.1,
        "end_s": 60.2,
        "size": Size(
            estimate=deg_s * DEG,
            low=(deg_s - half_deg_s) * DEG,
            high=(deg_s + half_deg_s) * DEG,
            confidence=0.999,
            unit="rad/s",
        ),
        "guaranteed": Interval(low=(deg_s - 1.2) * DEG, high=(deg_s + 1.2) * DEG),
        "detectors": ("difference", "guaranteed", "parity"),
        "dissent": (),
        "detail": "seen in windows of 1, 5 and 10 s",
    }
    return Finding(**{**values, **more})


def analysis(made: ChannelTable | None = None, **more: Any) -> Analysis:
    """Make a healthy analysis of three aligned triads, changed by whatever is given."""
    made = table() if made is None else made
    axes = made.axes
    compared = detectable(axes) if len(axes) else np.zeros(0, bool)
    sigma: NDArray[np.float64] = np.full(len(made.channels), 0.5 * DEG)
    values: dict[str, Any] = {
        "log": LogInfo(
            path="flights/2024-05-01 copter.bin",
            format="dataflash",
            bytes=8_123_456,
            sha256="9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08",
            start_utc="2024-05-01T13:04:42.200Z",
            duration_s=made.duration_s,
            vehicle={"type": "copter", "firmware": "ArduCopter V4.3.6"},
        ),
        "completeness": Completeness(
            whole=True,
            bytes_lost=0,
            seconds_lost=0.0,
            problems=(
                Problem(what="DataFlash has no checksums: whole as far as can be told", note=True),
            ),
        ),
        "sources": tuple(
            SourceInfo(
                name=name,
                topic=f"IMU[{place}]",
                used=True,
                reason="raw gyro of three axes at the highest rate",
                rate_hz=50.0,
                samples=len(made.time_s),
                derived=False,
            )
            for place, name in enumerate(dict.fromkeys(c.source for c in made.channels))
        ),
        "table": made,
        "status": tuple("healthy" if seen else "insufficient" for seen in compared),
        "sigma_rad_s": tuple(sigma.tolist()),
        "clocks": (),
        "calibration": (),
        "isolability": Isolability(
            detectable=tuple(n for n, seen in zip(made.names, compared, strict=True) if seen),
            groups=tuple(
                tuple(made.names[i] for i in group)
                for group in (isolability_groups(axes) if len(axes) else [])
            ),
        ),
        "verdict": "healthy",
        "findings": (),
        "evidence": (evidence(made),) if len(made.channels) and blocks(axes) else (),
        "config": Config(),
    }
    return Analysis(**{**values, **more})


def status_of(made: ChannelTable, **states: str) -> tuple[str, ...]:
    """Make every channel healthy but those given, as imu1_y="failed"."""
    return tuple(states.get(name.replace(".", "_"), "healthy") for name in made.names)


def failed_analysis(**more: Any) -> Analysis:
    """Three triads of which imu1.y read 2 deg/s too much for 20 s, and imu2 fell silent."""
    made = with_error(table(), "imu1.y", 40.1, 60.2, 2.0)
    made = without(made, ["imu2.x", "imu2.y", "imu2.z"], 80.0, 90.0)
    values: dict[str, Any] = {
        "status": status_of(made, imu1_y="failed", imu0_z="undecided"),
        "verdict": "failed",
        "findings": (bias(),),
        "clocks": (
            ClockOffset(source="imu1", offset_s=0.0012, low=0.0009, high=0.0015),
            ClockOffset(source="imu2", offset_s=-0.0031, low=float("-inf"), high=float("inf")),
        ),
        "calibration": (
            Calibration(
                source="imu1",
                rotation_deg=(0.12, -0.4, 1.03),
                scale=(1.001, 0.998, 1.0),
                bias_rad_s=(0.001, -0.002, 0.0),
                note="from 62 s of motion",
            ),
        ),
    }
    return analysis(made, **{**values, **more})


def pair_analysis(**more: Any) -> Analysis:
    """Two triads of which one x gyro is wrong, nobody can tell which; part of the log is lost."""
    made = with_error(table(sources=2), "imu0.x", 30.0, 70.0, -3.0)
    values: dict[str, Any] = {
        "status": status_of(made, imu0_x="suspect", imu1_x="suspect"),
        "verdict": "failed",
        "findings": (bias(("imu0.x", "imu1.x"), deg_s=-3.0, start_s=30.0, end_s=70.0),),
        "completeness": Completeness(
            whole=False,
            bytes_lost=12_345,
            seconds_lost=4.2,
            problems=(
                Problem(
                    what="damaged records", offset=1_048_576, bytes_lost=12_345, seconds_lost=4.2
                ),
                Problem(what="incomplete last record", offset=8_123_400, bytes_lost=56, note=True),
            ),
        ),
    }
    return analysis(made, **{**values, **more})
