"""Every setting, with its default and the reason for it."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field
from typing import Any


def _key(default: Any, why: str) -> Any:
    metadata = {"why": why}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, kw_only=True)
class Geometry:
    """Where each gyro points."""

    name: str = _key(
        "",
        "aligned-triads, mirrored-triads, matasov, pentagon, dodecahedron; empty: aligned-triads"
        " for sources of three axes, since autopilots rotate every IMU into the body frame",
    )
    axes: tuple[tuple[float, float, float], ...] = _key(
        (), "sensitivity axis [x, y, z] of each channel in column order, instead of a name"
    )
    mounting: dict[str, dict[str, tuple[float, ...]]] = _key(
        dict, "mounting.imu1.quaternion = [w, x, y, z] (Hamilton, sensor to body) turns a source"
    )


@dataclass(frozen=True, kw_only=True)
class GyroSource:
    """A gyro that the configuration names."""

    name: str
    topic: str
    fields: tuple[str, ...]
    unit: str = "rad/s"


@dataclass(frozen=True, kw_only=True)
class Sources:
    """Which streams are gyros."""

    use: tuple[str, ...] = _key((), "names of the sources to use; empty: all that were found")
    gyro: tuple[GyroSource, ...] = _key(
        (),
        "[[sources.gyro]] name, topic, fields, unit (rad/s, deg/s or mrad/s): a stream that no"
        " schema marks as a gyro",
    )


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """How large an error is a failure."""

    bias_deg_s: float = _key(
        1.0,
        "an autopilot's own check warns at a few deg/s; consumer gyros hold 0.3 deg/s in flight",
    )
    noise_factor: float = _key(3.0, "noise amplitude relative to the other gyros on the same axis")
    scale: float = _key(0.05, "scale factor error; data sheets promise 1 to 3 %")
    impulse_deg_s: float = _key(
        10.0,
        "a single reading this far from what its neighbours and the other gyros tell; vibration of"
        " recorded flights leaves less, save for the noisiest",
    )
    dropout_s: float = _key(0.5, "one source silent for longer while others go on")


@dataclass(frozen=True, kw_only=True)
class Noise:
    """What is known of the errors of healthy gyros."""

    bound_deg_s: float = _key(0.0, "guaranteed bound of a healthy error; 0: estimated per channel")
    bias_sigma_deg_s: float = _key(
        1.0 / 3.0, "healthy biases; the tolerance is three sigma, as in [Triads]"
    )
    scale_sigma: float = _key(0.05 / 3.0, "healthy scale errors; three sigma are the tolerance")
    time_sigma_s: float = _key(
        0.002, "sampling instants of two sources that share a time stamp; one IMU loop is 2.5 ms"
    )


@dataclass(frozen=True, kw_only=True)
class WindowSettings:
    """Over which stretches the readings are judged."""

    lengths_s: tuple[float, ...] = _key(
        (0.1, 1.0, 5.0, 10.0, 20.0, 60.0),
        "short ones see large faults at once, long ones small biases through the vibration",
    )
    overlap: float = _key(0.5, "part of a window that it shares with the next")
    confidence: float = _key(0.999, "of every interval that is printed")
    false_findings_per_hour: float = _key(
        0.01, "budget over all windows, lengths and channels: one false finding in 100 flight hours"
    )


@dataclass(frozen=True, kw_only=True)
class DetectorSettings:
    """Which methods are asked."""

    use: tuple[str, ...] = _key((), "names from `fdilog detectors`; empty: all that apply")
    max_failures: int = _key(
        2, "simultaneous failures considered, where the redundancy allows; more cannot be isolated"
    )


Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True, kw_only=True)
class ObserverSettings:
    """A model of the vehicle: x' = A x + B u, y = C x, watched by the detector `observer`."""

    outputs: tuple[str, ...] = _key(
        (),
        "sensors y that the model predicts: channels (imu0.z), or STREAM.FIELD of any stream"
        " (GPS.Spd); empty: no model, and `observer` is not asked",
    )
    inputs: tuple[str, ...] = _key(
        (), "commands u that drive it, STREAM.FIELD: RCOU.C1, SERVO_OUTPUT_RAW.servo1_raw"
    )
    A: Matrix = _key((), "dynamics, a row a state, in 1/s; SI units of outputs and inputs")
    B: Matrix = _key((), "how the inputs drive the states, a row a state")
    C: Matrix = _key((), "outputs of the states, a row an output; empty: output k is state k")
    identify: bool = _key(False, "estimate A and B by least squares over healthy_s instead")
    healthy_s: tuple[float, ...] = _key(
        (),
        "[from, to]: seconds of flight time in which the outputs are known to be healthy; gives"
        " the trims, the units, the threshold, and the model where it is identified",
    )
    eigenvalues_per_s: tuple[float, ...] = _key(
        (),
        "of the observer, one an output, negative; empty: twice as fast as the fastest of A, to"
        " outrun the vehicle without following its noise",
    )
    K: Matrix = _key((), "gain of the observer, a row a state, instead of eigenvalues_per_s")
    units: tuple[float, ...] = _key(
        (),
        "what counts as one in each output, so that metres and radians can be added; empty: the"
        " standard deviation of its residual over healthy_s",
    )
    threshold: float = _key(
        0.0,
        "length of the residual, in these units, that is an alarm; 0: three times the longest of"
        " healthy_s, since a model is never as good elsewhere as where it was looked at",
    )
    step_s: float = _key(
        0.1, "means over this long are watched: vehicles turn slower, vibration is faster"
    )


@dataclass(frozen=True, kw_only=True)
class Config:
    """All settings; immutable, so that a result can be traced to it by its hash."""

    geometry: Geometry = field(default_factory=Geometry)
    sources: Sources = field(default_factory=Sources)
    tolerance: Tolerance = field(default_factory=Tolerance)
    noise: Noise = field(default_factory=Noise)
    windows: WindowSettings = field(default_factory=WindowSettings)
    detectors: DetectorSettings = field(default_factory=DetectorSettings)
    observer: ObserverSettings = field(default_factory=ObserverSettings)

    @property
    def sha256(self) -> str:
        """Hash of every setting, in a canonical order."""
        text = json.dumps(dataclasses.asdict(self), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def replace(self, section: str, **values: Any) -> Config:
        """Return a copy with some keys of one section changed."""
        changed = dataclasses.replace(getattr(self, section), **values)
        return dataclasses.replace(self, **{section: changed})
