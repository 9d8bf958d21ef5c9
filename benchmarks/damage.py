"""What a hole of 4 kB costs: in every format that can be written, at 20 seeded places.

Writes a log with two or three gyros among other traffic, of more than forty chunks where the format
has chunks; puts a hole of zeros and one of random bytes at each place, one at a time; reads it; and
compares what is in the table with what the whole log holds. Prints one line per format; ends with
1 where

* less than 95 % of the samples outside the units that the hole touches are there, or one differs,
* a hole is not listed with its place, or the log is still called healthy,

except for holes that no reader could see: in a format without checksums, where neither a gyro's
record nor the framing has changed. Those are counted.

    python benchmarks/damage.py [--holes 20] [--only "MCAP zstd"] [--verbose]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from damaged_logs import FEWEST_CHUNKS, KINDS, Log, bits, gyros

from fdilog.analysis import analyse_recording
from fdilog.config import Config
from fdilog.errors import FdilogError
from fdilog.recording import Recording

HOLE_BYTES = 4096
SEED = 20240229
KEPT_GOAL = 0.95

# What is asked here is whether a log with a hole can be healthy; long windows and one detector
# answer that in a tenth of the time. Of holes that are told, which no verdict passes over, some
# are analysed; of those that are not, all.
ANALYSED_EVERY = 8
CONFIG = Config()
CONFIG = replace(
    CONFIG,
    detectors=replace(CONFIG.detectors, use=("difference",)),
    windows=replace(CONFIG.windows, lengths_s=(20.0, 60.0)),
)


@dataclass(frozen=True)
class Outcome:
    """What became of a log with one hole.

    Parameters
    ----------
    kept
        Share of the samples outside the touched units that are there, bit for bit.
    changed, false
        Samples that the whole log does not hold, outside the touched units and within them.
    """

    place: int
    filling: str
    kept: float
    changed: int
    false: int
    told: bool
    placed: bool
    verdict: str
    may_be_unseen: bool

    @property
    def passed(self) -> bool:
        """Whether everything holds that is promised of such a hole."""
        seen = (self.placed and self.verdict != "healthy") or self.may_be_unseen
        return self.kept >= KEPT_GOAL and self.changed == 0 and seen


def outcomes(log: Log, n_holes: int) -> list[Outcome]:
    """Put holes into a log, one at a time, and see; the file is as it was afterwards."""
    size = log.file.stat().st_size
    random = np.random.default_rng(SEED)
    places = np.sort(random.integers(0, size - HOLE_BYTES, n_holes)).tolist()
    found = []
    with log.file.open("r+b", buffering=0) as file:
        for place in places:
            for filling, hole in (
                ("zeros", bytes(HOLE_BYTES)),
                ("random", random.bytes(HOLE_BYTES)),
            ):
                file.seek(place)
                before = file.read(HOLE_BYTES)
                file.seek(place)
                file.write(hole)
                found.append(_outcome(log, place, hole, filling, len(found)))
                file.seek(place)
                file.write(before)
    return found


def _outcome(log: Log, place: int, hole: bytes, filling: str, number: int) -> Outcome:
    end = place + len(hole)
    touched = log.touched(place, end)
    unseen = log.unseen is not None and log.unseen(place, hole)
    try:
        recording = log.read()
    except FdilogError as error:
        print(f"  {log.name}: {error}")
        return Outcome(place, filling, 0.0, 0, 0, True, True, "unreadable", unseen)
    kept, expected, changed, false = 0, 0, 0, 0
    streams = gyros(recording)
    for name, samples in log.samples.items():
        outside = ~touched[samples.unit]
        expected += int(outside.sum())
        if name not in streams:
            continue
        got = bits(streams[name])
        index = np.searchsorted(samples.time_ns, streams[name].time_ns)
        index = np.minimum(index, len(samples.time_ns) - 1)
        known = samples.time_ns[index] == streams[name].time_ns
        same = known & (samples.values[index] == got).all(axis=1)
        kept += len(np.unique(index[same & outside[index]]))
        changed += int((known & ~same & outside[index]).sum())
        false += int((~same & ~(known & outside[index])).sum())
    low = min([place, *log.units[touched, 0].tolist()])
    losses = [problem for problem in recording.problems if not problem.note]
    placed = any(
        p.offset is not None and p.offset < end and p.offset + (p.bytes_lost or 0) >= low
        for p in losses
    )
    verdict = "not whole"
    if not losses or number % ANALYSED_EVERY == 0:
        verdict = _verdict(recording)
    return Outcome(
        place, filling, kept / expected, changed, false, bool(losses), placed, verdict, unseen
    )


def _verdict(recording: Recording) -> str:
    try:
        return analyse_recording(recording, CONFIG).verdict
    except FdilogError as error:
        return type(error).__name__


HEAD = (
    f"{'format':<18} {'MB':>5} {'chunks':>6} {'holes':>5} {'kept, least':>11} {'changed':>7}"
    f" {'false':>5} {'told':>4} {'placed':>6} {'unseen':>6} {'healthy':>7}"
)


def line(log: Log, found: list[Outcome]) -> str:
    """Sum up one format; verdicts and places are those of the holes that can be seen."""
    seen = [one for one in found if not one.may_be_unseen]
    return (
        f"{log.name:<18} {log.file.stat().st_size / 1e6:5.0f} {log.n_chunks or '-':>6}"
        f" {len(found):>5} {min(one.kept for one in found):>11.2%}"
        f" {sum(one.changed for one in found):>7} {sum(one.false for one in found):>5}"
        f" {sum(one.told for one in seen):>4} {sum(one.placed for one in seen):>6}"
        f" {len(found) - len(seen):>6} {sum(one.verdict == 'healthy' for one in seen):>7}"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--holes", type=int, default=20)
    parser.add_argument("--only", action="append", choices=KINDS, help="may be repeated")
    parser.add_argument("--verbose", action="store_true", help="every hole that fails")
    arguments = parser.parse_args()
    met = True
    print(HEAD)
    for name, make in KINDS.items():
        if arguments.only and name not in arguments.only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            log = make(name, Path(folder))
            whole = _verdict(log.read())
            found = outcomes(log, arguments.holes)
            print(line(log, found), flush=True)
        if whole != "healthy":
            print(f"  the whole log is {whole}, so its verdicts say nothing")
        bad = [one for one in found if not one.passed]
        met &= (
            not bad and whole == "healthy" and (not log.n_chunks or log.n_chunks >= FEWEST_CHUNKS)
        )
        for one in bad if arguments.verbose else ():
            print(f"  {one}")
        if arguments.verbose:
            print(f"  verdicts: {dict(Counter(one.verdict for one in found))}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
