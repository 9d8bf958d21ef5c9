"""Which files of a campaign are logs, without opening any further than its first bytes."""

from __future__ import annotations

import glob
import os
import stat
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from fdilog.errors import UsageError
from fdilog.opening import HEAD_BYTES, head_of
from fdilog.registry import files_of_log, is_log_directory, plugins

PACKED = (".gz", ".zst", ".zip")
"""Suffixes before which the suffix of the format may stand."""
UNFINISHED = (".tmp", ".temp", ".part", ".partial", ".filepart", ".crdownload", ".download")
"""Suffixes that copying programs put behind the name of a file until they are done with it."""
RESULTS = "audit.sqlite"
"""What an audit keeps its results in: no log, though ROS 2 bags begin like it."""
DESCRIPTION = "metadata.yaml"
"""What makes a folder one log: the recorder of ROS 2 bags writes it when it ends."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A file that is, or calls itself, a log.

    Parameters
    ----------
    root
        The argument it was found by: names of folders below it may tell the vehicle.
    stamp
        What changes when the file does, beside its size: its time of modification.
    error
        Why it cannot even be opened; else None.
    """

    path: str
    root: str
    size: int = 0
    stamp: str = ""
    error: str | None = None

    @property
    def key(self) -> bytes:
        """The path as the bytes it is made of."""
        return os.fsencode(self.path)

    @property
    def remote(self) -> bool:
        """Whether it is reached by URL."""
        return is_url(self.path)


def is_url(target: str) -> bool:
    """Tell a URL from a path."""
    scheme, separator, _ = target.partition("://")
    return bool(separator) and scheme.isidentifier()


def discover(targets: Sequence[str], output: Path | None = None) -> list[Candidate]:
    """Find every log that the arguments name, each once, in the order of their paths.

    A folder is searched to its ground for what a reader knows by its first bytes or by its suffix;
    a file that is named itself is a log whatever it looks like. What is named like a log but
    cannot be one is found too, with the reason.

    Parameters
    ----------
    output
        A folder to keep out of: the audit's own. One that is searched itself is searched all the
        same; what an audit writes is no log.

    Raises
    ------
    UsageError
        If an argument names nothing.
    """
    found: dict[str, Candidate] = {}
    for target in targets:
        number = len(found)
        for candidate in _found_by(target, output):
            found.setdefault(candidate.path, candidate)
        if len(found) == number and not _names_something(target):
            raise UsageError(f"{target}: no such file or folder")
    return [found[path] for path in sorted(found, key=os.fsencode)]


def _names_something(target: str) -> bool:
    return is_url(target) or os.path.lexists(target) or glob.has_magic(target)


def _found_by(target: str, output: Path | None) -> Iterator[Candidate]:
    if is_url(target):
        from fdilog.campaign.remote import discover_remote

        yield from discover_remote(target)
    elif os.path.lexists(target):
        yield from _named(os.path.normpath(target), output)
    else:
        for path in sorted(glob.glob(target, recursive=True)):  # noqa: PTH207  keeps odd bytes
            yield from _named(os.path.normpath(path), output)


def _named(path: str, output: Path | None) -> Iterator[Candidate]:
    """Give a file that was named, or all that a folder holds that was named."""
    if os.path.isdir(path):  # noqa: PTH112
        yield from _below(path, output)
    else:
        yield _candidate(path, root=os.path.dirname(path) or ".")  # noqa: PTH120


def _below(root: str, output: Path | None) -> Iterator[Candidate]:
    """Every log in a folder and below it; a folder is entered once, whatever links lead to it.

    What lies in the folder of a bag and is no part of it is looked at like anything else.
    """
    entered: set[tuple[int, int]] = set()
    if output is not None and output.is_dir() and not output.samefile(root):
        entered.add(_identity(output))
    waiting, links = [root], deque[str]()
    while waiting or links:
        # Links last: what has a place of its own in the folder is known by that.
        folder = waiting.pop() if waiting else links.popleft()
        try:
            place = _identity(folder)
            if place in entered:
                continue
            entered.add(place)
            with os.scandir(folder) as entries:
                listed = sorted(entries, key=lambda entry: os.fsencode(entry.name))
            is_one_log = _is_one_log(folder)
            parts = files_of_log(Path(folder)) if is_one_log else frozenset()
        except OSError as error:
            yield Candidate(path=folder, root=root, error=f"folder: {_reason(error)}")
            continue
        if is_one_log:
            yield _candidate(folder, root)
        for entry in listed:
            if _is_folder(entry):
                (links if entry.is_symlink() else waiting).append(entry.path)
                yield from _named_like_a_log_but_a_folder(entry, root)
            elif entry.name not in parts and _may_be_a_log(entry):
                yield _candidate(entry.path, root)


def _may_be_a_log(entry: os.DirEntry[str]) -> bool:
    if is_unfinished(entry.name) or entry.name == RESULTS:
        return False
    return named_like_a_log(entry.name) or _begins_like_a_log(entry.path)


def is_unfinished(name: str) -> bool:
    """Tell what is still being copied: rsync, browsers and others rename it when it is whole."""
    return name.startswith(".") or PurePath(name).suffix.lower() in UNFINISHED


def _named_like_a_log_but_a_folder(entry: os.DirEntry[str], root: str) -> Iterator[Candidate]:
    if named_like_a_log(entry.name) and not _holds_a_log(entry.path):
        reason = "is a directory, not a log, and holds none"
        yield Candidate(path=entry.path, root=root, error=reason)


def _identity(folder: str | Path) -> tuple[int, int]:
    status = os.stat(folder)  # noqa: PTH116
    return status.st_dev, status.st_ino


def _is_one_log(folder: str) -> bool:
    """Tell a ROS 2 bag from a folder of logs.

    Without its description it is a folder of files, each a log of its own: to take neighbours for
    parts of one recording would mix flights.
    """
    described = os.path.isfile(os.path.join(folder, DESCRIPTION))  # noqa: PTH113, PTH118
    return described and is_log_directory(Path(folder))


def _is_folder(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_dir()
    except OSError:
        return False  # a link to itself


def _candidate(path: str, root: str) -> Candidate:
    try:
        size, stamp = state_of(path)
        mode = os.stat(path).st_mode  # noqa: PTH116
    except OSError as error:
        return Candidate(path=path, root=root, error=_reason(error))
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        # Opening a pipe would wait for whoever writes to it.
        return Candidate(path=path, root=root, error="is a device or a pipe, not a file")
    return Candidate(path=path, root=root, size=size, stamp=stamp)


def state_of(path: str | Path) -> tuple[int, str]:
    """Size of a log and its latest time of modification, in ns; of a folder, of all that is in it.

    Raises
    ------
    OSError
        If it cannot be looked at.
    """
    status = os.stat(path)  # noqa: PTH116
    if not stat.S_ISDIR(status.st_mode):
        return status.st_size, str(status.st_mtime_ns)
    inside = [file.stat() for file in Path(path).rglob("*") if file.is_file()]
    newest = max((each.st_mtime_ns for each in inside), default=status.st_mtime_ns)
    return sum(each.st_size for each in inside), str(newest)


def _reason(error: OSError) -> str:
    return (error.strerror or str(error)).lower()


def readers() -> dict[str, Any]:
    """Return the installed readers."""
    return plugins("readers")


def named_like_a_log(name: str) -> bool:
    """Tell a log by its suffix, or by that before the one of a packed file."""
    pure = PurePath(name)
    suffix = pure.suffix.lower()
    if suffix in PACKED:
        suffix = PurePath(pure.stem).suffix.lower()
    return bool(suffix) and any(suffix in reader.suffixes for reader in readers().values())


def _begins_like_a_log(path: str) -> bool:
    try:
        if not os.path.isfile(path):  # noqa: PTH113
            return False
        head = _head(path)
    except Exception:  # noqa: BLE001  what cannot be looked into does not say that it is a log
        return False
    return bool(head) and any(reader.sniff(head) for reader in readers().values())


def _head(path: str) -> bytes:
    """First bytes of a file, or of what is packed in it."""
    suffix = PurePath(path).suffix.lower()
    if suffix == ".gz":
        import gzip

        with gzip.open(path) as file:
            return file.read(HEAD_BYTES)
    if suffix == ".zst":
        import zstandard

        with open(path, "rb") as raw, zstandard.ZstdDecompressor().stream_reader(raw) as unpacked:  # noqa: PTH123
            return bytes(unpacked.read(HEAD_BYTES))
    if suffix == ".zip":
        import zipfile

        with zipfile.ZipFile(path) as archive:
            files = [info for info in archive.infolist() if not info.is_dir()]
            with archive.open(files[0]) as member:
                return member.read(HEAD_BYTES)
    return head_of(Path(path))


def _holds_a_log(folder: str) -> bool:
    return any(candidate.error is None for candidate in _below(folder, None))
