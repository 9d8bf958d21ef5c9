"""Logs to check a reader with: how to make one, and what is known of it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from fdilog.recording import Recording
from fdilog.registry import plugins

Columns = Mapping[str, Mapping[str, NDArray[Any]]]
"""Stream name to field to values; the field ``time_ns`` is the stream's stamps. [ns]"""

SEED, SECONDS, RATE_HZ = 1, 12.0, 20.0
UTC_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """One whole log, and what is known of it.

    Parameters
    ----------
    name
        A word for the report: ``chunked``, ``two topics``.
    file_name
        What the log is called, suffix and all.
    make
        Writes the log to the path it is given: a file, or a folder where the format's logs are
        folders. It is called once.
    flight
        The recording that the log was made of, if there is one: the readings must be its readings,
        in rad/s, up to the format's rounding.
    official
        What another, trusted program reads in a log: every gyro field as the reader is to give it.
        It is shown cut logs, too, and may fail on those with any exception.
    records
        Where records begin in the content of the log's (largest) file, in increasing order. Without
        it the offsets of the reader's own streams are used, if it gives any. [byte]
    closed
        Whether a whole log ends with an index, a footer or the like: whatever is cut is a loss.
        Else a log may end after any record.
    checksums
        Whether every reading is covered by one: none that was changed may be believed.
    """

    name: str
    file_name: str
    make: Callable[[Path], object]
    flight: Recording | None = None
    official: Callable[[Path], Columns] | None = None
    records: Callable[[bytes], Sequence[int]] | None = None
    closed: bool = False
    checksums: bool = False

    @cached_property
    def _files(self) -> dict[str, bytes]:
        """Every file of the log by its path in it; of a plain file the path is empty."""
        with tempfile.TemporaryDirectory(prefix="fdilog-") as folder:
            log = Path(folder) / self.file_name
            self.make(log)
            if log.is_file():
                return {"": log.read_bytes()}
            files = sorted(path for path in log.rglob("*") if path.is_file())
            return {str(path.relative_to(log)): path.read_bytes() for path in files}

    @property
    def content(self) -> bytes:
        """The file that is damaged to see what happens: the largest one."""
        return self._files[self._largest]

    @property
    def _largest(self) -> str:
        return max(self._files, key=lambda path: len(self._files[path]))

    def put(self, folder: Path, content: bytes | None = None) -> Path:
        """Write the log into a folder, with another content of its largest file, if given."""
        log = folder / self.file_name
        for name, whole in self._files.items():
            path = log / name if name else log
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(whole if content is None or name != self._largest else content)
        return log


@cache
def simulated_flight() -> Recording:
    """Return a short flight of two IMUs: something to write a log of."""
    from fdilog.experiments.simulate import simulate

    flight = simulate(SECONDS, RATE_HZ, sources=2, seed=SEED)
    return replace(flight.recording(), utc_at_zero_ns=UTC_NS)


@cache
def written_examples() -> Mapping[str, Example]:
    """Return a simulated flight in every format that can be written, by the reader's name."""
    examples = {}
    for name, writer in plugins("writers").items():
        examples[name] = Example(
            name="simulated",
            file_name=f"flight{writer.suffix}",
            make=partial(writer.write, simulated_flight()),
            flight=simulated_flight(),
        )
    return examples
