"""Logs behind a URL, with fsspec: listed here, read by the workers themselves."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from fdilog.campaign.discovery import Candidate, readers
from fdilog.errors import FdilogError, UnreadableLogError, UsageError

COPY_BYTES = 1 << 20


def _fsspec() -> Any:
    try:
        import fsspec
    except ImportError:
        raise UsageError("logs behind a URL need fsspec: pip install 'fdilog[remote]'") from None
    return fsspec


def discover_remote(url: str) -> Iterator[Candidate]:
    """List the logs at a URL: one file, a pattern, or a folder searched to its ground.

    What a reader knows by its suffix is a log; a file that the URL names itself is one anyway.

    Raises
    ------
    FdilogError
        If the URL cannot be listed.
    """
    fsspec = _fsspec()
    try:
        system, path = fsspec.core.url_to_fs(url)
        if any(sign in path for sign in "*?["):
            listed = system.glob(path, detail=True)
        elif system.isfile(path):
            listed = {path: system.info(path)}
        else:
            listed = system.find(path, detail=True)
    except Exception as error:  # every file system has errors of its own
        raise FdilogError(f"{url}: {str(error) or type(error).__name__}") from error
    suffixes = {suffix for reader in readers().values() for suffix in reader.suffixes}
    for name, info in sorted(listed.items()):
        if info.get("type") != "file":
            continue
        if name == path or PurePosixPath(name).suffix.lower() in suffixes:
            yield Candidate(
                path=system.unstrip_protocol(name),
                root=url,
                size=int(info.get("size") or 0),
                stamp=_stamp(info),
            )


def _stamp(info: dict[str, Any]) -> str:
    """Return what the store says of a file's content or age: its tag, else its time."""
    for key in ("ETag", "etag", "md5Hash", "mtime", "LastModified", "last_modified", "created"):
        if info.get(key):
            return str(info[key])
    return ""


@contextmanager
def fetched(url: str) -> Iterator[Path]:
    """Copy a log to a local file for as long as it is analysed.

    Raises
    ------
    UnreadableLogError
        If it cannot be fetched.
    """
    fsspec = _fsspec()
    with TemporaryDirectory(prefix="fdilog-") as folder:
        # The suffix is kept: where no reader knows the bytes, it decides.
        local = Path(folder) / f"log{''.join(PurePosixPath(url).suffixes[-2:])}"
        try:
            with fsspec.open(url, "rb") as source, local.open("wb") as target:
                shutil.copyfileobj(source, target, COPY_BYTES)
        except Exception as error:
            raise UnreadableLogError(f"{url}: {str(error) or type(error).__name__}") from error
        yield local
