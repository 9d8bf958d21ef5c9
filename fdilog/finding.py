"""What detectors answer (Evidence) and what is concluded from it (Finding)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal[
    "bias", "drift", "scale", "noise", "stuck", "dead", "saturated", "impulse", "dropout",
    "mounting", "disagreement",
]  # fmt: skip
Status = Literal["failed", "suspect", "healthy", "undecided", "insufficient"]
Verdict = Literal["failed", "healthy", "undecided", "insufficient"]

SIZE_UNIT: dict[str, str] = {
    "bias": "rad/s", "impulse": "rad/s", "drift": "rad/s^2",
    "scale": "1", "noise": "1", "dropout": "s",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Windows:
    """Stretches of the table's samples, all of one nominal length or each of its own.

    Parameters
    ----------
    length_s
        Nominal length, or 0 where every window has its own. [s]
    start, stop : (n_windows,) int64
        First sample, and one past the last.
    start_s, end_s : (n_windows,)
        Flight time of the first and the last sample. [s]
    """

    length_s: float
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    start_s: NDArray[np.float64]
    end_s: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.start)


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """One detector's answer over some windows.

    Parameters
    ----------
    kind
        What it accuses a channel of.
    tested : (n_windows, n_channels) bool
        Whether the channel was compared with anything at all in that window.
    low, high : (n_windows, n_channels)
        Interval for the channel's size of that kind (for a bias: its error, reading minus true
        rate); infinite where the data do not bound it, NaN where the detector only votes. [SI]
    tolerance : (n_windows, n_channels)
        What the interval is held against. [SI]
    accused : (n_windows, n_channels) int8
        0 where the detector accuses nobody. Channels that carry the same number in one window are
        suspects of one and the same fault, which it cannot tell apart; a number that only one
        channel carries isolates it.
    confidence
        Of the interval; 1 for a guaranteed one.
    beside
        For each window, suspects that are no channels of the table: a speed, say, that a model
        predicts as well. Empty if there are none in any.
    details
        For each window, what a finding of it should say. Empty if there is nothing to say.
    note
        What a reader should know of the answer as a whole: a condition that was not met.
    least : (n_windows, n_channels) or None
        Smallest error that healthy channels surely never have in any window of a flight, where that
        is a condition beside the interval; infinite where nothing is known. [rad/s]
    """

    detector: str
    kind: Kind
    windows: Windows
    tested: NDArray[np.bool_]
    low: NDArray[np.float64]
    high: NDArray[np.float64]
    tolerance: NDArray[np.float64]
    accused: NDArray[np.int8]
    confidence: float
    beside: tuple[tuple[str, ...], ...] = ()
    details: tuple[str, ...] = ()
    note: str = ""
    least: NDArray[np.float64] | None = None


@dataclass(frozen=True, kw_only=True)
class Size:
    """How large a fault is: estimate and interval, in the kind's unit."""

    estimate: float
    low: float
    high: float
    confidence: float
    unit: str


@dataclass(frozen=True, kw_only=True)
class Interval:
    """A closed interval; an infinite end is unbounded."""

    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One fault: what, who, from when to when, how large, and who says so.

    ``suspects`` holds one channel if the fault is isolated, several if the redundancy of the log
    cannot tell them apart; it is never a guess. A device that is mounted wrongly is one fault of
    all its channels: then ``one_source`` says that it is this device. Times are seconds of flight
    time.
    """

    kind: Kind
    suspects: tuple[str, ...]
    start_s: float
    end_s: float
    size: Size | None = None
    guaranteed: Interval | None = None
    detectors: tuple[str, ...] = ()
    dissent: tuple[str, ...] = ()
    witness: str | None = None
    detail: str = ""
    one_source: bool = False

    @property
    def isolated(self) -> bool:
        """Whether a single channel is accused, or a single device as a whole."""
        return len(self.suspects) == 1 or self.one_source
