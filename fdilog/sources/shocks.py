"""Shocks that the accelerometer of a device feels: a gyro that jumps with it has not failed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Recording, Stream
from fdilog.sources.gyros import Gyro

NEIGHBOURHOOD_S = 2.0
FEWEST_AROUND = 60
"""Readings on either side that tell what the accelerometer shows there anyway."""
LEVEL = 0.95
LEVELS = 3.0
"""So many times what all but one in twenty readings about it stay below: vibration does that once
in a thousand."""
BESIDE = 1.5
"""A blow is over within a reading; gyro and accelerometer may not be read at one instant. [periods]
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shocks:
    """Accelerometers of the devices that hold gyros.

    Parameters
    ----------
    streams
        By the name of the source.
    starts_ns
        What their stamps read at flight time 0. [ns]
    """

    streams: Mapping[str, Stream]
    starts_ns: Mapping[str, int]

    @classmethod
    def of(
        cls, recording: Recording, gyros: Sequence[Gyro], late_ns: Sequence[int], zero_ns: int
    ) -> Shocks:
        """Find the accelerometer of each gyro.

        Parameters
        ----------
        late_ns
            What was taken from the stamps of each. [ns]
        zero_ns
            Flight time 0 on the recording's clock. [ns]
        """
        streams, starts_ns = {}, {}
        for gyro, late in zip(gyros, late_ns, strict=True):
            own = gyro.stream
            same = [own] if own.accelerometer else []
            same += [
                other
                for other in recording.streams
                if own.sensor is not None and other.sensor == own.sensor and other.accelerometer
            ]
            if same:
                streams[gyro.name] = same[0]
                starts_ns[gyro.name] = zero_ns + late
        return cls(streams=streams, starts_ns=starts_ns)

    def felt(self, source: str, time_s: float) -> bool:
        """Tell whether the accelerometer of a source jumps about a moment. [s]"""
        stream = self.streams.get(source)
        if stream is None or len(stream.time_ns) < 2 * FEWEST_AROUND:
            return False
        at_ns = self.starts_ns[source] + round(time_s * 1e9)
        place = int(np.searchsorted(stream.time_ns, at_ns))
        around = max(FEWEST_AROUND, round(NEIGHBOURHOOD_S * stream.rate_hz)) + 1
        rows = slice(max(0, place - around), place + around)
        near = np.abs(stream.time_ns[rows] - at_ns) * stream.rate_hz <= BESIDE * 1e9
        return any(
            _jumps(np.asarray(stream.columns[field][rows], float), near)
            for field in stream.accelerometer
            if field in stream.columns
        )


def _jumps(force: NDArray[np.float64], near: NDArray[np.bool_]) -> bool:
    """Tell whether any of some readings stands out from its neighbours as few others do."""
    known = np.isfinite(force)
    force, near = force[known], near[known]
    if len(force) < FEWEST_AROUND:
        return False
    apart = np.abs(force[1:-1] - (force[:-2] + force[2:]) / 2.0)
    level = float(np.quantile(apart, LEVEL))
    return bool((apart[near[1:-1]] > LEVELS * level).any()) and level > 0.0
