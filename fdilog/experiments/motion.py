"""How a simulated multicopter moves and shakes, in closed form at any instant.

Everything is a sum of tones times a smooth envelope, so that gyros which are sampled at different
instants see one and the same flight, and the body rate is the exact derivative of the attitude:
nothing is integrated, interpolated or repeated.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

ROLL, PITCH, YAW = 0, 1, 2
TILT_BAND_HZ = (0.05, 0.8)
"""Where a pilot's corrections in roll and pitch lie."""
HEADING_BAND_HZ = (0.01, 0.15)
TONES = 12
RAMP_S = 3.0
"""From standing to flying, and back."""
DOUBLET_S = 2.0
DOUBLET_EVERY_S = 12.0
"""Roll and pitch in turn."""

BROADBAND_HZ = (15.0, 400.0)
BROADBAND_TONES = 48
MOTORS = 4
HARMONICS = (1, 2)
"""Shaft and, for two-bladed propellers, blade passing."""
MOTOR_SPREAD = 0.08
MOTOR_SHARE = 0.5
"""Part of the vibration's power that is in the motors' tones."""
THROTTLE_SWING = 0.02
"""How far the motors' speed wanders, relative: the root of the sum of its squared tones."""
THROTTLE_HZ = np.array([0.017, 0.043, 0.11, 0.23, 0.57])
"""From trim to gusts. A throttle that wanders as one sine leaves each tone of the vibration a line
of its own (a carrier), and slow logging folds one of many to almost 0 Hz: a bias for minutes."""
ROWS_AT_ONCE = 16_384
"""Keeps the table of tones at some 15 MB however long the flight."""


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """How the aircraft is flown and how it shakes.

    Parameters
    ----------
    rest_s
        On the ground with motors off before take-off and after landing; at most a tenth of the
        flight each. [s]
    tilt_rad, heading_rad
        Standard deviation of roll and pitch, and of the heading. [rad]
    doublet_rad
        Peak angle of the roll and pitch doublets. [rad]
    vibration_rad_s
        Standard deviation of the airframe's rotational vibration, per axis, which all gyros feel.
        At 50 Hz, real quadcopters log 1 to 4 deg/s of it. [rad/s]
    own_share
        Vibration that each gyro feels for itself, relative to the common part. Robust differences
        between real IMUs of one autopilot are 0.2 to 0.3 of what they log. [1]
    motor_hz
        Speed of the motors. [Hz]
    """

    rest_s: float = 5.0
    tilt_rad: float = float(np.radians(5.0))
    heading_rad: float = float(np.radians(30.0))
    doublet_rad: float = float(np.radians(15.0))
    vibration_rad_s: float = float(np.radians(2.0))
    own_share: float = 0.15
    motor_hz: float = 90.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """One flight: attitude, body rate and vibration as functions of time.

    Parameters
    ----------
    tone_hz, tone_sine, tone_cosine : (3, n_tones)
        Frequencies [Hz] and amplitudes [rad] of roll, pitch and yaw.
    shake_hz : (n_shakes,)
        Frequencies of the vibration. [Hz]
    shake : (2 n_shakes, 3)
        Amplitudes of sines and cosines that are common to all gyros, in body axes. [rad/s]
    own : (2 n_shakes,)
        Root mean square amplitudes of what one gyro feels for itself. [rad/s]
    heading_rad
        Before take-off. [rad]
    take_off_s, landed_s
        First and last instant at which the motors run. [s]
    """

    airframe: Airframe
    tone_hz: Floats
    tone_sine: Floats
    tone_cosine: Floats
    shake_hz: Floats
    shake: Floats
    own: Floats
    heading_rad: float
    take_off_s: float
    landed_s: float

    def envelope(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Part of the manoeuvring, and of the motors' thrust, that is on: 0 at rest, 1 in flight.

        Returns
        -------
        envelope, slope : (n_samples,)
            Value [1] and derivative [1/s].
        """
        ramp = min(RAMP_S, (self.landed_s - self.take_off_s) / 2)
        up, up_slope = _smooth_step((time_s - self.take_off_s) / ramp)
        down, down_slope = _smooth_step((self.landed_s - time_s) / ramp)
        return up * down, (up_slope * down - up * down_slope) / ramp

    def euler(self, time_s: Floats) -> tuple[Floats, Floats]:
        """Roll, pitch and yaw (z down, turned in the order yaw, pitch, roll) and their slopes.

        Returns
        -------
        angles, slopes : (n_samples, 3)
            [rad], [rad/s]
        """
        envelope, slope = (part[:, None] for part in self.envelope(time_s))
        angles, slopes = self._doublets(time_s)
        for axis in (ROLL, PITCH, YAW):
            omega = 2 * np.pi * self.tone_hz[axis]
            phase = np.outer(time_s, omega)
            sine, cosine = np.sin(phase), np.cos(phase)
            a, b = self.tone_sine[axis], self.tone_cosine[axis]
            angles[:, axis] += sine @ a + cosine @ b
            slopes[:, axis] += cosine @ (a * omega) - sine @ (b * omega)
        flown = envelope * angles
        flown[:, YAW] += self.heading_rad
        return flown, envelope * slopes + slope * angles

    def _doublets(self, time_s: Floats) -> tuple[Floats, Floats]:
        since = time_s - (self.take_off_s + RAMP_S)
        turn = np.floor(since / DOUBLET_EVERY_S)
        phase = 2 * np.pi * (since - turn * DOUBLET_EVERY_S) / DOUBLET_S
        on = (phase < 2 * np.pi) & (turn >= 0)
        half = self.airframe.doublet_rad / 2
        angle = np.where(on, half * (1.0 - np.cos(phase)), 0.0)
        slope = np.where(on, half * np.sin(phase) * 2 * np.pi / DOUBLET_S, 0.0)
        roll = turn % 2 == 0
        zero = np.zeros_like(angle)
        columns = [np.where(roll, angle, 0.0), np.where(roll, 0.0, angle), zero]
        rates = [np.where(roll, slope, 0.0), np.where(roll, 0.0, slope), zero]
        return np.column_stack(columns), np.column_stack(rates)

    def body_rate(self, time_s: Floats) -> Floats:
        """Body rate w of the manoeuvres, without the vibration.

        Returns
        -------
        rate : (n_samples, 3)
            [rad/s]
        """
        rate = np.empty((len(time_s), 3))
        for rows in _blocks(len(time_s)):
            angles, slopes = self.euler(time_s[rows])
            sine, cosine = np.sin(angles), np.cos(angles)
            roll, pitch, yaw = slopes.T
            rate[rows, 0] = roll - yaw * sine[:, PITCH]
            turning = yaw * cosine[:, PITCH]
            rate[rows, 1] = pitch * cosine[:, ROLL] + turning * sine[:, ROLL]
            rate[rows, 2] = turning * cosine[:, ROLL] - pitch * sine[:, ROLL]
        return rate

    def vibration(self, time_s: Floats, own: Floats) -> tuple[Floats, Floats]:
        """Vibration: the airframe's rotation, and what each gyro adds of its own.

        Parameters
        ----------
        own : (2 n_shakes, n_channels)
            Amplitudes of each gyro's own part, see `own_amplitudes`. [rad/s]

        Returns
        -------
        common : (n_samples, 3)
            Rotation of the airframe, body axes. [rad/s]
        alone : (n_samples, n_channels)
            [rad/s]
        """
        amplitudes = np.concatenate([self.shake, own], axis=1)
        felt = np.empty((len(time_s), amplitudes.shape[1]))
        for rows in _blocks(len(time_s)):
            t = time_s[rows]
            # A wandering throttle is a wandering clock for every tone that hangs on it.
            omega = 2 * np.pi * THROTTLE_HZ
            swing = THROTTLE_SWING / np.sqrt(len(omega))
            warped = t - np.cos(np.outer(t, omega) + np.arange(len(omega))) @ (swing / omega)
            phase = np.outer(warped, 2 * np.pi * self.shake_hz)
            tones = np.concatenate([np.sin(phase), np.cos(phase)], axis=1)
            felt[rows] = self.envelope(t)[0][:, None] * (tones @ amplitudes)
        return felt[:, :3], felt[:, 3:]

    def own_sigma(self, time_s: Floats) -> Floats:
        """Give the standard deviation of what one gyro feels for itself, (n_samples,). [rad/s]"""
        return self.airframe.own_share * self.airframe.vibration_rad_s * self.envelope(time_s)[0]

    def own_amplitudes(self, n_channels: int, rng: np.random.Generator) -> Floats:
        """Draw the vibration that each of some gyros feels for itself, (2 n_shakes, n_channels)."""
        return _unit_power(self.own[:, None], rng.standard_normal((len(self.own), n_channels)))


def draw_motion(duration_s: float, airframe: Airframe, rng: np.random.Generator) -> Motion:
    """Draw the flight that fills a time."""
    rest = min(airframe.rest_s, duration_s / 10)
    bands = [TILT_BAND_HZ, TILT_BAND_HZ, HEADING_BAND_HZ]
    sigma = np.array([airframe.tilt_rad, airframe.tilt_rad, airframe.heading_rad])
    motors = airframe.motor_hz * (1 + MOTOR_SPREAD * rng.standard_normal(MOTORS))
    motor_hz = np.outer(HARMONICS, motors).ravel()
    shake_hz = np.concatenate([motor_hz, rng.uniform(*BROADBAND_HZ, BROADBAND_TONES)])
    power = np.concatenate(
        [
            np.full(len(motor_hz), MOTOR_SHARE / len(motor_hz)),
            np.full(BROADBAND_TONES, (1 - MOTOR_SHARE) / BROADBAND_TONES),
        ]
    )
    # The power of a tone is shared by its sine and its cosine.
    shake = airframe.vibration_rad_s * np.sqrt(np.tile(power, 2) / 2)
    return Motion(
        airframe=airframe,
        tone_hz=np.stack([rng.uniform(*band, TONES) for band in bands]),
        tone_sine=sigma[:, None] * rng.standard_normal((3, TONES)) / np.sqrt(TONES),
        tone_cosine=sigma[:, None] * rng.standard_normal((3, TONES)) / np.sqrt(TONES),
        shake_hz=shake_hz,
        shake=_unit_power(shake[:, None], rng.standard_normal((len(shake), 3))),
        own=airframe.own_share * shake,
        heading_rad=float(rng.uniform(-np.pi, np.pi)),
        take_off_s=rest,
        landed_s=duration_s - rest,
    )


def _unit_power(amplitude: Floats, draws: Floats) -> Floats:
    """Scale random amplitudes so that each column has exactly the power it is meant to have."""
    drawn = amplitude * draws
    wanted = np.sqrt((amplitude**2).sum(axis=0))
    # A sine and a cosine of unit amplitude have a mean square of one half each.
    power = np.sqrt((drawn**2).sum(axis=0) / 2)
    scaled: Floats = drawn * np.divide(wanted, power, out=np.zeros_like(power), where=power > 0)
    return scaled


def _smooth_step(u: Floats) -> tuple[Floats, Floats]:
    """Rise from 0 at u = 0 to 1 at u = 1 with two continuous derivatives; and its slope."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2), 30 * u**2 * (1 - u) ** 2


def _blocks(n: int) -> Iterator[slice]:
    for first in range(0, n, ROWS_AT_ONCE):
        yield slice(first, first + ROWS_AT_ONCE)


def quaternion(angles: Floats) -> Floats:
    """Hamilton quaternion, body to earth, of roll, pitch and yaw.

    Parameters
    ----------
    angles : (n_samples, 3)
        [rad]

    Returns
    -------
    quaternion : (n_samples, 4)
        (w, x, y, z). [1]
    """
    sr, sp, sy = np.sin(angles / 2).T
    cr, cp, cy = np.cos(angles / 2).T
    return np.column_stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
