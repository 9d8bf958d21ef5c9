"""What is said of a recording: that it is well formed, which samples it has, what it tells."""

from __future__ import annotations

import time
from collections.abc import Collection
from pathlib import Path

import numpy as np

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog.registry import Reader

LONGEST_READ_S = 2.0
"""Of processor time, for a log of an example's size."""
FASTEST_RAD_S = 300.0
"""No gyro measures as much (4000 deg/s are 70 rad/s); one in deg/s soon reads it."""


class NonconformanceError(AssertionError):
    """A reader does not keep what every reader must; the text says what."""


def require(holds: object, otherwise: str) -> None:
    """Fail unless something holds."""
    if not holds:
        raise NonconformanceError(otherwise)


def attempt(reader: Reader, path: Path, also: Collection[str] = ()) -> Recording | None:
    """Read a log that may be damaged; None if the reader refuses it in one clear line."""
    begun = time.process_time()
    try:
        recording = reader.read(path, also)
    except UnreadableLogError as error:
        line = str(error)
        require(str(path) in line, f"the refusal does not name the log: {line}")
        require(len(line.splitlines()) == 1, f"the refusal is not one line: {line}")
        recording = None
    except Exception as error:
        raise NonconformanceError(
            f"reading raised {type(error).__name__}, which no user understands: {error}"
        ) from error
    took = time.process_time() - begun
    require(took < LONGEST_READ_S, f"reading took {took:.1f} s of processor time")
    if recording is not None:
        well_formed(recording, path)
    return recording


def well_formed(recording: Recording, path: Path) -> None:
    """Require of a recording what everything after it relies on, damaged or not."""
    files = [path] if path.is_file() else [p for p in path.rglob("*") if p.is_file()]
    size = sum(file.stat().st_size for file in files)
    require(recording.path == str(path), f"its path is '{recording.path}', not '{path}'")
    require(0 <= recording.bytes <= size, f"it has {recording.bytes} bytes, the log {size}")
    names = [stream.name for stream in recording.streams]
    require(len(set(names)) == len(names), f"two streams have one name: {names}")
    for stream in recording.streams:
        name, n = stream.name, len(stream.time_ns)
        require(name and name.isprintable(), f"a stream's name is {name!r}")
        require(stream.time_ns.dtype == np.int64, f"{name}: time_ns is {stream.time_ns.dtype}")
        require(stream.time_ns.ndim == 1, f"{name}: time_ns has {stream.time_ns.ndim} dimensions")
        counts = {n} if stream.columns else {n, stream.count}
        require(stream.count in counts, f"{name}: its count is {stream.count}, its length {n}")
        for field, column in stream.columns.items():
            require(len(column) == n, f"{name}.{field} has {len(column)} values, not {n}")
            require(field.isprintable(), f"{name}: a field's name is {field!r}")
        require(set(stream.units) <= set(stream.columns), f"{name}: units of no column")
        _gyro_is_well_formed(recording, names.index(name))
        if stream.offsets is not None:
            require(len(stream.offsets) == n, f"{name}: {len(stream.offsets)} offsets, not {n}")
            require(
                not n or (stream.offsets.min() >= 0 and stream.offsets.max() < size),
                f"{name}: offsets beyond the file",
            )
    for problem in recording.problems:
        _problem_is_well_formed(problem, size)


def _gyro_is_well_formed(recording: Recording, number: int) -> None:
    stream = recording.streams[number]
    for unit, fields in (
        ("rad/s", stream.gyro),
        ("m/s^2", stream.accelerometer),
        ("m/s", stream.velocity),
        ("", stream.compass),
    ):
        for field in fields:
            told = stream.units.get(field)
            require(field in stream.columns, f"{stream.name}: no column for its {field}")
            require(unit in ("", told), f"{stream.name}.{field} is in {told}, not in {unit}")
            kind = stream.columns[field].dtype.kind
            require(kind in "fiu", f"{stream.name}.{field} is no number but of kind {kind}")
    require(len(stream.compass) in (0, 3), f"{stream.name}: a compass of other than three axes")
    require(len(stream.velocity) in (0, 2), f"{stream.name}: a velocity not to north and east")
    if stream.channel_names:
        require(
            len(stream.channel_names) == len(stream.gyro),
            f"{stream.name}: {len(stream.channel_names)} names of {len(stream.gyro)} channels",
        )


def _problem_is_well_formed(problem: Problem, size: int) -> None:
    what = problem.what
    require(what and what.isprintable(), f"a problem is not one printable line: {what!r}")
    for lost in (problem.bytes_lost, problem.seconds_lost):
        require(lost is None or lost >= 0, f"a negative loss: {problem}")
    require(
        problem.offset is None or 0 <= problem.offset <= size,
        f"a problem beyond the end of {size} bytes: {problem}",
    )


def samples(recording: Recording | None) -> dict[str, list[bytes]]:
    """Return every sample of every gyro to the last bit, stamp and readings, in order, by stream.

    One with a reading that is not there is none.
    """
    found = {}
    for stream in recording.streams if recording else ():
        if stream.gyro and len(stream.time_ns):
            rates = np.column_stack([stream.columns[f].astype(np.float64) for f in stream.gyro])
            rows = np.column_stack([stream.time_ns.view(np.uint64), rates.view(np.uint64)])
            opaque = rows.view(f"V{rows.itemsize * rows.shape[1]}")[:, 0]
            found[stream.name] = opaque[np.isfinite(rates).all(axis=1)].tolist()
    return found


def count(recording: Recording | None) -> int:
    """Count the gyro samples."""
    return sum(len(rows) for rows in samples(recording).values())


def new_problems(recording: Recording, whole: Recording, *, notes: bool) -> list[Problem]:
    """Return what a damaged log tells and the whole one does not: notes too, or losses only."""
    return [p for p in recording.problems if p not in whole.problems and (notes or not p.note)]
