"""How large a fault a flight would have shown: known faults are put into it and looked for.

Every fault is put into the recording in memory and the whole analysis is made again; the log itself
is read once. The smallest fault that is found is sought by bisection, which takes it that what is
found at one size is found at any larger one.
"""

from __future__ import annotations

import math
import os
import signal
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from types import MappingProxyType
from typing import get_args

import numpy as np

from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.errors import FdilogError, UsageError, nearest
from fdilog.experiments.faults import Fault, FaultKind
from fdilog.experiments.injection import inject
from fdilog.finding import Finding
from fdilog.recording import Recording
from fdilog.registry import plugins
from fdilog.table import ChannelTable

DURATION_S = 20.0
TRIALS = 2
SEED = 0

RESOLUTION = 1.25
"""A size is known when one this many times smaller was not found."""
MARGIN_S = 2.0
"""Faults keep this far from the ends of the log, where there is nothing to see their edges by."""
LONGEST_PART = 0.5
"""Of the log: a fault that lasts longer has no usual level beside it."""
FEWEST_READINGS = 4
ATTEMPTS = 200


@dataclass(frozen=True, kw_only=True)
class Scale:
    """Sizes at which a kind of fault is tried, in SI units.

    Parameters
    ----------
    least, first, most
        The smallest, the one tried first, and the largest.
    above
        What a size of zero means: 1 for a factor.
    """

    least: float
    first: float
    most: float
    above: float = 0.0


_DEG = math.radians(1.0)

SCALES: Mapping[str, Scale] = MappingProxyType(
    {
        "bias": Scale(least=0.05 * _DEG, first=1.5 * _DEG, most=500.0 * _DEG),
        "drift": Scale(least=0.002 * _DEG, first=0.15 * _DEG, most=50.0 * _DEG),
        "scale": Scale(least=0.01, first=0.2, most=9.0, above=1.0),
        "noise": Scale(least=0.2, first=3.0, most=99.0, above=1.0),
        "impulse": Scale(least=1.0 * _DEG, first=40.0 * _DEG, most=2000.0 * _DEG),
        "stuck": Scale(least=0.05, first=1.0, most=math.inf),
        "dead": Scale(least=0.05, first=1.0, most=math.inf),
        "dropout": Scale(least=0.05, first=0.7, most=math.inf),
    }
)
"""For kinds without a size it is the length that is sought, up to the whole span. [s]"""

BY_LENGTH = frozenset({"stuck", "dead", "dropout"})

VOTERS = frozenset(
    {
        "condition", "determinants", "difference", "joint", "kalman", "least-absolute",
        "least-squares", "mean-modulus", "mean-square", "one-norm", "rate-deviation",
    }
)  # fmt: skip
"""Detectors that agree with findings or dissent, and make none: leaving them out changes no answer
here, and makes it come three times as fast."""


@dataclass(frozen=True, kw_only=True)
class Trial:
    """The smallest fault that one start of one channel shows.

    Parameters
    ----------
    found, isolated
        Smallest size [SI, or s for kinds without one] at which a finding names the channel, and at
        which findings name no other with it; None if even the largest one tried does not.
    runs
        How many analyses that took.
    guess
        Where the next search had better begin.
    """

    start_s: float
    found: float | None
    isolated: float | None
    runs: int
    guess: float


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What was found out about one kind of fault of one channel.

    Parameters
    ----------
    trials
        One for each start; empty if nothing was tried, and ``note`` says why.
    most
        The largest size tried. [SI, or s]
    """

    kind: str
    channel: str
    trials: tuple[Trial, ...]
    most: float
    note: str = ""

    @property
    def found(self) -> float | None:
        """Smallest size that is found at every start, None if some start shows none."""
        return _worst([trial.found for trial in self.trials])

    @property
    def isolated(self) -> float | None:
        """Smallest size that is isolated at every start."""
        return _worst([trial.isolated for trial in self.trials])


def _worst(sizes: Sequence[float | None]) -> float | None:
    known = [size for size in sizes if size is not None]
    return max(known) if known and len(known) == len(sizes) else None


@dataclass(frozen=True, kw_only=True)
class Sensitivity:
    """The answers for one flight, and what they rest on."""

    path: str
    duration_s: float
    span_s: float
    starts_s: tuple[float, ...]
    kinds: tuple[str, ...]
    channels: tuple[str, ...]
    answers: tuple[Answer, ...]
    seed: int

    @property
    def runs(self) -> int:
        """How many analyses were made."""
        return sum(trial.runs for answer in self.answers for trial in answer.trials)


@dataclass(frozen=True, kw_only=True, eq=False)
class Flight:
    """What every search needs."""

    recording: Recording
    config: Config
    untouched: Analysis
    span_s: float
    starts_s: tuple[float, ...]
    seed: int


def sensitivity(
    recording: Recording,
    config: Config | None = None,
    *,
    kinds: Collection[str] = (),
    channels: Collection[str] = (),
    duration_s: float = DURATION_S,
    trials: int = TRIALS,
    seed: int = SEED,
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Sensitivity:
    """Find how large a fault of each kind would have been found and isolated, per channel.

    Parameters
    ----------
    kinds, channels
        Which to try; all by default.
    duration_s
        How long a fault lasts; at most half of the flight. [s]
    trials
        At how many starts, one drawn from each of so many equal parts of the flight.
    jobs
        Number of processes.
    progress
        Called with the number of searches that are done and that there are.

    Raises
    ------
    NoGyroError
        If the recording holds no gyro.
    UsageError
        If a name is unknown, a number makes no sense, or the flight is too short.
    """
    config = _deciding(config or Config())
    if trials < 1 or not 0.0 < duration_s < math.inf or jobs < 1:
        raise UsageError("sensitivity needs at least one trial, one process and some duration")
    kinds = tuple(_known("kind", kinds, list(SCALES)))
    untouched = analyse_recording(recording, config)
    table = untouched.table
    own = [channel.name for channel in table.channels if not channel.derived]
    channels = tuple(_known("channel", channels, own))
    span_s = min(duration_s, LONGEST_PART * table.duration_s)
    flight = Flight(
        recording=recording,
        config=config,
        untouched=untouched,
        span_s=span_s,
        starts_s=_starts(table, span_s, trials, seed),
        seed=seed,
    )
    answers: list[Answer] = []
    for found in _answers(flight, list(_tasks(table, kinds, channels)), jobs):
        answers += found
        progress(len(answers), len(kinds) * len(channels))
    return Sensitivity(
        path=recording.path,
        duration_s=table.duration_s,
        span_s=span_s,
        starts_s=flight.starts_s,
        kinds=kinds,
        channels=channels,
        answers=tuple(answers),
        seed=seed,
    )


def _deciding(config: Config) -> Config:
    if config.detectors.use:
        return config
    names = set(plugins("detectors")) - VOTERS
    if config.noise.bound_deg_s <= 0.0:
        names -= {"guaranteed"}  # without a stated bound it gives intervals, but no finding
    deciding = sorted(names, key=lambda name: (name != "parity", name))
    return config.replace("detectors", use=tuple(deciding))


def _known(what: str, names: Collection[str], known: list[str]) -> list[str]:
    for name in names:
        if name not in known:
            raise UsageError(f"no {what} '{name}'{nearest(name, known)}")
    return [name for name in known if name in names] or known


def _starts(table: ChannelTable, span_s: float, trials: int, seed: int) -> tuple[float, ...]:
    """Draw one start from each of some equal parts of the flight; no span holds a gap."""
    first = float(table.time_s[0]) + MARGIN_S
    last = float(table.time_s[-1]) - MARGIN_S - span_s
    if not last > first or span_s < FEWEST_READINGS * table.period_s:
        raise UsageError(f"a flight of {table.duration_s:.1f} s is too short for a fault in it")
    rng = np.random.default_rng((seed, 0))
    starts = []
    for low, high in pairwise(np.linspace(first, last, trials + 1).tolist()):
        draws = rng.uniform(low, high, ATTEMPTS)
        whole = (start for start in draws if _recorded(table, start, start + span_s))
        starts.append(float(next(whole, draws[0])))
    return tuple(starts)


def _recorded(table: ChannelTable, start_s: float, end_s: float) -> bool:
    inside = np.flatnonzero((table.time_s >= start_s) & (table.time_s <= end_s))
    if len(inside) < FEWEST_READINGS:
        return False
    steps = np.diff(table.time_s[inside])
    return bool(steps.max() < FEWEST_READINGS * float(np.median(steps)))


def _tasks(
    table: ChannelTable, kinds: Sequence[str], channels: Sequence[str]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """List what one process does at a stretch: one kind, all channels of one source."""
    for source in dict.fromkeys(channel.source for channel in table.channels):
        members = [c.name for c in table.channels if c.source == source and c.name in channels]
        if members:
            yield from ((kind, tuple(members)) for kind in kinds)


def _answers(
    flight: Flight, tasks: list[tuple[str, tuple[str, ...]]], jobs: int
) -> Iterator[list[Answer]]:
    """Give the answers in the order of the tasks, whoever makes them."""
    if jobs == 1 or len(tasks) == 1:
        yield from (search(flight, task) for task in tasks)
        return
    pool = ProcessPoolExecutor(min(jobs, len(tasks)), initializer=_begin, initargs=(flight,))
    try:
        yield from pool.map(_search_here, tasks)
    except BrokenProcessPool:
        raise FdilogError(
            f"{flight.recording.path}: a worker process was ended from outside, perhaps for"
            " want of memory; try -j 1"
        ) from None
    finally:
        # Not waited for, its thread can meet the end of the interpreter with a closed pipe.
        pool.shutdown(wait=True, cancel_futures=True)


_here: list[Flight] = []
"""The flight of a worker process, which is sent to it once."""


def _begin(flight: Flight) -> None:
    # Ctrl-C reaches every process; the parent has the one line to say about it.
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    _here[:] = [flight]


def _search_here(task: tuple[str, tuple[str, ...]]) -> list[Answer]:
    return search(_here[0], task)


def search(flight: Flight, task: tuple[str, tuple[str, ...]]) -> list[Answer]:
    """Find the smallest fault of one kind at every start, for channels of one source."""
    kind, channels = task
    answers: list[Answer] = []
    guess = SCALES[kind].first
    for channel in channels:
        if kind == "dropout" and answers:
            # The whole source falls silent: the answer is the same for all of its channels.
            silent = [replace(trial, runs=0) for trial in answers[0].trials]
            answers.append(replace(answers[0], channel=channel, trials=tuple(silent)))
        else:
            answers.append(_search_channel(flight, kind, channel, guess))
        guess = answers[-1].trials[-1].guess if answers[-1].trials else guess
    return answers


def _search_channel(flight: Flight, kind: str, channel: str, guess: float) -> Answer:
    scale = SCALES[kind]
    most = min(scale.most, flight.span_s) if kind in BY_LENGTH else scale.most
    trials = []
    for start_s in flight.starts_s:
        if _accused_already(flight, channel, start_s):
            continue
        runs = _Runs(flight, kind, channel, start_s)
        found = smallest(runs.found, scale.least, most, guess)
        isolated = None
        if found is not None:
            # What is isolated is found, so no smaller one can be.
            isolated = smallest(runs.isolated, found, most, found)
            guess = found
        trials.append(
            Trial(
                start_s=start_s,
                found=None if found is None else scale.above + found,
                isolated=None if isolated is None else scale.above + isolated,
                runs=len(runs.seen),
                guess=guess,
            )
        )
    note = "" if trials else "accused in the log as it is, at every start"
    return Answer(
        kind=kind, channel=channel, trials=tuple(trials), most=scale.above + most, note=note
    )


def _accused_already(flight: Flight, channel: str, start_s: float) -> bool:
    return any(
        channel in finding.suspects
        and finding.start_s <= start_s + flight.span_s
        and finding.end_s >= start_s
        for finding in flight.untouched.findings
    )


def smallest(
    passes: Callable[[float], bool], least: float, most: float, guess: float
) -> float | None:
    """Find the smallest number that passes, to within `RESOLUTION`, if larger ones pass as well.

    Steps away from the guess grow until one passes and one does not, then the ratio between the
    two is halved until it is small enough.
    """
    size = min(max(guess, least), most)
    passing, failing = (size, None) if passes(size) else (None, size)
    # From a good guess, one step beyond the answer and one back to the middle are enough.
    step = RESOLUTION**2
    while passing is None or failing is None:
        if passing is None:
            if size >= most:
                return None
            size = min(size * step, most)
        else:
            if size <= least:
                return least
            size = max(size / step, least)
        if passes(size):
            passing = size
        else:
            failing = size
        step *= step
    while passing / failing > RESOLUTION:
        size = math.sqrt(passing * failing)
        if passes(size):
            passing = size
        else:
            failing = size
    return passing


class _Runs:
    """Analyses of one fault at many sizes, each made once."""

    def __init__(self, flight: Flight, kind: str, channel: str, start_s: float) -> None:
        self.seen: dict[float, list[Finding]] = {}
        self._flight = flight
        self._channel = channel
        self._fault = partial(self._of_size, kind, start_s)

    def found(self, size: float) -> bool:
        """Whether any new finding names the channel."""
        return bool(self._naming(size))

    def isolated(self, size: float) -> bool:
        """Whether new findings name the channel and none names others with it."""
        naming = self._naming(size)
        return bool(naming) and all(finding.isolated for finding in naming)

    def _naming(self, size: float) -> list[Finding]:
        if size not in self.seen:
            fault = self._fault(size)
            self.seen[size] = [
                finding
                for finding in self._findings(fault)
                if self._channel in finding.suspects
                and finding.start_s <= fault.end_s
                and finding.end_s >= fault.start_s
                and not any(_alike(finding, old) for old in self._flight.untouched.findings)
            ]
        return self.seen[size]

    def _findings(self, fault: Fault) -> tuple[Finding, ...]:
        flight = self._flight
        try:
            changed = inject(flight.recording, [fault], seed=flight.seed, config=flight.config)
        except UsageError:
            return ()  # shorter than the time between two readings: nothing is changed
        return analyse_recording(changed.recording, flight.config).findings

    def _of_size(self, kind: str, start_s: float, size: float) -> Fault:
        known: FaultKind = next(one for one in get_args(FaultKind) if one == kind)
        by_length = kind in BY_LENGTH
        return Fault(
            kind=known,
            channel=self._channel,
            start_s=start_s,
            end_s=start_s + (size if by_length else self._flight.span_s),
            size=None if by_length else SCALES[kind].above + size,
        )


def _alike(one: Finding, other: Finding) -> bool:
    together = one.start_s <= other.end_s and other.start_s <= one.end_s
    return together and one.kind == other.kind and bool(set(one.suspects) & set(other.suspects))
