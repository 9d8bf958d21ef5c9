"""An observer over a whole record: sensors and commands of a log, a model, and what it leaves.

The formulas are in `fdilog.detectors.observer`; here they meet the streams that the configuration
names. What follows from the residual is in `fdilog.detectors.observer_evidence`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fdilog.config import ObserverSettings
from fdilog.detectors.identification import identify_model
from fdilog.detectors.observer import (
    ObserverDesign,
    assess_gain,
    design_observer,
    held_step,
    observer_residual,
    propagate,
)
from fdilog.errors import UsageError
from fdilog.maths.geometry import Floats
from fdilog.sources.signals import Signal, held, sampled
from fdilog.windows.survey import Survey, stretches

FORGOTTEN = 5.0
"""Time constants after which an observer no longer knows where it started: 1 % is left."""

THRESHOLD_FACTOR = 3.0
"""An alarm is a residual this many times as long as any of the healthy stretch."""

FASTER = 2.0
"""The usual choice: an observer twice as fast as what it observes."""

MARGIN = 0.1
"""Part of the range of a healthy input by which it may leave it: beyond, the model is not known."""

ROUNDING = 1e-9
"""Part of an output that may be rounding: less than that is no residual."""

FEWEST_HEALTHY = 20

SLOWEST_PER_S = 1e-3
"""An observer that forgets more slowly than over a quarter of an hour settles in no log."""

LEAST_EXPLAINED = 0.5
"""An identified model must explain half of what an output does in the stretch it is made from, by
the inputs alone: what follows a sensor without them says nothing of it."""


class NotAskedError(Exception):
    """The log does not hold what the model needs; the text says what."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """A stretch without gaps: instants (n,), outputs y (n, p) and inputs u (n, m)."""

    time_s: Floats
    outputs: Floats
    inputs: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Watch:
    """What the observer of a record leaves.

    Parameters
    ----------
    time_s : (n,)
        Instants at which it has forgotten its start. [s]
    residual : (n, p)
        r less its mean over the healthy stretch, in `units`.
    healthy : (n,) bool
        Whether an instant belongs to the healthy stretch.
    beyond : (n,) bool
        Whether an input lies beyond those of the healthy stretch.
    units : (p,)
        What counts as one in each output.
    threshold
        Length of the residual that is an alarm.
    """

    time_s: Floats
    residual: Floats
    healthy: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    units: Floats
    threshold: float
    step_s: float
    design: ObserverDesign

    @property
    def slowest_s(self) -> float:
        """Time constant of the observer. [s]"""
        return 1.0 / float(np.abs(self.design.eigenvalues.real).min())

    @property
    def lines(self) -> Floats:
        """Unit vectors along the lines of the sensors, (p, p)."""
        lines = self.design.directions / self.units
        length = np.linalg.norm(lines, axis=1, keepdims=True)
        unit: Floats = np.divide(lines, length, out=np.zeros_like(lines), where=length > 0)
        return unit

    def errors(self) -> Floats:
        """Error of each sensor if it is the one and its fault is constant, (n, p) [its unit].

        It settles at ``r = l_i f / rate``.
        """
        lines = self.design.directions / self.units
        power = (lines**2).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            errors: Floats = self.residual @ lines.T * (self.design.rates_per_s / power)
        return errors

    def least_errors(self) -> Floats:
        """Smallest constant error of each sensor that raises an alarm, (p,) [its unit]."""
        length = np.linalg.norm(self.design.directions / self.units, axis=1)
        with np.errstate(divide="ignore"):
            least: Floats = self.threshold * np.abs(self.design.rates_per_s) / length
        return least


def check(settings: ObserverSettings) -> None:
    """Raise a UsageError if the keys of [observer] do not fit one another."""
    n_outputs, n_inputs = len(settings.outputs), len(settings.inputs)
    n_states = n_outputs if settings.identify else len(settings.A)
    wanted = {
        "A": (settings.A, (n_states, n_states)),
        "B": (settings.B, (n_states, n_inputs)),
        "C": (settings.C, (n_outputs, n_states)),
        "K": (settings.K, (n_states, n_outputs)),
    }
    if settings.identify and (settings.A or settings.B or settings.C):
        raise UsageError("observer: identify = true finds A and B itself, with C the identity")
    if not settings.identify and not settings.A:
        raise UsageError("observer: give A and B, or identify = true")
    for key, (matrix, shape) in wanted.items():
        empty = not matrix and (key in {"C", "K"} or settings.identify or not n_inputs)
        if not empty and (len(matrix), len(matrix[0]) if matrix else 0) != shape:
            rows, columns = shape
            raise UsageError(f"observer.{key} must have {rows} rows of {columns} numbers")
    if not settings.C and n_states != n_outputs:
        raise UsageError(f"observer: {n_outputs} outputs of {n_states} states need C")
    for key, values in (
        ("units", settings.units),
        ("eigenvalues_per_s", settings.eigenvalues_per_s),
    ):
        if values and len(values) != n_outputs:
            raise UsageError(f"observer.{key} must have {n_outputs} numbers, one an output")
    if not settings.healthy_s and (
        settings.identify or not settings.units or not settings.threshold
    ):
        raise UsageError(
            "observer.healthy_s = [from, to] must name a healthy stretch, unless A, B, units and"
            " threshold are given"
        )


def watched(survey: Survey) -> Watch:
    """Run the observer over every stretch without gaps.

    Raises
    ------
    NotAskedError
        If the log does not hold what the model needs.
    """
    settings = survey.config.observer
    parts = runs(survey)
    if not parts:
        raise NotAskedError("outputs and inputs are never there at the same time")
    dynamics, inputs, outputs = _model(settings, parts)
    try:
        design = (
            assess_gain(dynamics, settings.K, outputs)
            if settings.K
            else design_observer(dynamics, _eigenvalues(settings, dynamics), outputs)
        )
        if not bool((design.eigenvalues.real < -SLOWEST_PER_S).all()):
            raise NotAskedError("; ".join(unmet(settings, design)))
        trim = _trim(settings, parts)
        residuals = [
            observer_residual(
                run.outputs,
                run.inputs - trim,
                step_s=settings.step_s,
                dynamics=dynamics,
                inputs=inputs,
                gain=design.gain,
                outputs=outputs,
            )
            for run in parts
        ]
    except ValueError as error:
        raise NotAskedError(str(error)) from None
    slowest_s = 1.0 / float(np.abs(design.eigenvalues.real).min())
    settled = np.concatenate([run.time_s - run.time_s[0] >= FORGOTTEN * slowest_s for run in parts])
    time_s = np.concatenate([run.time_s for run in parts])[settled]
    residual = np.concatenate(residuals)[settled]
    healthy = np.zeros(len(time_s), bool)
    if settings.healthy_s:
        healthy = (time_s >= settings.healthy_s[0]) & (time_s <= settings.healthy_s[1])
        if healthy.sum() < FEWEST_HEALTHY:
            raise NotAskedError(
                f"of the healthy stretch {healthy.sum()} steps are left after the observer settled"
            )
        # What a healthy record leaves on average are trims of servos and biases of sensors.
        residual = residual - residual[healthy].mean(axis=0)
    driven = np.concatenate([run.inputs for run in parts])[settled]
    units = np.array(settings.units)
    if not settings.units:
        told = np.concatenate([run.outputs for run in parts])[settled]
        least = ROUNDING * np.abs(told).max(axis=0)
        units = np.maximum(residual[healthy].std(axis=0), least)
    if not bool((units > 0).all()):
        raise NotAskedError("an output is zero all along")
    residual = residual / units
    threshold = settings.threshold
    if not threshold:
        longest = float(np.linalg.norm(residual[healthy], axis=1).max())
        threshold = THRESHOLD_FACTOR * max(longest, 1.0)
    return Watch(
        time_s=time_s,
        residual=residual,
        healthy=healthy,
        beyond=_beyond(driven, healthy),
        units=units,
        threshold=threshold,
        step_s=settings.step_s,
        design=design,
    )


def unmet(settings: ObserverSettings, design: ObserverDesign) -> list[str]:
    """Say which conditions of a directional residual a design does not meet, by sensor."""
    said = []
    for problem in design.problems:
        text = problem
        for number, name in enumerate(settings.outputs):
            text = text.replace(f"sensor {number} ", f"{name} ")
        said.append(text)
    if not bool((design.eigenvalues.real < 0).all()):
        return said
    slow = not bool((design.eigenvalues.real < -SLOWEST_PER_S).all())
    return [*said, "the observer hardly forgets where it started"] if slow else said


def _beyond(inputs: Floats, healthy: NDArray[np.bool_]) -> NDArray[np.bool_]:
    if not healthy.any():
        return np.zeros(len(inputs), bool)
    least, most = inputs[healthy].min(axis=0), inputs[healthy].max(axis=0)
    margin = MARGIN * (most - least)
    beyond: NDArray[np.bool_] = ((inputs < least - margin) | (inputs > most + margin)).any(axis=1)
    return beyond


def _eigenvalues(settings: ObserverSettings, dynamics: Floats) -> Floats:
    if settings.eigenvalues_per_s:
        return np.array(settings.eigenvalues_per_s)
    fastest = float(np.abs(np.linalg.eigvals(dynamics).real).max())
    if not fastest > 0:
        raise NotAskedError("A has no rate of its own; give observer.eigenvalues_per_s")
    return np.full(len(settings.outputs), -FASTER * fastest)


def _healthy_part(settings: ObserverSettings, run: Run) -> slice:
    first, last = settings.healthy_s
    return slice(
        int(np.searchsorted(run.time_s, first)), int(np.searchsorted(run.time_s, last, "right"))
    )


def _trim(settings: ObserverSettings, parts: list[Run]) -> Floats:
    """Mean of the inputs over the healthy stretch: a servo's neutral is not zero."""
    if not settings.healthy_s:
        return np.zeros(len(settings.inputs))
    inputs = np.concatenate([run.inputs[_healthy_part(settings, run)] for run in parts])
    return inputs.mean(axis=0) if len(inputs) else np.zeros(len(settings.inputs))


def _model(settings: ObserverSettings, parts: list[Run]) -> tuple[Floats, Floats, Floats]:
    """Return A, B and C as configured, or as identified from the longest healthy run."""
    if not settings.identify:
        n_states = len(settings.A)
        outputs = np.array(settings.C) if settings.C else np.eye(n_states)
        return np.array(settings.A), np.array(settings.B).reshape(n_states, -1), outputs
    run = max(parts, key=lambda run: len(run.time_s[_healthy_part(settings, run)]))
    part = _healthy_part(settings, run)
    try:
        dynamics, inputs = identify_model(run.outputs[part], run.inputs[part], settings.step_s)
    except ValueError as error:
        raise NotAskedError(f"no model from the healthy stretch: {error}") from None
    if not bool((np.linalg.eigvals(dynamics).real < 0).all()):
        raise NotAskedError("no model from the healthy stretch: the one that fits is not stable")
    share = explained(run.outputs[part], run.inputs[part], dynamics, inputs, step_s=settings.step_s)
    for name, part_of_it in zip(settings.outputs, share, strict=True):
        if part_of_it < LEAST_EXPLAINED:
            raise NotAskedError(
                f"no model from the healthy stretch: the inputs explain {max(part_of_it, 0.0):.0%}"
                f" of the variance of {name}"
            )
    return dynamics, inputs, np.eye(len(dynamics))


def explained(
    outputs: Floats, driven: Floats, dynamics: Floats, inputs: Floats, *, step_s: float
) -> Floats:
    """Part of the variance of each output, (p,), that a model explains from its inputs alone."""
    step, drive = held_step(dynamics, inputs, step_s)
    told = propagate(step, (driven - driven.mean(axis=0))[:-1] @ drive.T, np.zeros(len(step)))
    share: Floats = 1.0 - (outputs - told).var(axis=0) / outputs.var(axis=0)
    return share


def runs(survey: Survey) -> list[Run]:
    """Bring outputs and inputs onto uniform instants, and split these where one is missing."""
    settings, table = survey.config.observer, survey.table
    series = {**survey.signals, **_of_table(survey)}
    missing = [name for name in (*settings.outputs, *settings.inputs) if name not in series]
    if missing:
        raise NotAskedError(f"no {missing[0]}")
    dropout_s = survey.config.tolerance.dropout_s
    found = []
    for first, stop in stretches(table, survey.config):
        count = int((table.time_s[stop - 1] - table.time_s[first]) / settings.step_s) + 1
        time_s = table.time_s[first] + settings.step_s * np.arange(count)
        y = [sampled(series[name], time_s, dropout_s) for name in settings.outputs]
        u = [held(series[name], time_s, dropout_s) for name in settings.inputs]
        both = np.column_stack([*y, *u])
        there = np.concatenate([[False], np.isfinite(both).all(axis=1), [False]])
        edges = np.flatnonzero(np.diff(there.astype(np.int8))).reshape(-1, 2)
        found += [
            Run(
                time_s=time_s[a:b],
                outputs=both[a:b, : len(y)],
                inputs=both[a:b, len(y) :],
            )
            for a, b in edges
        ]
    return found


def _of_table(survey: Survey) -> dict[str, Signal]:
    settings, table = survey.config.observer, survey.table
    found = {}
    for name in (*settings.outputs, *settings.inputs):
        if name in table.names:
            column = table.names.index(name)
            rows = table.valid[:, column]
            if rows.sum() > 1:
                found[name] = Signal(
                    name=name,
                    unit="rad/s",
                    time_s=table.time_s[rows],
                    values=table.rate_rad_s[rows, column],
                )
    return found
