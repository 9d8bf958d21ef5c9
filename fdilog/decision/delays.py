"""Disagreements of a whole device that are gone when its readings are taken to be earlier or later.

A driver that hangs, a buffer that fills, a clock that is set: from then on a device tells what the
others told a while ago. In motion that is a disagreement of each of its channels, and one fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.disagreement import DETECTOR, disagreements, overlap
from fdilog.finding import Finding
from fdilog.sources.offsets import ClockOffset, estimate_offset
from fdilog.sources.witness import triads
from fdilog.table import ChannelTable

Floats = NDArray[np.float64]

EXPLAINED = ("disagreement", "bias", "drift", "scale")
"""What a delay looks like, second by second."""


def with_delays(table: ChannelTable, findings: Sequence[Finding], config: Config) -> list[Finding]:
    """Put one finding of a device in the place of those that a delay of it explains.

    Parameters
    ----------
    table
        Gyros, calibrated, in the mounting found; what accuses itself is not valid.
    """
    kept = list(findings)
    sources = list(dict.fromkeys(channel.source for channel in table.channels))
    # Of two devices, whichever is late, the other is early.
    for source in sources if len(sources) > 2 else sources[1:]:
        mine = [one for one in kept if source in _suspected(table, one) and one.kind in EXPLAINED]
        disagreeing = [
            one
            for one in mine
            if one.kind == "disagreement"
            and (len(sources) == 2 or _suspected(table, one) == {source})
        ]
        if not disagreeing:
            continue
        start_s = min(one.start_s for one in disagreeing)
        end_s = max(one.end_s for one in disagreeing)
        clock = _late(table, source, (start_s, end_s), config)
        if clock is None or clock.low <= 0.0 <= clock.high:
            continue
        among = sources if len(sources) == 2 else [source]
        found = replace(
            disagreeing[0],
            suspects=tuple(c.name for c in table.channels if c.source in among),
            start_s=start_s,
            end_s=end_s,
            detectors=(DETECTOR,),
            witness=None,
            detail=_words(source, clock),
            one_source=len(among) == 1,
        )
        explained = [one for one in mine if overlap(one, found)]
        others = [one for one in kept if one not in explained]
        left = disagreements(_earlier(table, source, found, clock.offset_s), others, config)
        if not any(overlap(one, found) for one in left):
            kept = [*others, found]
    return kept


def _suspected(table: ChannelTable, one: Finding) -> set[str]:
    """Devices that a finding suspects."""
    return {channel.source for channel in table.channels if channel.name in one.suspects}


def _late(
    table: ChannelTable, source: str, span_s: tuple[float, float], config: Config
) -> ClockOffset | None:
    """Say by how much a device is late against the others over a span, if its rates tell."""
    inside = (table.time_s >= span_s[0]) & (table.time_s <= span_s[1])
    own = [k for k, channel in enumerate(table.channels) if channel.source == source]
    others = [k for k in range(len(table.channels)) if k not in own]
    within = table.only(inside)
    mine, theirs = triads(within.columns(own)), triads(within.columns(others))
    if not mine or not theirs:
        return None
    (rows, rate), (reference_rows, reference) = mine[0], theirs[0]
    return estimate_offset(
        source,
        (within.time_s[reference_rows], reference),
        (within.time_s[rows], rate),
        config.windows.confidence,
    )


def _earlier(table: ChannelTable, source: str, found: Finding, by_s: float) -> ChannelTable:
    """Return the table with a device's readings within a span taken to be earlier."""
    rate = table.rate_rad_s.copy()
    inside = (table.time_s >= found.start_s) & (table.time_s <= found.end_s)
    for k, channel in enumerate(table.channels):
        known = table.valid[:, k]
        if channel.source == source and known.any():
            at_s = table.time_s[inside] + by_s
            rate[inside, k] = np.interp(at_s, table.time_s[known], table.rate_rad_s[known, k])
    return replace(table, rate_rad_s=np.where(table.valid, rate, np.nan))


def _words(source: str, clock: ClockOffset) -> str:
    size, half_width = abs(clock.offset_s), (clock.high - clock.low) / 2.0
    way = "late" if clock.offset_s > 0 else "early"
    return (
        f"{source} runs {size:.3f} \u00b1 {half_width:.3f} s {way}, by its stamps or its readings;"
        " but for that it would agree with the others"
    )
