"""Numbers, times and foreign strings, ready to print; nothing here knows what a finding is."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal

DEG_PER_RAD = 180.0 / math.pi
SHOWN_NAME = 60
"""Longest foreign name that is printed whole; channel and topic names of real logs stay below."""
SHOWN_TEXT = 400
"""Longest foreign sentence that is printed whole: an error text, a reason."""

LONGEST_PLAIN = 1e7
"""Numbers from here on are printed with an exponent."""
SIGNIFICANT = 12
"""Digits of a float that are taken at their word; a change of unit disturbs the last few."""

_GROUP = "\u202f"  # narrow no-break space between groups of three digits, as SI writes them
# Categories of characters that print nothing, or rearrange what is printed around them.
_INVISIBLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
_RIGHT_TO_LEFT = {"R", "AL", "AN"}
_LONE_SURROGATE = re.compile("[\ud800-\udfff]")


def shown(text: str, limit: int = SHOWN_NAME) -> str:
    r"""Make a string that came from a log or a path safe to look at, in any format.

    Control, bidirectional-override and other invisible characters appear as escapes, bytes of a
    file name that are no text as ``\xff``; a long string loses its middle and says how long it
    was; right-to-left text is isolated so that it cannot reorder what stands beside it. Escaping
    for HTML or Markdown is the templates' part.
    """
    if len(text) > limit:
        head, tail = text[: limit * 2 // 3], text[-(limit // 4) :]
        line = f"{_visible(head)}\u2026[{several(len(text), 'character')}]\u2026{_visible(tail)}"
    else:
        line = _visible(text)
    if any(unicodedata.bidirectional(char) in _RIGHT_TO_LEFT for char in line):
        return f"\u2068{line}\u2069"
    return line


def _visible(text: str) -> str:
    return "".join(_visible_character(char) for char in text)


def _visible_character(char: str) -> str:
    category = unicodedata.category(char)
    if category == "Zs":
        return " "
    if category not in _INVISIBLE:
        return char
    code = ord(char)
    if 0xDC80 <= code <= 0xDCFF:  # how Python carries a byte that is not UTF-8
        return f"\\x{code - 0xDC00:02x}"
    if code < 0x100:
        return {"\n": "\\n", "\r": "\\r", "\t": "\\t"}.get(char, f"\\x{code:02x}")
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def encodable(text: str) -> str:
    """Replace what UTF-8 cannot hold, for text that is otherwise kept exactly."""
    return _LONE_SURROGATE.sub("\ufffd", text)


def figure(value: float, significant: int = 3) -> str:
    """Print a number to so many significant digits, without an exponent where one can do so."""
    if math.isnan(value):
        return "unknown"
    if math.isinf(value):
        return "unbounded"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < LONGEST_PLAIN:
        return f"{value:.{significant - 1}e}"
    places = max(0, significant - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:.{places}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def count(number: int) -> str:
    """Print a whole number, digits in groups of three from five digits on."""
    return f"{number:,}".replace(",", _GROUP) if abs(number) >= 10_000 else str(number)


def several(number: int, one: str, many: str = "") -> str:
    """Print a number with its noun: 1 sample, 2 samples."""
    return f"{count(number)} {one if number == 1 else many or one + 's'}"


def size_of(number: int) -> str:
    """Print a number of bytes, exactly and, where that is long, in short."""
    exact = several(number, "byte")
    for unit, power in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if number >= power:
            return f"{figure(number / power)} {unit} ({exact})"
    return exact


def percent(share: float) -> str:
    """Print a confidence or a share: 0.999 as 99.9 %."""
    return f"{100.0 * share:.6g} %"


def rounded(low: float, high: float, estimate: float) -> tuple[str, str, str]:
    """Print an interval and its estimate to the digits that the interval supports.

    The ends are rounded outwards, so that the printed interval holds the computed one.

    Returns
    -------
    low, high, estimate
        An end that is not finite is empty, an estimate that is not finite "unknown".
    """
    largest = max((abs(x) for x in (low, high, estimate) if math.isfinite(x)), default=0.0)
    half_width = (high - low) / 2.0
    if math.isfinite(half_width) and half_width > 0.0:
        places = _places(half_width)
    else:  # three digits of whatever is known
        places = 2 - _exponent(largest)
    if largest < LONGEST_PLAIN:
        places = max(0, places)
    quantum = Decimal(1).scaleb(-min(places, SIGNIFICANT - 1 - _exponent(largest)))
    return (
        _rounded(low, quantum, ROUND_FLOOR) if math.isfinite(low) else "",
        _rounded(high, quantum, ROUND_CEILING) if math.isfinite(high) else "",
        _rounded(estimate, quantum, ROUND_HALF_EVEN) if math.isfinite(estimate) else "unknown",
    )


def _rounded(value: float, quantum: Decimal, rounding: str) -> str:
    # Twelve digits first: what lies beyond them is the rounding of a change of unit.
    text = str(Decimal(f"{value:.{SIGNIFICANT}g}").quantize(quantum, rounding))
    text = text.removeprefix("-") if text.startswith("-") and not text.strip("-0.E+") else text
    return text if "E" in text else _grouped(text)


def _grouped(text: str) -> str:
    """Part the digits before the point in groups of three, from five on, as `count` does."""
    whole, point, rest = text.partition(".")
    sign, digits = whole[: -len(whole.lstrip("-"))], whole.lstrip("-")
    return f"{sign}{count(int(digits))}{point}{rest}" if len(digits) > 4 else text


def _exponent(value: float) -> int:
    return math.floor(math.log10(abs(value))) if value else 0


def _places(half_width: float) -> int:
    """Decimals that leave one significant digit, or two where the first is below three."""
    exponent = _exponent(half_width)
    first = round(half_width / 10.0**exponent, 6) if exponent > -300 else 1.0
    return -exponent + (0 if first >= 3.0 else 1)


def between(low: str, high: str) -> str:
    """Print an interval of ends that are printed already; an empty end is unbounded."""
    if low and high:
        return f"{low} to {high}"
    if low:
        return f"at least {low}"
    return f"at most {high}" if high else "unbounded"


def flight_time(start_s: float, end_s: float | None = None) -> str:
    """Print an instant or a span of flight time."""
    if end_s is None:
        return f"{_fixed(start_s, _time_places(0.0))} s"
    places = _time_places(end_s - start_s)
    start, end = f"{_fixed(start_s, places)} s", f"{_fixed(end_s, places)} s"
    return f"at {start}" if start == end else f"from {start} to {end}"


def _fixed(value: float, places: int) -> str:
    """Print so many decimals, and no minus before zero."""
    return f"{round(value, places) + 0.0:.{places}f}"


def _time_places(span_s: float) -> int:
    return 1 if span_s >= 1.0 else 2


def utc(start_utc: str | None, *times_s: float) -> str:
    """Print flight times as UTC, the date once; empty where the log does not tell UTC.

    Parameters
    ----------
    start_utc
        UTC at flight time zero, in ISO 8601.
    """
    try:
        start = datetime.fromisoformat(start_utc or "")
        start = start.astimezone(UTC) if start.tzinfo else start.replace(tzinfo=UTC)
        moments = [start + timedelta(seconds=time_s) for time_s in times_s]
    except (ValueError, OverflowError):
        return ""
    texts = [f"{moment:%Y-%m-%d %H:%M:%S}.{moment.microsecond // 100_000}" for moment in moments]
    first, last = texts[0], texts[-1]
    day = len("2024-05-01 ")
    if first == last:
        return f"{first} UTC"
    return f"{first} to {last[day:] if first[:day] == last[:day] else last} UTC"


def listed(names: Sequence[str], last: str = "and", limit: int = 12) -> str:
    """Print names as a sentence does: a, b and c."""
    if len(names) > limit:
        names = [*names[: limit - 1], f"{len(names) - limit + 1} more"]
        last = "and"
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"
