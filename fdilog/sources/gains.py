"""Devices and gyros that read a multiple of what the others do, all along.

A device set to another range, or logged in another unit, differs from the others by a factor of two
or more, and so do its noise and its biases. That is one fault: it is recognised before anything is
compared, and the comparison goes on with its rates divided by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import SIZE_UNIT, Finding, Size
from fdilog.maths.noise import NORMAL_CONSISTENCY
from fdilog.maths.student import student_quantile
from fdilog.sources.devices import Devices, triads_of
from fdilog.sources.mounting_words import AXES
from fdilog.table import PARALLEL, ChannelTable

Floats = NDArray[np.float64]

DETECTOR = "gains"
LEAST_FACTOR = float(np.sqrt(2.0))
"""Ranges differ by factors of two; what is off by less is told with the other scale errors."""

DEGREES = float(np.degrees(1.0))
ALIKE = 1.05
"""A factor within five per cent of the degrees in a radian is that one: gyros are better."""

PIECES = 12
FEWEST_PIECES = 4
FEWEST_CELLS = 5
"""The flight is cut into up to so many pieces of so many half seconds at least, and each tells by
itself: a fault in one of them does not matter."""

FOLLOWED = 0.5
"""A piece tells if half of the variance of either is that of the other."""

CONFIDENCE = 0.999

MEDIAN_SIGMA = 1.2533
"""How much less a median tells than a mean."""


class Factor(NamedTuple):
    """What some readings are over others: the likeliest value, and its interval. [1]"""

    low: float
    value: float
    high: float

    @property
    def far(self) -> bool:
        """Whether it is one factor, as at full scale it is not, and surely far from one."""
        one = self.high < self.low * LEAST_FACTOR
        return one and (self.low > LEAST_FACTOR or self.high < 1.0 / LEAST_FACTOR)

    @property
    def inverse(self) -> Factor:
        """What the others are over these."""
        return Factor(1.0 / self.high, 1.0 / self.value, 1.0 / self.low)


@dataclass(frozen=True, kw_only=True, eq=False)
class Gain:
    """A device or gyro that reads a multiple of what the others do.

    Parameters
    ----------
    source
        Whose rates are divided; one of ``among``, or the only one.
    among
        The devices that may be the one.
    axes
        Numbers of the body axes concerned.
    factor
        What ``source`` reads over what the others do.
    """

    source: str
    among: tuple[str, ...]
    axes: tuple[int, ...]
    factor: Factor

    @property
    def note(self) -> str:
        """What is to be said of the device beside its calibration."""
        return "compared with its rates divided by a factor: see the finding of kind scale"


def gains(table: ChannelTable) -> tuple[Gain, ...]:
    """Find every device, or axis of one, whose rates are a multiple of the others' all along.

    Noise in the reference lessens the slope of a device's rates over it, and noise in the device
    that of the reference over the device: what it reads lies between the two.
    """
    flight = Devices.of(table)
    found: list[Gain] = []
    for source, others in flight.compared():
        among = (source,) if len(others) > 1 or others == flight.derived else (*others, source)
        rate, reading = flight.reference(others), flight.means[source]
        each = [_factor(rate[:, k : k + 1], reading[:, k : k + 1]) for k in range(3)]
        far = {
            k: one
            for k, one in enumerate(each)
            if one is not None and one.far and _one_unit(flight, others, k)
        }
        whole = _factor(rate, reading) if far else None
        spread = [_spread(rate[:, k], reading[:, k]) for k in range(3)]
        if whole is not None and whole.far and _agree(each, spread, whole):
            far = {}
            found.append(Gain(source=source, among=among, axes=(0, 1, 2), factor=whole))
        # A gyro that points along no axis of the body has a part in several.
        along = all(_gyros(table, name, (k,)) for name in (source, *others) for k in far)
        for k, one in far.items() if along else ():
            found.append(Gain(source=source, among=among, axes=(k,), factor=one))
    return tuple(found)


def rescaled(table: ChannelTable, found: Sequence[Gain]) -> ChannelTable:
    """Return the table as if no device read a multiple."""
    for one in found:
        factor = np.ones(len(table.channels))
        factor[_gyros(table, one.source, one.axes)] = one.factor.value
        deviation = table.deviation_rad_s
        table = replace(
            table,
            rate_rad_s=table.rate_rad_s / factor,
            channels=tuple(
                replace(channel, step_rad_s=channel.step_rad_s / by)
                for channel, by in zip(table.channels, factor.tolist(), strict=True)
            ),
            deviation_rad_s=None if deviation is None else deviation / factor,
        )
    return table


def gain_findings(table: ChannelTable, found: Sequence[Gain]) -> list[Finding]:
    """Turn factors into findings, one for each device or axis."""
    findings = []
    for one in found:
        concerned = [k for name in one.among for k in _gyros(table, name, one.axes)]
        # As everywhere, the size is the first suspect's if it is the one.
        factor = one.factor if one.among[0] == one.source else one.factor.inverse
        findings.append(
            Finding(
                kind="scale",
                suspects=tuple(table.names[k] for k in concerned),
                start_s=float(table.time_s[0]),
                end_s=float(table.time_s[-1]),
                size=Size(
                    estimate=factor.value,
                    low=factor.low,
                    high=factor.high,
                    confidence=CONFIDENCE,
                    unit=SIZE_UNIT["scale"],
                ),
                detectors=(DETECTOR,),
                detail=_words(one),
                one_source=len(one.among) == 1 and len(concerned) > 1,
            )
        )
    return findings


def _words(one: Gain) -> str:
    axes = ", ".join(AXES[k] for k in one.axes)
    others = " and ".join(name for name in one.among if name != one.source) or "the others"
    factor = one.factor.value
    said = f"{one.source} reads {factor:.3g} times what {others} read about {axes}"
    if 1.0 / ALIKE < max(factor, 1.0 / factor) / DEGREES < ALIKE:
        said += ", as where degrees and radians are mistaken for one another"
    if len(one.among) > 1:
        said += "; which of them is wrong, this log cannot tell"
    return f"{said}; the comparison goes on with its rates divided by it"


def _gyros(table: ChannelTable, source: str, axes: Sequence[int]) -> list[int]:
    """Columns of a device's gyros: all of them, or those that point along some body axes."""
    columns = triads_of(table)[source]
    if len(axes) == 3:
        return columns
    along = np.abs(table.axes[:, list(axes)]).max(axis=1) > PARALLEL
    return [k for k in columns if along[k]]


def _one_unit(flight: Devices, names: Sequence[str], axis: int) -> bool:
    """Tell whether several devices read the same about an axis: else any of them is the one."""
    pairs = [
        _factor(flight.means[a][:, axis : axis + 1], flight.means[b][:, axis : axis + 1])
        for a, b in combinations(names, 2)
    ]
    return all(one is not None and not one.far for one in pairs)


def _agree(each: Sequence[Factor | None], spread: Sequence[float], whole: Factor) -> bool:
    """Tell whether all axes show one factor; where an axis turns too little, its noise does."""
    low, high = whole.value / LEAST_FACTOR, whole.value * LEAST_FACTOR
    return all(
        low < (one.value if one is not None else size) < high
        for one, size in zip(each, spread, strict=True)
    )


def _spread(rate: Floats, reading: Floats) -> float:
    """Ratio of the usual changes from cell to cell, (n_cells,), of readings to rates."""
    changes = np.abs(np.diff(np.column_stack([rate, reading]), axis=0))
    known = changes[np.isfinite(changes).all(axis=1)]
    usual = np.median(known, axis=0) if len(known) else np.ones(2)
    return float(usual[1] / usual[0]) if usual[0] > 0.0 else np.inf


def _factor(rate: Floats, reading: Floats) -> Factor | None:
    """Tell what readings are over rates, (n_cells, k), all along, if anything."""
    rows = np.flatnonzero((np.isfinite(rate) & np.isfinite(reading)).all(axis=1))
    slopes: list[tuple[float, float]] = []
    number = min(PIECES, len(rows) // FEWEST_CELLS)
    for piece in np.array_split(rows, number) if number >= FEWEST_PIECES else []:
        w, z = rate[piece], reading[piece]
        w, z = w - np.median(w, axis=0), z - np.median(z, axis=0)
        ww, wz, zz = float((w * w).sum()), float((w * z).sum()), float((z * z).sum())
        if wz > 0.0 and wz**2 > FOLLOWED * ww * zz:
            slopes.append((float(np.log(wz / ww)), float(np.log(zz / wz))))
    if len(slopes) < max(FEWEST_PIECES, number / 2):
        return None
    logs = np.array(slopes)
    middle = np.median(logs, axis=0)
    told = np.abs(logs.mean(axis=1)) > np.log(LEAST_FACTOR)
    if told.any() and not told.all():
        # It was sound for a while: that is for the windows.
        return None
    sigma = NORMAL_CONSISTENCY * np.median(np.abs(logs - middle), axis=0)
    quantile = student_quantile(np.array([len(logs) - 1.0]), CONFIDENCE)[0]
    half = quantile * MEDIAN_SIGMA * sigma / np.sqrt(len(logs))
    ends = (middle[0] - half[0], middle.mean(), middle[1] + half[1])
    return Factor(*np.exp(ends).tolist())
