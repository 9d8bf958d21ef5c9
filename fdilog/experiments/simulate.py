"""Synthetic flights of a multicopter with redundant gyros, some of which may fail.

What is known of a flight is exact: the body rate at every instant, each gyro's bias, scale error
and mounting, the offset between a source's stamps and the instants at which it was sampled, and
the faults. The same arguments give the same flight, and a fault changes nothing but what it
touches.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.errors import UsageError, nearest
from fdilog.experiments.faults import Fault, apply, touched, turned_about, turns_source
from fdilog.experiments.flight import STAMP_NS, Flight, Floats, SimulatedSource
from fdilog.experiments.motion import Airframe, Motion, draw_motion, quaternion
from fdilog.maths.geometry import ALIGNED, checked_axes, named_axes

BOOT_NS = 20_000_000_000
"""The recording begins this long after the clock did."""
MOST_JITTER = 0.4
"""Of a period: stamps never change their order."""
CLAMP_SIGMAS = 3.0
"""Where healthy errors are clamped, as in the Monte Carlo of [Triads]."""
ADC_BITS = 16

GRAVITY_M_S2 = 9.80665
ACCELEROMETER_RANGE_M_S2 = 16 * GRAVITY_M_S2
ACCELEROMETER_NOISE_M_S2 = 0.05
ACCELEROMETER_VIBRATION_M_S2 = 0.4
"""Per axis in flight; real quadcopters log 0.3 to 0.6 m/s^2."""
COLD_C, WARM_UP_C, WARM_UP_S = 32.0, 8.0, 60.0

ATTITUDE_HZ = 10.0
ATTITUDE_ERROR_RAD = float(np.radians(0.3))
"""Slow error of the autopilot's attitude. It is not fed by the gyros: a filter that follows a
failed gyro is not simulated."""
ATTITUDE_ERROR_HZ = (0.01, 0.1)
ATTITUDE_ERROR_TONES = 8

# What a random draw is for: one generator each, so that no draw moves another.
_MOTION, _STAMPS, _SOURCE, _FAULT, _ATTITUDE = range(5)


@dataclass(frozen=True, kw_only=True)
class GyroErrors:
    """How good the healthy gyros are.

    Parameters
    ----------
    bias_rad_s, scale
        Standard deviations of each channel's constant bias [rad/s] and scale factor error [1];
        the means of a real autopilot's IMUs differ by 0.02 to 0.2 deg/s.
    mounting_rad
        Standard deviation of the turn of a device about each body axis. [rad]
    noise_rad_s
        White noise of each reading. [rad/s]
    full_scale_rad_s
        Readings are clipped here and rounded to 16 bits of it; 0 for neither. [rad/s]
    """

    bias_rad_s: float = float(np.radians(0.1))
    scale: float = 0.005
    mounting_rad: float = float(np.radians(0.2))
    noise_rad_s: float = float(np.radians(0.1))
    full_scale_rad_s: float = float(np.radians(2000.0))

    @property
    def step_rad_s(self) -> float:
        """Quantisation step. [rad/s]"""
        return self.full_scale_rad_s / float(2 ** (ADC_BITS - 1))


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When readings are taken and how they are stamped.

    Parameters
    ----------
    jitter_s
        Standard deviation of the stamps about an even rate. [s]
    offset_s
        Standard deviation of what each source's stamps are late by. [s]
    shared
        Whether sources of one rate are stamped alike, as an autopilot's logger does; else each
        has its own jitter and begins within a period of the first.
    """

    jitter_s: float = 0.0003
    offset_s: float = 0.0005
    shared: bool = True


def simulate(
    duration_s: float = 100.0,
    rate_hz: float | Sequence[float] = 50.0,
    *,
    geometry: str | ArrayLike = ALIGNED,
    sources: int | None = None,
    faults: Sequence[Fault] = (),
    seed: int = 0,
    airframe: Airframe | None = None,
    errors: GyroErrors | None = None,
    timing: Timing | None = None,
) -> Flight:
    """Fly a multicopter: at rest, take-off, manoeuvres, landing, at rest.

    Parameters
    ----------
    duration_s
        Of the whole recording. [s]
    rate_hz
        At which gyros are logged: one for all sources, or one each. [Hz]
    geometry
        Name of a unit, or sensitivity axes H (n_channels, 3).
    sources
        How many devices the channels are divided among: for ``aligned-triads`` any number (3 if
        not said), for another unit one, or as many as divide its channels.
    faults
        What fails, in the order in which it is applied.

    Raises
    ------
    UsageError
        If the arguments do not fit one another, or a fault names no channel or touches no reading.

    References
    ----------
    [Triads]: healthy biases and scale errors are normal, clamped at three sigma.
    """
    airframe, errors, timing = airframe or Airframe(), errors or GyroErrors(), timing or Timing()
    axes = _device_axes(geometry, sources)
    rates = _rates(rate_hz, len(axes))
    if not (math.isfinite(duration_s) and duration_s * min(rates) >= 2.0):
        raise UsageError(f"a flight of {duration_s} s at {min(rates)} Hz has no two readings")
    names = _channel_names(axes)
    stamps = _stamps(duration_s, rates, timing, seed)
    for fault in faults:
        _check(fault, names, stamps)
    motion = draw_motion(duration_s, airframe, np.random.default_rng((seed, _MOTION)))
    devices = tuple(
        _device(
            k,
            names[k],
            axes[k],
            stamps[k],
            motion=motion,
            errors=errors,
            timing=timing,
            faults=faults,
            seed=seed,
        )
        for k in range(len(axes))
    )
    time_s = np.arange(int(duration_s * ATTITUDE_HZ)) / ATTITUDE_HZ
    angles = motion.euler(time_s)[0]
    return Flight(
        motion=motion,
        sources=devices,
        faults=tuple(faults),
        zero_ns=BOOT_NS,
        attitude_time_ns=BOOT_NS + _whole_stamps(time_s),
        attitude=quaternion(angles),
        logged_attitude_rad=_logged_attitude(time_s, angles, seed),
        settings={
            "seed": seed,
            "duration_s": duration_s,
            "rate_hz": rates,
            "airframe": asdict(airframe),
            "errors": asdict(errors),
            "timing": asdict(timing),
        },
    )


def _device_axes(geometry: str | ArrayLike, sources: int | None) -> list[Floats]:
    aligned = isinstance(geometry, str) and geometry == ALIGNED
    parts = sources if sources is not None else 3 if aligned else 1
    if parts < 1:
        raise UsageError(f"a flight needs at least one source of gyro readings, not {parts}")
    if aligned:
        return [np.eye(3) for _ in range(parts)]
    try:
        axes = named_axes(geometry) if isinstance(geometry, str) else checked_axes(geometry)
    except ValueError as error:
        raise UsageError(str(error)) from None
    if len(axes) % parts:
        raise UsageError(f"{len(axes)} channels cannot be divided among {parts} sources")
    return np.split(axes / np.linalg.norm(axes, axis=1)[:, None], parts)


def _rates(rate_hz: float | Sequence[float], n: int) -> list[float]:
    rates = [float(rate_hz)] * n if isinstance(rate_hz, int | float) else [*map(float, rate_hz)]
    if len(rates) != n or not all(math.isfinite(rate) and rate > 0 for rate in rates):
        raise UsageError(f"rate_hz must be above zero, one for all or one for each of {n} sources")
    return rates


def _channel_names(axes: Sequence[Floats]) -> list[tuple[str, ...]]:
    """Names of each device's channels: ``imu0.x`` along the body axes; else numbered from 1."""
    names = []
    for k, device in enumerate(axes):
        prefix = f"imu{k}." if len(axes) > 1 else "g"
        if _is_triad(device):
            names.append(tuple(f"imu{k}.{letter}" for letter in "xyz"))
        else:
            names.append(tuple(f"{prefix}{j}" for j in range(1, len(device) + 1)))
    return names


def _check(fault: Fault, names: list[tuple[str, ...]], stamps: list[NDArray[np.int64]]) -> None:
    """Refuse a fault that names no channel or lies outside of the flight."""
    whose = {name: k for k, device in enumerate(names) for name in device}
    if fault.kind == "dropout":
        whose.update({f"imu{k}": k for k in range(len(names))})
    if fault.channel not in whose:
        raise UsageError(
            f"{fault.kind}: no channel '{fault.channel}'{nearest(fault.channel, list(whose))}"
        )
    time_s = stamps[whose[fault.channel]] / 1e9
    if not touched(fault, time_s).any():
        raise UsageError(
            f"{fault.kind} of {fault.channel}: no reading from {fault.start_s} s to"
            f" {fault.end_s} s; the flight lasts {time_s[-1]:.3f} s"
        )


def _whole_stamps(time_s: Floats) -> NDArray[np.int64]:
    return STAMP_NS * np.round(time_s * (1e9 / STAMP_NS)).astype(np.int64)


def _stamps(
    duration_s: float, rates: list[float], timing: Timing, seed: int
) -> list[NDArray[np.int64]]:
    """Stamps of each source, the first of all at zero. [ns]"""
    stamps = []
    for k, rate in enumerate(rates):
        rng = np.random.default_rng((seed, _STAMPS, rates.index(rate) if timing.shared else k))
        late = 0.0 if timing.shared else rng.uniform(0.0, 1.0 / rate)
        even = np.arange(int(duration_s * rate)) / rate
        jitter, most = timing.jitter_s * rng.standard_normal(len(even)), MOST_JITTER / rate
        stamps.append(_whole_stamps(late + even + np.clip(jitter, -most, most)))
    first = min(stamp[0] for stamp in stamps)
    return [stamp - first for stamp in stamps]


def _device(
    number: int,
    names: tuple[str, ...],
    axes: Floats,
    stamps_ns: NDArray[np.int64],
    *,
    motion: Motion,
    errors: GyroErrors,
    timing: Timing,
    faults: Sequence[Fault],
    seed: int,
) -> SimulatedSource:
    """Let one device measure the flight, and let it fail."""
    rng = np.random.default_rng((seed, _SOURCE, number))
    n_axes, n = len(names), len(stamps_ns)
    offset_s = timing.offset_s * float(_clamped(rng, 1)[0])
    mounting = errors.mounting_rad * _clamped(rng, 3)
    bias = errors.bias_rad_s * _clamped(rng, n_axes)
    scale = 1.0 + errors.scale * _clamped(rng, n_axes)
    own = motion.own_amplitudes(n_axes, rng)
    white = errors.noise_rad_s * rng.standard_normal((n, n_axes))

    time_s = stamps_ns / 1e9
    sampled_s = time_s - offset_s
    shaken, alone = motion.vibration(sampled_s, own)
    body_rate = motion.body_rate(sampled_s) + shaken
    turned = axes + np.cross(mounting, axes)
    readings = scale * (body_rate @ turned.T) + bias + alone + white
    noise = np.hypot(errors.noise_rad_s, motion.own_sigma(sampled_s))
    device = f"imu{number}"
    for j, fault in enumerate(faults):
        if turns_source(fault) and fault.channel in names:
            readings = turned_about(fault, time_s, readings, names.index(fault.channel))
            continue
        for column in _columns(fault, device, names):
            fault_rng = np.random.default_rng((seed, _FAULT, j))
            readings[:, column] = apply(fault, time_s, readings[:, column], fault_rng, noise)
    kept = np.isfinite(readings).all(axis=1)
    force = _specific_force(sampled_s, motion, rng) if _is_triad(axes) else None
    return SimulatedSource(
        name=device,
        channels=names,
        axes=axes,
        time_ns=BOOT_NS + stamps_ns[kept],
        rate_rad_s=_digitised(readings[kept], errors.full_scale_rad_s),
        truth_rad_s=(body_rate @ axes.T)[kept],
        acceleration_m_s2=None if force is None else force[kept],
        temperature_c=np.round(COLD_C + number - WARM_UP_C * np.expm1(-time_s / WARM_UP_S), 2)[
            kept
        ],
        bias_rad_s=bias,
        scale=scale,
        mounting_rad=mounting,
        offset_s=offset_s,
    )


def _is_triad(axes: Floats) -> bool:
    return np.array_equal(axes, np.eye(3))


def _clamped(rng: np.random.Generator, n: int) -> Floats:
    clamped: Floats = np.clip(rng.standard_normal(n), -CLAMP_SIGMAS, CLAMP_SIGMAS)
    return clamped


def _columns(fault: Fault, device: str, names: tuple[str, ...]) -> list[int]:
    """Columns of a device that a fault concerns: all, if the device falls silent."""
    if fault.kind == "dropout" and fault.channel in (device, *names):
        return list(range(len(names)))
    return [names.index(fault.channel)] if fault.channel in names else []


def _digitised(values: Floats, full_scale: float) -> Floats:
    """Round to 16 bits of a range, and clip to it."""
    if full_scale <= 0.0:
        return values
    most = float(2 ** (ADC_BITS - 1))
    step = full_scale / most
    # Adding zero makes a negative zero an ordinary one.
    digitised: Floats = np.clip(np.round(values / step), -most, most - 1) * step + 0.0
    return digitised


def _specific_force(time_s: Floats, motion: Motion, rng: np.random.Generator) -> Floats:
    """Give what an accelerometer feels in slow flight: gravity, vibration, noise. [m/s^2]"""
    roll, pitch, _ = motion.euler(time_s)[0].T
    down = np.column_stack(
        [-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)]
    )
    shaking = ACCELEROMETER_VIBRATION_M_S2 * motion.envelope(time_s)[0]
    sigma = np.hypot(ACCELEROMETER_NOISE_M_S2, shaking)
    force = -GRAVITY_M_S2 * down + sigma[:, None] * rng.standard_normal(down.shape)
    return _digitised(force, ACCELEROMETER_RANGE_M_S2)


def _logged_attitude(time_s: Floats, angles: Floats, seed: int) -> Floats:
    """Roll, pitch and yaw with a slow error, yaw within half a turn. [rad]"""
    rng = np.random.default_rng((seed, _ATTITUDE))
    hz = rng.uniform(*ATTITUDE_ERROR_HZ, ATTITUDE_ERROR_TONES)
    phase = np.outer(time_s, 2 * np.pi * hz)
    tones = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
    amplitude = ATTITUDE_ERROR_RAD / np.sqrt(ATTITUDE_ERROR_TONES)
    logged: Floats = angles + amplitude * tones @ rng.standard_normal((2 * ATTITUDE_ERROR_TONES, 3))
    logged[:, 2] = (logged[:, 2] + np.pi) % (2 * np.pi) - np.pi
    return logged
