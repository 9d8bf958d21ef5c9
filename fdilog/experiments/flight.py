"""A synthetic flight: what its gyros logged, and everything that is true of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.experiments.faults import Fault
from fdilog.experiments.motion import Motion, quaternion
from fdilog.recording import Recording, Stream

Floats = NDArray[np.float64]

STAMP_NS = 1000
"""Stamps are whole microseconds, as autopilots write them."""
FIRMWARE = "fdilog simulator V1.1"
"""Its number goes up when the same arguments begin to give another flight."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulatedSource:
    """One device: what it logged, and the truth about it.

    Parameters
    ----------
    axes : (n_axes, 3)
        Nominal sensitivity axes H. [1]
    time_ns : (n,) int64
        Stamps, on the recording's clock. [ns]
    rate_rad_s : (n, n_axes)
        Readings z. [rad/s]
    truth_rad_s : (n, n_axes)
        What a perfect gyro would have read, H w, vibration of the airframe included. [rad/s]
    acceleration_m_s2 : (n, 3)
        Specific force in body axes, or None for a device without accelerometer. [m/s^2]
    temperature_c : (n,)
        Of the device. [degC]
    bias_rad_s, scale : (n_axes,)
        Healthy errors: bias [rad/s] and scale factor [1].
    mounting_rad : (3,)
        Small rotation from body to device. [rad]
    offset_s
        How late the stamps are. [s]
    """

    name: str
    channels: tuple[str, ...]
    axes: Floats
    time_ns: NDArray[np.int64]
    rate_rad_s: Floats
    truth_rad_s: Floats
    acceleration_m_s2: Floats | None
    temperature_c: Floats
    bias_rad_s: Floats
    scale: Floats
    mounting_rad: Floats
    offset_s: float

    def truth(self) -> dict[str, Any]:
        """Return what was drawn for this device as plain JSON values."""
        return {
            "name": self.name,
            "channels": list(self.channels),
            "axes": self.axes.tolist(),
            "bias_rad_s": self.bias_rad_s.tolist(),
            "scale": self.scale.tolist(),
            "mounting_rad": self.mounting_rad.tolist(),
            "offset_s": self.offset_s,
        }

    def stream(self, number: int) -> Stream:
        """Return the readings as a reader would find them."""
        triad = np.array_equal(self.axes, np.eye(3))
        letters = "xyz" if triad else [str(k) for k in range(1, len(self.axes) + 1)]
        rates = {f"gyro_{a}": column for a, column in zip(letters, self.rate_rad_s.T, strict=True)}
        forces: dict[str, Floats] = {}
        if self.acceleration_m_s2 is not None:
            parts = zip("xyz", self.acceleration_m_s2.T, strict=True)
            forces = {f"acceleration_{a}": column for a, column in parts}
        return Stream(
            name=self.name,
            time_ns=self.time_ns,
            columns={**rates, **forces, "temperature": self.temperature_c},
            units={
                **dict.fromkeys(rates, "rad/s"),
                **dict.fromkeys(forces, "m/s^2"),
                "temperature": "degC",
            },
            clock="simulated",
            gyro=tuple(rates),
            accelerometer=tuple(forces),
            channel_names=() if triad else self.channels,
            sensor=number,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """A synthetic flight.

    Parameters
    ----------
    zero_ns
        Flight time 0, the first stamp of any gyro, on the recording's clock. [ns]
    attitude_time_ns : (m,) int64
        [ns]
    attitude : (m, 4)
        True attitude, Hamilton quaternion (w, x, y, z) from body to earth (z down). [1]
    logged_attitude_rad : (m, 3)
        Roll, pitch and yaw as an autopilot estimates them: the truth with a slow error. [rad]
    settings
        The arguments it was made with, as plain JSON values.
    """

    motion: Motion
    sources: tuple[SimulatedSource, ...]
    faults: tuple[Fault, ...]
    zero_ns: int
    attitude_time_ns: NDArray[np.int64]
    attitude: Floats
    logged_attitude_rad: Floats
    settings: Mapping[str, Any]

    @property
    def axes(self) -> Floats:
        """Nominal sensitivity axes H of all channels, (n_channels, 3)."""
        return np.concatenate([source.axes for source in self.sources])

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of all channels, in the order of `axes`."""
        return tuple(name for source in self.sources for name in source.channels)

    def truth(self) -> dict[str, Any]:
        """Return all that was drawn and put in, as plain JSON values."""
        return {
            "faults": [fault.to_dict() for fault in self.faults],
            "settings": dict(self.settings),
            "sources": [source.truth() for source in self.sources],
        }

    def recording(self, *, attitude: bool = True) -> Recording:
        """Return the flight as a reader would find it, with the autopilot's attitude or without."""
        streams = [source.stream(k) for k, source in enumerate(self.sources)]
        if attitude:
            streams.append(self._attitude_stream())
        return Recording(
            path="",
            format="simulated",
            bytes=0,
            streams=tuple(streams),
            vehicle={"firmware": FIRMWARE},
            armed=((self._clock_ns(self.motion.take_off_s), self._clock_ns(self.motion.landed_s)),),
        )

    def _clock_ns(self, time_s: float) -> int:
        return self.zero_ns + STAMP_NS * round(time_s * 1e9 / STAMP_NS)

    def _attitude_stream(self) -> Stream:
        angles = dict(zip(("roll", "pitch", "yaw"), self.logged_attitude_rad.T, strict=True))
        turned = quaternion(self.logged_attitude_rad)
        parts = dict(zip(("qw", "qx", "qy", "qz"), turned.T, strict=True))
        return Stream(
            name="attitude",
            time_ns=self.attitude_time_ns,
            columns={**angles, **parts},
            units={**dict.fromkeys(angles, "rad"), **dict.fromkeys(parts, "1")},
            clock="simulated",
            origin="derived",
        )
