"""Luenberger observer whose residual points along one line for each sensor that may fail.

Model ``x' = A x + B u``, measurements ``y = C x``; a fault of sensor i adds c_i f to y, c_i its
unit vector. The observer ``x^' = A x^ + B u + K (y - C x^)`` leaves the residual r = y - C x^.

Where this departs from [Observer24]: the paper asks that ``l_i`` and ``(A - K C) l_i`` be parallel
for ``l_i = K c_i``, with one observer for each sensor. That overlooks that f enters r directly,
and forces an eigenvalue 0 where K c_i is parallel to A c_i. With d_i such that C d_i = c_i and
``q = (x - x^) + d_i f`` one has ``r = C q`` and ``q' = (A - K C) q - A d_i f + d_i f'``: after the
onset the residual stays on the line ``l_i = C A d_i`` if and only if A d_i is an eigenvector of
A - K C. One gain can do that for all sensors at once, and that is the gain built here.

References
----------
[Observer24] "Fault detection algorithm for the inertial navigation system of an uncrewed surface
    vessel", Journal of Instrument Engineering 67(1), 2024.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdilog.maths.geometry import RANK_TOLERANCE, Floats

FORGOTTEN = 1e-18
"""Share of a state so old that adding it changes no digit of a double."""
# A matrix of norm 1/16 has converged to the last bit after as many terms.
EXPONENTIAL_TERMS = 14


@dataclass(frozen=True, kw_only=True)
class ObserverDesign:
    """A gain, and how far it does what it was designed for.

    Parameters
    ----------
    gain : (n_states, n_outputs)
        K. [1/s]
    directions : (n_outputs, n_outputs)
        Row i is l_i, the line on which a fault of sensor i holds the residual. [1/s]
    rates_per_s : (n_outputs,)
        Eigenvalue of A - K C that belongs to A d_i: a constant fault f settles at
        ``r = l_i f / rate``. [1/s]
    eigenvalues : (n_states,)
        Of A - K C. [1/s]
    directional : (n_outputs,)
        Whether A d_i is an eigenvector of A - K C indeed.
    problems
        What could not be met, in words; empty if all was.
    """

    gain: Floats
    directions: Floats
    rates_per_s: Floats
    eigenvalues: NDArray[np.complex128]
    directional: NDArray[np.bool_]
    problems: tuple[str, ...]


def _matrices(
    dynamics: ArrayLike, inputs: ArrayLike, outputs: ArrayLike | None
) -> tuple[Floats, Floats, Floats]:
    a = np.asarray(dynamics, dtype=np.float64)
    n = len(a)
    b = np.asarray(inputs, dtype=np.float64)
    c = np.eye(n) if outputs is None else np.asarray(outputs, dtype=np.float64)
    if a.shape != (n, n) or b.ndim != 2 or len(b) != n or c.ndim != 2 or c.shape[1] != n:
        raise ValueError(f"A {a.shape}, B {b.shape} and C {c.shape} do not fit one another")
    return a, b, c


def design_observer(
    dynamics: ArrayLike, eigenvalues: ArrayLike, outputs: ArrayLike | None = None
) -> ObserverDesign:
    """Gain that keeps every sensor's fault on its own line in the residual.

    Parameters
    ----------
    dynamics : (n_states, n_states)
        A. [1/s]
    eigenvalues : (n_outputs,)
        Wanted eigenvalue of A - K C for each sensor's direction A d_i, negative. [1/s]
    outputs : (n_outputs, n_states)
        C; the identity if every state is measured.

    Returns
    -------
    design
        With ``K = (A A D - A D diag(eigenvalues)) pinv(C A D)``, D = pinv(C). With fewer sensors
        than states the other eigenvalues follow and may be unstable, and with dependent sensors
        the directions coincide; `problems` says so.

    Raises
    ------
    ValueError
        If shapes do not fit or an eigenvalue is not negative.

    References
    ----------
    [Observer24], derived anew: see the head of this module.
    """
    a, _, c = _matrices(dynamics, np.zeros((len(np.asarray(dynamics)), 0)), outputs)
    wanted = np.asarray(eigenvalues, dtype=np.float64)
    if wanted.shape != (len(c),) or not (wanted < 0).all():
        raise ValueError(f"{len(c)} sensors need as many negative eigenvalues, not {wanted}")
    entry = np.linalg.pinv(c)
    moved = a @ entry
    seen = c @ moved
    gain = (a @ moved - moved * wanted) @ np.linalg.pinv(seen, rcond=RANK_TOLERANCE)
    return assess_gain(a, gain, c)


def assess_gain(
    dynamics: ArrayLike, gain: ArrayLike, outputs: ArrayLike | None = None
) -> ObserverDesign:
    """Check how far a gain does what the directional residual asks of it.

    Parameters
    ----------
    dynamics : (n_states, n_states)
        A. [1/s]
    gain : (n_states, n_outputs)
        K. [1/s]
    outputs : (n_outputs, n_states)
        C; the identity if every state is measured.

    Returns
    -------
    design
        Sensor i is directional if A d_i is an eigenvector of A - K C, with the eigenvalue
        `rates_per_s`; `problems` says what is not met.

    Raises
    ------
    ValueError
        If shapes do not fit.

    References
    ----------
    [Observer24], condition derived anew: see the head of this module.
    """
    a, _, c = _matrices(dynamics, np.zeros((len(np.asarray(dynamics)), 0)), outputs)
    k = np.asarray(gain, dtype=np.float64)
    if k.shape != c.T.shape:
        raise ValueError(f"K {k.shape} does not fit C {c.shape}")
    closed = a - k @ c
    found = np.linalg.eigvals(closed).astype(np.complex128)
    entry = np.linalg.pinv(c)
    moved = a @ entry
    seen = c @ moved
    scale = max(float(np.abs(closed).max()), 1.0)
    size = np.linalg.norm(moved, axis=0)
    turned = closed @ moved
    rates = np.einsum("ij,ij->j", moved, turned) / np.maximum(size, RANK_TOLERANCE) ** 2
    exact = np.abs(turned - moved * rates).max(axis=0) <= 1e-6 * scale * size
    entered = np.abs(c @ entry - np.eye(len(c))).max(axis=0) <= RANK_TOLERANCE**0.5
    directional = exact & entered & (np.linalg.norm(seen, axis=0) > RANK_TOLERANCE * scale)
    problems = [
        f"the fault of sensor {i} does not stay on one line" for i in np.flatnonzero(~directional)
    ]
    if np.linalg.matrix_rank(seen, rtol=RANK_TOLERANCE) < len(c):
        problems.append("the lines of the sensors are not independent")
    if not (found.real < 0).all():
        problems.append("the observer is not stable")
    return ObserverDesign(
        gain=k,
        directions=np.ascontiguousarray(seen.T),
        rates_per_s=rates,
        eigenvalues=found,
        directional=directional,
        problems=tuple(problems),
    )


def _exponential(matrix: Floats) -> Floats:
    """Matrix exponential by a Taylor series of the matrix halved until it is small, and squaring.

    References
    ----------
    C. Moler, C. Van Loan, "Nineteen dubious ways to compute the exponential of a matrix,
    twenty-five years later", SIAM Review 45(1), 2003, method 3.
    """
    halvings = max(
        0, int(np.ceil(np.log2(max(np.abs(matrix).sum(axis=1).max(initial=0.0), 1e-9)))) + 4
    )
    small = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, EXPONENTIAL_TERMS):
        term = term @ small / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


def held_step(dynamics: Floats, inputs: Floats, step_s: float) -> tuple[Floats, Floats]:
    """Discretise x' = A x + B u exactly, with u held over each step: F (n, n) and g (n, m)."""
    n, m = inputs.shape
    joint = np.zeros((n + m, n + m))
    joint[:n, :n], joint[:n, n:] = dynamics, inputs
    step = _exponential(joint * step_s)
    return step[:n, :n], step[:n, n:]


def propagate(step: Floats, drive: Floats, start: Floats) -> Floats:
    """States of ``x_k+1 = F x_k + g_k`` without a loop over time.

    Parameters
    ----------
    step : (n_states, n_states)
        F.
    drive : (n_steps, n_states)
        g.
    start : (n_states,)
        x_0.

    Returns
    -------
    states : (n_steps + 1, n_states)
        x_0 to x_n. Every pass doubles the past that each state has taken in; a stable system
        needs only as many passes as it remembers.
    """
    states = np.concatenate([start[None, :], drive])
    power, reach = step, 1
    while reach < len(states) and np.abs(power).max() > FORGOTTEN:
        states[reach:] += states[:-reach] @ power.T
        power, reach = power @ power, 2 * reach
    return states


def observer_residual(
    measured: ArrayLike,
    inputs_held: ArrayLike,
    *,
    step_s: float,
    dynamics: ArrayLike,
    inputs: ArrayLike,
    gain: ArrayLike,
    outputs: ArrayLike | None = None,
) -> Floats:
    """Run the observer over a record and give what it fails to explain.

    Parameters
    ----------
    measured : (n_samples, n_outputs)
        y, without gaps. [any units]
    inputs_held : (n_samples, n_inputs)
        u, each held until the next sample. [any units]
    step_s
        Sampling interval. [s]
    dynamics, inputs, outputs
        A (n_states, n_states), B (n_states, n_inputs), C (n_outputs, n_states).
    gain : (n_states, n_outputs)
        K of `design_observer`, or any other. [1/s]

    Returns
    -------
    residual : (n_samples, n_outputs)
        ``r = y - C x^``; the observer starts at ``x^ = pinv(C) y``. [units of y]

    Raises
    ------
    ValueError
        If shapes do not fit, a value is not finite (split the record at its gaps), or the observer
        is not stable at this sampling interval.

    Notes
    -----
    The residual is held over each step: ``x^_k+1 = F x^_k + g u_k + G K (y_k - C x^_k)`` with
    F = exp(A step), G the integral of exp(A t). So a healthy record leaves none, however coarse the
    sampling, and that of a constant fault settles exactly on its line, since F - 1 = G A.

    References
    ----------
    [Observer24], observer equation.
    """
    a, b, c = _matrices(dynamics, inputs, outputs)
    k = np.asarray(gain, dtype=np.float64)
    y = np.asarray(measured, dtype=np.float64)
    u = np.asarray(inputs_held, dtype=np.float64)
    if y.ndim != 2 or y.shape[1] != len(c) or u.shape != (len(y), b.shape[1]):
        raise ValueError(f"y {y.shape} and u {u.shape} do not fit the model")
    if not (np.isfinite(y).all() and np.isfinite(u).all()):
        raise ValueError("an observer cannot cross a gap: split the record at values not finite")
    if not len(y):
        return y
    free, held = held_step(a, np.hstack([b, k]), step_s)
    step = free - held[:, b.shape[1] :] @ c
    if np.abs(np.linalg.eigvals(step)).max() > 1.0 + RANK_TOLERANCE:
        raise ValueError(f"the observer is not stable at a sampling interval of {step_s} s")
    drive = np.hstack([u, y])[:-1] @ held.T
    estimate = propagate(step, drive, np.linalg.pinv(c) @ y[0])
    residual: Floats = y - estimate @ c.T
    return residual


def directional_metric(residual: ArrayLike, directions: ArrayLike) -> Floats:
    """How much of the residual lies along the line of each sensor.

    Parameters
    ----------
    residual : (n_samples, n_outputs)
        r. [any]
    directions : (n_sensors, n_outputs)
        l_i. [any]

    Returns
    -------
    metric : (n_samples, n_sensors)
        ``C_i = (l_i' r)^2 / (|l_i|^2 |r|^2)``, between 0 and 1: the larger, the likelier sensor i.
        Not-a-number where the residual is zero. [1]

    References
    ----------
    [Observer24], decision by the normalised projection. Angles between states of different units
    depend on the units: measure each output in units of its noise to compare like with like.
    """
    r = np.asarray(residual, dtype=np.float64)
    lines = np.asarray(directions, dtype=np.float64)
    unit = lines / np.linalg.norm(lines, axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        metric: Floats = (r @ unit.T) ** 2 / (r**2).sum(axis=1, keepdims=True)
    return metric
