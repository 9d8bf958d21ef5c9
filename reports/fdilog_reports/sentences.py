"""What the report says in plain words: a finding, a verdict, and what could not have been seen."""

from __future__ import annotations

import math
from dataclasses import dataclass

from fdilog.analysis import Analysis
from fdilog.decision.revealed import FEWEST_READINGS
from fdilog.finding import Finding, Size
from fdilog.sources.witness import SOURCE as WITNESS
from fdilog_reports.lone import lone_gyros, unheld
from fdilog_reports.residuals import drawn_evidence, intervals
from fdilog_reports.words import (
    DEG_PER_RAD,
    SHOWN_TEXT,
    between,
    figure,
    flight_time,
    listed,
    percent,
    rounded,
    several,
    shown,
)

# SI unit of a size: the factor and the unit it is printed in.
_PRINTED_UNIT = {
    "rad/s": (DEG_PER_RAD, "deg/s"),
    "rad/s^2": (DEG_PER_RAD, "deg/s per second"),
    "s": (1.0, "s"),
}
_PRINTED_FACTOR = {"scale": (100.0, "%"), "noise": (1.0, "times")}

MENDING = {"gains", "mounting"}
"""Who finds a wrong unit, range or mounting."""

KIND_NAME = {
    "bias": "bias",
    "drift": "drift",
    "scale": "scale error",
    "noise": "excess noise",
    "stuck": "stuck",
    "dead": "dead",
    "saturated": "saturated",
    "impulse": "impulse",
    "dropout": "dropout",
    "mounting": "mounting",
    "disagreement": "disagreement of no known kind",
}

MOST_GROUPS = 3
"""Groups of suspects that the verdict names; more of them are only counted there."""

PARALLEL = 1.0 - 1e-9
"""Cosine from which two axes are one line."""

# A finding that starts and ends this near to the ends of the table lasted throughout.
_THROUGHOUT_S = 1.0


@dataclass(frozen=True, kw_only=True)
class PrintedSize:
    """A size in the unit people think in, as strings."""

    estimate: str
    interval: str
    unit: str
    confidence: str

    def __str__(self) -> str:
        """Return estimate and unit, as a table cell has it."""
        return self.estimate if self.estimate == "unknown" else f"{self.estimate} {self.unit}"


def printed_size(finding: Finding, *, flipped: bool = False) -> PrintedSize | None:
    """Convert and round a finding's size; ``flipped`` prints its negative."""
    size = finding.size
    if size is None:
        return None
    scale, unit = _PRINTED_FACTOR.get(finding.kind) or _PRINTED_UNIT.get(size.unit) or (1.0, "")
    # A scale factor of 1.2 is said as "20 % too large", one of 8 as "8 times".
    usual = 1.0 if finding.kind == "scale" else 0.0
    if _multiple(finding):
        scale, unit, usual, flipped = 1.0, "times", 0.0, False
    ends = [size.low - usual, size.high - usual]
    estimate = size.estimate - usual
    if flipped:
        ends, estimate = [-ends[1], -ends[0]], -estimate
    low, high, middle = rounded(scale * ends[0], scale * ends[1], scale * estimate)
    return PrintedSize(
        estimate=middle,
        interval=between(low, high),
        unit=unit or shown(size.unit),
        confidence=confidence_of(size),
    )


def _multiple(finding: Finding) -> bool:
    """Whether a scale error is one by a factor of two or more."""
    size = finding.size
    return finding.kind == "scale" and size is not None and not 0.5 < size.estimate < 2.0


def confidence_of(size: Size) -> str:
    """Return "99.9 %", or "guaranteed" where the interval holds as long as its bound does."""
    return "guaranteed" if size.confidence >= 1.0 else percent(size.confidence)


def negative(size: Size, usual: float = 0.0) -> bool:
    """Whether a signed size means "too little": less than what is usual."""
    if math.isfinite(size.estimate):
        return size.estimate < usual
    return size.high < usual


def suspects(finding: Finding) -> str:
    """Name whom a finding accuses."""
    joint = "and" if finding.one_source else "or"
    return listed([shown(name) for name in finding.suspects], joint)


def finding_sentence(finding: Finding, analysis: Analysis) -> str:
    """Say what one finding found: who, what, how much, when."""
    claim = f"{_claim(finding, analysis)} {_when(finding, analysis)}"
    whole_device = finding.kind == "disagreement" and finding.one_source
    if finding.detail and (finding.kind == "mounting" or whole_device):
        claim = f"{claim}: {shown(finding.detail.partition(';')[0], SHOWN_TEXT)}"
    if finding.isolated:
        return f"{suspects(finding)} {claim}."
    one_of = listed([shown(name) for name in finding.suspects])
    return f"One of {one_of} {claim}; this log cannot tell which."


def size_is_shared(finding: Finding, analysis: Analysis) -> bool:
    """Whether the size would be the same whichever suspect it was: all measure along one line."""
    axes = [c.axis for c in analysis.table.channels if c.name in finding.suspects]
    return len(axes) == len(finding.suspects) and all(
        abs(sum(a * b for a, b in zip(axes[0], axis, strict=True))) > PARALLEL for axis in axes
    )


def negated(finding: Finding, analysis: Analysis) -> bool:
    """Whether a size is best said without its sign, which depends on which suspect it was."""
    if finding.size is None or finding.isolated or not size_is_shared(finding, analysis):
        return False
    return finding.kind in {"bias", "drift", "impulse"} and negative(finding.size)


def _when(finding: Finding, analysis: Analysis) -> str:
    time_s = analysis.table.time_s
    span = flight_time(finding.start_s, finding.end_s)
    if not len(time_s) or finding.kind == "impulse":
        return span
    first, last = float(time_s[0]), float(time_s[-1])
    at_start = finding.start_s - first <= _THROUGHOUT_S
    at_end = last - finding.end_s <= _THROUGHOUT_S
    if at_start and at_end and last - first > 4 * _THROUGHOUT_S:
        return f"throughout, {span}"
    return span


def _claim(finding: Finding, analysis: Analysis) -> str:
    """Say what happened, without who and when."""
    size = finding.size
    if size is None:
        held = _AGAIN.get(finding.kind) if finding.detail.endswith("s in all") else None
        return held or _UNSIZED[finding.kind]
    flipped = (finding.kind in {"bias", "drift", "impulse"} and negative(size)) or (
        finding.kind == "scale" and negative(size, usual=1.0)
    )
    printed = printed_size(finding, flipped=flipped)
    amount = str(printed)
    interval = ""
    if printed is not None and printed.estimate == "unknown":
        amount = f"an unknown number of {printed.unit}"
    if printed is not None and size.low != size.high:
        interval = f" ({printed.confidence}: {printed.interval})"
    much, large = ("too little", "too small") if flipped else ("too much", "too large")
    up = "downwards" if flipped else "upwards"
    claim = _CLAIM_MULTIPLE if _multiple(finding) else _CLAIM[finding.kind]
    if not finding.isolated:  # the sign depends on which of them it is
        if not size_is_shared(finding, analysis):
            interval = f"{interval} if it was {shown(finding.suspects[0])}"
        if not _multiple(finding):
            claim = _CLAIM_OF_SEVERAL.get(finding.kind, claim)
        return claim.format(amount=amount, interval=interval)
    return claim.format(amount=amount, interval=interval, much=much, large=large, up=up)


_CLAIM = {
    "bias": "read {amount} {much}{interval}",
    "drift": "drifted {up} by {amount}{interval}",
    "scale": "read rates {amount} {large}{interval}",
    "noise": "was {amount} as noisy as the others{interval}",
    "impulse": "jumped {up} by {amount}{interval}",
    "dropout": "was silent for {amount} while others went on{interval}",
    "stuck": "was stuck at one value",
    "dead": "was dead: it read zero",
    "saturated": "was at the end of its range",
    "mounting": "read as if mounted otherwise",
    "disagreement": "disagreed with what was expected of it",
}
_CLAIM_MULTIPLE = "read {amount} the true rate{interval}"
_CLAIM_OF_SEVERAL = {
    "bias": "was wrong by {amount}{interval}",
    "drift": "drifted by {amount}{interval}",
    "scale": "read rates wrong by {amount}{interval}",
    "impulse": "jumped by {amount}{interval}",
}
_AGAIN = {
    "stuck": "was stuck again and again",
    "dead": "was dead again and again: it read zero",
}
_UNSIZED = {
    "bias": "read a wrong rate, by how much the log does not bound,",
    "drift": "drifted, how fast the log does not bound,",
    "scale": "read rates in a wrong scale, by how much the log does not bound,",
    "noise": "was noisier than the others",
    "impulse": "jumped again and again",
    "dropout": "was silent again and again while others went on",
    "stuck": "was stuck at one value",
    "dead": "was dead: it read zero",
    "saturated": "was at the end of its range",
    "mounting": "read as if mounted otherwise",
    "disagreement": "disagreed with what was expected of it",
}

# Of so short a time it is said how short it is: hardly any fault would have shown. [s]
BRIEF_S = 10.0

VERDICT_WORD = {
    "failed": "Failed",
    "healthy": "Healthy as far as this log can tell",
    "undecided": "Undecided",
    "insufficient": "Insufficient",
}


def verdict_sentence(analysis: Analysis) -> str:
    """Say in one sentence what the log shows."""
    if analysis.verdict == "failed":
        return _failed(analysis)
    if analysis.verdict == "insufficient":
        return f"Nothing could be compared: {_why_nothing(analysis)}."
    gyros = [
        (shown(channel.name), status)
        for channel, status in zip(analysis.table.channels, analysis.status, strict=True)
        if not channel.derived
    ]
    judged = [name for name, status in gyros if status != "insufficient"]
    unsure = [name for name, status in gyros if status == "undecided"]
    tolerance = f"{figure(analysis.config.tolerance.bias_deg_s)} deg/s"
    if analysis.verdict == "healthy":
        duration_s = analysis.table.duration_s
        brief = ""
        if duration_s < BRIEF_S:
            brief = f" It lasts {figure(duration_s)} s, in which hardly a fault would have shown."
        return (
            f"No channel was found to have failed, and all {several(len(judged), 'channel')} that"
            f" could be compared kept within {tolerance} of what the others say, in windows that"
            f" cover at least 90 % of the time.{brief}"
        )
    if unsure:
        return (
            f"No channel was found to have failed, but {len(unsure)} of {len(judged)} compared"
            f" could not be shown to keep within {tolerance}: {listed(unsure)}."
        )
    return "No channel was found to have failed, but part of the log is lost."


def _failed(analysis: Analysis) -> str:
    alone: dict[str, list[str]] = {}
    for finding in analysis.findings:
        for name in finding.suspects if finding.isolated else ():
            kinds = alone.setdefault(name, [])
            kinds += [KIND_NAME[finding.kind]] if KIND_NAME[finding.kind] not in kinds else []
    groups = list(dict.fromkeys(f.suspects for f in analysis.findings if not f.isolated))
    if len(analysis.findings) == 1:
        return finding_sentence(analysis.findings[0], analysis)
    parts = []
    for together in dict.fromkeys(tuple(kinds) for kinds in alone.values()):
        names = [shown(name) for name, kinds in alone.items() if tuple(kinds) == together]
        parts.append(f"{listed(names)} failed ({listed(together)})")
    if groups:
        each = [f"one of {listed([shown(name) for name in group])}" for group in groups]
        if len(groups) > MOST_GROUPS:
            each = [f"one in each of {len(groups)} groups of channels"]
        parts.append(f"{', and '.join(each)} failed, and this log cannot tell which")
    if not parts:
        return "A gyro failed."
    said = "; ".join(parts)
    if not alone:
        said = said[0].upper() + said[1:]
    return f"{said}: {several(len(analysis.findings), 'finding')}."


def _why_nothing(analysis: Analysis) -> str:
    channels = analysis.table.channels
    sources = list(dict.fromkeys(shown(channel.source) for channel in channels))
    if not channels:
        return "the log holds no gyro channel that could be used"
    if not len(analysis.table.time_s):
        return "no sample is left of the gyro channels"
    if not analysis.isolability.detectable:
        if len(sources) == 1:
            said = f"the log holds one gyro source, {sources[0]}, and nothing to hold it against"
            return "; ".join([said, *_attitude_unused(analysis)])
        return f"no two of the sources {listed(sources)} measure along a common direction"
    return f"the sources {listed(sources)} have too little in common in time"


def _attitude_unused(analysis: Analysis) -> list[str]:
    """Say of an attitude that the log holds why it tells nothing of the gyros."""
    return [
        f"the attitude, {shown(info.topic)}, is {info.reason}"
        for info in analysis.sources
        if info.name == WITNESS and not info.used
    ]


def blind_spots(analysis: Analysis) -> list[str]:
    """Say what this log could not have shown, whatever had happened."""
    said = []
    groups = [listed([shown(name) for name in group]) for group in analysis.isolability.groups]
    if groups:
        said.append(
            "A fault of one looks like a fault of the other, so these are accused together, never"
            f" apart: {'; '.join(groups)}."
        )
    compared = set(analysis.isolability.detectable)
    alone = [
        shown(c.name) for c in analysis.table.channels if c.name not in compared and not c.derived
    ]
    modelled = [shown(name) for name in analysis.config.observer.outputs if shown(name) in alone]
    for names, so in (
        ([name for name in alone if name not in modelled], "a wrong rate would not have shown"),
        (modelled, "only the model of the vehicle could have shown a wrong rate, as its note says"),
    ):
        if names:
            axes = "its axis" if len(names) == 1 else "their axes"
            said.append(
                f"{listed(names)}: nothing else in this log measures along {axes}, so {so}."
            )
    untested = [
        shown(c.name)
        for c, status in zip(analysis.table.channels, analysis.status, strict=True)
        if status == "insufficient" and c.name in compared
    ]
    if untested:
        said.append(f"{listed(untested)}: never compared, for want of samples in common.")
    witnesses = list(dict.fromkeys(shown(c.source) for c in analysis.table.channels if c.derived))
    if witnesses:
        said.append(
            f"{listed(witnesses)} {'is' if len(witnesses) == 1 else 'are'} derived, not measured by"
            " a gyro of its own: a witness for faults that last seconds, blind to short ones."
        )
    lone = [shown(name) for name in lone_gyros(analysis)]
    if lone:
        said.append(
            f"{listed(lone)}: checked by no other gyro, so noise, a scale error, or a few readings"
            " that are off by no more than a vehicle may turn would hardly have shown."
        )
    doubtful = [shown(name) for name in unheld(analysis)]
    if doubtful:
        axes = "its axis" if len(doubtful) == 1 else "their axes"
        said.append(
            f"{listed(doubtful)}: held against the attitude alone, which nothing else in this log"
            f" holds to the truth about {axes}. A filter that follows a failed gyro agrees with it,"
            " so that they agree decides nothing."
        )
    said += [f"{unused[0].upper()}{unused[1:]}." for unused in _attitude_unused(analysis)]
    said += limits(analysis)
    said += _sharpness(analysis)
    tolerance = figure(analysis.config.tolerance.bias_deg_s)
    said.append(f"Errors below the tolerance of {tolerance} deg/s are not called failures.")
    return said


def taken_out(analysis: Analysis) -> str:
    """Say what is in the readings as they are drawn, and not in the intervals of their errors.

    A wrong unit, range or mounting is taken out before anything is compared.
    """
    kinds = {KIND_NAME[one.kind] for one in analysis.findings if MENDING & set(one.detectors)}
    return f"; {listed(sorted(kinds))} taken out" if kinds else ""


def limits(analysis: Analysis) -> list[str]:
    """Say how large and how long a constant error must be to show at this log's rate."""
    groups = analysis.revealed
    bounded = [group for group in groups if group.shortest_s is not None]
    if not bounded:
        if not groups:
            return []
        return ["No stretch of the log bounds the error of any channel."]
    sizes: dict[float, list[float]] = {}
    for group in bounded:
        for one in group.windows:
            if one.bias_rad_s is not None:
                sizes.setdefault(one.length_s, []).append(one.bias_rad_s)
    everywhere = [length for length, found in sorted(sizes.items()) if len(found) == len(bounded)]
    # What lasts long shows in the short windows that it fills as well.
    least = [min(max(sizes[one]) for one in everywhere[: k + 1]) for k in range(len(everywhere))]
    # Windows advance by a part of their length: what lasts so much longer fills one for sure.
    longer = 2.0 - analysis.config.windows.overlap
    shown_from: dict[str, float] = {}
    told = [*zip(least, everywhere, strict=True)]
    for size, length in [*told[:2], *told[2:][-1:]]:
        shown_from.setdefault(figure(DEG_PER_RAD * size, 2), longer * length)
    flight_s = analysis.table.duration_s
    parts = [
        f"from {size} deg/s on if it lasts"
        f" {f'{figure(length)} s' if length < flight_s else 'all along'}"
        for size, length in shown_from.items()
    ]
    shortest_s = longer * max(group.shortest_s or 0.0 for group in bounded)
    shortest = f"{figure(shortest_s)} s" if shortest_s < flight_s else "the whole of it"
    rate = figure(min(group.rate_hz for group in bounded))
    shows = f"a constant error shows {', or '.join(parts)}; " if parts else ""
    return [f"Logged at {rate} Hz, {shows}what lasts less than {shortest} can pass unseen."]


def is_slow(analysis: Analysis) -> bool:
    """Whether the log is too slow for the shortest windows that were asked for."""
    shortest_s = min(analysis.config.windows.lengths_s)
    return any(group.rate_hz * shortest_s < FEWEST_READINGS for group in analysis.revealed)


def _sharpness(analysis: Analysis) -> list[str]:
    """Say how far beyond the tolerance an error must be to show."""
    drawn = drawn_evidence(analysis)
    bars = [intervals(drawn, column) for column in range(len(analysis.table.channels))]
    widths = [DEG_PER_RAD * bar.median_half_width for bar in bars if bar is not None]
    if drawn is None or not widths:
        return []
    least, most = figure(min(widths), 2), figure(max(widths), 2)
    within = f"{least} deg/s" if least == most else f"{least} to {most} deg/s, by channel"
    said = (
        f"Over {figure(drawn.windows.length_s)} s a channel's error is known to within {within}"
        " (median half-width of its intervals); an error that lasts that long shows only where it"
        " exceeds the tolerance by that much."
    )
    return [said]
