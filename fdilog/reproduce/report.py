"""The comparison with the papers, for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict

from fdilog.reproduce.row import Row
from fdilog.text_table import text_table

SCHEMA = "fdilog-reproduction/1"

Tables = Mapping[str, Sequence[Row]]


def all_agree(tables: Tables) -> bool:
    """Whether every printed value that can be compared agrees."""
    return not any(row.agrees is False for rows in tables.values() for row in rows)


def in_words(tables: Tables, seed: int) -> str:
    """Lay out printed value, ours, difference and agreement; remarks stand below each table."""
    parts = [f"seed {seed}\n"]
    for name, rows in tables.items():
        notes = list(dict.fromkeys(row.note for row in rows if row.note))
        head = ["table", "quantity", "printed", "ours", "difference", "agrees", "note"]
        cells = [
            [
                row.table,
                row.quantity,
                _value(row.printed),
                _value(row.ours),
                "-" if row.difference is None else f"{row.difference:+.4g}",
                {True: "yes", False: "NO", None: "-"}[row.agrees],
                f"[{notes.index(row.note) + 1}]" if row.note else "",
            ]
            for row in rows
        ]
        compared = [row for row in rows if row.agrees is not None]
        agreeing = sum(bool(row.agrees) for row in compared)
        remarks = "".join(f"[{k}] {note}\n" for k, note in enumerate(notes, start=1))
        parts.append(
            f"{name}: {agreeing} of {len(compared)} printed values agree\n\n"
            f"{text_table(head, cells)}{remarks}"
        )
    return "\n".join(parts)


def _value(value: float | str | None) -> str:
    if value is None:
        return "-"
    return value if isinstance(value, str) else f"{value:.6g}"


def as_json(tables: Tables, seed: int) -> str:
    """Return every row as one line of JSON."""
    plain = {
        "schema": SCHEMA,
        "seed": seed,
        "agree": all_agree(tables),
        "tables": {
            name: [{**asdict(row), "difference": row.difference} for row in rows]
            for name, rows in tables.items()
        },
    }
    return json.dumps(plain, allow_nan=False, separators=(",", ":")) + "\n"
