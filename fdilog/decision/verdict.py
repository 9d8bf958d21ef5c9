"""From evidence and findings to channel status and verdict: an interval against a tolerance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fdilog.config import Config
from fdilog.finding import Evidence, Finding, Status, Verdict
from fdilog.sources.anchors import Anchors
from fdilog.table import ChannelTable

# A channel is healthy only if it was inside tolerance over this share of its valid time (the
# contract's figure).
HEALTHY_COVERAGE = 0.9
# A cosine below this is a right angle: a quaternion turns axes to within 1e-15.
ROUNDING = 1e-9


def channel_status(
    table: ChannelTable, evidence: Sequence[Evidence], findings: Sequence[Finding]
) -> tuple[Status, ...]:
    """Say of each channel whether it failed, by the contract's rule.

    Healthy is a channel in no finding whose longest windows (of the greatest length whose windows
    cover at least 90 % of its valid time) all lie inside the tolerance.
    """
    lead = evidence[0].detector if evidence else None
    by_length = sorted(
        (item for item in evidence if item.detector == lead),
        key=lambda item: -item.windows.length_s,
    )
    alone = {name for f in findings if f.isolated for name in f.suspects}
    shared = {name for f in findings if not f.isolated for name in f.suspects}
    status: list[Status] = []
    for channel, name in enumerate(table.names):
        if name in alone:
            status.append("failed")
        elif name in shared:
            status.append("suspect")
        elif not any(item.tested[:, channel].any() for item in by_length):
            status.append("insufficient")
        else:
            status.append("healthy" if _healthy(table, by_length, channel) else "undecided")
    return tuple(status)


def _healthy(table: ChannelTable, by_length: Sequence[Evidence], channel: int) -> bool:
    valid = table.valid[:, channel]
    for item in by_length:
        rows = np.flatnonzero(item.tested[:, channel])
        covered = np.zeros(len(valid) + 1, np.int64)
        np.add.at(covered, item.windows.start[rows], 1)
        np.add.at(covered, item.windows.stop[rows], -1)
        inside_one = np.cumsum(covered)[:-1] > 0
        if (inside_one & valid).sum() >= HEALTHY_COVERAGE * valid.sum():
            tolerance = item.tolerance[rows, channel]
            low, high = item.low[rows, channel], item.high[rows, channel]
            return bool(((low > -tolerance) & (high < tolerance)).all())
    return False


def with_witness(
    table: ChannelTable,
    compared: ChannelTable,
    status: Sequence[Status],
    anchors: Anchors,
    config: Config,
) -> tuple[Status, ...]:
    """Hold what was concluded with an attitude's help against what that attitude is worth.

    A gyro that only the attitude checks is healthy if the attitude itself is, about that gyro's
    axis and over the whole flight: a filter that follows a failed gyro agrees with it. Derived
    channels get the attitude's own standing; they are never failed or suspect.
    """
    flight = (float(table.time_s[0]), float(table.time_s[-1]))
    drift = anchors.drift(*flight, config.windows.confidence)
    tolerance = np.radians(config.tolerance.bias_deg_s)
    standing: list[Status] = []
    for channel, own in zip(table.channels, status, strict=True):
        axis = np.array(channel.axis)
        within = drift is not None and not drift.lost and drift.within(axis, tolerance)
        on_its_word = any(
            one.derived and float(np.abs(np.dot(one.axis, axis))) > ROUNDING
            for one in compared.channels
        )
        if channel.derived:
            standing.append("healthy" if within else "insufficient" if not drift else "undecided")
        else:
            standing.append("undecided" if own == "healthy" and on_its_word and not within else own)
    return tuple(standing)


def conclude(status: Sequence[Status], *, whole: bool) -> Verdict:
    """Give the verdict on a log, by the contract's rule."""
    if "failed" in status or "suspect" in status:
        return "failed"
    if all(one == "insufficient" for one in status):
        return "insufficient"
    if "undecided" in status or not whole:
        return "undecided"
    return "healthy"
