"""What holds of a reader and a log that nothing is wrong with."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from fdilog.config import Config
from fdilog.conformance.claims import FASTEST_RAD_S, attempt, require, samples
from fdilog.conformance.examples import Columns, Example
from fdilog.opening import HEAD_BYTES
from fdilog.recording import Recording
from fdilog.registry import Reader
from fdilog.sources.assembly import channel_table
from fdilog.sources.gyros import choose

ROUNDING_RAD_S = 1e-3
"""The coarsest format in use (MAVLink's whole mrad/s) rounds by half of this."""
ROUNDING_NS = 1_000_000
"""And its stamps are whole milliseconds."""


def whole_log(reader: Reader, example: Example, folder: Path) -> Recording:
    """Read the example; nothing of it may be lost."""
    recording = attempt(reader, example.put(folder))
    if recording is None:
        require(holds=False, otherwise="it refuses a whole log")
        raise AssertionError
    lost = [problem.what for problem in recording.problems if not problem.note]
    require(not lost, f"it finds losses in a whole log: {lost}")
    require(samples(recording), "it finds no gyro in a whole log")
    return recording


def it_knows_its_own(reader: Reader, example: Example, folder: Path) -> None:
    """Require that ``sniff`` takes the log, also when asked again, and stands a short head."""
    log = example.put(folder)
    if log.is_dir():
        require(hasattr(reader, "sniff_directory"), "its logs are folders: sniff_directory")
        require(reader.sniff_directory(log), "it does not know its own folder")  # type: ignore[attr-defined]
        require(not reader.sniff_directory(folder / "absent"), "it knows a folder that is absent")  # type: ignore[attr-defined]
        return
    head = example.content[:HEAD_BYTES]
    require(reader.sniff(head) is True, "it does not know its own log")
    require(reader.sniff(head) is True, "it does not know its own log when asked again")
    for length in [*range(min(len(head), 64)), *range(64, len(head), 61)]:
        require(reader.sniff(head[:length]) in {True, False}, "sniff neither takes nor refuses")


def readings_are_rad_s_and_the_stamps_go_on(reader: Reader, example: Example, folder: Path) -> None:
    """Require rates of a size that gyros have, and a table whose time increases strictly."""
    recording = whole_log(reader, example, folder)
    for stream in recording.streams:
        for field in stream.gyro:
            most = np.nanmax(np.abs(stream.columns[field].astype(float)), initial=0.0)
            require(most < FASTEST_RAD_S, f"{stream.name}.{field} reads {most:.0f} rad/s")
    for gyro in choose(recording, Config())[0]:
        steps = np.diff(gyro.time_ns)
        require((steps > 0).all(), f"{gyro.name}: stamps of a whole log repeat or go back")
    table = channel_table(recording)
    require((np.diff(table.time_s) > 0).all(), "the table's time does not increase strictly")


def it_reads_what_the_official_library_reads(
    reader: Reader, example: Example, folder: Path
) -> None:
    """Require every sample of every gyro, to the last bit, and no gyro more."""
    recording = whole_log(reader, example, folder)
    if example.official is None:
        return
    same_gyros(recording, example.official(folder / example.file_name))


def same_gyros(recording: Recording, theirs: Columns) -> None:
    """Require of every gyro what another program reads of it, to the last bit, and none more."""
    ours = {stream.name: stream for stream in recording.streams}
    gyros = set(samples(recording))
    require(gyros <= set(theirs), f"the official library reads no {sorted(gyros - set(theirs))}")
    for name, columns in theirs.items():
        require(name in ours, f"it has no stream {name}")
        stream = ours[name]
        require(set(stream.gyro) <= set(columns), f"nothing tells what {stream.gyro} should be")
        for field, values in columns.items():
            got = stream.time_ns if field == "time_ns" else stream.columns[field]
            require(len(got) == len(values), f"{name}: {len(got)} samples, not {len(values)}")
            want = np.asarray(values).astype(got.dtype)
            require(
                np.array_equal(np.asarray(values), want, equal_nan=want.dtype.kind == "f"),
                f"{name}.{field}: {got.dtype} cannot hold what the official library reads",
            )
            same = got.tobytes() == want.tobytes()
            require(same, f"{name}.{field} is not what the official library reads")


def it_reads_the_flight_that_was_logged(reader: Reader, example: Example, folder: Path) -> None:
    """Require its readings in rad/s and nanoseconds, up to the rounding of the format."""
    recording = whole_log(reader, example, folder)
    if example.flight is None:
        return
    flown, logged = choose(example.flight, Config())[0], choose(recording, Config())[0]
    require(len(flown) == len(logged), f"{len(flown)} gyros flew, {len(logged)} are read")
    for true, gyro in zip(flown, logged, strict=True):
        require(len(true.time_ns) == len(gyro.time_ns), f"{gyro.name}: samples are missing")
        late_ns = gyro.time_ns - true.time_ns
        require(np.ptp(late_ns) <= ROUNDING_NS, f"{gyro.name}: stamps are not nanoseconds")
        apart = np.abs(gyro.rate_rad_s - true.rate_rad_s).max()
        require(apart <= ROUNDING_RAD_S, f"{gyro.name}: readings are off by {apart:.2g} rad/s")


def reading_again_gives_the_same(reader: Reader, example: Example, folder: Path) -> None:
    """Require that no state is kept between logs, and no order left to chance."""
    first = whole_log(reader, example, folder)
    second = reader.read(folder / example.file_name)
    require(first.problems == second.problems, "other problems when read again")
    require(_all_bits(first) == _all_bits(second), "other streams when read again")


def more_that_is_asked_for_changes_no_gyro(reader: Reader, example: Example, folder: Path) -> None:
    """Require that ``also`` adds columns, and nothing for a name that the log does not have."""
    plain = whole_log(reader, example, folder)
    path = folder / example.file_name
    everything = attempt(reader, path, {s.name for s in plain.streams} | {"no such stream"})
    require(samples(everything) == samples(plain), "asking for more changed a gyro")
    if everything is not None:
        counts = [{s.name: s.count for s in r.streams} for r in (plain, everything)]
        require(counts[0].items() <= counts[1].items(), "asking for more changed a count")


def the_log_is_left_as_it_was(reader: Reader, example: Example, folder: Path) -> None:
    """Require that no byte, stamp or file beside it changes; it may be write-protected."""
    log = example.put(folder)
    files = [folder, *folder.rglob("*")]
    for path in files:
        path.chmod(0o500 if path.is_dir() else 0o400)
    try:
        before = [(path, _state(path)) for path in files]
        attempt(reader, log)
        after = [(path, _state(path)) for path in (folder, *folder.rglob("*"))]
    finally:
        for path in files:
            path.chmod(0o700 if path.is_dir() else 0o600)
    require([path for path, _ in after] == files, "it left a file behind, or took one away")
    require(before == after, "it changed the log")


def _state(path: Path) -> tuple[int, int, bytes]:
    found = os.stat(path)  # noqa: PTH116
    return found.st_size, found.st_mtime_ns, path.read_bytes() if path.is_file() else b""


def _all_bits(recording: Recording) -> list[tuple[str, int, str, list[tuple[str, bytes]]]]:
    return [
        (
            stream.name,
            stream.count,
            stream.clock,
            [
                ("", stream.time_ns.tobytes()),
                *((f, c.tobytes()) for f, c in stream.columns.items()),
            ],
        )
        for stream in recording.streams
    ]


CLAIMS = (
    it_knows_its_own,
    readings_are_rad_s_and_the_stamps_go_on,
    it_reads_what_the_official_library_reads,
    it_reads_the_flight_that_was_logged,
    reading_again_gives_the_same,
    more_that_is_asked_for_changes_no_gyro,
    the_log_is_left_as_it_was,
)
