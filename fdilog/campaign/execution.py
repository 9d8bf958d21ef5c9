"""Drive tasks through lanes: few in flight, deaths and hangs cost the log that caused them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from fdilog.campaign.lanes import Burial, Lane, met_death

T = TypeVar("T")

LOOK_S = 0.25
"""How often hangs are looked for; a time limit is exact to about this."""


@dataclass(frozen=True, kw_only=True)
class Lost:
    """A task without an outcome: its worker died, or it ran out of time."""

    timeout: bool
    reason: str


@dataclass(frozen=True, eq=False)
class _Flight(Generic[T]):
    task: T
    lane: Lane
    alone: bool


def run(
    function: Callable[[T], Any],
    tasks: Iterable[T],
    lanes: Sequence[Lane],
    timeout_s: float = 0.0,
) -> Iterator[tuple[T, Any]]:
    """Do every task, begun in the order given, and give each with its outcome as it comes.

    Parameters
    ----------
    timeout_s
        What one task may take; 0 for no limit. [s]

    Yields
    ------
    task, outcome
        What ``function`` returned, or `Lost`.

    Raises
    ------
    WorkersError
        If there are no workers left to be had.
    """
    return _Run(function, deque(tasks), lanes, timeout_s).outcomes()


class _Run(Generic[T]):
    """Tasks that wait, tasks that are to be tried alone, and tasks that are with a worker."""

    def __init__(
        self,
        function: Callable[[T], Any],
        waiting: deque[T],
        lanes: Sequence[Lane],
        timeout_s: float,
    ) -> None:
        self.function = function
        self.waiting = waiting
        self.suspects: deque[T] = deque()
        self.flying: dict[Future[Any], _Flight[T]] = {}
        self.lanes = lanes
        self.timeout_s = timeout_s

    def outcomes(self) -> Iterator[tuple[T, Any]]:
        """Yield outcomes until no task is left."""
        while self.waiting or self.suspects or self.flying:
            self._fill()
            done, _ = wait(self.flying, timeout=LOOK_S, return_when=FIRST_COMPLETED)
            for future in sorted(done, key=met_death):  # outcomes first: they clear of suspicion
                if future not in self.flying:
                    continue
                lane = self.flying[future].lane
                if met_death(future):
                    burial = lane.bury(future)
                    yield from self._lost(burial, burial.reason, timeout=False)
                else:
                    lane.settle(future)
                    yield self.flying.pop(future).task, future.result()
            for future in self._overdue():
                if future in self.flying:
                    burial = self.flying[future].lane.end(future)
                    reason = f"took longer than {self.timeout_s:g} s and was ended"
                    yield from self._lost(burial, reason, timeout=True)

    def _fill(self) -> None:
        """Give every lane what it has room for, the emptiest first; a suspect flies alone."""
        while self.waiting or self.suspects:
            load = dict.fromkeys(map(id, self.lanes), 0)
            for flight in self.flying.values():
                load[id(flight.lane)] += flight.lane.room if flight.alone else 1
            lane = min(self.lanes, key=lambda each: load[id(each)] / each.room)
            if load[id(lane)] >= lane.room or (self.suspects and load[id(lane)]):
                return
            alone = bool(self.suspects)
            task = self.suspects.popleft() if alone else self.waiting.popleft()
            self.flying[lane.submit(self.function, task)] = _Flight(task, lane, alone)

    def _lost(self, burial: Burial, reason: str, *, timeout: bool) -> Iterator[tuple[T, Lost]]:
        """Give up the guilty; what only died with it is done again."""
        for future in burial.innocent:
            self.waiting.appendleft(self.flying.pop(future).task)
        for future in burial.unclear:
            flight = self.flying.pop(future)
            if flight.alone:
                yield flight.task, Lost(timeout=False, reason=reason)
            else:
                self.suspects.append(flight.task)
        if burial.guilty is not None:
            yield self.flying.pop(burial.guilty).task, Lost(timeout=timeout, reason=reason)

    def _overdue(self) -> list[Future[Any]]:
        now = time.monotonic()
        begun = {each: flight.lane.running_since(each) for each, flight in self.flying.items()}
        return [
            future
            for future, since in begun.items()
            if self.timeout_s
            and since is not None
            and now - since > self.timeout_s
            and not future.done()
        ]
