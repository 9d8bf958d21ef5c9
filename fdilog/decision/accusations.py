"""Who is accused by what: windows in a row, and those that speak of one fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Evidence, Kind
from fdilog.table import ChannelTable


@dataclass(frozen=True, kw_only=True)
class Accusation:
    """Windows in a row, of one length, in which a detector names the same suspects."""

    kind: Kind
    detector: str
    suspects: frozenset[int]
    start: int
    stop: int
    length_s: float


def accusations(evidence: Evidence) -> Iterator[Accusation]:
    """List what one piece of evidence says, windows in a row taken together."""
    rows = np.flatnonzero(evidence.accused.any(axis=1))
    patterns, which = np.unique(evidence.accused[rows], axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        here = rows[which == number]
        start, stop = evidence.windows.start[here], evidence.windows.stop[here]
        for first, last in _merged(start, stop):
            for group in np.unique(pattern[pattern > 0]):
                yield Accusation(
                    kind=evidence.kind,
                    detector=evidence.detector,
                    suspects=frozenset(np.flatnonzero(pattern == group).tolist()),
                    start=first,
                    stop=last,
                    length_s=evidence.windows.length_s,
                )


def _merged(start: NDArray[np.int64], stop: NDArray[np.int64]) -> list[tuple[int, int]]:
    """Join ranges that touch or overlap."""
    order = np.argsort(start, kind="stable")
    start, stop = start[order], stop[order]
    reach = np.maximum.accumulate(stop)
    fresh = np.concatenate([[True], start[1:] > reach[:-1]]) if len(start) else np.zeros(0, bool)
    first = np.flatnonzero(fresh)
    last = np.append(first[1:], len(start)) - 1
    return [(int(start[a]), int(reach[b])) for a, b in zip(first, last, strict=True)]


@dataclass(frozen=True, kw_only=True)
class Cluster:
    """Accusations of one detector that overlap in time and share a suspect.

    The suspects are those that every accusation names; accusations that have none in common are
    never joined.
    """

    suspects: frozenset[int]
    start: int
    stop: int
    longest_s: float
    members: tuple[Accusation, ...]

    @classmethod
    def of(cls, member: Accusation) -> Cluster:
        """Start a cluster from one accusation."""
        return cls(
            suspects=member.suspects,
            start=member.start,
            stop=member.stop,
            longest_s=member.length_s,
            members=(member,),
        )

    def joined(self, other: Cluster) -> Cluster:
        """Return both as one."""
        return Cluster(
            suspects=self.suspects & other.suspects,
            start=min(self.start, other.start),
            stop=max(self.stop, other.stop),
            longest_s=max(self.longest_s, other.longest_s),
            members=(*other.members, *self.members),
        )


def clusters(
    time_s: NDArray[np.float64], accused: Sequence[Accusation], reach_s: float = 0.0
) -> list[Cluster]:
    """Join accusations that share a suspect and are no further apart than their windows reach."""
    furthest_s = max([reach_s, *(item.length_s / 2 for item in accused)])
    # With the number of what was joined last; those that nothing later can reach are done.
    done: list[tuple[int, Cluster]] = []
    found: list[tuple[int, Cluster]] = []
    in_order = sorted(accused, key=lambda a: (a.start, a.stop, -a.length_s, sorted(a.suspects)))
    for number, item in enumerate(in_order):
        merged = Cluster.of(item)
        apart: list[tuple[int, Cluster]] = []
        for last, other in found:
            gap_s = time_s[merged.start] - time_s[other.stop - 1]
            near = gap_s <= max(merged.longest_s / 2, other.longest_s / 2, reach_s)
            if near and other.suspects & merged.suspects:
                merged = merged.joined(other)
            else:
                reached = time_s[item.start] - time_s[other.stop - 1] <= furthest_s
                (apart if reached else done).append((last, other))
        found = [*apart, (number, merged)]
    return [cluster for _, cluster in sorted([*done, *found], key=lambda one: one[0])]


class Span(Protocol):
    """From one sample to one past the last."""

    @property
    def start(self) -> int:
        """First sample."""
        ...

    @property
    def stop(self) -> int:
        """One past the last sample."""
        ...


Spanned = TypeVar("Spanned", bound=Span)


def spanned(
    time_s: NDArray[np.float64],
    accused: Sequence[Accusation],
    span_of: Callable[[Cluster], Spanned | None],
) -> Iterator[Spanned]:
    """Find the span of every cluster; what lies apart from it is a cluster of its own.

    Parameters
    ----------
    span_of
        Finds the span that a cluster speaks of, or nothing, which ends the matter.
    """
    while accused:
        left: list[Accusation] = []
        for cluster in clusters(time_s, accused):
            if (span := span_of(cluster)) is None:
                continue
            yield span
            left.extend(
                member
                for member in cluster.members
                if member.stop <= span.start or member.start >= span.stop
            )
        accused = left if len(left) < len(accused) else []


def region(table: ChannelTable, start: int, stop: int, reach_s: float) -> tuple[int, int]:
    """Widen a range of samples by some time on both sides."""
    time_s = table.time_s
    first = int(np.searchsorted(time_s, time_s[start] - reach_s))
    return first, int(np.searchsorted(time_s, time_s[stop - 1] + reach_s, side="right"))
