"""Which channels failed: every hypothesis that the redundancy can test, tested jointly.

A hypothesis is a set of channels that are taken out; it stands if none of those left is off by
more than its tolerance, each compared with the others that are left. The smallest sets that stand
are the answer: one set isolates its channels, several name suspects. A large fault of one channel
pulls the comparison of every other, but only without it do the rest agree, so nobody else is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.finding import Evidence
from fdilog.maths.geometry import leave_one_out
from fdilog.maths.noise import WindowedMean
from fdilog.windows.survey import Moments, Survey

Floats = NDArray[np.float64]

# No channel is trusted with more than ten times the weight of another: noise levels are estimates.
LEAST_VARIANCE_SHARE = 0.1
# A hypothesis that stands is still let go if another explains the same readings this many times
# better: one wrong accusation in a hundred cases that the intervals alone would leave open.
LEAST_ODDS = 100.0
# Of what healthy offsets are, this part wanders in a flight: 0.17 deg/s by default. In recorded
# flights of up to eighteen minutes it is 0.1 deg/s at most, warming up included.
WANDER = 0.5
# Windows laid where a fault seems to lie are chosen among all spans, which is as if so many more
# were looked at: of an hour of white noise, the largest mean of all spans of five seconds to a
# minute is beyond 5 sigma as often as if windows advanced by this. [s]
LAID_S = 0.07
# A tone that stands still is off by its amplitude at most, and that in the window itself it cannot
# be seen: its root mean square is told by the other windows.
PEAK = np.sqrt(2.0)
SECONDS_PER_HOUR = 3600.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Comparison:
    """Each channel against its prediction from the others, some being taken out.

    Parameters
    ----------
    tested : (k,) bool
        Whether the others span the channel's axis.
    error, half_width, doubt, tolerance : (n, k)
        Estimate of the channel's error, half-width of its interval at the printed confidence and
        at the family-wise one, and its tolerance. [rad/s]
    """

    tested: NDArray[np.bool_]
    error: Floats
    half_width: Floats
    doubt: Floats
    tolerance: Floats

    def outside(self, healthy_sigma: float) -> NDArray[np.bool_]:
        """Tell which errors lie beyond tolerance for sure, (n, k).

        Two conditions: the interval at the printed confidence lies wholly outside the tolerance,
        and the one at the family-wise confidence excludes what healthy gyros usually have. The
        first decides where a window is known well; the second keeps windows that are known badly,
        of which a flight has thousands, from crying wolf.
        """
        size = np.abs(self.error)
        found: NDArray[np.bool_] = (
            self.tested
            & (size - self.half_width > self.tolerance)
            & (size - self.doubt > healthy_sigma)
        )
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """What the redundancy says of each channel in each window.

    Parameters
    ----------
    tested : (n, k) bool
        Whether the channel was compared with anything.
    low, high : (n, k)
        Interval for its error that holds under every hypothesis that stands. [rad/s]
    tolerance : (n, k)
        Tolerance for that error, wider while the rate is high. [rad/s]
    accused : (n, k) int8
        As in `fdilog.finding.Evidence`.
    doubt : (n, k) or None
        Half-width of the interval at the family-wise confidence. [rad/s]
    """

    tested: NDArray[np.bool_]
    low: Floats
    high: Floats
    tolerance: Floats
    accused: NDArray[np.int8]
    doubt: Floats | None = None

    @classmethod
    def of(cls, comparison: Comparison) -> Answer:
        """Start from a comparison of everyone with everyone, nobody accused yet."""
        shape = comparison.error.shape
        return cls(
            tested=np.broadcast_to(comparison.tested, shape).copy(),
            low=np.where(comparison.tested, comparison.error - comparison.half_width, -np.inf),
            high=np.where(comparison.tested, comparison.error + comparison.half_width, np.inf),
            tolerance=comparison.tolerance.copy(),
            accused=np.zeros(shape, np.int8),
            doubt=np.where(comparison.tested, comparison.doubt, np.inf),
        )


def family_wise_confidence(config: Config, length_s: float, n_channels: int) -> float:
    """Confidence per window that keeps false findings of a whole flight within the budget.

    The budget of false findings per flight hour is shared alike by all window lengths and, within
    one, by all windows of an hour and all channels (Bonferroni). Windows without a nominal length
    are laid where a fault seems to lie.
    """
    settings = config.windows
    advance = length_s * (1.0 - settings.overlap) or LAID_S
    per_hour = SECONDS_PER_HOUR / advance * n_channels * len(settings.lengths_s)
    return max(settings.confidence, 1.0 - settings.false_findings_per_hour / per_hour)


def noise_shares(moments: Moments) -> Floats:
    """Split the noise of the parity vector into variances of the single channels, (k,).

    Solves ``G diag(s^2) G = V' C V`` for s^2 >= 0 in the least-squares sense, with C the covariance
    of the parity vector. The right side is the median over windows, because a fault or a manoeuvre
    concerns few of them. Only ratios matter to the weights: the result has a mean of one.
    """
    parity = moments.parity
    q, k = parity.shape
    known = moments.parity_mean.dof > 0
    projector = parity.T @ parity
    upper = np.triu_indices(k)
    design = np.array([np.outer(column, column)[upper] for column in projector.T]).T
    if q == 1 or not bool(known.any()) or np.linalg.matrix_rank(design) < k:
        return np.ones(k)
    target = (parity.T @ moments.typical @ parity)[upper]
    scale = float(np.abs(target).max())
    if scale == 0.0:
        return np.ones(k)
    solution = non_negative_least_squares(design, target / scale)
    variance: Floats = np.maximum(solution, LEAST_VARIANCE_SHARE * solution.max())
    return variance / float(variance.mean())


def non_negative_least_squares(design: Floats, target: Floats) -> Floats:
    """Solve ``min |A x - b|`` over x >= 0 for a dozen unknowns or fewer.

    Parameters
    ----------
    design : (n, k)
        A, of full rank.
    target : (n,)
        b.

    References
    ----------
    C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, Prentice-Hall 1974, chapter 23.
    """
    k = design.shape[1]
    found = np.zeros(k)
    free = np.zeros(k, bool)
    gradient = design.T @ target
    tolerance = 1e-12 * float(np.abs(gradient).max(initial=0.0))
    while not free.all() and float(gradient[~free].max()) > tolerance:
        free[np.where(free, -np.inf, gradient).argmax()] = True
        while True:
            trial = np.zeros(k)
            trial[free] = np.linalg.lstsq(design[:, free], target, rcond=None)[0]
            leaving = free & (trial <= 0.0)
            if not leaving.any():
                break
            # Go towards the trial as far as no unknown turns negative, and let go of those at zero.
            part = float((found[leaving] / (found[leaving] - trial[leaving])).min())
            found = found + part * (trial - found)
            free &= found > tolerance
            found[~free] = 0.0
        found = trial
        gradient = design.T @ (target - design @ found)
    return found


def compare(
    moments: Moments,
    axes: Floats,
    variance: Floats,
    *,
    removed: Sequence[int],
    config: Config,
    family_confidence: float,
) -> Comparison:
    """Compare every channel with its prediction from all others that are not removed.

    Parameters
    ----------
    axes : (k, 3)
        Sensitivity axes H of the channels compared. [1]
    variance : (k,)
        Relative noise variances; the prediction is weighted with their inverse.

    References
    ----------
    [Triads] search 4 and its tolerance ``d = 3 sqrt(s_b^2 + (s_k z_p)^2)``; section 6 of the
    suite's notes for the term in the rate of change.
    """
    rows = leave_one_out(axes, removed, np.sqrt(variance))
    tested = np.asarray(np.isfinite(rows).all(axis=1), bool)
    rows = np.where(tested[:, None], rows, 0.0)
    # Every row annihilates H, so it is a combination of the parity vector.
    of_parity = rows @ moments.parity.T
    looks = moments.parity_mean
    error = looks.mean @ of_parity.T
    known = looks.dof > 0
    covariance = np.where(known[:, None, None], looks.covariance, 0.0)
    own = np.einsum("iq,wqr,ir->wi", of_parity, covariance, of_parity)
    # A thousand short windows hold some that look quiet by chance: what decides against all of them
    # together is no surer than the middlemost.
    usual = np.einsum("iq,qr,ir->i", of_parity, moments.typical, of_parity)
    half_width = _half_width(looks, of_parity, own, config.windows.confidence)
    doubt = _half_width(looks, of_parity, np.maximum(own, usual), family_confidence)
    doubt *= moments.restless
    swell = np.maximum(
        np.einsum("iq,wqr,ir->wi", of_parity, moments.swell, of_parity),
        np.einsum("iq,qr,ir->i", of_parity, moments.usual_swell, of_parity),
    )
    doubt = np.maximum(doubt, PEAK * np.sqrt(np.maximum(swell, 0.0)))
    predicted = moments.mean - error
    tolerance = np.sqrt(
        np.radians(config.tolerance.bias_deg_s) ** 2
        + (config.tolerance.scale * predicted) ** 2
        + (3.0 * config.noise.time_sigma_s * moments.slope) ** 2
    )
    return Comparison(
        tested=tested, error=error, half_width=half_width, doubt=doubt, tolerance=tolerance
    )


def _half_width(
    looks: WindowedMean, combinations: Floats, variance: Floats, confidence: float
) -> Floats:
    """Half-width of the Student intervals of combinations of variance (n, k); inf if unknown."""
    sigma = np.sqrt(np.maximum(variance, 0.0))
    quantile = looks.quantile(combinations, confidence)
    known = np.isfinite(quantile)
    return np.where(known, np.where(known, quantile, 0.0) * sigma, np.inf)


def isolate(
    moments: Moments, axes: Floats, config: Config, length_s: float, offset: Floats
) -> Answer:
    """Find the smallest sets of failed channels that leave the others in agreement.

    Parameters
    ----------
    axes : (k, 3)
        Sensitivity axes H of ``moments.channels``. [1]
    length_s
        Nominal length of the windows. [s]
    offset : (k,)
        What the channels are usually off by; see `fdilog.windows.usual`. [rad/s]
    """
    k = len(moments.channels)
    family_confidence = family_wise_confidence(config, length_s, k)
    variance = noise_shares(moments)
    healthy = np.radians(config.noise.bias_sigma_deg_s)
    nobody = compare(
        moments,
        axes,
        variance,
        removed=(),
        config=config,
        family_confidence=family_confidence,
    )
    answer = Answer.of(nobody)
    open_windows = np.flatnonzero(nobody.outside(healthy).any(axis=1))
    for size in range(1, min(config.detectors.max_failures, len(moments.parity)) + 1):
        if not len(open_windows):
            break
        part = moments.at(open_windows)
        hypotheses = list(combinations(range(k), size))
        compared = [
            compare(
                part,
                axes,
                variance,
                removed=removed,
                config=config,
                family_confidence=family_confidence,
            )
            for removed in hypotheses
        ]
        left = np.ones((len(hypotheses), k), bool)
        for number, removed in enumerate(hypotheses):
            left[number, list(removed)] = False
        stands = np.column_stack(
            [
                ~(others.outside(healthy) & kept).any(axis=1)
                for others, kept in zip(compared, left, strict=True)
            ]
        )
        stands &= _likely(
            part, hypotheses, stands, nobody.tolerance[open_windows].mean(axis=1), offset
        )
        low = np.full((len(open_windows), k), np.inf)
        high = np.full((len(open_windows), k), -np.inf)
        for number, others in enumerate(compared):
            fits = stands[:, number]
            # Without a comparison, a channel that the hypothesis calls healthy is within tolerance,
            # and one that it calls failed may be off by anything.
            free = np.where(left[number], others.tolerance, np.inf)
            lower = np.where(others.tested, others.error - others.half_width, -free)
            upper = np.where(others.tested, others.error + others.half_width, free)
            low[fits] = np.minimum(low[fits], lower[fits])
            high[fits] = np.maximum(high[fits], upper[fits])
        solved = stands.any(axis=1)
        rows = open_windows[solved]
        answer.low[rows], answer.high[rows] = low[solved], high[solved]
        answer.accused[rows] = numbered_suspects(stands[solved], hypotheses, k)
        open_windows = open_windows[~solved]
    # No set that may be considered explains these: somebody failed, and all compared may have.
    answer.accused[open_windows] = answer.tested[open_windows]
    answer.low[open_windows], answer.high[open_windows] = -np.inf, np.inf
    return answer


def _likely(
    moments: Moments,
    hypotheses: Sequence[tuple[int, ...]],
    stands: NDArray[np.bool_],
    tolerance: Floats,
    offset: Floats,
) -> NDArray[np.bool_]:
    """Tell which hypotheses are not `LEAST_ODDS` times less likely than the likeliest that stands.

    The parity vector of healthy channels is normal with the covariance of its mean and, since
    healthy errors are a third of the tolerance (three sigma, [Triads]), their variance in every
    direction: V V' = I. That is mostly a constant of the flight; what wanders is `WANDER` of it. A
    failed channel adds any multiple of its column of V, which is fitted: to the wander, if it
    failed for a while, or to the constant, if it was always so. What is left are quadratic forms;
    with an estimated covariance their likelihood is Student's.
    """
    looks = moments.parity_mean
    q = looks.mean.shape[1]
    covariance = np.where((looks.dof > 0)[:, None, None], looks.covariance, 0.0)
    healthy = (tolerance[:, None, None] / 3.0) ** 2 * np.eye(q)
    usual = np.broadcast_to(moments.parity @ offset, looks.mean.shape)
    constant = np.asarray(np.linalg.inv(healthy), np.float64)
    wander = np.asarray(np.linalg.inv(covariance + WANDER**2 * healthy), np.float64)
    change = looks.mean - usual
    dof = np.maximum(looks.dof, 1.0)

    def student(form: Floats) -> Floats:
        return np.asarray((dof + q) * np.log1p(form / dof), np.float64)

    never = student(_misfit(change, wander, moments.parity[:, []]))
    usually = _misfit(usual, constant, moments.parity[:, []])
    cost = np.column_stack(
        [
            np.minimum(
                usually + student(_misfit(change, wander, columns)),
                _misfit(usual, constant, columns) + never,
            )
            for columns in (moments.parity[:, list(removed)] for removed in hypotheses)
        ]
    )
    least = np.where(stands, cost, np.inf).min(axis=1, keepdims=True)
    likely: NDArray[np.bool_] = cost <= least + 2.0 * np.log(LEAST_ODDS)
    return likely


def _misfit(vector: Floats, weight: Floats, columns: Floats) -> Floats:
    """Fit multiples of some columns, and return what is left of the weighted squares, (n,)."""
    total = np.einsum("wi,wij,wj->w", vector, weight, vector)
    onto = np.einsum("if,wij,wj->wf", columns, weight, vector)
    normal = np.einsum("if,wij,jg->wfg", columns, weight, columns)
    fitted = np.einsum("wf,wfg,wg->w", onto, np.linalg.pinv(normal), onto)
    return np.asarray(np.maximum(total - fitted, 0.0), np.float64)


def numbered_suspects(
    stands: NDArray[np.bool_], hypotheses: Sequence[tuple[int, ...]], k: int
) -> NDArray[np.int8]:
    """Give each suspect a number; members of every set that stands are sure, each by itself."""
    member = np.zeros((len(hypotheses), k), bool)
    for number, removed in enumerate(hypotheses):
        member[number, list(removed)] = True
    named = (stands.astype(float) @ member) > 0
    spared = (stands.astype(float) @ ~member) > 0
    sure = named & ~spared
    accused = np.zeros(named.shape, np.int8)
    accused[named & ~sure] = 1
    numbers = 1 + np.cumsum(sure, axis=1)
    accused[sure] = numbers[sure]
    return accused


def comparative_evidence(detector: str, survey: Survey, answers: Sequence[Answer]) -> Evidence:
    """Lay the answers for the blocks of a survey out over its windows and channels.

    Parameters
    ----------
    answers
        One for each of ``survey.moments``, in that order.
    """
    shape = (len(survey.windows), len(survey.table.channels))
    evidence = Evidence(
        detector=detector,
        kind="bias",
        windows=survey.windows,
        tested=np.zeros(shape, bool),
        low=np.full(shape, -np.inf),
        high=np.full(shape, np.inf),
        tolerance=np.full(shape, np.nan),
        accused=np.zeros(shape, np.int8),
        confidence=survey.config.windows.confidence,
        least=np.full(shape, np.inf) if all(a.doubt is not None for a in answers) else None,
    )
    healthy = np.radians(survey.config.noise.bias_sigma_deg_s)
    for moments, answer in zip(survey.moments, answers, strict=True):
        place = np.ix_(moments.windows, np.array(moments.channels))
        # Suspects of one block are not those of another, whatever number they carry.
        offset = evidence.accused[moments.windows].max(axis=1, initial=0)[:, None]
        evidence.accused[place] = np.where(answer.accused > 0, answer.accused + offset, 0)
        evidence.tested[place] = answer.tested
        evidence.low[place], evidence.high[place] = answer.low, answer.high
        evidence.tolerance[place] = answer.tolerance
        if evidence.least is not None and answer.doubt is not None:
            evidence.least[place] = healthy + answer.doubt
    return evidence
