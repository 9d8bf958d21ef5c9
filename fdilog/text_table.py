"""Rows and columns as text, for a terminal or for Markdown."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(
    head: Sequence[str], rows: Sequence[Sequence[str]], *, markdown: bool = False
) -> str:
    """Lay out rows of cells under a head, every column as wide as its widest cell.

    Columns whose cells all begin like a number stand right, the others left.
    """
    cells = [[cell.replace("|", "\\|") if markdown else cell for cell in row] for row in rows]
    columns = list(zip(head, *cells, strict=True))
    widths = [max(len(cell) for cell in column) for column in columns]
    right = [all(_like_number(cell) for cell in column[1:]) for column in columns]
    lines = [
        [
            cell.rjust(w) if r else cell.ljust(w)
            for cell, w, r in zip(row, widths, right, strict=True)
        ]
        for row in (head, *cells)
    ]
    if not markdown:
        return "".join("  ".join(line).rstrip() + "\n" for line in lines)
    ruler = ["-" * (w - 1) + ":" if r else "-" * w for w, r in zip(widths, right, strict=True)]
    return "".join(f"| {' | '.join(line)} |\n" for line in (lines[0], ruler, *lines[1:]))


def _like_number(cell: str) -> bool:
    return not cell.strip("-") or cell.lstrip("-+<>").startswith(tuple("0123456789"))
