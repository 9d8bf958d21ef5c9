"""The window test for bias and scale error together, as a vote on the windows of a log.

The formula is `fdilog.detectors.joint.joint_test`; here stands what a log needs around it: the
noise of every window, and a check of every answer.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.detectors.joint import _likeliest, joint_test
from fdilog.detectors.vote import Hypothesis, exchangeable
from fdilog.finding import Evidence
from fdilog.geometry import Floats, parity_matrix
from fdilog.isolation import (
    Answer,
    _suspects,
    comparative_evidence,
    family_wise_confidence,
    noise_shares,
)
from fdilog.noise import MAX_COSINES, windowed_mean
from fdilog.registry import Stage
from fdilog.windows import Moments, Survey

FEWEST_SAMPLES = 40
"""Ten for each coefficient that noise must be told from: a constant and three rates."""

FEWEST_DOF = 1.0
"""With less the noise of a window is not known at all."""

LEAST_SIGMA = 1e-3
"""Share of the tolerance below which noise, or a healthy spread, is as good as none."""

LEVELS_PER_OCTAVE = 2
"""Windows of nearly equal noise are tested together, each at the next higher level."""

ISOLATION = 0.8
"""Share of the likelihood that the channels named must hold together, as in `joint_suspects`."""

BLOCK_VALUES = 250_000
"""Readings worked on at once, 2 MB: bounds the memory and stays in the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class JointDetector:
    """Bias and scale error in windows of 40 samples or more; shorter ones are not tested.

    It needs no full rank: parallel gyros, two or more, are tested against the rate about their own
    axis. The rate must vary for a scale error to be told from a bias; either is accused.
    """

    description: ClassVar[str] = "likelihood ratio of bias and scale error over a window [Triads]"
    stage: ClassVar[Stage] = "windows"

    def detect(self, survey: Survey) -> list[Evidence]:
        """Name whose bias and scale error explain a window, where healthy ones do not."""
        answers = [_answer(moments, survey) for moments in survey.moments]
        evidence = comparative_evidence("joint", survey, answers)
        nothing = np.full(evidence.low.shape, np.nan)
        return [replace(evidence, low=nothing, high=nothing)]


@dataclass(frozen=True, kw_only=True, eq=False)
class _Block:
    """Windows of one size of one block of channels.

    Parameters
    ----------
    readings : (n_samples, k)
        Readings at the instants at which all channels of the block were recorded. [rad/s]
    start : (n,)
        First of them in each window, which holds `size`.
    relative : (k,)
        Noise variances relative to one another. [1]
    level : (n,)
        Noise of a sample: ``2^(level / LEVELS_PER_OCTAVE)`` tolerances.
    """

    readings: Floats
    start: NDArray[np.int64]
    size: int
    axes: Floats
    relative: Floats
    level: NDArray[np.int64]
    config: Config

    def ratios(
        self, rows: NDArray[np.intp], channels: NDArray[np.intp], *, doubles: bool = False
    ) -> Floats:
        """Likelihood ratio of each channel's failure, or each pair's, in some windows."""
        n = len(channels)
        found = np.empty((len(rows), n * (n - 1) // 2 if doubles else n))
        tolerance = np.radians(self.config.tolerance.bias_deg_s)
        least = LEAST_SIGMA * tolerance
        for level in np.unique(self.level[rows]).tolist():
            sigma = tolerance * 2.0 ** (level / LEVELS_PER_OCTAVE)
            of_level = np.flatnonzero(self.level[rows] == level)
            for at in _chunks(of_level, self.size * n):
                test = joint_test(
                    self.gather(rows[at])[:, :, channels],
                    self.axes[channels],
                    sigma * np.sqrt(self.relative[channels]),
                    max(np.radians(self.config.noise.bias_sigma_deg_s), least, LEAST_SIGMA * sigma),
                    # Next to nothing is no scale error at all, of a failed channel either.
                    max(self.config.noise.scale_sigma, np.finfo(float).eps),
                    doubles=doubles,
                )
                found[at] = test.double if doubles else test.single
        return found

    def gather(self, rows: NDArray[np.intp]) -> Floats:
        """Return the readings of some windows, (n_rows, size, k)."""
        readings: Floats = self.readings[self.start[rows, None] + np.arange(self.size)]
        return readings


def _chunks(rows: NDArray[np.intp], values_per_row: int) -> Iterator[NDArray[np.intp]]:
    step = max(1, BLOCK_VALUES // values_per_row)
    for first in range(0, len(rows), step):
        yield rows[first : first + step]


def _answer(moments: Moments, survey: Survey) -> Answer:
    """Test the windows of one block of channels."""
    k = len(moments.channels)
    shape = (len(moments.windows), k)
    answer = Answer(
        tested=np.zeros(shape, bool),
        low=np.full(shape, -np.inf),
        high=np.full(shape, np.inf),
        tolerance=np.full(shape, np.radians(survey.config.tolerance.bias_deg_s)),
        accused=np.zeros(shape, np.int8),
    )
    block, known = _block(moments, survey)
    if block is None:
        return answer
    answer.tested[known] = True
    everyone = np.arange(k)
    doubt = 1.0 - survey.config.windows.confidence
    single = block.ratios(known, everyone)
    redundancy = len(moments.parity)
    # The formula knows single and double failures; one parity component is left to check them.
    most = min(survey.config.detectors.max_failures, max(redundancy - 1, 1), 2)
    alarmed = single.max(axis=1) > _threshold(k, doubt)
    left, single = known[alarmed], single[alarmed]
    for size in range(1, most + 1):
        if not len(left):
            break
        hypotheses: list[Hypothesis] = list(combinations(range(k), size))
        ratio = single if size == 1 else block.ratios(left, everyone, doubles=True)
        likely = _likeliest(ratio, ISOLATION).astype(float)
        stands = likely @ _alike(block.axes, hypotheses) > 0
        best = ratio.argmax(axis=1)
        explained = np.ones(len(left), bool)
        for number in np.unique(best).tolist():
            here = np.flatnonzero(best == number)
            others = np.setdiff1d(everyone, hypotheses[number])
            if len(parity_matrix(block.axes[others])):
                # Without a large fault the rate is right too, and the others show if they agree.
                rest = block.ratios(left[here], others).max(axis=1)
                explained[here] = rest <= _threshold(len(others), doubt)
        answer.accused[left[explained]] = _suspects(stands[explained], hypotheses, k)
        left = left[~explained]
    answer.accused[left] = answer.tested[left]
    return answer


def _threshold(hypotheses: int, doubt: float) -> float:
    """Return what the best of several two-parameter hypotheses exceeds with that probability."""
    return float(2.0 * np.log(hypotheses / doubt))


def _alike(axes: Floats, hypotheses: list[Hypothesis]) -> Floats:
    """Which hypotheses redundancy cannot tell apart, (h, h)."""
    place = {hypothesis: number for number, hypothesis in enumerate(hypotheses)}
    alike = np.eye(len(hypotheses))
    for hypothesis, number in place.items():
        for other in exchangeable(axes, hypothesis):
            alike[number, place[other]] = 1.0
    return alike


def _block(moments: Moments, survey: Survey) -> tuple[_Block | None, NDArray[np.intp]]:
    """Cut out the readings of a block, with the windows in which their noise is known."""
    table, windows = survey.table, survey.windows
    columns = list(moments.channels)
    together = np.asarray(table.valid[:, columns].all(axis=1), bool)
    before = np.concatenate([[0], np.cumsum(together)])
    start = before[windows.start[moments.windows]]
    size = int((before[windows.stop[moments.windows]] - start)[0]) if len(start) else 0
    if size < FEWEST_SAMPLES:
        return None, np.zeros(0, np.intp)
    block = _Block(
        readings=(table.rate_rad_s if together.all() else table.rate_rad_s[together])[:, columns],
        start=start,
        size=size,
        axes=table.axes[columns],
        relative=noise_shares(moments),
        level=np.zeros(len(start), np.int64),
        config=survey.config,
    )
    config = survey.config
    confidence = family_wise_confidence(config, windows.length_s, len(columns))
    # Sources sampled at different instants differ by the rate of change all through the window.
    late = config.noise.time_sigma_s * np.abs(moments.slope).max(axis=1, initial=0.0)
    tolerance = np.radians(config.tolerance.bias_deg_s)
    bounds = []
    for variance, dof in _noise(block, moments):
        sigma = np.maximum(np.sqrt(variance + size * late**2), LEAST_SIGMA * tolerance)
        bounds.append(sigma * _inflation(dof, confidence, config.windows.confidence, len(columns)))
    # Both hold; the smaller one fails no more often than the two together.
    octaves = np.log2(np.minimum(*bounds) / tolerance)
    known = np.flatnonzero(np.isfinite(octaves))
    block.level[known] = np.ceil(LEVELS_PER_OCTAVE * octaves[known]).astype(np.int64)
    return block, known


def _inflation(dof: Floats, family: float, printed: float, hypotheses: int) -> Floats:
    """How much larger to take the noise, given how well a window knows it.

    The test is held against its threshold at the printed confidence, as the tolerance for healthy
    errors asks. Noise alone, of which a flight draws thousands of windows, must not reach it but
    with the family-wise probability. The ratio is twice an F statistic with (2, dof) degrees of
    freedom, whose tail is ``(1 + 2 x / dof)^(-dof / 2)``.
    """
    inflation = np.full(len(dof), np.inf)
    known = dof >= FEWEST_DOF
    doubt = (1.0 - family) / (2 * hypotheses)  # two bounds on the noise
    reached = np.expm1(-2.0 / dof[known] * np.log(doubt)) * dof[known]
    inflation[known] = np.sqrt(reached / _threshold(hypotheses, 1.0 - printed))
    return inflation


def _noise(block: _Block, moments: Moments) -> Iterator[tuple[Floats, Floats]]:
    """Noise of one sample in every window, as white noise of that level would average out.

    Yields twice, from the parity vector as it is and from what is left of it when scale errors of
    any size are fitted. The first is better known, the second is not fooled by scale errors.

    Yields
    ------
    variance : (n,)
        Long-run variance of a sample, or plain variance where that is larger, in the direction in
        which it is largest. In units of the relative noise of the channels; infinite if not known.
        [rad^2/s^2]
    dof : (n,)
        Degrees of freedom.
    """
    n, size = len(block.start), block.size
    parity = moments.parity
    factor = np.linalg.cholesky(parity @ np.diag(block.relative) @ parity.T)
    to_parity = np.linalg.solve(factor, parity).T
    rank = len(block.axes) - len(parity)
    # A scale error adds a multiple of the rate to the parity vector: rates are fitted.
    fitted = rank if block.config.noise.scale_sigma > 0.0 else 0
    to_rate = np.linalg.pinv(block.axes).T @ np.linalg.svd(block.axes)[2][:fitted].T
    plain, variance, dof = np.full(n, np.inf), np.full(n, np.inf), np.zeros(n)
    q, to_series = len(parity), np.hstack([to_parity, to_rate])
    for at in _chunks(np.arange(n), size * len(block.axes)):
        series = block.gather(at) @ to_series
        series -= series.mean(axis=1, keepdims=True)
        left, rates = series[..., :q], series[..., q:]
        products = np.swapaxes(series, 1, 2) @ series
        spread, across = products[:, :q, :q], products[:, q:, :q]
        if fitted:
            fit = np.linalg.pinv(products[:, q:, q:], hermitian=True) @ across
            # One rate is multiplied, not matrix-multiplied: BLAS starts threads for single columns.
            left -= rates * fit if fitted == 1 else rates @ fit
            spread = spread - np.swapaxes(across, 1, 2) @ fit
        plain[at] = _largest(spread / (size - 1 - fitted))
        looks = windowed_mean(left)
        known = looks.dof > 0
        variance[at[known]] = size * _largest(looks.covariance[known])
        dof[at] = looks.dof * (1.0 - fitted / min(size - 1, MAX_COSINES))
    yield np.maximum(plain, variance), dof
    looks = moments.parity_mean
    known = looks.dof > 0
    whiten: Floats = np.linalg.inv(factor)
    unfitted = np.full(n, np.inf)
    unfitted[known] = size * _largest(whiten @ looks.covariance[known] @ whiten.T)
    yield np.maximum(plain, unfitted), looks.dof


def _largest(covariance: Floats) -> Floats:
    """Return the largest variance of any combination of unit length."""
    largest: Floats = np.maximum(np.linalg.eigvalsh(covariance)[..., -1], 0.0).astype(np.float64)
    return largest
