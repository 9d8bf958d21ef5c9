"""ROS 2 bags: a folder of SQLite or MCAP files with a description, or without, or one bare file."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import Any

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog_readers import mcap, mcap_records, rosbag2_sqlite
from fdilog_readers.columns import plain_text
from fdilog_readers.file_bytes import opened
from fdilog_readers.topics import Topics, utc_at_zero_ns

suffixes = (".db3",)
description = "ROS 2 bags: a folder with metadata.yaml, or a .db3 file"

DESCRIPTION = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"
STORED = re.compile(r"\.(db3|mcap)(\.zstd)?$")
COPY_BYTES = 1 << 20
DESCRIPTION_BYTES = 64 << 20
HEAD_BYTES = 1 << 16


def sniff(head: bytes) -> bool:
    """Tell an SQLite file, which in the world of logs is a ROS 2 bag."""
    return head.startswith(rosbag2_sqlite.MAGIC)


def sniff_directory(path: Path) -> bool:
    """Tell a folder that is a bag: it has a description, or files that one recorder left in it.

    A recorder numbers its files (``name_0.mcap``, ``name_1.mcap``); a folder of files with names of
    their own holds several recordings, which are not to be mixed.
    """
    return _describes(path / DESCRIPTION) or len({_unnumbered(f) for f in _files_in(path)}) == 1


def files_of(path: Path) -> tuple[str, ...]:
    """Return the names of the files that make up a bag; others may lie in its folder."""
    there = _files_in(path)
    recorded = len({_unnumbered(file) for file in there}) == 1  # what one recorder numbered
    files = there if recorded else _described(path).files
    return (DESCRIPTION, *(file.name for file in files))


def _describes(description: Path) -> bool:
    """Tell a bag's description from other files of so common a name."""
    try:
        with description.open("rb") as file:
            return INFORMATION.encode() in file.read(HEAD_BYTES)
    except OSError:
        return False


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read every gyro of a ROS 2 bag, and the topics named in ``also``.

    Raises
    ------
    UnreadableLogError
        If nothing can be read from any of its files.
    """
    topics = Topics(also)
    try:
        folder = path if path.is_dir() else None
        bag = _described(path) if folder else _Bag((path,), ())
    except OSError as error:
        raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    problems = list(bag.problems)
    failures: list[str] = []
    size = 0
    for file in bag.files:
        try:
            size += file.stat().st_size
            with _uncompressed(file) as (plain, damage):
                problems += damage + _read_file(topics, plain, is_copy=plain != file)
        except UnreadableLogError as error:
            failures.append(str(error))
            problems.append(Problem(what=plain_text(str(error))))
        except OSError as error:
            failures.append(f"{file}: {(error.strerror or str(error)).lower()}")
            problems.append(Problem(what=plain_text(failures[-1])))
    if len(failures) == len(bag.files):
        missing = [problem.what for problem in bag.problems if not problem.note]
        why = missing[0] if missing else "it has no files"
        raise UnreadableLogError(failures[0] if failures else f"{path}: {why}")
    streams = topics.streams()
    if any(file.suffix != ".mcap" for file in bag.files):
        what = "this format has no checksums: damage inside messages cannot be seen"
        problems.append(Problem(what=what, note=True))
    return Recording(
        path=str(path),
        format="rosbag2",
        bytes=size,
        streams=streams,
        problems=(*problems, *topics.problems),
        utc_at_zero_ns=utc_at_zero_ns(streams),
    )


@dataclass(frozen=True)
class _Bag:
    """The files of a bag in the order in which they were written."""

    files: tuple[Path, ...]
    problems: tuple[Problem, ...]


def _read_file(topics: Topics, path: Path, *, is_copy: bool) -> list[Problem]:
    with opened(path) as data:
        if data.at(0, len(mcap_records.MAGIC)) == mcap_records.MAGIC:
            problems = mcap.read_into(topics, data, str(path))
        else:
            problems = rosbag2_sqlite.read_into(topics, path)
    # A place in what was unpacked is none in the file.
    return [replace(problem, offset=None) for problem in problems] if is_copy else problems


def _described(folder: Path) -> _Bag:
    """Find a bag's files by its description, and by looking."""
    there = _files_in(folder)
    if not (folder / DESCRIPTION).is_file():
        what = f"the recording was not closed: it has no {DESCRIPTION}"
        return _Bag(there, (Problem(what=what),))
    try:
        named = _named_files(folder / DESCRIPTION)
    except ValueError as error:
        what = f"{DESCRIPTION} cannot be used ({plain_text(str(error))}); its folder was searched"
        return _Bag(there, (Problem(what=what),))
    files, problems = [], []
    for name in named:
        file = _present(folder, name)
        if file is None:
            what = f"{plain_text(name)} is named in {DESCRIPTION}, but is not there"
            problems.append(Problem(what=what))
        elif file not in files:
            files.append(file)
    for file in there:
        if file not in files:
            what = f"{plain_text(file.name)} is not named in {DESCRIPTION}, and was not read"
            problems.append(Problem(what=what, note=True))
    return _Bag(tuple(files), tuple(problems))


def _present(folder: Path, name: str) -> Path | None:
    """Find a file by its name alone, which may have been compressed or not since."""
    for candidate in (name, f"{name}.zstd", name.removesuffix(".zstd")):
        if STORED.search(candidate) and (folder / candidate).is_file():
            return folder / candidate
    return None


def _named_files(description: Path) -> list[str]:
    """Return the names, and nothing but the names, of the files in a description.

    Older recorders write the folder's name before them; whatever else a path may hold would lead
    out of the folder.

    Raises
    ------
    ValueError
        If the description has no such list.
    """
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    with description.open("rb") as file:
        text = file.read(DESCRIPTION_BYTES)
    try:
        root: Any = YAML(typ="safe", pure=True).load(text.decode(errors="replace"))
    except (YAMLError, RecursionError, ValueError, TypeError, LookupError, AttributeError) as error:
        raise ValueError(str(error).partition("\n")[0]) from error
    information = root.get(INFORMATION) if isinstance(root, dict) else None
    paths = information.get("relative_file_paths") if isinstance(information, dict) else None
    if not isinstance(paths, list):
        raise ValueError("it names no files")  # noqa: TRY004  the text is at fault, not a caller
    return [name for name in (PureWindowsPath(str(path)).name for path in paths) if name]


def _files_in(folder: Path) -> tuple[Path, ...]:
    try:
        found = [path for path in folder.iterdir() if STORED.search(path.name) and path.is_file()]
    except OSError:
        return ()
    return tuple(sorted(found, key=_natural))


def _unnumbered(path: Path) -> str:
    return re.sub(r"_\d+$", "", STORED.sub("", path.name))


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key by which bag_10 comes after bag_2."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d*)", path.name)]


@contextmanager
def _uncompressed(path: Path) -> Iterator[tuple[Path, list[Problem]]]:
    """Give a file that was compressed as a whole back its content, in a temporary folder."""
    if path.suffix != ".zstd":
        yield path, []
        return
    import zstandard

    problems: list[Problem] = []
    with tempfile.TemporaryDirectory(prefix="fdilog-") as folder:
        plain = Path(folder) / path.stem
        try:
            with path.open("rb") as packed, plain.open("wb") as unpacked:
                tool = zstandard.ZstdDecompressor()
                with tool.stream_reader(packed, read_across_frames=True) as content:
                    shutil.copyfileobj(content, unpacked, COPY_BYTES)
        except zstandard.ZstdError as error:
            if not plain.stat().st_size:
                raise UnreadableLogError(f"{path}: does not decompress ({error})") from error
            problems.append(Problem(what=f"{plain_text(path.name)} is damaged: {error}"))
        try:
            yield plain, problems
        except UnreadableLogError as error:  # it names what nobody but us has seen
            raise UnreadableLogError(str(error).replace(str(plain), str(path))) from error
