"""Stretches of a file that could not be read, many of them summed up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

from fdilog.recording import Problem

# A log in which every other record is broken would otherwise list millions of places.
PLACES_LISTED = 100


@dataclass
class Losses:
    """Every stretch of bytes that is lost, in file order."""

    places: list[tuple[int, int, str]] = field(default_factory=list)
    more: tuple[int, int, int] = (0, 0, 0)

    def add(self, offset: int, end: int, what: str) -> None:
        """Note a loss from one byte up to another; after a hundred only their sum is kept."""
        if len(self.places) < PLACES_LISTED:
            self.places.append((offset, end - offset, what))
        else:
            first, count, total = self.more
            self.more = (first if count else offset, count + 1, total + end - offset)

    def problems(self) -> Iterator[Problem]:
        """Return the losses in the recording's words."""
        for offset, length, what in self.places:
            yield Problem(what=what, offset=offset, bytes_lost=length)
        first, count, total = self.more
        if count:
            yield Problem(what=f"{count} more places like these", offset=first, bytes_lost=total)
