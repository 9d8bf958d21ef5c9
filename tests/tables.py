"""Tables of redundant gyros for tests, seeded, with a known fault in them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.geometry import named_axes
from fdilog.maths.noise import quantisation_step
from fdilog.table import Channel, ChannelTable

DEG = np.pi / 180.0


def triads(
    n_triads: int = 3,
    *,
    seconds: float = 60.0,
    rate_hz: float = 50.0,
    sigma_deg_s: float = 0.5,
    seed: int = 1,
) -> ChannelTable:
    """Aligned triads in slow manoeuvres with white noise of their own."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    phase = np.array([0.0, 1.0, 2.0])
    body = 10.0 * DEG * np.sin(2 * np.pi * time_s[:, None] * [0.11, 0.07, 0.05] + phase)
    rate = np.tile(body, (1, n_triads)) + rng.normal(
        0, sigma_deg_s * DEG, (len(time_s), 3 * n_triads)
    )
    return table_of(time_s, rate)


def table_of(time_s: NDArray[np.float64], rate: NDArray[np.float64]) -> ChannelTable:
    """Aligned triads imu0, imu1 ... with these readings; NaN is no reading."""
    valid = np.isfinite(rate)
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    channels = tuple(
        Channel(
            name=f"imu{k // 3}.{'xyz'[k % 3]}",
            source=f"imu{k // 3}",
            axis=tuple(float(k % 3 == axis) for axis in range(3)),  # type: ignore[arg-type]
            rate_hz=1.0 / step if step else 0.0,
            samples=int(valid[:, k].sum()),
            step_rad_s=quantisation_step(rate[valid[:, k], k]),
        )
        for k in range(rate.shape[1])
    )
    return ChannelTable(
        time_s=time_s, rate_rad_s=rate, valid=valid, channels=channels, period_s=step
    )


def changed(
    table: ChannelTable, channel: str, start_s: float, end_s: float, **how: float
) -> ChannelTable:
    """Return the table with ``add`` added to, or ``put`` in place of, one channel's readings."""
    rate = table.rate_rad_s.copy()
    rows = (table.time_s >= start_s) & (table.time_s < end_s)
    column = table.names.index(channel)
    rate[rows, column] = how["put"] if "put" in how else rate[rows, column] + how["add"]
    return table_of(table.time_s, rate)


def unit(
    geometry: str,
    channels: int | None = None,
    *,
    seconds: float = 30.0,
    rate_hz: float = 50.0,
    sigma_deg_s: float = 0.3,
    seed: int = 1,
) -> ChannelTable:
    """Gyros of a named geometry in slow manoeuvres with white noise of their own."""
    axes = named_axes(geometry, channels)
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    body = 10.0 * DEG * np.sin(2 * np.pi * time_s[:, None] * [0.31, 0.27, 0.23] + [0.0, 1.0, 2.0])
    rate = body @ axes.T + rng.normal(0, sigma_deg_s * DEG, (len(time_s), len(axes)))
    return ChannelTable(
        time_s=time_s,
        rate_rad_s=rate,
        valid=np.ones(rate.shape, bool),
        channels=tuple(
            Channel(
                name=f"g{k}",
                source=f"s{k // 3}",
                axis=(float(axis[0]), float(axis[1]), float(axis[2])),
                rate_hz=rate_hz,
                samples=len(time_s),
            )
            for k, axis in enumerate(axes)
        ),
    )


def put(table: ChannelTable, rate: NDArray[np.float64]) -> ChannelTable:
    """Return the table with other readings on the same axes; NaN is no reading."""
    return replace(table, rate_rad_s=rate, valid=np.isfinite(rate))


def biased(
    table: ChannelTable, channel: int, size_deg_s: float, start_s: float, end_s: float
) -> ChannelTable:
    """Return the table with one channel off by a constant for a while."""
    rate = table.rate_rad_s.copy()
    rate[(table.time_s >= start_s) & (table.time_s < end_s), channel] += size_deg_s * DEG
    return put(table, rate)
