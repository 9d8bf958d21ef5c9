"""Writing a recording in any format that can be written, our own writers exactly as a plug-in's.

A writer is a module found by the entry-point group ``fdilog.writers``, under the name of the reader
that reads it back.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from fdilog.errors import UsageError, nearest
from fdilog.injection import Change
from fdilog.recording import Recording
from fdilog.registry import plugins


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
    writers: dict[str, Writer] = plugins("writers")
    by_suffix = {writer.suffix: writer for writer in writers.values()}
    suffix = path.suffix.lower()
    if suffix not in by_suffix:
        raise UsageError(f"{path}: no format with suffix '{suffix}'{nearest(suffix, [*by_suffix])}")
    try:
        by_suffix[suffix].write(recording, path)
    except OSError as error:
        raise UsageError(f"{path}: {(error.strerror or str(error)).lower()}") from error
