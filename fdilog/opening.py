"""Unwrapping a log: standard input and compressed files become a plain file for a while."""

from __future__ import annotations

import hashlib
import os
import stat
import sys
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from io import BufferedIOBase
from pathlib import Path
from typing import IO

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem

HEAD_BYTES = 4096
COPY_BYTES = 1 << 20
# Flight logs shrink by 2 to 20 times; a file that grows by more than this is not one.
MOST_EXPANSION = 1000
LEAST_LIMIT_BYTES = 1 << 30

_GZIP, _ZSTD, _ZIP = b"\x1f\x8b", b"\x28\xb5\x2f\xfd", b"PK\x03\x04"


@dataclass(frozen=True, kw_only=True)
class Opened:
    """A log ready for a reader.

    Parameters
    ----------
    named
        What the user called it.
    path
        A plain file or a directory; a temporary one if the log was wrapped.
    bytes
        Size of what the user named, where that is not the plain file.
    problems
        What was lost in unwrapping.
    """

    named: Path
    path: Path
    bytes: int | None = None
    problems: tuple[Problem, ...] = ()

    @property
    def sha256(self) -> str:
        """Hash of the content that the user named; of a directory, that of names and contents."""
        if not self.named.is_dir():
            # Standard input is gone once read; its copy is what was named.
            return _sha256(self.named if self.named.is_file() else self.path)
        whole = hashlib.sha256()
        for file in sorted(p for p in self.named.rglob("*") if p.is_file()):
            whole.update(os.fsencode(file.relative_to(self.named)) + b"\0")
            whole.update(bytes.fromhex(_sha256(file)))
        return whole.hexdigest()


@contextmanager
def opened(path: Path) -> Iterator[Opened]:
    """Unwrap a log named by a path, or ``-`` for standard input.

    Raises
    ------
    UnreadableLogError
        If there is no such file, it is neither file nor directory, or it cannot be unwrapped.
    """
    try:
        if str(path) != "-" and not _wrapped(path):
            yield Opened(named=path, path=path)
            return
        with tempfile.TemporaryDirectory(prefix="fdilog-") as folder:
            source = path
            if str(path) == "-":
                source = Path(folder) / "stdin"
                _copy(sys.stdin.buffer, source, limit=None)
            plain: Path = source
            problems: tuple[Problem, ...] = ()
            if _wrapped(source):
                plain, problems = _unwrapped(source, Path(folder), named=path)
            size = source.stat().st_size
            yield Opened(named=path, path=plain, bytes=size, problems=problems)
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise UnreadableLogError(f"{path}: {reason}") from error


def head_of(path: Path) -> bytes:
    """Return the first bytes of a plain file."""
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def _wrapped(path: Path) -> bool:
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        return False
    if not stat.S_ISREG(mode):
        raise UnreadableLogError(f"{path}: is neither a file nor a directory")
    return head_of(path).startswith((_GZIP, _ZSTD, _ZIP))


def _unwrapped(path: Path, folder: Path, *, named: Path) -> tuple[Path, tuple[Problem, ...]]:
    head = head_of(path)
    plain = folder / "unwrapped" / (path.stem or "log")
    plain.parent.mkdir()
    limit = max(LEAST_LIMIT_BYTES, MOST_EXPANSION * path.stat().st_size)
    try:
        if head.startswith(_ZIP):
            plain = _unzipped(path, plain.parent, limit)
        elif head.startswith(_GZIP):
            import gzip

            with gzip.open(path) as file:
                _copy(file, plain, limit)
        else:
            import zstandard

            with path.open("rb") as raw, zstandard.ZstdDecompressor().stream_reader(raw) as file:
                _copy(file, plain, limit)
    except (EOFError, zlib.error, OSError, UnreadableLogError, _zstd_error()) as error:
        if isinstance(error, UnreadableLogError) or not plain.exists() or not plain.stat().st_size:
            raise UnreadableLogError(f"{named}: cannot be decompressed: {error}") from None
        lost = Problem(what=f"the compressed file is damaged or ends early: {error}")
        return plain, (lost,)
    return plain, ()


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _zstd_error() -> type[Exception]:
    import zstandard

    return zstandard.ZstdError


def _unzipped(path: Path, folder: Path, limit: int) -> Path:
    """Unpack the one log of an archive; member names never choose where it goes."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            members = [info for info in archive.infolist() if not info.is_dir()]
            members = [i for i in members if not i.filename.startswith("__MACOSX/")]
            if len(members) != 1:
                names = ", ".join(info.filename for info in members[:5])
                raise UnreadableLogError(
                    f"holds {len(members)} files ({names}); unpack it and name the log"
                )
            plain = folder / (Path(members[0].filename).name or "log")
            with archive.open(members[0]) as file:
                _copy(file, plain, limit)
            return plain
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise UnreadableLogError(str(error)) from None


def _copy(source: IO[bytes] | BufferedIOBase, target: Path, limit: int | None) -> None:
    written = 0
    with target.open("wb") as file:
        # All the streams have it: of one that ends early, it gives what there is of the last block.
        while block := source.read1(COPY_BYTES):  # type: ignore[union-attr]
            written += len(block)
            if limit is not None and written > limit:
                raise UnreadableLogError(f"grows to more than {limit:,} bytes")
            file.write(block)
