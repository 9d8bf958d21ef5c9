"""From evidence of excess noise to findings, whose edges are those of the noise itself."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from fdilog.decision.accusations import Cluster, accusations, clusters, region
from fdilog.finding import SIZE_UNIT, Evidence, Finding, Size
from fdilog.maths.noise import moving_mean
from fdilog.table import ChannelTable
from fdilog.windows.bursts import LONGEST_S
from fdilog.windows.loudness import (
    CAP,
    FEWEST_SAMPLES,
    capped_sigma,
    noise_peers,
    paces,
    shown_noise,
)

# A swing of a noise may begin or end so much beside it. [s]
EDGE_S = 1.0
# Vibration changes with the throttle, within seconds.
SHAKING_S = 1.0
# With so much of the usual vibration, or less, it stands. [1]
STILL = 0.25
# What covers so much of a finding, or of a flight, explains it.
MOST = 0.5
# A span of noise is looked for between so many pieces at most, then between readings.
MOST_PIECES = 300
# How loud it is beside noise is told by so many readings at least; the span of noise may reach half
# as many beyond the windows that accuse.
BESIDE = 1.5
# The change points of variance and the variances about them settle within this.
ROUNDS = 5
_NOISY = "noisier than the other gyros that sense its axis, or than it usually is"
_LOUDER = "is noisy, or the other shows too little: in this flight neither did otherwise"


def noise_findings(
    table: ChannelTable, evidence: Sequence[Evidence], known: Sequence[Finding]
) -> list[Finding]:
    """Turn evidence of excess noise into findings, their edges those of the noise itself.

    Parameters
    ----------
    known
        What else is wrong: noise that a scale error or a gyro's many impulses explain is none.
    """
    said = [accusation for item in evidence for accusation in accusations(item)]
    spells = []
    for cluster in clusters(table.time_s, said):
        sizes = {
            k: _ratio(evidence, k, cluster.start, cluster.stop) for k in sorted(cluster.suspects)
        }
        channel = max(sizes, key=lambda k: sizes[k].estimate)
        at_each = [
            _span_of_noise(paced, every, cluster, channel, sizes[channel].estimate)
            for every, paced in paces(table)
        ]
        _, start, stop = max(at_each, key=lambda one: one[0])
        detectors = frozenset(member.detector for member in cluster.members)
        spells.append(_Spell(cluster.suspects, channel, start, stop, detectors))
    findings = []
    for spell in _joined(table, spells):
        channel = spell.channel
        peers = noise_peers(table, channel)
        found = Finding(
            kind="noise",
            suspects=tuple(table.names[k] for k in sorted(spell.suspects)),
            start_s=float(table.time_s[spell.start]),
            end_s=float(table.time_s[spell.stop - 1]),
            size=_ratio(evidence, channel, spell.start, spell.stop),
            detectors=tuple(sorted(spell.detectors)),
            detail=_NOISY if len(spell.suspects) == 1 else f"{table.names[channel]} {_LOUDER}",
        )
        compared = {channel, *(peers if len(peers) == 1 else ())}
        names = {table.names[k] for k in compared}
        others = [one for one in known if names & set(one.suspects)]
        if not any(_explains(one, found, table.duration_s) for one in others):
            findings.append(found)
    return findings


class _Spell(NamedTuple):
    """Rows over which one of some suspects is noisy."""

    suspects: frozenset[int]
    channel: int
    start: int
    stop: int
    detectors: frozenset[str]


def _joined(table: ChannelTable, spells: Sequence[_Spell]) -> list[_Spell]:
    """Join spells of the same noise, which windows that accuse apart have found to be one."""
    joined: list[_Spell] = []
    for spell in sorted(spells, key=lambda one: (sorted(one.suspects), one.start)):
        before = joined[-1] if joined else None
        if (
            before is not None
            and before.suspects == spell.suspects
            and table.time_s[spell.start] <= table.time_s[before.stop - 1] + EDGE_S
        ):
            stop = max(before.stop, spell.stop)
            joined[-1] = before._replace(stop=stop, detectors=before.detectors | spell.detectors)
        else:
            joined.append(spell)
    return joined


def without_swings(biased: Sequence[Finding], noise: Sequence[Finding]) -> list[Finding]:
    """Return biases but for those that are swings of a noise of the same channels."""
    return [
        one
        for one in biased
        if not any(
            one.kind == "bias"
            and one.end_s - one.start_s <= LONGEST_S
            and set(one.suspects) <= set(loud.suspects)
            and loud.start_s - EDGE_S <= one.start_s <= one.end_s <= loud.end_s + EDGE_S
            for loud in noise
        )
    ]


def _span_of_noise(
    table: ChannelTable, every: int, cluster: Cluster, channel: int, ratio: float
) -> tuple[float, int, int]:
    """Find where noise begins and ends, at one pace.

    Parameters
    ----------
    table
        Means over `every` rows each.

    Returns
    -------
    gain
        Logarithm of how many times likelier that is than nothing.
    start, stop
        First row, one past the last, of the table that means are taken of.
    """
    deviation, own = shown_noise(table)
    peers = noise_peers(table, channel)
    begin, end = cluster.start // every, max(cluster.start // every + 1, cluster.stop // every)
    reach_s = max(cluster.longest_s / 2, BESIDE * FEWEST_SAMPLES * table.period_s)
    first, last = region(table, begin, end, reach_s)
    shown = np.isfinite(deviation[first:last][:, [channel, *peers]]).all(axis=1)
    rows = first + np.flatnonzero(shown)
    inside = (rows >= begin) & (rows < end)
    if not inside.any():
        return -np.inf, cluster.start, cluster.stop
    shaking, still = _shaking(table, deviation[rows][:, peers])
    told = inside | ~still
    rows, inside, shaking = rows[told], inside[told], shaking[told]
    gain, low, high = _loud(np.abs(own[rows, channel]) / shaking, inside, ratio)
    return gain, int(rows[low]) * every, (int(rows[high - 1]) + 1) * every


def _explains(one: Finding, noise: Finding, flight_s: float) -> bool:
    """Tell whether what is wrong with a gyro, or its only peer, is what noise of it looks like.

    A gyro that shows a fifth of all rates shows a fifth of the vibration, and one that does so for
    most of the flight leaves what is usual unknown. One that jumps again and again is loud.
    """
    together_s = min(noise.end_s, one.end_s) - max(noise.start_s, one.start_s)
    mostly = together_s >= MOST * (noise.end_s - noise.start_s)
    if one.kind == "scale":
        return mostly or one.end_s - one.start_s >= MOST * flight_s
    return one.kind == "impulse" and one.size is None and mostly


def _shaking(
    table: ChannelTable, deviation: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Tell how much the other gyros shake about each reading, and never much less than usual.

    Parameters
    ----------
    deviation : (n, k)
        Of the others, as white sigmas. [rad/s]

    Returns
    -------
    shaking : (n,)
        [rad/s]
    still : (n,) bool
        Where they hardly do, as on the ground: that is quieter than any flight.
    """
    power = (deviation**2).mean(axis=1)
    width = min(len(power), max(1, round(SHAKING_S / table.period_s)))
    around = np.maximum(moving_mean(power, width), 0.0)
    usual = float(np.median(around))
    shaking = np.sqrt(around + usual)
    return np.where(shaking > 0.0, shaking, 1.0), around < STILL**2 * usual


def _loud(
    size: NDArray[np.float64], inside: NDArray[np.bool_], ratio: float
) -> tuple[float, int, int]:
    """Find the span over which readings are likelier noisy than not, the change points of variance.

    Parameters
    ----------
    size : (n,)
        Moduli of a channel's own noise, over the vibration. [1]
    inside : (n,) bool
        Where it is noisy, as a beginning.
    ratio
        How many times noisier it is there.

    Returns
    -------
    gain
        Logarithm of how many times likelier.
    start, stop
        First reading, one past the last.
    """
    span = _louder_part(size, inside, ratio)
    most = 0.0
    for _ in range(ROUNDS):
        loud = float(capped_sigma(size[span[0] : span[1]]))
        length = span[1] - span[0]
        near = (size[max(0, span[0] - length) : span[0]], size[span[1] : span[1] + length])
        sides = [side for side in near if len(side) >= FEWEST_SAMPLES]
        # Before and after may differ, in flight and landed; noise is what is above both.
        quiet = max((float(capped_sigma(side)) for side in sides), default=loud / ratio)
        if not 0.0 < quiet < loud:
            break
        # Log likelihood ratio of the two variances; a few readings of a crash count like others.
        power = np.minimum(size, CAP * loud) ** 2
        gain = power * (quiet**-2 - loud**-2) / 2.0 - np.log(loud / quiet)
        total = np.concatenate([[0.0], np.cumsum(gain)])
        least = np.minimum.accumulate(total)
        stop = int(np.argmax(total - least))
        found = (int(np.argmin(total[: stop + 1])), stop)
        if found[1] <= found[0]:
            break
        most = float((total - least)[stop])
        if found == span:
            break
        span = found
    return most, *span


def _louder_part(
    size: NDArray[np.float64], inside: NDArray[np.bool_], ratio: float
) -> tuple[int, int]:
    """Find the span that differs the most in the logarithm of its noise from what is around.

    Long windows accuse where a part of them is noisy. Where no part stands out by most of the
    ratio, all of it is.
    """
    whole = (int(np.argmax(inside)), len(inside) - int(np.argmax(inside[::-1])))
    edges = np.linspace(0, len(size), min(MOST_PIECES, len(size) // FEWEST_SAMPLES) + 1)
    edges = edges.astype(np.int64)
    sigma = np.array([float(capped_sigma(size[a:b])) for a, b in pairwise(edges.tolist())])
    if len(sigma) < 2 or not (sigma > 0.0).any():
        return whole
    level = np.log(np.maximum(sigma, sigma[sigma > 0.0].min()))
    total = np.concatenate([[0.0], np.cumsum(level)])
    accused = np.concatenate([[0], np.cumsum(inside)])[edges]
    first, last = np.triu_indices(len(edges), 1)
    count, n = last - first, len(level)
    some = count < n
    some &= 2 * (accused[last] - accused[first]) >= edges[last] - edges[first]
    first, last, count = first[some], last[some], count[some]
    louder = (total[last] - total[first]) / count
    louder -= (total[-1] - total[last] + total[first]) / (n - count)
    explained = np.where(louder > np.log(ratio) / 2.0, count * (n - count) * louder**2, 0.0)
    if not explained.any():
        return whole
    best = int(explained.argmax())
    return int(edges[first[best]]), int(edges[last[best]])


def _ratio(evidence: Sequence[Evidence], channel: int, start: int, stop: int) -> Size:
    """Hull of the ratios in the longest windows that accuse, since noise changes in a flight.

    They should lie within the span of the noise: what they hold beside it dilutes the ratio.
    """
    accusing = [item for item in evidence if item.accused[:, channel].any()]
    longest = max(accusing, key=lambda item: item.windows.length_s)
    rows = (longest.windows.start < stop) & (longest.windows.stop > start)
    rows &= longest.accused[:, channel] > 0
    rows = rows if rows.any() else longest.accused[:, channel] > 0
    for item in sorted(accusing, key=lambda item: -item.windows.length_s):
        within = (item.windows.start >= start) & (item.windows.stop <= stop)
        within &= item.accused[:, channel] > 0
        if within.any():
            longest, rows = item, within
            break
    low, high = longest.low[rows, channel], longest.high[rows, channel]
    return Size(
        estimate=float(np.median(np.sqrt(low * high))),
        low=float(low.min()),
        high=float(high.max()),
        confidence=longest.confidence,
        unit=SIZE_UNIT["noise"],
    )
