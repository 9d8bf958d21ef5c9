"""The boat of `fdilog.reproduce.observer` as logs and configurations, for tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from fdilog.config import Config
from fdilog.detectors.observer import held_step, propagate
from fdilog.maths.geometry import Floats
from fdilog.reproduce.observer import NOISE, vessel, voyage
from fdilog.sources.signals import Signal
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, spans
from tests.tables import table_of

OUTPUTS = ("boat.sway", "imu0.z")


def write_voyage(path: Path, seed: int = 20240817) -> None:
    """Write the timeline of the paper as a table: gyro, sway speed and rudder."""
    sailed = voyage(seed)
    rows = ["time_s,gyro.z,boat.sway [m/s],boat.rudder [rad]"]
    rows += [
        f"{time_s:.2f},{rate:.6f},{sway:.6f},{rudder:.6f}"
        for time_s, rudder, (sway, rate) in zip(
            sailed.time_s, sailed.rudder_rad, sailed.measured, strict=True
        )
    ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")


def configured(**keys: Any) -> Config:
    """A configuration with the boat's true model, and other keys of [observer]."""
    dynamics, inputs = vessel()
    known = {
        "outputs": OUTPUTS,
        "inputs": ("boat.rudder",),
        "A": tuple(map(tuple, dynamics.tolist())),
        "B": tuple(map(tuple, inputs.tolist())),
        "healthy_s": (0.0, 40.0),
    }
    return Config().replace("observer", **{**known, **keys})


def sailed(
    config: Config,
    *,
    seconds: float = 120.0,
    step_s: float = 0.05,
    faults: dict[str, Floats] | None = None,
    seed: int = 0,
) -> Survey:
    """A survey of the boat in a zigzag; faults are added to the sensors, a row a sample."""
    dynamics, inputs = vessel()
    time_s = np.arange(round(seconds / step_s)) * step_s
    rudder = 0.17 * np.sign(np.sin(time_s * 2 * np.pi / 16.0 + 0.1))
    step, held = held_step(dynamics, inputs, step_s)
    states = propagate(step, rudder[:-1, None] @ held.T, np.zeros(2))
    states = states + np.random.default_rng(seed).normal(0.0, NOISE, states.shape)
    off = faults or {}
    table = gyros(time_s, states[:, 1] + off.get("imu0.z", 0.0))
    sway = states[:, 0] + off.get("boat.sway", 0.0)
    return survey_of(table, config, sway, rudder)


def gyros(time_s: Floats, yaw_rate: Floats) -> ChannelTable:
    """One triad that turns about z only."""
    rates = np.random.default_rng(9).normal(0.0, 0.002, (len(time_s), 3))
    rates[:, 2] = yaw_rate
    return table_of(time_s, rates)


def survey_of(table: ChannelTable, config: Config, sway: Floats, rudder: Floats) -> Survey:
    """What the detector is shown of a table with a speed and a rudder beside it."""
    signals = {
        name: Signal(name=name, unit=unit, time_s=table.time_s, values=values)
        for name, unit, values in (("boat.sway", "m/s", sway), ("boat.rudder", "rad", rudder))
    }
    whole = spans(table, np.array([0]), np.array([len(table.time_s)]))
    return Survey(table=table, windows=whole, config=config, signals=signals)
