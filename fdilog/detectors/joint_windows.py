"""The window test for bias and scale error together, as a vote on the windows of a log.

The formula is `fdilog.detectors.joint.joint_test`; here stands what a log needs around it: the
noise of every window, and a check of every answer.

It is asked about the means of short segments, not about samples. Vibration is no rate to judge a
scale factor by: every gyro feels its own, and what a gyro reads of it stands in the estimated rate
as well as in the residual, so that noise of unequal size looks like a scale error. In the means it
is small, and the long-run variance of the window is the right measure of their noise.
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
from fdilog.maths.geometry import Floats, parity_matrix
from fdilog.maths.noise import windowed_mean
from fdilog.registry import Stage
from fdilog.windows.isolation import (
    Answer,
    comparative_evidence,
    family_wise_confidence,
    noise_shares,
    numbered_suspects,
)
from fdilog.windows.survey import Moments, Survey

FEWEST_SAMPLES = 100
"""Twenty segments of five readings: less leaves either the vibration in or the noise unknown."""

SEGMENT_SAMPLES = 5
"""Readings in the shortest segment."""

MOST_SEGMENTS = 40
"""Enough to follow a manoeuvre; long windows take longer segments."""

FEWEST_DOF = 1.0
"""With less the noise of a window is not known at all."""

LEAST_SIGMA = 1e-3
"""Share of the tolerance below which noise, or a healthy spread, is as good as none."""

LEVELS_PER_OCTAVE = 2
"""Windows of nearly equal noise are tested together, each at the next higher level."""

ISOLATION = 0.8
"""Share of the likelihood that the channels named must hold together, as in `joint_suspects`."""

BLOCK_VALUES = 250_000
"""Means worked on at once, 2 MB: bounds the memory and stays in the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class JointDetector:
    """Bias and scale error in windows of 100 samples or more; shorter ones are not tested.

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
    total : (n_samples + 1, k)
        Sums of the readings from the first instant on at which all channels of the block were
        recorded. [rad/s]
    start : (n,)
        First of these instants in each window.
    edges : (n_segments + 1,)
        Where the segments of a window begin and end.
    segment_s
        Length of a segment. [s]
    relative : (k,)
        Noise variances relative to one another. [1]
    level : (n,)
        Noise of the mean of a segment: ``2^(level / LEVELS_PER_OCTAVE)`` tolerances.
    moving : (n,) bool
        Whether the rate varies enough to judge scale factors by.
    """

    total: Floats
    start: NDArray[np.int64]
    edges: NDArray[np.int64]
    segment_s: float
    axes: Floats
    relative: Floats
    level: NDArray[np.int64]
    moving: NDArray[np.bool_]
    config: Config

    def ratios(
        self, rows: NDArray[np.intp], channels: NDArray[np.intp], *, doubles: bool = False
    ) -> Floats:
        """Likelihood ratio of each channel's failure, or each pair's, in some windows."""
        n = len(channels)
        found = np.empty((len(rows), n * (n - 1) // 2 if doubles else n))
        tolerance = np.radians(self.config.tolerance.bias_deg_s)
        least = LEAST_SIGMA * tolerance
        kinds, kind = np.unique(
            np.column_stack([self.level, self.moving])[rows], axis=0, return_inverse=True
        )
        for number, (level, moving) in enumerate(kinds.tolist()):
            sigma = tolerance * 2.0 ** (level / LEVELS_PER_OCTAVE)
            # Next to nothing is no scale error at all, of a failed channel either.
            scale_sigma = self.config.noise.scale_sigma if moving else float(np.finfo(float).eps)
            for at in _chunks(np.flatnonzero(kind == number), len(self.edges) * len(self.axes)):
                test = joint_test(
                    self.means(rows[at])[:, :, channels],
                    self.axes[channels],
                    sigma * np.sqrt(self.relative[channels]),
                    max(np.radians(self.config.noise.bias_sigma_deg_s), least, LEAST_SIGMA * sigma),
                    scale_sigma,
                    doubles=doubles,
                )
                found[at] = test.double if doubles else test.single
        return found

    def means(self, rows: NDArray[np.intp]) -> Floats:
        """Return the means of the segments of some windows, (n_rows, n_segments, k)."""
        sums = np.diff(self.total[self.start[rows, None] + self.edges], axis=1)
        means: Floats = sums / np.diff(self.edges)[:, None]
        return means


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
        answer.accused[left[explained]] = numbered_suspects(stands[explained], hypotheses, k)
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
    together, start, size = survey.together(moments)
    if size < FEWEST_SAMPLES:
        return None, np.zeros(0, np.intp)
    readings = (table.rate_rad_s if together.all() else table.rate_rad_s[together])[:, columns]
    total = np.zeros((len(readings) + 1, len(columns)))
    np.cumsum(readings, axis=0, out=total[1:])
    segments = min(MOST_SEGMENTS, size // SEGMENT_SAMPLES)
    block = _Block(
        total=total,
        start=start,
        edges=np.linspace(0, size, segments + 1).astype(np.int64),
        segment_s=size / segments * table.period_s,
        axes=table.axes[columns],
        relative=noise_shares(moments),
        level=np.zeros(len(start), np.int64),
        moving=np.zeros(len(start), bool),
        config=survey.config,
    )
    config = survey.config
    confidence = family_wise_confidence(config, windows.length_s, len(columns))
    least = LEAST_SIGMA * np.radians(config.tolerance.bias_deg_s)
    fitted, plain = _noise(block, moments)
    bounds = [
        np.maximum(np.sqrt(noise.variance), least)
        * _inflation(noise.dof, confidence, config.windows.confidence, len(columns))
        for noise in (fitted, plain)
    ]
    # Both hold; the smaller one fails no more often than the two together.
    octaves = np.log2(np.minimum(*bounds) * (LEAST_SIGMA / least))
    known = np.flatnonzero(np.isfinite(octaves))
    block.level[known] = np.ceil(LEVELS_PER_OCTAVE * octaves[known]).astype(np.int64)
    # Noise that stands in the rate and in the residual looks like a scale error of their ratio of
    # variances at most: a healthy one where the rate varies so much.
    block.moving[:] = config.noise.scale_sigma * fitted.motion > fitted.variance
    return block, known


@dataclass(frozen=True, kw_only=True, eq=False)
class _Noise:
    """Noise of the mean of a segment in every window, by its long-run variance.

    Parameters
    ----------
    variance : (n,)
        In the direction of parity space in which it is largest, in units of the relative noise of
        the channels; infinite if not known. [rad^2/s^2]
    dof : (n,)
        Degrees of freedom.
    motion : (n,)
        Variance over the window of the estimated rate, along the axis about which it varies least.
        [rad^2/s^2]
    """

    variance: Floats
    dof: Floats
    motion: Floats


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


def _noise(block: _Block, moments: Moments) -> tuple[_Noise, _Noise]:
    """Measure the noise twice: less scale errors of any size, and with what is in it.

    The first is not fooled by scale errors, the second is better known.
    """
    n, segments = len(block.start), len(block.edges) - 1
    parity = moments.parity
    whiten: Floats = np.linalg.inv(
        np.linalg.cholesky(parity @ np.diag(block.relative) @ parity.T)
    ).astype(np.float64)
    rank = len(block.axes) - len(parity)
    # A scale error adds a multiple of the rate to the parity vector: rates are fitted.
    fitted = rank if block.config.noise.scale_sigma > 0.0 else 0
    to_rate = np.linalg.pinv(block.axes).T @ np.linalg.svd(block.axes)[2][:fitted].T
    left = np.empty((n, segments, len(parity)))
    late, motion = np.empty(n), np.zeros(n)
    for at in _chunks(np.arange(n), len(block.edges) * len(block.axes)):
        means = block.means(at)
        # Sources sampled at different instants differ by the rate of change.
        change = np.diff(means, axis=1) / block.segment_s
        late[at] = (change**2).mean(axis=1).max(axis=1) * block.config.noise.time_sigma_s**2
        means -= means.mean(axis=1, keepdims=True)
        left[at] = means @ (whiten @ parity).T
        if fitted:
            rates = means @ to_rate
            fit = np.linalg.pinv(rates) @ left[at]
            left[at] -= rates @ fit
            along = means @ (block.axes @ np.linalg.pinv(block.axes)).T
            motion[at] = along.var(axis=1).min(axis=1)
    looks = windowed_mean(left)
    plain = _largest(np.swapaxes(left, 1, 2) @ left) / (segments - 1 - fitted)
    free = 1.0 - fitted / (segments - 1)
    mean = moments.parity_mean
    known = mean.dof > 0
    raw = np.full_like(mean.covariance, np.inf)
    raw[known] = whiten @ mean.covariance[known] @ whiten.T
    both = []
    for covariance, dof in ((looks.covariance, looks.dof * free), (raw, mean.dof)):
        variance = np.full(n, np.inf)
        variance[dof > 0] = segments * _largest(covariance[dof > 0])
        both.append(_Noise(variance=np.maximum(variance, plain) + late, dof=dof, motion=motion))
    return both[0], both[1]


def _largest(covariance: Floats) -> Floats:
    """Return the largest variance of any combination of unit length."""
    largest: Floats = np.maximum(np.linalg.eigvalsh(covariance)[..., -1], 0.0).astype(np.float64)
    return largest
