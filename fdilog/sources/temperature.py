"""By how much the offset between two gyros follows a temperature: told, never taken out.

A gyro's bias moves with its temperature, by 0.01 to 0.05 deg/s per kelvin in consumer parts. Where
a log holds the temperature of a device, its offset against the reference is fitted with it. What
is found is said beside the calibration and left in the readings: an offset that the warmth of a
device explains is still an offset, and is held against the tolerance like any other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.maths.noise import NORMAL_CONSISTENCY
from fdilog.maths.student import student_quantile
from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import SourceInfo
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

FIELDS = ("T", "Temp", "temperature")
CELL_S = 2.0
"""Means over two seconds: most of the vibration is gone, and no device warms up in less."""

LEAST_RANGE_K = 2.0
"""A fit over less would be carried far beyond what it was made of, and sensors drift by as much as
a tenth of a kelvin in flight."""

FEWEST_CELLS = 24
PIECES = 12
"""Pieces of the flight of which each is left out once: an offset that wanders for other reasons
gives other slopes without them, and a wide interval."""

SURER = 2.0
"""Half the width of the interval, relative to the slope: four times the data."""

TUKEY = 4.685
ROUNDS = 20
SETTLED = 1e-4
"""Relative change of a slope below which the fit is done; it is told to three digits."""

BELIEVED_C = (-60.0, 125.0)
"""What silicon is specified for; other values are placeholders. [degC]"""


@dataclass(frozen=True, kw_only=True)
class Slope:
    """How an offset along one axis follows a temperature. [rad/s per K]"""

    axis: str
    estimate: float
    low: float
    high: float


def temperatures(
    recording: Recording, sources: Sequence[SourceInfo], zero_ns: int
) -> dict[str, tuple[Floats, Floats]]:
    """Find the temperature of every gyro in use: flight times [s] and values [degC]."""
    streams = {stream.name: stream for stream in recording.streams}
    found = {}
    for source in sources:
        stream = streams.get(source.topic)
        if source.used and not source.derived and stream is not None:
            series = _series(stream, zero_ns)
            if series is not None:
                found[source.name] = series
    return found


def _series(stream: Stream, zero_ns: int) -> tuple[Floats, Floats] | None:
    name = next((field for field in FIELDS if field in stream.columns), None)
    if name is None or not len(stream.time_ns) or bool((np.diff(stream.time_ns) < 0).any()):
        return None
    column = np.asarray(stream.columns[name])
    if column.dtype.kind not in "iuf":
        return None
    values = column.astype(np.float64)
    known = (values > BELIEVED_C[0]) & (values < BELIEVED_C[1])
    if not known.any() or float(np.ptp(values[known])) < LEAST_RANGE_K:
        return None
    return (stream.time_ns[known] - zero_ns) / 1e9, values[known]


def temperature_notes(
    table: ChannelTable, measured: Mapping[str, tuple[Floats, Floats]], confidence: float
) -> dict[str, str]:
    """Say of each source whether its offset from the reference source follows a temperature.

    Parameters
    ----------
    measured
        Flight times [s] and temperatures [degC] of the sources that log them.
    confidence
        Of the intervals of the slopes; one that holds zero is not mentioned.
    """
    triads = {}
    for source in dict.fromkeys(c.source for c in table.channels if not c.derived):
        columns = [k for k, channel in enumerate(table.channels) if channel.source == source]
        if len(columns) == 3 and np.linalg.matrix_rank(table.axes[columns]) == 3:
            triads[source] = table.rate_rad_s[:, columns] @ np.linalg.inv(table.axes[columns]).T
    notes = {}
    names = list(triads)
    for source in names[1:]:
        said = [
            (warm, slopes, span_k)
            for warm in (source, names[0])
            if warm in measured
            for slopes, span_k in [
                _slopes(table.time_s, triads[names[0]], triads[source], measured[warm], confidence)
            ]
            if slopes
        ]
        if said:
            # Two devices warm up together: the other is named only if that is far surer.
            def worth(one: tuple[str, list[Slope], float], own: str = source) -> float:
                return max(_surely(s) for s in one[1]) * (SURER if one[0] == own else 1.0)

            warm, slopes, span_k = max(said, key=worth)
            notes[source] = _words(names[0], warm, slopes, span_k)
    return notes


def _surely(slope: Slope) -> float:
    return abs(slope.estimate) / max((slope.high - slope.low) / 2.0, 1e-300)


def _words(reference: str, warm: str, slopes: Sequence[Slope], span_k: float) -> str:
    parts = [
        f"{slope.axis} {np.degrees(slope.estimate):+.3f} deg/s per kelvin"
        f" ({np.degrees(slope.low):+.3f} to {np.degrees(slope.high):+.3f})"
        for slope in slopes
    ]
    return (
        f"its offset from {reference} follows the temperature of {warm} over {span_k:.1f} K:"
        f" {', '.join(parts)}; left in"
    )


def _slopes(
    time_s: Floats,
    reference: Floats,
    rate: Floats,
    measured: tuple[Floats, Floats],
    confidence: float,
) -> tuple[list[Slope], float]:
    """Fit the offset along each axis; only slopes that are surely not zero, and the range. [K]"""
    cell = np.floor((time_s - time_s[:1]) / CELL_S).astype(np.int64)
    apart = rate - reference
    known = np.isfinite(apart).all(axis=1)
    known &= (time_s >= measured[0][0]) & (time_s <= measured[0][-1])
    if not known.any():
        return [], 0.0
    start = np.flatnonzero(np.diff(cell[known], prepend=-1))
    count = np.diff(np.append(start, int(known.sum())))
    full = count > np.median(count) / 2
    columns = np.column_stack([apart, reference, np.interp(time_s, *measured)])[known]
    means = (np.add.reduceat(columns, start, axis=0) / count[:, None])[full]
    warmth = means[:, 6] - means[:, 6].mean() if len(means) else np.zeros(0)
    if len(means) < FEWEST_CELLS or float(np.ptp(warmth)) < LEAST_RANGE_K:
        return [], 0.0
    # What is in proportion to the rate is misalignment and scale, which is told elsewhere.
    design = np.column_stack([np.ones(len(means)), means[:, 3:6], warmth])
    found = []
    for k, axis in enumerate("xyz"):
        estimate, half = _jackknifed(design, means[:, k], confidence)
        if abs(estimate) > half:
            found.append(
                Slope(axis=axis, estimate=estimate, low=estimate - half, high=estimate + half)
            )
    return found, float(np.ptp(warmth))


def _jackknifed(design: Floats, target: Floats, confidence: float) -> tuple[float, float]:
    """Return the last coefficient of a robust fit, and the half-width of its interval."""
    rows = np.arange(len(target))
    whole, weight = _robust(design, target, np.ones(len(target)))
    left_out = np.array(
        [
            _robust(*(np.delete(part, piece, axis=0) for part in (design, target, weight)))[0]
            for piece in np.array_split(rows, PIECES)
        ]
    )
    variance = (PIECES - 1) / PIECES * float(((left_out - left_out.mean()) ** 2).sum())
    quantile = float(student_quantile(np.array([PIECES - 1.0]), confidence)[0])
    return whole, quantile * float(np.sqrt(variance))


def _robust(design: Floats, target: Floats, weight: Floats) -> tuple[float, Floats]:
    """Fit by Tukey's biweight from some weights on: the last coefficient, and the weights."""
    slope = np.inf
    for _ in range(ROUNDS):
        root, before = np.sqrt(weight), slope
        solved = np.linalg.lstsq(design * root[:, None], target * root, rcond=None)[0]
        slope = float(solved[-1])
        if abs(slope - before) <= SETTLED * abs(slope):
            break
        residual = target - design @ solved
        sigma = max(NORMAL_CONSISTENCY * float(np.median(np.abs(residual))), 1e-12)
        weight = np.square(np.maximum(1.0 - (residual / (TUKEY * sigma)) ** 2, 0.0))
    return slope, weight
