"""Faults of one gyro as pure functions of its readings: what a simulator or an injector adds.

A fault is active at every reading with ``start_s <= time_s <= end_s``; outside of that span the
readings stay as they are, to the last bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UsageError, nearest

FaultKind = Literal[
    "bias", "drift", "scale", "noise", "impulse", "saturated", "stuck", "dead", "dropout",
    "mounting",
]  # fmt: skip
KINDS: tuple[str, ...] = get_args(FaultKind)

SIZE_UNITS: Mapping[str, str] = MappingProxyType(
    {
        "bias": "rad/s",
        "drift": "rad/s^2",
        "scale": "1",
        "noise": "1",
        "impulse": "rad/s",
        "saturated": "rad/s",
        "mounting": "rad",
    }
)
"""Unit of a fault's size; kinds that are missing here have none."""
MAY_HAVE_NO_SIZE = ("mounting",)

# Third differences of white noise have 1 + 9 + 9 + 1 times its variance.
THIRD_DIFFERENCE_GAIN = math.sqrt(20.0)
# Median absolute deviation of a normal variable, in standard deviations: the quantile at 3/4.
NORMAL_MAD = 0.6744897501960817


@dataclass(frozen=True, kw_only=True)
class Fault:
    """What goes wrong with one gyro, when, and by how much.

    Parameters
    ----------
    kind
        ``bias``: the reading is too large by ``size``. [rad/s]
        ``drift``: it is too large by ``size`` times the time since the start. [rad/s^2]
        ``scale``: it is multiplied by ``size``: 1.2 reads 20 % too much. [1]
        ``noise``: the standard deviation of its own noise is multiplied by ``size``. [1]
        ``impulse``: ``count`` single readings are too large by ``size``. [rad/s]
        ``saturated``: it reads no more than ``size`` either way. [rad/s]
        ``stuck``: it repeats the last reading before the start.
        ``dead``: it reads zero.
        ``dropout``: its whole source has no readings.
        ``mounting``: its whole source is turned by ``size`` about this channel's axis [rad], as
        `turned_about` has it; without a size, the channel alone reads with the wrong sign.
    channel
        Name of the channel, ``imu1.y``; for a dropout its source will do, ``imu1``.
    start_s, end_s
        First and last instant, in flight time. [s]
    count
        How many impulses, spread evenly over the span, the first at its first reading.

    Raises
    ------
    UsageError
        If the kind is unknown, or the size or span makes no sense for it.
    """

    kind: FaultKind
    channel: str
    start_s: float = 0.0
    end_s: float = math.inf
    size: float | None = None
    count: int = 1

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"no fault of kind '{self.kind}'{nearest(self.kind, list(KINDS))}")
        if not (math.isfinite(self.start_s) and self.start_s <= self.end_s):
            raise UsageError(f"{self.kind} of {self.channel}: it starts after it ends")
        self._check_size()
        if self.count < 1 or (self.count > 1 and self.kind != "impulse"):
            raise UsageError(f"{self.kind} of {self.channel}: count = {self.count} has no meaning")

    def _check_size(self) -> None:
        unit = SIZE_UNITS.get(self.kind)
        if unit is None:
            if self.size is not None:
                raise UsageError(f"{self.kind} of {self.channel}: this kind has no size")
            return
        if self.size is None and self.kind in MAY_HAVE_NO_SIZE:
            return
        if self.size is None or not math.isfinite(self.size):
            raise UsageError(f"{self.kind} of {self.channel}: needs a size [{unit}]")
        if self.kind == "noise" and self.size < 1.0:
            raise UsageError(f"noise of {self.channel}: a factor below 1 cannot be added")
        if self.kind == "saturated" and self.size <= 0.0:
            raise UsageError(f"saturated of {self.channel}: the limit must be above zero")

    def to_dict(self) -> dict[str, Any]:
        """Return the truth as plain JSON values; an end that never comes is null."""
        truth: dict[str, Any] = {
            "kind": self.kind,
            "channel": self.channel,
            "start_s": self.start_s,
            "end_s": None if math.isinf(self.end_s) else self.end_s,
            "size": self.size,
            "unit": SIZE_UNITS.get(self.kind),
        }
        if self.kind == "impulse":
            truth["count"] = self.count
        return truth

    @classmethod
    def from_dict(cls, truth: Mapping[str, Any]) -> Fault:
        """Make a fault from what `to_dict` gave."""
        end_s = truth.get("end_s")
        return cls(
            kind=truth["kind"],
            channel=truth["channel"],
            start_s=truth["start_s"],
            end_s=math.inf if end_s is None else end_s,
            size=truth.get("size"),
            count=truth.get("count", 1),
        )


def touched(fault: Fault, time_s: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the readings that a fault changes or, if it is a dropout, removes.

    Parameters
    ----------
    time_s : (n_samples,)
        Flight time of each reading; not-a-number is never touched. [s]

    Returns
    -------
    touched : (n_samples,) bool
    """
    span: NDArray[np.bool_] = (time_s >= fault.start_s) & (time_s <= fault.end_s)
    inside = np.flatnonzero(span)
    if fault.kind != "impulse" or not len(inside):
        return span
    hits = np.zeros(len(time_s), bool)
    hits[inside[np.arange(fault.count) * len(inside) // fault.count]] = True
    return hits


def apply(
    fault: Fault,
    time_s: NDArray[np.float64],
    rate_rad_s: NDArray[np.floating[Any]],
    rng: np.random.Generator,
    noise_rad_s: float | NDArray[np.float64] = 0.0,
) -> NDArray[np.float64]:
    """Put a fault into the readings of one channel.

    Parameters
    ----------
    time_s : (n_samples,)
        Flight time of each reading. [s]
    rate_rad_s : (n_samples,)
        Readings z. [rad/s]
    rng
        Draws the added noise; no other kind uses it.
    noise_rad_s : () or (n_samples,)
        Standard deviation of the channel's own noise, which a fault of kind ``noise`` multiplies;
        see `noise_sigma`. [rad/s]

    Returns
    -------
    rate_rad_s : (n_samples,)
        Readings with the fault; not-a-number where a dropout leaves none. [rad/s]

    Raises
    ------
    UsageError
        If noise is to be multiplied but there is none.
    """
    rate = np.array(rate_rad_s, np.float64)
    hit = touched(fault, time_s)
    if not hit.any():
        return rate
    size = 0.0 if fault.size is None else fault.size
    match fault.kind:
        case "bias" | "impulse":
            rate[hit] += size
        case "drift":
            rate[hit] += size * (time_s[hit] - fault.start_s)
        case "scale" | "mounting":
            rate[hit] *= _factor(fault)
        case "noise":
            rate[hit] += _added_noise(fault, noise_rad_s, len(rate), rng)[hit]
        case "saturated":
            rate[hit] = np.clip(rate[hit], -size, size)
        case "stuck":
            rate[hit] = rate[max(int(np.argmax(hit)) - 1, 0)]
        case "dead":
            rate[hit] = 0.0
        case "dropout":
            rate[hit] = np.nan
    return rate


def _factor(fault: Fault) -> float:
    """By what a channel's readings are multiplied; a turn about its own axis leaves them."""
    if fault.kind == "mounting":
        return -1.0 if fault.size is None else 1.0
    return 0.0 if fault.size is None else fault.size


def turns_source(fault: Fault) -> bool:
    """Tell whether a fault turns a whole device, and so needs all of its readings at once."""
    return fault.kind == "mounting" and fault.size is not None


def turned_about(
    fault: Fault, time_s: NDArray[np.float64], rates_rad_s: NDArray[np.floating[Any]], axis: int
) -> NDArray[np.float64]:
    """Turn a device about one of its axes while a fault lasts.

    Parameters
    ----------
    time_s : (n_samples,)
        Flight time of each reading. [s]
    rates_rad_s : (n_samples, 3)
        Readings along x, y, z. [rad/s]
    axis
        Which of them it is turned about, by ``fault.size``, right-handed.

    Returns
    -------
    rates_rad_s : (n_samples, 3)
        What the device reads: the body rate along its own axes. [rad/s]

    Raises
    ------
    UsageError
        If the device does not have three axes.
    """
    rates = np.array(rates_rad_s, np.float64)
    if rates.shape[1] != 3:
        raise UsageError(f"mounting of {fault.channel}: only a device of three axes can be turned")
    angle, hit = fault.size or 0.0, touched(fault, time_s)
    first, second = rates[hit, (axis + 1) % 3], rates[hit, (axis + 2) % 3]
    rates[hit, (axis + 1) % 3] = math.cos(angle) * first + math.sin(angle) * second
    rates[hit, (axis + 2) % 3] = math.cos(angle) * second - math.sin(angle) * first
    return rates


def _added_noise(
    fault: Fault, noise_rad_s: float | NDArray[np.float64], n: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """White noise that makes the whole of the channel's noise ``size`` times as large."""
    if not bool((np.asarray(noise_rad_s) > 0.0).any()):
        raise UsageError(f"noise of {fault.channel}: the channel has no noise to multiply")
    # Variances add: k^2 s^2 = s^2 + (k^2 - 1) s^2. All n are drawn, so that moving the span of
    # the fault does not change what is added where the spans overlap.
    missing = math.sqrt((fault.size or 1.0) ** 2 - 1.0)
    return missing * np.asarray(noise_rad_s) * rng.standard_normal(n)


def noise_sigma(rate_rad_s: NDArray[np.floating[Any]]) -> float:
    """Estimate the standard deviation of the noise in one channel of a flight, motion left out.

    The median absolute third difference: a quadratic, and so nearly all of a flight that is slow
    against the sampling, has none. Exact for white noise; aliased vibration counts as noise.

    Parameters
    ----------
    rate_rad_s : (n_samples,)
        Readings z; not-a-number is left out. [rad/s]

    Returns
    -------
    sigma
        0 for fewer than four readings. [rad/s]
    """
    third = np.diff(np.asarray(rate_rad_s, np.float64), n=3)
    third = third[np.isfinite(third)]
    if not len(third):
        return 0.0
    return float(np.median(np.abs(third))) / (NORMAL_MAD * THIRD_DIFFERENCE_GAIN)
