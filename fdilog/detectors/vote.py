"""Which channel a search statistic names, and what becomes of that vote on windows of a log.

A published search always names somebody: some channel has the extreme statistic, failed or not. On
a log it is asked only where something is beyond tolerance for sure, and believed only if all is
well without the channel that it names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence
from fdilog.maths.geometry import Floats, detectable, isolability_groups, parity_matrix
from fdilog.windows.isolation import (
    Answer,
    Comparison,
    comparative_evidence,
    compare,
    family_wise_confidence,
    numbered_suspects,
)
from fdilog.windows.survey import Moments, Survey

Naming = Callable[[Floats, Floats], NDArray[np.bool_]]
"""A method's vote: mean readings (n_windows, n_channels) and axes (n_channels, 3) to the channels
that it names, (n_windows, n_channels) bool; at least two parity components are left to it."""

Hypothesis = tuple[int, ...]

BLOCKS = 32
"""Blocks of channels whose comparison is kept for the next method."""


def named_channel(statistic: Floats, *, largest: bool) -> NDArray[np.intp]:
    """Channel with the extreme statistic in each sample.

    Parameters
    ----------
    statistic : (n_samples, n_channels)
        One figure a channel; not-a-number where the channel was not compared.
    largest
        Whether the failed channel is the one with the largest figure, or the smallest.

    Returns
    -------
    channel : (n_samples,)
        Index of the channel, -1 where none was compared. The first of several equal ones.
    """
    # -inf loses against every comparison that was made, an infinite ratio included.
    signed = np.where(np.isnan(statistic), -np.inf, statistic if largest else -statistic)
    return np.where(np.isnan(statistic).all(axis=1), -1, signed.argmax(axis=1))


def ballot(statistic: Callable[[Floats, Floats], Floats], *, largest: bool) -> Naming:
    """Turn a search statistic into a vote for the one channel where it is extreme.

    Parameters
    ----------
    statistic
        Function of mean readings (n_windows, n_channels) and axes (n_channels, 3) that gives one
        figure for each window and channel.
    """

    def name(readings: Floats, axes: Floats) -> NDArray[np.bool_]:
        candidate = named_channel(statistic(readings, axes), largest=largest)
        named: NDArray[np.bool_] = candidate[:, None] == np.arange(len(axes))
        return named

    return name


def voted_evidence(
    detector: str, survey: Survey, naming: Naming, *, needs: int = 1, intervals: bool = False
) -> Evidence:
    """Run a vote on every block of channels of a survey; see `elect`.

    Parameters
    ----------
    needs
        Parity components without which the method does not apply: with one, nobody can be told
        from anybody, and only some methods call that an answer.
    intervals
        Whether the method estimates the errors, or only votes.
    """
    answers = [elect(moments, survey, naming, needs=needs) for moments in survey.moments]
    evidence = comparative_evidence(detector, survey, answers)
    if intervals:
        return evidence
    nothing = np.full(evidence.low.shape, np.nan)
    return replace(evidence, low=nothing, high=nothing)


def elect(moments: Moments, survey: Survey, naming: Naming, *, needs: int = 1) -> Answer:
    """Let a method name the failed channels of one block, where its channels disagree.

    1. Detection: the method is asked where some channel's difference from its prediction lies
       beyond its tolerance for sure (`fdilog.windows.isolation.Comparison.outside`). That happens
       without a failure no more often than ``windows.false_findings_per_hour`` says.
    2. Vote: what it names is struck out. If what is left agrees, the vote stands; if not, the
       method is asked again about what is left, while a check of the answer remains possible.
    3. What was struck out but agrees with the sound channels is taken back.
    4. Channels that redundancy cannot tell from those named are named with them, under one number.
    5. If no vote stands, somebody failed and the method cannot tell who: all get one number.

    Parameters
    ----------
    moments
        Window means of one block of channels.
    needs
        See `voted_evidence`.

    References
    ----------
    [Triads]: the candidate of a search is failed if its difference exceeds its tolerance.
    """
    axes = survey.table.axes[list(moments.channels)]
    config = survey.config
    against = _comparing(moments, survey)
    healthy = np.radians(config.noise.bias_sigma_deg_s)
    nobody = _nobody_removed(moments, survey)
    answer = Answer.of(nobody)
    redundancy = len(moments.parity)
    if redundancy < needs:
        return replace(answer, tested=np.zeros_like(answer.tested))
    # One parity component is left to check the answer, unless there is only one.
    most = min(config.detectors.max_failures, max(redundancy - 1, 1))
    todo: list[tuple[Hypothesis, NDArray[np.intp]]] = [
        ((), np.flatnonzero(nobody.outside(healthy).any(axis=1)))
    ]
    while todo:
        removed, rows = todo.pop()
        if len(removed) >= most:
            _accuse_all(answer, rows)
            continue
        for votes, members in _alike(_named(moments.mean[rows], axes, removed, naming)):
            struck = (*removed, *votes)
            here = rows[members]
            if not votes:
                continue  # the method has nothing to say
            if len(struck) > most:
                _accuse_all(answer, here)
                continue
            found = against(moments.at(here), removed=struck)
            outside = found.outside(healthy)
            left = np.ones(len(axes), bool)
            left[list(struck)] = False
            stands = ~(outside & left).any(axis=1)
            for failed, those in _alike(outside[stands] & ~left):
                part = here[stands][those]
                if not failed:
                    _accuse_all(answer, part)
                    continue
                hypotheses = exchangeable(axes, failed)
                answer.accused[part] = numbered_suspects(
                    np.ones((1, len(hypotheses)), bool), hypotheses, len(axes)
                )
                _bound(answer, part, hypotheses, partial(against, moments.at(part)))
            if not stands.all():
                todo.append((struck, here[~stands]))
    return answer


def _comparing(moments: Moments, survey: Survey) -> Callable[..., Comparison]:
    """Compare the channels of a block, weighted alike."""
    axes = survey.table.axes[list(moments.channels)]
    return partial(
        compare,
        axes=axes,
        variance=np.ones(len(axes)),
        config=survey.config,
        family_confidence=family_wise_confidence(survey.config, survey.windows.length_s, len(axes)),
    )


@lru_cache(maxsize=BLOCKS)
def _nobody_removed(moments: Moments, survey: Survey) -> Comparison:
    """Compare everyone with everyone, which is where every method begins."""
    return _comparing(moments, survey)(moments, removed=())


def _named(mean: Floats, axes: Floats, removed: Hypothesis, naming: Naming) -> NDArray[np.bool_]:
    """Ask the method about the channels that are left and still checked by others."""
    named = np.zeros(mean.shape, bool)
    if not len(mean):
        return named
    left = np.setdiff1d(np.arange(len(axes)), removed)
    left = left[detectable(axes[left])]
    if len(parity_matrix(axes[left])) == 1:
        named[:, left[0]] = True  # stands for all of them: `exchangeable` names the others too
    else:
        named[:, left] = naming(mean[:, left], axes[left])
    return named


def _alike(masks: NDArray[np.bool_]) -> Iterator[tuple[Hypothesis, NDArray[np.intp]]]:
    """Group rows with equal masks: the columns that are true, and the rows."""
    patterns, which = np.unique(masks, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        yield tuple(np.flatnonzero(pattern).tolist()), np.flatnonzero(which == number)


def _accuse_all(answer: Answer, rows: NDArray[np.intp]) -> None:
    """Say that somebody failed, any of those compared."""
    answer.accused[rows] = answer.tested[rows]
    answer.low[rows], answer.high[rows] = -np.inf, np.inf


def _bound(
    answer: Answer,
    rows: NDArray[np.intp],
    hypotheses: list[Hypothesis],
    against: Callable[..., Comparison],
) -> None:
    """Hull of the intervals under every hypothesis; without a comparison, healthy ones hold."""
    low = np.full(answer.low[rows].shape, np.inf)
    high = -low
    for removed in hypotheses:
        found = against(removed=removed)
        free = found.tolerance.copy()
        free[:, list(removed)] = np.inf
        low = np.minimum(low, np.where(found.tested, found.error - found.half_width, -free))
        high = np.maximum(high, np.where(found.tested, found.error + found.half_width, free))
    answer.low[rows], answer.high[rows] = low, high


def exchangeable(axes: Floats, failed: Hypothesis) -> list[Hypothesis]:
    """List the sets of failed channels that no algorithm can tell from the given one.

    Parameters
    ----------
    axes : (n_channels, 3)
        Sensitivity axes H. [1]
    failed
        Channels that are said to have failed.

    Returns
    -------
    hypotheses
        The set itself, and every set with one member replaced by a channel whose parity column is
        collinear with the member's once the other members are out.
    """
    found = {tuple(sorted(failed))}
    for member in failed:
        others = [channel for channel in failed if channel != member]
        left = np.setdiff1d(np.arange(len(axes)), others)
        for group in isolability_groups(axes[left]):
            channels = left[list(group)].tolist()
            if member in channels:
                found |= {tuple(sorted((*others, channel))) for channel in channels}
    return sorted(found)
