"""Writing a recording in any format that can be written, our own writers exactly as a plug-in's.

A writer is a module found by the entry-point group ``fdilog.writers``, under the name of the reader
that reads it back.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Protocol, runtime_checkable

from fdilog.config import Config
from fdilog.errors import UsageError, nearest
from fdilog.experiments.injection import Change, Injection
from fdilog.recording import Recording
from fdilog.registry import plugins
from fdilog.sources.attitude import logged_attitude
from fdilog.sources.gyros import choose, physical_streams


class Writer(Protocol):
    """A module that writes one log format."""

    suffix: str

    def write(self, recording: Recording, path: Path) -> None:
        """Write what the format can hold; the same recording gives the same bytes.

        Raises
        ------
        UsageError
            If the format cannot hold the gyros of this recording.
        """


@runtime_checkable
class Patcher(Protocol):
    """A writer that can also change a log in place, keeping every byte that does not matter."""

    def patch(self, log: Path, path: Path, changes: Sequence[Change]) -> None:
        """Copy a log with other values in some fields and without some records.

        Raises
        ------
        UsageError
            If a field cannot be changed without changing its size.
        """


def write(recording: Recording, path: str | Path) -> None:
    """Write a recording in the format that the path's suffix names.

    Raises
    ------
    UsageError
        If no writer knows the suffix, the format cannot hold these gyros, or the path cannot be
        written.
    """
    path = Path(path)
    with _one_line(path):
        _writer(path).write(recording, path)


def write_injected(injection: Injection, log: str | Path, path: str | Path) -> None:
    """Write a copy of a log with faults in it.

    Where the format's writer can patch and the copy is of the same format, every other byte of the
    log stays as it is; else the recording is written anew, with what its writer can hold.

    Parameters
    ----------
    log
        The file that ``injection`` was made from, as it lies on the disk: not compressed.

    Raises
    ------
    UsageError
        As for `write`, and if the copy would overwrite the log.
    """
    log, path = Path(log), Path(path)
    if path.exists() and path.samefile(log):
        raise UsageError(f"{path}: is the log itself; name another file for the copy")
    writer = _writer(path)
    if not isinstance(writer, Patcher) or log.suffix.lower() != path.suffix.lower():
        write(_anew(injection, path), path)
        return
    with _one_line(path):
        writer.patch(log, path, injection.changes)


def _anew(injection: Injection, path: Path) -> Recording:
    """Leave out every gyro stream that an analysis of the log itself would not use.

    The fault may have left the changed stream with less to say than another one of its sensor, or
    unlike a twin that is the same sensor logged twice: these do not hold the fault. Of rates that
    the autopilot logs with its attitude, the attitude stays.
    """
    changes = injection.changes
    changed = {change.stream.name for change in changes}
    used = changed | physical_streams(injection.original, Config())
    streams = [
        s if s.name in used or s.origin == "derived" else replace(s, gyro=())
        for s in injection.recording.streams
        if not s.gyro
        or s.origin == "derived"
        or s.name in used
        or logged_attitude(s.columns) is not None
    ]
    copy = replace(injection.recording, streams=tuple(streams))
    held = {gyro.stream.name for gyro in choose(copy, Config())[0]}
    for change in changes:
        if change.stream.name not in held and not change.removed.all():
            raise UsageError(
                f"{path}: a log written anew would not hold {change.stream.name}, where the fault"
                f" is; {', '.join(sorted(held))} would be its gyros"
            )
    return copy


def _writer(path: Path) -> Writer:
    writers: dict[str, Writer] = plugins("writers")
    by_suffix = {writer.suffix: writer for writer in writers.values()}
    suffix = path.suffix.lower()
    if suffix not in by_suffix:
        raise UsageError(f"{path}: no format with suffix '{suffix}'{nearest(suffix, [*by_suffix])}")
    return by_suffix[suffix]


@contextmanager
def _one_line(path: Path) -> Iterator[None]:
    """Say in one line why a file cannot be written."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
