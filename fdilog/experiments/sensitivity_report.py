"""What a flight would have shown, for people and for programs."""

from __future__ import annotations

import json
import math
from html import escape
from pathlib import Path
from typing import Any

from fdilog.errors import UsageError
from fdilog.experiments.faults import SIZE_UNITS
from fdilog.experiments.sensitivity import BY_LENGTH, RESOLUTION, SCALES, Answer, Sensitivity
from fdilog.experiments.typed_fault import TYPED_UNITS
from fdilog.text_table import text_table

SCHEMA = "fdilog-sensitivity/1"


def in_words(seen: Sensitivity, *, markdown: bool = False) -> str:
    """Lay out the smallest faults found, channels down and kinds across, and what was tried."""
    head = ["channel", *(f"{kind} [{_unit(kind)}]" for kind in seen.kinds)]
    by_name = {(answer.channel, answer.kind): answer for answer in seen.answers}
    rows = [
        [channel, *(_cell(by_name[channel, kind]) for kind in seen.kinds)]
        for channel in seen.channels
    ]
    table = text_table(head, rows, markdown=markdown)
    lines = [
        (
            f"Smallest fault that would have been found in {seen.path or 'this flight'}"
            f" ({seen.duration_s:.1f} s), whenever it was tried:"
        ),
        "",
        table,
        *_explained(seen),
    ]
    return "\n".join(lines) + "\n"


def _explained(seen: Sensitivity) -> list[str]:
    starts = ", ".join(f"{start:.1f}" for start in seen.starts_s)
    untried = [kind for kind in (*SCALES, "saturated", "mounting") if kind not in seen.kinds]
    lines = [
        (
            "One number: found, and no other channel named with it. Two: found / named alone from"
            " there on; - if never named alone, so the log cannot tell it from another."
        ),
        (
            f"Tried: starts at {starts} s (seed {seen.seed}); bias, drift, scale and noise last"
            f" {seen.span_s:g} s, an impulse is one reading, for {_listed(sorted(BY_LENGTH))} it is"
            f" the length that was sought. {seen.runs} analyses; sizes to within"
            f" {100 * (RESOLUTION - 1):.0f} %, larger ones are taken to be found as well."
        ),
        "Not tried: two faults at once, negative sizes, other starts and lengths"
        + (f", {_listed(untried)}." if untried else "."),
    ]
    lines += [f"{a.channel}, {a.kind}: not tried, {a.note}." for a in seen.answers if a.note]
    return lines


def _listed(words: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(words[:-1]), words[-1]]))


def _unit(kind: str) -> str:
    return "s" if kind in BY_LENGTH else TYPED_UNITS[SIZE_UNITS[kind]]


def _typed(kind: str, size: float) -> float:
    """Convert a size from SI into the unit in which people give it."""
    in_rad = kind not in BY_LENGTH and SIZE_UNITS[kind].startswith("rad")
    return math.degrees(size) if in_rad else size


def _cell(answer: Answer) -> str:
    if not answer.trials:
        return "not tried"
    if answer.found is None:
        return f">{_figure(_typed(answer.kind, answer.most))}"
    found = _figure(_typed(answer.kind, answer.found))
    if answer.isolated == answer.found:
        return found
    alone = answer.isolated
    return f"{found} / {'-' if alone is None else _figure(_typed(answer.kind, alone))}"


def _figure(size: float) -> str:
    return f"{float(f'{size:.2g}'):g}"


def as_json(seen: Sensitivity) -> str:
    """Return all that was found out, in SI units, as one line of JSON."""
    plain: dict[str, Any] = {
        "schema": SCHEMA,
        "log": {"path": seen.path, "duration_s": seen.duration_s},
        "seed": seen.seed,
        "span_s": seen.span_s,
        "starts_s": seen.starts_s,
        "resolution": RESOLUTION,
        "runs": seen.runs,
        "answers": [
            {
                "kind": answer.kind,
                "channel": answer.channel,
                "unit": "s" if answer.kind in BY_LENGTH else SIZE_UNITS[answer.kind],
                "found": answer.found,
                "isolated": answer.isolated,
                "most_tried": answer.most,
                "note": answer.note or None,
                "trials": [
                    {"start_s": t.start_s, "found": t.found, "isolated": t.isolated}
                    for t in answer.trials
                ],
            }
            for answer in seen.answers
        ],
    }
    # ASCII only: a path may hold bytes that are no UTF-8.
    return json.dumps(plain, allow_nan=False, separators=(",", ":")) + "\n"


PANEL_WIDE, ROW_HIGH, HEAD_HIGH, NAMES_WIDE = 190, 20, 44, 90
DOT = 4


def as_svg(seen: Sensitivity) -> str:
    """Draw a panel for each kind: a dot for each start, filled where the channel is named alone."""
    wide = NAMES_WIDE + PANEL_WIDE * len(seen.kinds)
    high = HEAD_HIGH + ROW_HIGH * (len(seen.channels) + 1)
    rows = {name: HEAD_HIGH + ROW_HIGH * (k + 0.5) for k, name in enumerate(seen.channels)}
    parts = [
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {wide} {high}" width="{wide}"'
            f' height="{high}" font-family="sans-serif" font-size="12">'
        ),
        "<title>Smallest faults that this flight would have shown</title>",
        f'<rect width="{wide}" height="{high}" fill="white"/>',
    ]
    parts += [f'<text x="4" y="{y + 4}">{escape(name)}</text>' for name, y in rows.items()]
    for k, kind in enumerate(seen.kinds):
        answers = [answer for answer in seen.answers if answer.kind == kind]
        parts += _panel(NAMES_WIDE + PANEL_WIDE * k, kind, answers, rows, high)
    return "\n".join([*parts, "</svg>"]) + "\n"


def _panel(
    left: float, kind: str, answers: list[Answer], rows: dict[str, float], high: float
) -> list[str]:
    above, least = SCALES[kind].above, SCALES[kind].least
    most = max(answer.most for answer in answers) - above
    low, wide = math.log(least), PANEL_WIDE - 30

    def x(size: float) -> float:
        return (
            left + 10 + wide * (math.log(max(size - above, least)) - low) / (math.log(most) - low)
        )

    ends = [_figure(_typed(kind, above + size)) for size in (least, most)]
    parts = [
        f'<text x="{left + 10}" y="16">{kind} [{_unit(kind)}]</text>',
        f'<text x="{left + 10}" y="32" fill="#555">{ends[0]}</text>',
        f'<text x="{left + 10 + wide}" y="32" fill="#555" text-anchor="end">{ends[1]}</text>',
        (
            f'<path d="M{left + 10} 36V{high - ROW_HIGH / 2}M{left + 10 + wide} 36V'
            f'{high - ROW_HIGH / 2}" stroke="#bbb" fill="none"/>'
        ),
    ]
    for answer in answers:
        for trial in answer.trials:
            if trial.found is None:
                continue
            alone = trial.isolated == trial.found
            parts.append(
                f'<circle cx="{x(trial.found):.1f}" cy="{rows[answer.channel]:.1f}" r="{DOT}"'
                f' stroke="#06c" fill="{"#06c" if alone else "white"}"><title>'
                f"{_figure(_typed(kind, trial.found))} {_unit(kind)} at {trial.start_s:.1f} s"
                f"</title></circle>"
            )
    return parts


FORMATS = {
    ".md": lambda seen: in_words(seen, markdown=True),
    ".json": as_json,
    ".svg": as_svg,
    ".txt": in_words,
}


def write_sensitivity(seen: Sensitivity, path: Path) -> None:
    """Write the answers in the format that the suffix names.

    Raises
    ------
    UsageError
        If the path cannot be written.
    """
    text = FORMATS[path.suffix.lower()](seen)
    try:
        path.write_text(text, encoding="utf-8", errors="backslashreplace", newline="\n")
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error


def checked_format(path: Path) -> None:
    """Complain about a suffix that means no format, before the work begins.

    Raises
    ------
    UsageError
        If it means none.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"{path}: must end in {_listed(sorted(FORMATS)).replace(' and', ' or')}")
