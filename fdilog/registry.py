"""Finding readers, detectors and reports by entry point, our own exactly as a third party's."""

from __future__ import annotations

import warnings
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

from fdilog.errors import FdilogError, UnreadableLogError, UsageError, nearest
from fdilog.opening import Opened, head_of, opened

if TYPE_CHECKING:
    from fdilog.analysis import Analysis
    from fdilog.finding import Evidence
    from fdilog.recording import Recording
    from fdilog.windows.survey import Survey

Stage = Literal["alone", "samples", "windows", "model"]
"""What a detector is shown: the whole table, to judge each channel by itself, before the others are
compared, without what those of this stage accused whose names come before its own; every sample as
a window of its own; the windows of each configured length; or the whole table with the signals that
a model of the vehicle needs."""


class Reader(Protocol):
    """A module that reads one log format; its entry-point name is the format's name.

    One whose logs are directories also has ``sniff_directory(path) -> bool``, and ``read`` is given
    the directory. If others may lie in it beside the log's own files, ``files_of(path)`` gives the
    names of its own.
    """

    suffixes: tuple[str, ...]
    description: str

    def sniff(self, head: bytes) -> bool:
        """Tell from the first bytes of a file whether this reader should have it."""

    def read(self, path: Path, also: Collection[str] = ()) -> Recording:
        """Read every gyro stream, and the streams named in ``also``, saving what can be saved.

        Raises
        ------
        UnreadableLogError
            Only if nothing can be saved; says at which byte and why.
        """


class Detector(Protocol):
    """A frozen dataclass of settings; its entry-point name is the word in CLI and report."""

    description: str
    stage: Stage

    def detect(self, survey: Survey) -> list[Evidence]:
        """Answer for every window of the survey that this method can say anything about."""


class Report(Protocol):
    """A module that turns an analysis into one text file.

    One whose files can share others also has ``shared_files() -> dict[str, str]``, texts by file
    name, and ``render_shared(analysis)`` for a file in a folder that holds them.
    """

    suffix: str

    def render(self, analysis: Analysis) -> str:
        """Return the whole file."""


@cache
def plugins(group: str) -> dict[str, Any]:
    """Load every plug-in of ``fdilog.<group>``; one that will not import is a warning."""
    loaded: dict[str, Any] = {}
    for entry in sorted(entry_points(group=f"fdilog.{group}"), key=lambda e: e.name):
        try:
            loaded[entry.name] = entry.load()
        except Exception as error:  # noqa: BLE001  a broken plug-in must not take the tool along
            warnings.warn(
                f"{group[:-1]} '{entry.name}' ({entry.value}) does not import: {error}",
                RuntimeWarning,
                stacklevel=2,
            )
    return loaded


def plugin(group: str, name: str) -> Any:
    """Return one plug-in by name.

    Raises
    ------
    UsageError
        If there is none of that name.
    """
    known = plugins(group)
    if name not in known:
        raise UsageError(f"no {group[:-1]} named '{name}'{nearest(name, list(known))}")
    return known[name]


def detectors(names: Collection[str]) -> Iterator[tuple[str, Detector]]:
    """Make the named detectors with their default settings, in the order given."""
    for name in names:
        yield name, plugin("detectors", name)()


def read(path: str | Path, also: Collection[str] = ()) -> Recording:
    """Read a log of any known format, compressed or not; ``-`` is standard input.

    The first bytes decide; a suffix only where no reader knows the bytes.

    Raises
    ------
    UnreadableLogError
        If nothing can be read, with the path, the place and the reason.
    """
    with opened(Path(path)) as log:
        return read_opened(log, also)


def read_opened(log: Opened, also: Collection[str] = ()) -> Recording:
    """Read a log that has been unwrapped; see `read`."""
    try:
        recording = read_plain(log.path, also)
    except UnreadableLogError as error:
        # The name of a temporary file says nothing to anybody.
        raise UnreadableLogError(str(error).replace(str(log.path), str(log.named))) from error
    return replace(
        recording,
        path=str(log.named),
        bytes=log.bytes if log.bytes is not None else recording.bytes,
        problems=(*log.problems, *recording.problems),
    )


def read_plain(path: Path, also: Collection[str] = ()) -> Recording:
    """Read a log that is a plain file or a directory; see `read`."""
    readers = plugins("readers")
    name = _reader_of_directory(path) if path.is_dir() else _reader_of_file(path)
    try:
        recording: Recording = readers[name].read(path, also)
    except (FdilogError, MemoryError, KeyboardInterrupt):
        raise
    except Exception as error:
        # A log must never bring the tool down; what a reader did not foresee is said, not shown.
        raise UnreadableLogError(
            f"{path}: the {name} reader failed: {type(error).__name__}: {error}"
        ) from error
    return recording


def is_log_directory(path: Path) -> bool:
    """Whether a directory is one log as a whole, such as a ROS 2 bag, and not a folder of logs."""
    readers = plugins("readers").values()
    return any(r.sniff_directory(path) for r in readers if hasattr(r, "sniff_directory"))


def files_of_log(path: Path) -> frozenset[str]:
    """Return the names in a directory that belong to the log that it is; all, if no reader says.

    Raises
    ------
    OSError
        If the directory cannot be listed.
    """
    for reader in plugins("readers").values():
        if hasattr(reader, "sniff_directory") and reader.sniff_directory(path):
            if hasattr(reader, "files_of"):
                return frozenset(reader.files_of(path))
            break
    return frozenset(file.name for file in path.iterdir())


def _reader_of_directory(path: Path) -> str:
    for name, reader in plugins("readers").items():
        if hasattr(reader, "sniff_directory") and reader.sniff_directory(path):
            return name
    raise UnreadableLogError(f"{path}: is a directory, not a log; name the file in it")


def _reader_of_file(path: Path) -> str:
    head = head_of(path)
    if not head:
        raise UnreadableLogError(f"{path}: the file is empty")
    readers = plugins("readers")
    name = next((n for n, reader in readers.items() if reader.sniff(head)), None)
    if name is None:
        suffix = path.suffix.lower()
        name = next((n for n, reader in readers.items() if suffix in reader.suffixes), None)
    if name is None:
        raise UnreadableLogError(
            f"{path}: not a log of any format that is installed ({', '.join(readers)});"
            f" it begins with {head[:8]!r}"
        )
    return name
