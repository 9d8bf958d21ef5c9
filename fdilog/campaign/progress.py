"""How far an audit has come: a bar on a terminal, one line a log on a pipe; then what came out."""

from __future__ import annotations

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from fdilog.campaign.audit import Progress
from fdilog.campaign.summary import Campaign, Cell
from fdilog.escapes import visible

STYLE = {"failed": "red", "healthy": "green", "undecided": "yellow", "not analysed": "magenta"}
MOST_NAMED = 10
"""Vehicles, and channels of each, in the closing words; the rest are in the report."""


@contextmanager
def shown_progress(*, quiet: bool = False) -> Iterator[Progress | None]:
    """Give what fits standard error: a bar, lines, or nothing."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        bar = BarProgress()
        with bar.shown:
            yield bar
    else:
        yield LineProgress(sys.stderr)


class LineProgress:
    """One line for each log, in the order in which they are done."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def begin(self, logs: int, reused: int, where: str) -> None:
        """Start a batch."""
        self._logs, self._done, self._since = logs, 0, time.monotonic()
        told = f"{logs} log{'s' * (logs != 1)} to analyse, {reused} known from before"
        self._say(f"{told}; {where}" if logs else told)

    def done(self, path: str, state: str, words: str) -> None:
        """Print one log's line, with the rate so far and what remains."""
        self._done += 1
        rate = self._done / max(time.monotonic() - self._since, 1e-9)
        left_s = (self._logs - self._done) / rate
        count = f"[{self._done}/{self._logs}, {rate:.1f}/s, {left_s:.0f} s left]"
        self._say(visible(f"{count} {state}: {path}" + (f": {words}" if words else "")))

    def end(self) -> None:
        """End a batch."""

    def _say(self, text: str) -> None:
        print(text, file=self._stream, flush=True)


class BarProgress:
    """A bar with rate, remaining time and counts by verdict."""

    def __init__(self) -> None:
        from rich import progress
        from rich.console import Console

        self.shown = progress.Progress(
            progress.BarColumn(),
            progress.MofNCompleteColumn(),
            progress.TextColumn("{task.fields[rate]}"),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(),
            progress.TextColumn("{task.fields[counts]}"),
            console=Console(stderr=True),
        )
        self._task: Any = None

    def begin(self, logs: int, reused: int, where: str) -> None:
        """Start a batch."""
        if logs:
            self.shown.console.print(f"{logs} log{'s' * (logs != 1)} to analyse; {where}")
        self._counts: Counter[str] = Counter()
        if reused:
            self._counts["known from before"] = reused
        self._since, self._done = time.monotonic(), 0
        if self._task is not None:
            self.shown.remove_task(self._task)
        self._task = self.shown.add_task("", total=logs, rate="", counts=self._words())

    def done(self, path: str, state: str, words: str) -> None:  # noqa: ARG002
        """Move the bar."""
        self._done += 1
        self._counts[state] += 1
        rate = self._done / max(time.monotonic() - self._since, 1e-9)
        self.shown.update(self._task, advance=1, rate=f"{rate:.1f} logs/s", counts=self._words())

    def _words(self) -> str:
        return "  ".join(
            f"[{STYLE.get(state, 'default')}]{number} {state}[/]"
            for state, number in self._counts.items()
        )

    def end(self) -> None:
        """End a batch."""


def summary_lines(campaign: Campaign, output: Path) -> Iterator[str]:
    """Say what came out: counts, the vehicles that fail, the sensors that drift, where to look."""
    counts = campaign.counts
    told = ", ".join(f"{number} {state}" for state, number in counts.items() if number)
    number = len(campaign.logs)
    yield f"{number} log{'s' * (number != 1)}: {told}"
    failing: dict[str, list[Cell]] = defaultdict(list)
    for cell in sorted(campaign.cells, key=lambda cell: (-cell.failed, -cell.suspect)):
        if cell.failed or cell.suspect:
            failing[cell.vehicle].append(cell)
    ranked = sorted(failing.items(), key=lambda item: (*_worst(item[1]), item[0]))
    for vehicle, cells in ranked[:MOST_NAMED]:
        named = [_told(cell) for cell in cells[:MOST_NAMED]]
        if len(cells) > MOST_NAMED:
            named.append(f"{len(cells) - MOST_NAMED} more channels")
        yield "  failed: " + visible(f"{vehicle}: {', '.join(named)}")
    if len(ranked) > MOST_NAMED:
        yield f"  and {len(ranked) - MOST_NAMED} more vehicles"
    for series in campaign.drifting[:MOST_NAMED]:
        yield "  drifts: " + visible(f"{series.vehicle}: {series.channel}, {series.quantity}")
    yield f"report: {output / 'index.html'}; results: {output / 'audit.sqlite'}"


def _worst(cells: Sequence[Cell]) -> tuple[int, int]:
    return -max(cell.failed for cell in cells), -max(cell.suspect for cell in cells)


def _told(cell: Cell) -> str:
    number = cell.failed or cell.suspect
    flights = f"{number} flight{'s' * (number > 1)}"
    if not cell.failed:
        return f"{cell.channel} suspect in {flights}"
    more = f" (suspect in {cell.suspect} more)" if cell.suspect else ""
    return f"{cell.channel} in {flights}{more}"
