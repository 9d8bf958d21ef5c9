"""What to do about a finding: one or two sentences for whoever has the vehicle before them."""

from __future__ import annotations

from fdilog.analysis import Analysis
from fdilog.finding import Finding
from fdilog_reports.words import listed, shown

_ISOLATED = {
    "bias": "Log the vehicle at rest: if {name} is off there too, calibrate it again; if it is not,"
    " the error comes and goes, and {source} should be replaced before it is trusted.",
    "drift": "Log {source} at rest while it warms up: a drift that follows its temperature asks"
    " for a temperature calibration, any other for another sensor.",
    "scale": "Turn {source} by a known angle about this axis and compare; check the range and the"
    " scale factor that are set for it.",
    "noise": "Check how {source} is fixed and damped, and what near it is loose or out of balance;"
    " if earlier flights were quiet with the same mounting, replace it.",
    "stuck": "Check the bus and the driver of {source}; do not let it vote in flight until it"
    " has run for hours without stopping.",
    "dead": "Check the supply, the bus and the driver of {source}; replace it if it stays dead.",
    "saturated": "Find out what turned or shook it so fast, or widen the range of {source}; how"
    " fast it really was, {name} does not tell.",
    "impulse": "Look what happened at that moment: a knock, a dip of the supply, a bus error."
    " Once is to be watched, several times is a reason to replace {source}.",
    "dropout": "Check the wiring and the bus of {source}, and whether the logger itself kept up;"
    " until it is explained it is no spare.",
    "mounting": "Compare the orientation that is set for {source} with how it sits in the vehicle;"
    " state it under [geometry.mounting] in the configuration and analyse again.",
    "disagreement": "Look at the plots of this time: {name} does not follow the others, in a way"
    " that none of the known kinds describes.",
}
_AT_REST = " At rest every gyro must read zero: the one that does not is the one."
_ONE_OF_SEVERAL = (
    "Treat all of {names} as suspect. A third gyro along that axis, or an attitude with GPS and"
    " compass in the log, would have told them apart."
)


def next_step(finding: Finding, analysis: Analysis) -> str:
    """Say what to look at or to do next."""
    source_of = {c.name: c.source for c in analysis.table.channels if not c.derived}
    first = finding.suspects[0]
    # Gyros that all come from one table, or one device, are spoken of by themselves.
    several = len(set(source_of.values())) > 1
    source = shown(source_of.get(first, first) if several else first)
    if finding.isolated:
        name = shown(first) if len(finding.suspects) == 1 else source
        return _ISOLATED[finding.kind].format(name=name, source=source)
    said = _ONE_OF_SEVERAL.format(names=listed([shown(name) for name in finding.suspects]))
    return said + (_AT_REST if finding.kind == "bias" else "")
