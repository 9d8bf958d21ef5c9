"""What holds of a reader and a log that is cut, holed, or otherwise damaged."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fdilog.conformance.claims import attempt, count, new_problems, require, samples
from fdilog.conformance.examples import Example
from fdilog.conformance.of_whole_logs import whole_log
from fdilog.recording import Recording
from fdilog.registry import Reader

EVEN_CUTS = 30
HEAD_CUTS = 24
RECORDS_TRIED = 10
OFFICIAL_CUTS = 6
FLIPS = 60
HOLES = 16
HOLE_BYTES = 4096
GARBAGE_BYTES = 100


def records(example: Example, whole: Recording) -> Sequence[int]:
    """Where records are known to begin. [byte]"""
    if example.records is not None:
        return example.records(example.content)
    offsets = [s.offsets for s in whole.streams if s.gyro and s.offsets is not None]
    return sorted(np.concatenate(offsets).tolist()) if offsets else []


def cuts(example: Example, whole: Recording) -> list[int]:
    """Choose where to cut, one place or more of every kind.

    Within the first bytes, evenly over the file, at, one and two bytes after and one byte before
    records, and within the last bytes.
    """
    size = len(example.content)
    places = {*range(1, HEAD_CUTS), *(size * k // EVEN_CUTS for k in range(1, EVEN_CUTS))}
    places |= {size - back for back in (1, 2, 4, 8, 9, 16, 37)}
    for start in _spread(records(example, whole), RECORDS_TRIED):
        places |= {start - 1, start, start + 1, start + 2}
    return sorted(place for place in places if 0 < place < size)


def _spread(values: Sequence[int], most: int) -> list[int]:
    """So many values, the first and the last among them."""
    picked = np.linspace(0, len(values) - 1, min(most, len(values)))
    return [values[int(k)] for k in np.unique(picked.astype(int))]


def a_cut_log_gives_what_stands_before_the_cut(
    reader: Reader, example: Example, folder: Path
) -> None:
    """Require that none is made up or lost, and that more of a log is never less."""
    whole = whole_log(reader, example, folder)
    all_samples, starts = samples(whole), records(example, whole)
    before: dict[str, list[bytes]] = {}
    for place in cuts(example, whole):
        recording = attempt(reader, example.put(folder, example.content[:place]))
        got = samples(recording)
        _require_part(got, all_samples, f"cut at byte {place}")
        for name, rows in before.items():
            require(
                len(rows) <= len(got.get(name, ())),
                f"cut at byte {place}: {name} has fewer samples than if it is cut before",
            )
        before = got
        _require_all_before(got, whole, starts, place)


def _require_all_before(
    got: dict[str, list[bytes]], whole: Recording, starts: Sequence[int], place: int
) -> None:
    """Where offsets tell which records end before a cut, all of those must be there."""
    if not got:
        return  # without its definitions nothing can be read
    for stream in whole.streams:
        if stream.gyro and stream.offsets is not None:
            following = [bisect_right(starts, offset) for offset in stream.offsets.tolist()]
            ends = [starts[k] if k < len(starts) else place + 1 for k in following]
            least = sum(end <= place for end in ends)
            n = len(got.get(stream.name, ()))
            require(n >= least, f"cut at byte {place}: {n} samples of {stream.name}, not {least}")


def what_a_cut_costs_is_told(reader: Reader, example: Example, folder: Path) -> None:
    """Require a loss where logs are closed, and at least a note of a record that is cut."""
    whole = whole_log(reader, example, folder)
    inside = {place + k for place in records(example, whole) for k in (1, 2)}
    for place in cuts(example, whole):
        recording = attempt(reader, example.put(folder, example.content[:place]))
        if recording is not None and (example.closed or place in inside):
            told = new_problems(recording, whole, notes=not example.closed)
            require(told, f"cut at byte {place}: nothing is told of it")


def a_cut_log_gives_no_less_than_the_official_library(
    reader: Reader, example: Example, folder: Path
) -> None:
    """Require every true sample that it gives, wherever the log is cut.

    What it makes of bytes that are not there is no sample of the whole log, and need not be given.
    """
    whole = whole_log(reader, example, folder)
    if example.official is None:
        return
    true = samples(whole)
    for place in _spread(cuts(example, whole)[HEAD_CUTS:], OFFICIAL_CUTS):
        path = example.put(folder, example.content[:place])
        try:
            theirs = example.official(path)
        except Exception:  # noqa: BLE001  whatever stops the other library does not stop this check
            theirs = {}
        ours = samples(attempt(reader, path))
        for stream in whole.streams:
            if stream.gyro and stream.name in theirs:
                official = replace(
                    stream,
                    time_ns=np.asarray(theirs[stream.name]["time_ns"], np.int64),
                    columns={f: np.asarray(theirs[stream.name][f]) for f in stream.gyro},
                    offsets=None,
                    count=-1,
                )
                given = set(samples(replace(whole, streams=(official,))).get(stream.name, ()))
                less = (given & set(true[stream.name])) - set(ours.get(stream.name, ()))
                require(
                    not less,
                    f"cut at byte {place}: the official library has {len(less)} samples of"
                    f" {stream.name} that it does not",
                )


def a_flipped_bit_is_no_disaster(reader: Reader, example: Example, folder: Path) -> None:
    """Require that missing records are told, and, of checksums, that none is changed."""
    _check_damage(reader, example, folder, _flipped(example), notes=True)


def a_hole_is_told(reader: Reader, example: Example, folder: Path) -> None:
    """Require the same of zeros, ones and noise in the middle of a log, as a loss."""
    _check_damage(reader, example, folder, _holed(example), notes=False)


def bytes_that_do_not_belong_are_told(reader: Reader, example: Example, folder: Path) -> None:
    """Require the same of noise pushed in between, and of first bytes that are spoilt."""
    _check_damage(reader, example, folder, _mixed(example), notes=False)


def bytes_behind_the_end_are_told(reader: Reader, example: Example, folder: Path) -> None:
    """Require that they cost no sample, and are at least a note."""
    whole = whole_log(reader, example, folder)
    for tail in (bytes(GARBAGE_BYTES), np.random.default_rng(4).bytes(GARBAGE_BYTES)):
        recording = attempt(reader, example.put(folder, example.content + tail))
        if recording is None:
            continue  # what says how to read the log stands at its end
        # Whether the last record of all ended before the noise, not every format can tell.
        n = len([s for s in whole.streams if s.gyro])
        require(count(recording) >= count(whole) - n, "bytes behind the end cost samples")
        require(new_problems(recording, whole, notes=True), "nothing is told of them")


def _check_damage(
    reader: Reader,
    example: Example,
    folder: Path,
    damaged: Iterator[tuple[str, bytes]],
    *,
    notes: bool,
) -> None:
    whole = whole_log(reader, example, folder)
    all_samples = samples(whole)
    for what, content in damaged:
        recording = attempt(reader, example.put(folder, content))
        if recording is None:
            continue  # refused, and said so
        if example.checksums:
            _require_part(samples(recording), all_samples, what)
        lost = _records(whole) - _records(recording)
        told = new_problems(recording, whole, notes=notes)
        require(lost <= 0 or told, f"{what}: nothing is told of {lost} missing records")


def _records(recording: Recording) -> int:
    """Count the records of all streams.

    Without checksums, damage in what names or defines a stream can make another stream of it, and
    nobody can tell; but its records are still there.
    """
    return sum(stream.count for stream in recording.streams)


def _require_part(got: dict[str, list[bytes]], whole: dict[str, list[bytes]], what: str) -> None:
    for name, rows in got.items():
        strange = set(rows) - set(whole.get(name, ()))
        require(not strange, f"{what}: {len(strange)} samples of {name} are not in the whole log")


def _flipped(example: Example) -> Iterator[tuple[str, bytes]]:
    random = np.random.default_rng(2)
    content = example.content
    for place in random.integers(0, len(content), FLIPS).tolist():
        bit = int(random.integers(8))
        flipped = bytes([content[place] ^ 1 << bit])
        yield (
            f"bit {bit} of byte {place} flipped",
            content[:place] + flipped + content[place + 1 :],
        )


def _holed(example: Example) -> Iterator[tuple[str, bytes]]:
    random = np.random.default_rng(3)
    content = example.content
    size = min(HOLE_BYTES, len(content) // 8)
    for k, place in enumerate(random.integers(0, len(content) - size, HOLES).tolist()):
        filling = (bytes(size), b"\xff" * size, random.bytes(size))[k % 3]
        yield (
            f"hole of {size} bytes at {place}",
            content[:place] + filling + content[place + size :],
        )


def _mixed(example: Example) -> Iterator[tuple[str, bytes]]:
    random = np.random.default_rng(4)
    content = example.content
    for length in (1, 4, 8):
        yield f"first {length} bytes zero", bytes(length) + content[length:]
        yield f"first {length} bytes gone", content[length:]
    for place in random.integers(0, len(content), HOLES).tolist():
        noise = random.bytes(GARBAGE_BYTES)
        yield f"noise pushed in at {place}", content[:place] + noise + content[place:]


CLAIMS = (
    a_cut_log_gives_what_stands_before_the_cut,
    what_a_cut_costs_is_told,
    a_cut_log_gives_no_less_than_the_official_library,
    a_flipped_bit_is_no_disaster,
    a_hole_is_told,
    bytes_that_do_not_belong_are_told,
    bytes_behind_the_end_are_told,
)
