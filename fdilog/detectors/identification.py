"""A linear model of the vehicle by least squares, from a stretch in which its sensors are healthy.

References
----------
[Observer24] "Fault detection algorithm for the inertial navigation system of an uncrewed surface
    vessel", Journal of Instrument Engineering 67(1), 2024: its model x' = A x + B u.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fdilog.maths.geometry import RANK_TOLERANCE, Floats


def identify_model(
    states: ArrayLike, inputs_held: ArrayLike, step_s: float
) -> tuple[Floats, Floats]:
    """Estimate A and B by least squares from a healthy stretch in which every state is measured.

    Parameters
    ----------
    states : (n_samples, n_states)
        x as measured. [any units]
    inputs_held : (n_samples, n_inputs)
        u, each held until the next sample. [any units]
    step_s
        Sampling interval. [s]

    Returns
    -------
    dynamics : (n_states, n_states)
        A. [1/s]
    inputs : (n_states, n_inputs)
        B. [state/s per input]

    Raises
    ------
    ValueError
        If the stretch is too short or does not move enough to fix the model, or if the step it
        fits is no step of a continuous model.

    Notes
    -----
    Fits ``x_k+1 = F x_k + g u_k + constant`` and takes the matrix logarithm. The constant takes up
    sensor biases. Noise of the measured states would pull F towards zero, so x_k is first replaced
    by what x_k-1, u_k-1 and u_k tell of it (two-stage least squares [1]). That frees the fit of
    noise that is white; thin out a record whose noise lasts longer than its steps.

    References
    ----------
    [Observer24] takes A and B from hydrodynamic coefficients that are not legible; a log gives its
    own.

    [1] T. Soederstroem, P. Stoica, "Instrumental variable methods for system identification",
    Circuits, Systems and Signal Processing 21(1), 2002, 1-9.
    """
    x = np.asarray(states, dtype=np.float64)
    u = np.asarray(inputs_held, dtype=np.float64)
    if x.ndim != 2 or u.ndim != 2 or len(x) != len(u):
        raise ValueError(f"x {x.shape} and u {u.shape} do not fit one another")
    n, m = x.shape[1], u.shape[1]
    regressors = np.hstack([x, u, np.ones((len(x), 1))])
    size = np.abs(regressors).max(axis=0, initial=0.0)
    if len(regressors) <= 2 * (n + m + 1) or not size.all():
        raise ValueError("the stretch is too short, or a state or input is zero all along")
    regressors = regressors / size
    # What was known a step before, and the command, which no noise disturbs.
    before = np.hstack([regressors[:-2], regressors[1:-1, n:]])
    told = before @ np.linalg.lstsq(before, regressors[1:-1], rcond=RANK_TOLERANCE)[0]
    fitted, _, rank, _ = np.linalg.lstsq(told, x[2:], rcond=RANK_TOLERANCE)
    if rank < n + m + 1:
        raise ValueError("the stretch does not move enough to tell states and inputs apart")
    joint = np.eye(n + m)
    joint[:n] = (fitted / size[:, None])[: n + m].T
    poles = np.linalg.eigvals(joint[:n, :n])
    # The logarithm is real only if no pole lies on the negative real axis or at zero.
    if ((poles.real <= 0) & (np.abs(poles.imag) <= RANK_TOLERANCE)).any():
        raise ValueError("the fit is no step of a continuous model: the sampling is too coarse")
    continuous = _logarithm(joint) / step_s
    return continuous[:n, :n], continuous[:n, n:]


def _logarithm(matrix: Floats) -> Floats:
    """Principal matrix logarithm by eigenvectors: a fitted matrix has distinct eigenvalues."""
    values, vectors = np.linalg.eig(matrix)
    logarithm: Floats = np.real(
        vectors @ np.diag(np.log(values.astype(complex))) @ np.linalg.inv(vectors)
    )
    return logarithm
