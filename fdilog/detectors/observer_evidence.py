"""A sensor that contradicts a model of the vehicle: directional observer over a whole record.

What it leaves of a record is in `fdilog.detectors.observer_watch`; here that becomes alarms, each
with the sensors that explain it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config, ObserverSettings
from fdilog.detectors.observer_watch import (
    THRESHOLD_FACTOR,
    NotAskedError,
    Watch,
    check,
    unmet,
    watched,
)
from fdilog.finding import Evidence
from fdilog.maths.geometry import Floats
from fdilog.maths.noise import windowed_mean
from fdilog.maths.student import student_quantile
from fdilog.registry import Stage
from fdilog.windows.survey import Survey, spans

SETTLED = 3.0
"""Time constants of the observer after which 5 % of a transient are left."""

MOST_LISTED = 3
OPEN = "and no single sensor explains it: too short, several at once, an input, or the model itself"


@dataclass(frozen=True, kw_only=True)
class Alarm:
    """A residual beyond the threshold for a while.

    Parameters
    ----------
    suspects
        Outputs that explain it, none that explains it far worse than another; empty if none does.
    beyond
        Whether it began while an input was beyond those of the healthy stretch, or just after.
    share
        Part of the squared residual that lies on the line of the likeliest one, C_i. [1]
    low, high : (p,)
        Error of each output if it is the one. [its unit]
    """

    start_s: float
    end_s: float
    suspects: tuple[int, ...]
    beyond: bool
    share: float
    low: Floats
    high: Floats


@dataclass(frozen=True, kw_only=True)
class ObserverDetector:
    """Sensors against a model of the vehicle; one that has no redundancy is checked as well.

    It accuses and never acquits: an error that is smaller than what the model itself is off by
    leaves no residual to speak of.
    """

    description: ClassVar[str] = (
        "contradiction to a model of the vehicle [Observer24]; asked where [observer] names one"
    )
    stage: ClassVar[Stage] = "model"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Give one window for every alarm of the observer, [Observer24].

        Raises
        ------
        UsageError
            If the matrices of the configuration do not fit one another.
        """
        settings = survey.config.observer
        if not settings.outputs:
            return []
        check(settings)
        try:
            watch = watched(survey)
            found = alarms(watch, survey.config)
        except NotAskedError as reason:
            return [_evidence(survey, [], f"observer: not asked: {reason}")]
        return [_evidence(survey, found, _note(settings, watch, found))]


def alarms(watch: Watch, config: Config) -> list[Alarm]:
    """List every alarm; pauses shorter than the observer's time constant are bridged."""
    length = np.linalg.norm(watch.residual, axis=1)
    at = np.flatnonzero(length > watch.threshold)
    if not len(at):
        return []
    apart = np.diff(watch.time_s[at]) > max(watch.slowest_s, 1.5 * watch.step_s)
    errors = watch.errors()
    model_error = (
        np.abs(errors[watch.healthy]).max(axis=0)
        if watch.healthy.any()
        else np.zeros(len(watch.units))
    )
    found = []
    for span in np.split(at, np.flatnonzero(apart) + 1):
        # A fault that ends makes the residual jump like one that begins, and what is left of that
        # dies away with the slowest time constant.
        tail_s = watch.slowest_s * np.log(length[span].max() / watch.threshold)
        start_s, end_s = watch.time_s[span[0]], watch.time_s[span[-1]]
        rows = np.arange(span[0], span[-1] + 1)
        rows = rows[
            (watch.time_s[rows] >= start_s + SETTLED * watch.slowest_s)
            & (watch.time_s[rows] <= end_s - tail_s)
        ]
        before = (watch.time_s >= start_s - SETTLED * watch.slowest_s) & (watch.time_s <= start_s)
        suspects, share = _explained(watch, rows, config.windows.confidence)
        looks = windowed_mean(errors[rows][None])
        half = student_quantile(looks.dof, config.windows.confidence)[0]
        half = half * np.sqrt(np.diagonal(looks.covariance[0])) + model_error
        if not looks.dof[0] > 0:
            half = np.full(len(watch.units), np.inf)
        found.append(
            Alarm(
                start_s=float(start_s - watch.step_s / 2),
                end_s=float(end_s + watch.step_s / 2),
                suspects=suspects,
                beyond=bool(watch.beyond[before].any()),
                share=share,
                low=looks.mean[0] - half,
                high=looks.mean[0] + half,
            )
        )
    return found


def _explained(
    watch: Watch, rows: NDArray[np.int64], confidence: float
) -> tuple[tuple[int, ...], float]:
    """Name the sensors on whose line the settled residual of an alarm lies, and the metric C_i.

    The largest C_i names the likeliest. It explains the alarm if no more lies beside its line than
    the healthy stretch leaves; a sensor whose C_i is not surely smaller is a suspect with it, and
    so is one whose fault has no line.
    """
    looks = windowed_mean(watch.residual[rows][None])
    if not looks.dof[0] > 0:
        return (), float("nan")
    mean, lines = looks.mean[0], watch.lines
    along = lines @ mean
    best = int(np.argmax(along**2))
    share = float(along[best] ** 2 / (mean @ mean))
    beside = watch.residual[rows] - np.outer(watch.residual[rows] @ lines[best], lines[best])
    if np.median(np.linalg.norm(beside, axis=1)) > watch.threshold / THRESHOLD_FACTOR:
        return (), share
    suspects = []
    for sensor in range(len(lines)):
        # How the difference of the two squared projections moves with the mean residual.
        gradient = 2.0 * (along[best] * lines[best] - along[sensor] * lines[sensor])
        doubt = float(looks.half_width(gradient, confidence)[0])
        worse = along[best] ** 2 - along[sensor] ** 2 > doubt
        if sensor == best or not worse or not watch.design.directional[sensor]:
            suspects.append(sensor)
    return tuple(suspects), share


def _note(settings: ObserverSettings, watch: Watch, found: list[Alarm]) -> str:
    """Say what would have shown, what the design cannot meet, and which alarms accuse nobody."""
    least = ", ".join(
        f"{name} {size:.2g}"
        for name, size in zip(settings.outputs, watch.least_errors(), strict=True)
    )
    said = [f"a constant error raises an alarm beyond (SI units): {least}"]
    said += unmet(settings, watch.design)
    said += [
        f"the model is contradicted {_spans(those)}, {why}"
        for those, why in (
            (
                [alarm for alarm in found if alarm.beyond],
                "where an input is beyond those of the healthy stretch and the model is not known",
            ),
            (
                [alarm for alarm in found if not alarm.suspects and not alarm.beyond],
                OPEN,
            ),
        )
        if those
    ]
    return f"observer: {'; '.join(said)}"


def _spans(found: list[Alarm]) -> str:
    listed = ", ".join(f"{a.start_s:.1f} to {a.end_s:.1f} s" for a in found[:MOST_LISTED])
    more = len(found) - MOST_LISTED
    return f"{listed} and {more} more times" if more > 0 else listed


def _evidence(survey: Survey, found: list[Alarm], note: str) -> Evidence:
    table, settings = survey.table, survey.config.observer
    tolerance = float(np.radians(survey.config.tolerance.bias_deg_s))
    shape = (len(found), len(table.channels))
    low, high = np.full(shape, -np.inf), np.full(shape, np.inf)
    tested = np.zeros(shape, bool)
    accused = np.zeros(shape, np.int8)
    columns = {
        k: table.names.index(name)
        for k, name in enumerate(settings.outputs)
        if name in table.names and not table.channels[table.names.index(name)].derived
    }
    beside, details = [], []
    for row, alarm in enumerate(found):
        for k, column in columns.items():
            tested[row, column] = True
            low[row, column], high[row, column] = alarm.low[k], alarm.high[k]
        # A gyro's error within tolerance is no failure, and then nobody can be blamed alone.
        intolerable = all(
            max(alarm.low[k], -alarm.high[k]) > tolerance for k in alarm.suspects if k in columns
        )
        named = alarm.suspects if intolerable and not alarm.beyond else ()
        for k in named:
            if k in columns:
                accused[row, columns[k]] = 1
        beside.append(tuple(settings.outputs[k] for k in named if k not in columns))
        details.append(_detail(survey, alarm) if named else "")
    start = np.searchsorted(table.time_s, [alarm.start_s for alarm in found])
    stop = np.searchsorted(table.time_s, [alarm.end_s for alarm in found], side="right")
    start = np.minimum(start, max(len(table.time_s) - 1, 0))
    return Evidence(
        detector="observer",
        kind="bias",
        windows=spans(table, start, np.maximum(stop, start + 1)),
        tested=tested,
        low=low,
        high=high,
        tolerance=np.full(shape, tolerance),
        accused=accused,
        confidence=survey.config.windows.confidence,
        beside=tuple(beside),
        details=tuple(details),
        note=note,
    )


def _detail(survey: Survey, alarm: Alarm) -> str:
    settings = survey.config.observer
    names = [settings.outputs[k] for k in alarm.suspects]
    if len(names) > 1:
        return (
            f"one of {', '.join(names)} contradicts the model of the vehicle; their lines are too"
            " close to tell which"
        )
    text = "contradicts what the model of the vehicle predicts from its inputs"
    if len(settings.outputs) == 1:
        return f"{text}; nothing tells a failed sensor from a failed input or a wrong model"
    text += f"; {alarm.share:.1%} of the squared residual lies on its line"
    (k,) = alarm.suspects
    if names[0] not in survey.table.names and np.isfinite([alarm.low[k], alarm.high[k]]).all():
        unit = survey.signals[names[0]].unit
        text += f"; off by {alarm.low[k]:.3g} to {alarm.high[k]:.3g} {unit}".rstrip()
    return text
