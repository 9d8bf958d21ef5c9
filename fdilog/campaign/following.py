"""Watch folders into which logs are copied, and do each log once it has stopped growing."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from fdilog.campaign.discovery import Candidate, discover
from fdilog.campaign.store import Store
from fdilog.errors import FdilogError

POLL_S = 1.0
SETTLED_S = 2.0
"""A log that has not changed for so long is taken to be complete."""


def follow_logs(
    targets: Sequence[str],
    store: Store,
    do: Callable[[Sequence[Candidate]], None],
    report: Callable[[], object],
    go_on: Callable[[], bool],
) -> None:
    """Do every log once it has stopped growing, again if it changes, for as long as is asked.

    A log that was done and is gone stays in the campaign: its answer was true of the flight.

    Parameters
    ----------
    do
        Gives logs that are listed in the store their results.
    report
        Writes the campaign's reports anew.
    go_on
        Asked again and again.
    """
    seen: dict[str, tuple[int, str, float]] = {}
    done: dict[str, tuple[int, str]] = {}
    store.list_only([])
    first = True
    while go_on():
        now = time.monotonic()
        ready = []
        for candidate in _found_now(targets, store.folder):
            state = (candidate.size, candidate.stamp)
            if done.get(candidate.path) == state:
                continue
            if seen.get(candidate.path, ())[:2] != state:
                seen[candidate.path] = (*state, now)
            if candidate.error or _settled(candidate, now - seen[candidate.path][2]):
                ready.append(candidate)
                done[candidate.path] = state
        if ready or first:
            store.list_more(ready)
            do(ready)
            report()
            first = False
        time.sleep(POLL_S)


def _found_now(targets: Sequence[str], output: Path) -> list[Candidate]:
    """Find what there is at this moment; nothing while a disk or a network is away."""
    try:
        return discover(targets, output)
    except FdilogError:
        return []


def _settled(candidate: Candidate, unchanged_s: float) -> bool:
    """Tell a log that is complete from one that is still being copied."""
    if unchanged_s >= SETTLED_S:
        return True
    if candidate.remote:
        # A store that tells a tag or a time shows what is complete, and nothing else.
        return bool(candidate.stamp)
    return time.time() - int(candidate.stamp) / 1e9 >= SETTLED_S + POLL_S
