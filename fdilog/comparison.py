"""Two results held against each other: what appeared, what vanished, what changed.

A size has changed if it lies outside the interval of the other; two intervals that hold each
other's estimates say the same. What has no interval is compared with a limit that is named here.
Of one log, findings are paired by time; of two flights, by kind, for their times have nothing to
do with each other.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from fdilog.analysis import SCHEMA
from fdilog.errors import UsageError

Result = Mapping[str, Any]

MOVED_S = 0.5
"""An edge that moves less has not moved: shorter silences are no dropouts either."""
NOISE_RATIO = 1.5
"""Noise changes by less from one flight to the next with the same propellers."""
ROTATION_DEG = 0.5
SCALE = 0.01
"""Data sheets promise scale factors to 1 to 3 %."""
BIAS_RAD_S = math.radians(0.3)
"""Consumer gyros hold 0.3 deg/s in flight."""

SIGNED = {"bias", "drift", "impulse"}
"""Kinds whose sign depends on which of several suspects it was."""

What = Literal["appeared", "vanished", "changed"]


@dataclass(frozen=True, kw_only=True)
class Difference:
    """One thing that two results do not agree on.

    Parameters
    ----------
    of
        What it is about: ``verdict``, ``channel imu0.x``, ``finding bias of imu1.y at 20.0 s``.
    before, after
        What each result says, in words; None where it says nothing.
    """

    what: What
    of: str
    before: str | None
    after: str | None


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """All differences, and what to know when reading them."""

    before: str
    after: str
    notes: tuple[str, ...]
    differences: tuple[Difference, ...]


def load_result(path: Path) -> Result:
    """Read the JSON result of one log.

    Raises
    ------
    UsageError
        If the file cannot be read, is no JSON, or is no result of this schema.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    except UnicodeDecodeError:
        raise UsageError(f"{path}: not a JSON result: not UTF-8") from None
    try:
        result = json.loads(text)
    except RecursionError:
        raise UsageError(f"{path}: not a JSON result: it is nested too deeply") from None
    except ValueError as error:
        several = " (it holds several results, one a line)" if "Extra data" in str(error) else ""
        raise UsageError(f"{path}: not a JSON result: {error}{several}") from None
    schema = result.get("schema") if isinstance(result, dict) else None
    if schema != SCHEMA:
        raise UsageError(
            f"{path}: not a result of `fdilog analyse`: its schema is {schema!r}, not {SCHEMA!r}"
        )
    known: Result = result
    return known


def compare(before: Result, after: Result) -> Comparison:
    """Hold two results against each other.

    Parameters
    ----------
    before, after
        As the JSON contract has them.

    Raises
    ------
    UsageError
        If a result lacks what its schema promises.
    """
    try:
        hashes = before["log"].get("sha256"), after["log"].get("sha256")
        one_log = bool(hashes[0]) and hashes[0] == hashes[1]
        return Comparison(
            before=str(before["log"]["path"]),
            after=str(after["log"]["path"]),
            notes=tuple(_notes(before, after, one_log=one_log)),
            differences=(
                *_single_values(before, after, VERDICT),
                *_findings(before, after, one_log=one_log),
                *_channels(before, after),
                *_single_values(before, after, COMPLETENESS),
                *_calibrations(before, after),
            ),
        )
    except (KeyError, TypeError, AttributeError, ValueError, OverflowError) as error:
        raise UsageError(f"a result lacks what {SCHEMA} promises: {error!r}") from None


def _notes(before: Result, after: Result, *, one_log: bool) -> Iterator[str]:
    if not one_log:
        yield "the two are about different logs: findings are paired by kind and channel, not time"
    for key, what in (("fdilog_version", "versions of fdilog"), ("config_sha256", "settings")):
        if before.get(key) != after.get(key):
            yield f"they were made with different {what}"


VERDICT = (("error", ("error",)), ("verdict", ("verdict",)))
COMPLETENESS = (
    ("completeness: whole", ("completeness", "whole")),
    ("completeness: bytes lost", ("completeness", "bytes_lost")),
    ("completeness: seconds lost", ("completeness", "seconds_lost")),
)


def _single_values(
    before: Result, after: Result, wanted: Iterable[tuple[str, tuple[str, ...]]]
) -> Iterator[Difference]:
    def value(result: Result, *keys: str) -> Any:
        for key in keys:
            result = result.get(key, {}) if isinstance(result, Mapping) else {}
        return None if result == {} else result

    for of, keys in wanted:
        yield from _difference(of, _word(value(before, *keys)), _word(value(after, *keys)))


def _word(value: Any) -> str | None:
    if value is None:
        return None
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _difference(of: str, before: str | None, after: str | None) -> Iterator[Difference]:
    if before == after:
        return
    what: What = "changed"
    if before is None:
        what = "appeared"
    elif after is None:
        what = "vanished"
    yield Difference(what=what, of=of, before=before, after=after)


def _named(result: Result, *keys: str, by: str) -> dict[str, Result]:
    part: Any = result
    for key in keys:
        part = part.get(key, {})
    return {str(one[by]): one for one in part}


def _channels(before: Result, after: Result) -> Iterator[Difference]:
    old, new = (_named(one, "table", "channels", by="name") for one in (before, after))
    for name in dict.fromkeys([*old, *new]):
        a, b = old.get(name), new.get(name)
        of = f"channel {name}"
        if a is None or b is None:
            yield from _difference(of, *(str(one["status"]) if one else None for one in (a, b)))
            continue
        yield from _difference(of, str(a["status"]), str(b["status"]))
        sigmas = a.get("sigma_rad_s"), b.get("sigma_rad_s")
        if _apart_by_factor(*sigmas):
            yield from _difference(f"{of}: noise", *(_rate(sigma) for sigma in sigmas))


def _apart_by_factor(one: float | None, other: float | None) -> bool:
    if not one or not other:
        return (one or 0.0) != (other or 0.0)
    return max(one, other) > NOISE_RATIO * min(one, other)


def _rate(rad_s: float | None) -> str:
    return "unknown" if rad_s is None else f"{math.degrees(rad_s):.3g} deg/s"


def _calibrations(before: Result, after: Result) -> Iterator[Difference]:
    old, new = (_named(one, "calibration", by="source") for one in (before, after))
    for name in dict.fromkeys([*old, *new]):
        a, b = old.get(name), new.get(name)
        of = f"calibration of {name}"
        if a is None or b is None:
            yield from _difference(of, *("estimated" if one else None for one in (a, b)))
            continue
        for key, limit, degrees, unit in (
            ("rotation_deg", ROTATION_DEG, False, "deg"),
            ("scale", SCALE, False, ""),
            ("bias_rad_s", BIAS_RAD_S, True, "deg/s"),
        ):
            if any(_apart(x, y, limit) for x, y in zip(a[key], b[key], strict=True)):
                words = (_triple(one[key], unit, degrees=degrees) for one in (a, b))
                yield from _difference(f"{of}: {key.split('_')[0]}", *words)


def _apart(one: float | None, other: float | None, limit: float) -> bool:
    if one is None or other is None:
        return one is not other
    return abs(one - other) > limit


def _triple(values: list[float | None], unit: str, *, degrees: bool) -> str:
    shown = ["unknown" if v is None else f"{math.degrees(v) if degrees else v:.4g}" for v in values]
    return f"{', '.join(shown)} {unit}".rstrip()


def _findings(before: Result, after: Result, *, one_log: bool) -> Iterator[Difference]:
    """Pair findings that share a suspect, those of one kind first; what is left came or went."""
    old, new = list(before.get("findings", [])), list(after.get("findings", []))
    for same_kind in (True, False) if one_log else (True,):
        pairs = [
            (*_unlike(a, b, one_log=one_log), i, j)
            for i, a in enumerate(old)
            for j, b in enumerate(new)
            if a and b and _same(a, b, same_kind=same_kind, one_log=one_log)
        ]
        for *_, i, j in sorted(pairs):
            if old[i] and new[j]:
                yield from _changes(old[i], new[j], one_log=one_log)
                old[i] = new[j] = None
    for finding in filter(None, old):
        yield from _difference(_title(finding), _sentence(finding), None)
    for finding in filter(None, new):
        yield from _difference(_title(finding), None, _sentence(finding))


def _unlike(a: Result, b: Result, *, one_log: bool) -> tuple[float, float]:
    """Rank a pair: of one log by the time they share, of two by suspects and size."""
    if one_log:
        return -_shared_s(a, b), 0.0
    one, other = (finding["size"]["estimate"] if finding["size"] else None for finding in (a, b))
    apart = math.inf if one is None or other is None else abs(one - other)
    return -float(len(set(a["suspects"]) & set(b["suspects"]))), apart


def _shared_s(a: Result, b: Result) -> float:
    return float(min(a["end_s"], b["end_s"]) - max(a["start_s"], b["start_s"]))


def _same(a: Result, b: Result, *, same_kind: bool, one_log: bool) -> bool:
    # Faults of a single reading have no length to share; neighbours within the limit are one.
    near = not one_log or _shared_s(a, b) >= -MOVED_S
    return (
        near
        and bool(set(a["suspects"]) & set(b["suspects"]))
        and (not same_kind or a["kind"] == b["kind"])
    )


def _changes(a: Result, b: Result, *, one_log: bool) -> Iterator[Difference]:
    title = _title(a)
    yield from _difference(f"{title}: kind", str(a["kind"]), str(b["kind"]))
    yield from _difference(
        f"{title}: suspects", ", ".join(sorted(a["suspects"])), ", ".join(sorted(b["suspects"]))
    )
    for key, what in (("start_s", "start"), ("end_s", "end")) if one_log else ():
        if abs(a[key] - b[key]) > MOVED_S:
            yield from _difference(f"{title}: {what}", f"{a[key]:.3f} s", f"{b[key]:.3f} s")
    if a["kind"] == b["kind"] and _beyond(a, b):
        yield from _difference(f"{title}: size", _size(a), _size(b))


def _beyond(a: Result, b: Result) -> bool:
    one, other = a["size"], b["size"]
    if one is None or other is None:
        return one is not other
    signs: tuple[float, ...] = (1.0,)
    if a["kind"] in SIGNED and not (a["isolated"] and b["isolated"]):
        signs = (1.0, -1.0)
    return not any(
        _holds(one, turned["estimate"]) and _holds(turned, one["estimate"])
        for turned in (_times(other, sign) for sign in signs)
    )


def _times(size: Result, sign: float) -> Result:
    if sign > 0:
        return size
    estimate, low, high = (
        None if size[key] is None else -size[key] for key in ("estimate", "low", "high")
    )
    return {**size, "estimate": estimate, "low": high, "high": low}


def _holds(size: Result, estimate: float | None) -> bool:
    """Whether an interval holds an estimate; an end that is null has no bound."""
    if estimate is None:
        return size["estimate"] is None
    low, high = size["low"], size["high"]
    return (low is None or low <= estimate) and (high is None or estimate <= high)


def _title(finding: Result) -> str:
    return f"{finding['kind']} of {', '.join(finding['suspects'])} at {finding['start_s']:.1f} s"


def _sentence(finding: Result) -> str:
    size = f", {_size(finding)}" if finding["size"] else ""
    return f"{finding['start_s']:.3f} to {finding['end_s']:.3f} s{size}"


def _size(finding: Result) -> str:
    size = finding["size"]
    if size is None:
        return "unknown"
    if finding["kind"] in SIGNED and not finding["isolated"] and (size["estimate"] or 0.0) < 0.0:
        size = _times(size, -1.0)
    unit = str(size["unit"])
    in_degrees = unit.startswith("rad")
    shown = [
        "unbounded" if v is None else f"{math.degrees(v) if in_degrees else v:.4g}"
        for v in (size["estimate"], size["low"], size["high"])
    ]
    names = {"rad/s": " deg/s", "rad/s^2": " deg/s per second", "1": " times", "s": " s"}
    return f"{shown[0]}{names.get(unit, '')} ({shown[1]} to {shown[2]})"


def in_words(seen: Comparison) -> str:
    """Tell what is different, a line each, or that nothing is."""
    lines = [f"before: {seen.before}", f"after:  {seen.after}"]
    lines += [f"note: {note}" for note in seen.notes]
    for one in seen.differences:
        sides = [side for side in (one.before, one.after) if side is not None]
        lines.append(f"{one.what:<8}  {one.of}: {' -> '.join(sides)}")
    if not seen.differences:
        lines.append("no difference")
    return "\n".join(lines) + "\n"


def as_json(seen: Comparison) -> str:
    """Return the differences as one line of JSON."""
    plain = {"schema": "fdilog-comparison/1", "same": not seen.differences, **asdict(seen)}
    return json.dumps(plain, allow_nan=False, separators=(",", ":")) + "\n"
