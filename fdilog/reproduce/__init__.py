"""The papers' own tables, computed again: what is printed, what we get, and whether they agree.

Nothing is stored here but the printed values. Only the command line imports this package.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from fdilog.reproduce.row import Row

__all__ = ["SEED", "TABLES", "Row", "reproduce"]

SEED = 20240817
"""Seed of every random draw, so that a table comes out the same each time."""

TABLES: tuple[str, ...] = ("larin", "triads", "matasov", "observer")
"""Papers whose tables can be computed again."""


def reproduce(name: str, seed: int = SEED) -> list[Row]:
    """Compute the tables of one paper again.

    Parameters
    ----------
    name
        One of `TABLES`.
    seed
        Seed of the random draws, where the paper has any.

    Returns
    -------
    rows
        One for each printed value, and for what the paper does not say but should have.

    Raises
    ------
    ValueError
        For a name that is none of `TABLES`.
    """
    if name not in TABLES:
        raise ValueError(f"unknown table {name!r}; known: {', '.join(TABLES)}")
    rows: Callable[[int], list[Row]] = import_module(f"fdilog.reproduce.{name}").rows
    return rows(seed)
