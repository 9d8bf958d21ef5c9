"""What the attitude says of the gyros under suspicion.

A filter that integrates a failed gyro follows it for a while, and then agrees with the wrong one.
So a gyro is not held against the attitude as it is, but against gravity, GPS and the compass, with
the attitude as the thread that leads from one to the other: had the vehicle turned as this gyro
says, where would they point? That does not depend on what the filter did with the gyro. And as a
second lock, the attitude itself must be further from the gyro that is named than from any other.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.maths.noise import windowed_mean
from fdilog.sources.anchors import VAGUE, Drift
from fdilog.sources.attitude import interpolated, matrices
from fdilog.sources.witness import Witness, triads
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

ANCHOR_CONFIDENCE = 0.99
"""The anchors choose between the suspects of a fault that is found already, of which a flight has a
few, not thousands; and they are not the only lock. Of a gyro alone either it or the attitude is
off, and attitudes are more often: then the configured confidence of windows holds."""
MOST_DOUBT_RAD = np.pi / 2.0
"""Anchors that leave open whether a direction turned by a right angle meanwhile tell nothing: how
directions move was taken as linear."""
SURE_ODDS = 1000.0
"""How much likelier than of any other suspect it must be of the one named: with an attitude that
followed the failed gyro, anchors are the only lock."""
TOLERANCE_SIGMAS = 3.0
"""What a healthy gyro may be off by is three times what it usually is."""

LONG_S = 20.0
"""A filter that is corrected with a time constant of a minute and a half or less has come off the
gyro that it followed by a sixth of the step within the last third of so long a time."""
CLEAR = 2.0
"""Over a shorter time a few seconds of force level an attitude that started anew, and their noise
turns the axes that gravity seems to show: so many half-widths are asked of a gyro alone, or that
half of its error shows in the attitude as it is."""
UNTOUCHED = 1.0 / 6.0
STEADY = 1.0 / 4.0
"""How much of a step the thirds of a span may differ by, of a sound gyro and of a failed one. Ten
seconds of manoeuvres make a tenth to a half of a deg/s of it on recorded flights."""
LEAST_ODDS = 10.0
"""By how much the anchors must be for it where no other gyro agrees with the attitude, or nothing
but gravity corrects the filter."""


@dataclass(frozen=True, kw_only=True)
class Testimony:
    """What a witness says of one gyro over a span.

    Parameters
    ----------
    error, half_width
        Mean difference from the attitude, and the half-width of its interval. [rad/s]
    drift
        How wrong the attitude would be that this gyro alone would have given.
    anchored, anchored_half_width
        The gyro's error against the anchors, and the half-width of its interval; infinite if they
        tell nothing. [rad/s]
    tolerance
        What errors are held against. [rad/s]
    thirds
        Mean difference from the attitude in each third of the span, less the usual one. [rad/s]
    confidence
        Of the interval of what the anchors say.
    """

    error: float
    half_width: float
    drift: Drift
    anchored: float
    anchored_half_width: float
    tolerance: float
    thirds: tuple[float, float, float]
    confidence: float

    @property
    def failed(self) -> bool:
        """Whether the anchors say that the gyro is off."""
        return abs(self.anchored) - self.anchored_half_width > self.tolerance

    @property
    def step(self) -> float:
        """By how much it came off the attitude, if by the same all the time; else 0. [rad/s]"""
        mean = sum(self.thirds) / 3.0
        steady = all(abs(third - mean) <= STEADY * abs(mean) for third in self.thirds)
        return mean if steady and abs(mean) > self.tolerance else 0.0

    def untouched(self, step: float) -> bool:
        """Whether nothing of a step shows in the differences from the attitude."""
        return all(abs(third) <= UNTOUCHED * abs(step) for third in self.thirds)

    def borne_out(self, step: float, odds: float) -> bool:
        """Whether anchors make it so much likelier that it is off by a step than not at all."""
        anchors = self.anchored_half_width / NormalDist().inv_cdf(0.5 + self.confidence / 2.0)
        doubt = math.hypot(anchors, self.tolerance / TOLERANCE_SIGMAS)
        return step * (2.0 * self.anchored - step) / (2.0 * doubt**2) > math.log(odds)


@dataclass(frozen=True, kw_only=True)
class Statement:
    """What a witness concludes of a fault: whom it names, if anyone, and why."""

    named: int | None
    detail: str


def hear(
    witness: Witness,
    table: ChannelTable,
    suspects: Sequence[int],
    span: tuple[int, int],
    config: Config,
) -> Statement:
    """Ask which of some gyros was off over a span of samples.

    Parameters
    ----------
    table
        Gyros and, among the channels, the derived ones of the attitude.
    suspects
        Columns of gyros.
    """
    heard: dict[int, Testimony] = {}
    sure = ANCHOR_CONFIDENCE if len(suspects) > 1 else config.windows.confidence
    for channel in suspects:
        said = testimony(witness, table, channel, span, config=config, confidence=sure)
        if said is None:
            return Statement(named=None, detail="the attitude has no anchor over so short a time")
        heard[channel] = said
    if not heard:
        return Statement(named=None, detail="")
    failed = [channel for channel, said in heard.items() if said.failed]
    furthest = max(heard, key=lambda channel: abs(heard[channel].error))
    words = _words(table, heard)
    long = float(table.time_s[span[1] - 1] - table.time_s[span[0]]) >= LONG_S
    if _surely(heard, furthest, long=long) or (long and _stepped(heard, furthest)):
        return Statement(named=furthest, detail=words)
    if not failed and all(said.drift.lost for said in heard.values()):
        words = f"the attitude is lost, and tells nothing; {words}"
    return Statement(named=None, detail=words)


def _surely(heard: Mapping[int, Testimony], named: int, *, long: bool) -> bool:
    """Tell whether the anchors name a gyro.

    Of one alone they must show that it is off; of several of which one is, which of them it is.
    """
    said = heard[named]
    others = [other for channel, other in heard.items() if channel != named]
    if not others:
        # A filter follows a failed gyro, lagging; it does not run ahead of it.
        behind = said.error * said.anchored > 0.0
        shown = abs(said.error) > abs(said.anchored) / 2.0
        clear = abs(said.anchored) > CLEAR * said.anchored_half_width
        return said.failed and behind and (long or shown or clear)
    return not any(other.failed for other in others) and all(
        said.borne_out(said.anchored - other.anchored, SURE_ODDS) for other in others
    )


def _stepped(heard: Mapping[int, Testimony], named: int) -> bool:
    """Tell whether the course of the differences names a gyro, and the anchors bear it out."""
    step = heard[named].step
    others = [said for channel, said in heard.items() if channel != named]
    # Without compass and GPS no filter corrects its heading.
    corrected = len(heard[named].drift.anchors) > 1
    return (
        step != 0.0
        and all(said.untouched(step) for said in others)
        and heard[named].borne_out(step, 1.0 if others and corrected else LEAST_ODDS)
    )


def testimony(
    witness: Witness,
    table: ChannelTable,
    channel: int,
    span: tuple[int, int],
    *,
    config: Config,
    confidence: float,
) -> Testimony | None:
    """Hold one gyro against the attitude over a span, or nothing where that is not possible."""
    start_s, end_s = float(table.time_s[span[0]]), float(table.time_s[span[1] - 1])
    derived = [k for k, one in enumerate(table.channels) if one.derived]
    known = np.asarray(table.valid[:, [channel, *derived]].all(axis=1), bool)
    rows = span[0] + np.flatnonzero(known[span[0] : span[1]])
    if len(derived) != 3 or len(rows) < 3:
        return None
    axis = table.axes[channel]
    along = table.rate_rad_s[:, derived] @ (table.axes[derived] @ axis)
    apart = np.where(known, table.rate_rad_s[:, channel] - along, 0.0)
    looks = windowed_mean(apart[rows][None, :, None])
    mean = float(looks.mean[0, 0])
    doubted = (axis, _across(witness, table, axis, span))
    path = (table.time_s, _path(witness, table, _apart(table, channel, apart)))
    anchors = witness.anchors
    # Either the gyro is right, or the attitude.
    guesses = (np.zeros(3), mean * axis)
    drift = anchors.drift(
        start_s, end_s, confidence, path=path, axis=doubted, guesses_rad_s=guesses
    )
    of_attitude = anchors.drift(start_s, end_s, confidence, axis=doubted)
    if drift is None or of_attitude is None:
        return None
    anchored, doubt = float(axis @ drift.error_rad_s), drift.half_width(axis)
    bias = np.radians(config.tolerance.bias_deg_s)
    tolerance = float(np.hypot(bias, config.tolerance.scale * float(along[rows].mean())))
    of_mean = looks.half_width(np.ones(1), confidence)[0]
    if of_attitude.within(axis, tolerance) and of_mean < doubt:
        # Where the attitude was right for sure, the gyro is off by what they differ by, whatever it
        # does beside the span.
        anchored = float(axis @ of_attitude.error_rad_s) + mean
        doubt = math.hypot(of_attitude.half_width(axis), of_mean)
    outside = known.copy()
    outside[span[0] : span[1]] = False
    usual = float(np.median(apart[outside])) if outside.sum() >= len(rows) / 2 else 0.0
    first, middle, last = (float(apart[part].mean()) - usual for part in np.array_split(rows, 3))
    return Testimony(
        error=mean,
        half_width=float(looks.half_width(np.ones(1), config.windows.confidence)[0]),
        drift=drift,
        anchored=anchored,
        anchored_half_width=doubt if doubt * (end_s - start_s) < MOST_DOUBT_RAD else math.inf,
        tolerance=tolerance,
        thirds=(first, middle, last),
        confidence=confidence,
    )


def _across(witness: Witness, table: ChannelTable, axis: Floats, span: tuple[int, int]) -> float:
    """How far an attitude's rate may be wrong across an axis over a span. [rad/s]

    As far as a healthy gyro, where it agrees with gyros about the other axes: they have not failed.
    A filter that is drawn back from a failed gyro may turn about any axis meanwhile.
    """
    inside = np.zeros(len(table.time_s), bool)
    inside[slice(*span)] = True
    within = table.only(inside)
    derived = [k for k, channel in enumerate(table.channels) if channel.derived]
    attitude = within.rate_rad_s[:, derived] @ table.axes[derived]
    nearest = VAGUE
    for rows, rate in triads(within.gyros):
        apart = (attitude[rows] - rate)[within.valid[rows][:, derived].all(axis=1)]
        if len(apart):
            mean = apart.mean(axis=0)
            nearest = min(nearest, float(np.linalg.norm(mean - axis * (axis @ mean))))
    return math.hypot(nearest, witness.anchors.healthy_rad_s)


def _apart(table: ChannelTable, channel: int, apart: Floats) -> Floats:
    """Tell what a gyro and its siblings on the device turn beyond the attitude, (n, 3). [rad/s]

    About the other axes it is the siblings that are asked: an attitude that starts anew or comes
    back from where a failed gyro led it turns about any.
    """
    source = table.channels[channel].source
    columns = [k for k, one in enumerate(table.channels) if one.source == source]
    derived = [k for k, one in enumerate(table.channels) if one.derived]
    if np.linalg.matrix_rank(table.axes[columns]) < 3:
        return np.outer(apart, table.axes[channel])
    known = np.asarray(table.valid[:, [*columns, *derived]].all(axis=1), bool)[:, None]
    rate = table.rate_rad_s[:, columns] @ np.linalg.pinv(table.axes[columns]).T
    attitude = table.rate_rad_s[:, derived] @ table.axes[derived]
    return np.where(known, rate - attitude, 0.0)


def _path(witness: Witness, table: ChannelTable, apart: Floats) -> Floats:
    """By how much more than the attitude gyros have turned, in the world, (n_samples, 3). [rad]"""
    attitude = witness.attitude
    turned = matrices(interpolated(attitude.time_s, attitude.quaternion, table.time_s))
    rate = (turned @ apart[:, :, None])[:, :, 0]
    steps = np.diff(table.time_s)
    # Across a hole nothing is known of either, and nothing is added.
    steps = np.where(steps > 5 * table.period_s, 0.0, steps)[:, None]
    path = np.zeros_like(rate)
    np.cumsum((rate[1:] + rate[:-1]) / 2 * steps, axis=0, out=path[1:])
    return path


def _words(table: ChannelTable, heard: dict[int, Testimony]) -> str:
    anchors = next(iter(heard.values())).drift.anchors
    several = f"{', '.join(anchors[:-1])} and {anchors[-1]}" if len(anchors) > 1 else anchors[0]
    said = [
        f"{table.names[k]} {_size(one.anchored, one.anchored_half_width)}"
        f" (against the attitude as it is {_size(one.error, one.half_width)})"
        for k, one in heard.items()
    ]
    return f"against {several}, by way of the attitude, in deg/s: {'; '.join(said)}"


def _size(error: float, half_width: float) -> str:
    if not math.isfinite(half_width):
        return "unknown"
    return f"{np.degrees(error):+.2f} ± {np.degrees(half_width):.2f}"
