"""Logs behind a URL, with fsspec: listed here, read by the workers themselves."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote, urlsplit

from fdilog.campaign.discovery import Candidate, is_unfinished, named_like_a_log
from fdilog.errors import FdilogError, UnreadableLogError, UsageError

COPY_BYTES = 1 << 20
STAMPS = (
    "ETag", "etag", "md5Hash", "mtime", "LastModified", "Last-Modified", "last_modified", "created"
)  # fmt: skip
"""What file systems call the tag or the time of a file, the tag first."""


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
        system.invalidate_cache()  # what was listed a while ago may have grown since
        listed = sorted(_listed(system, path).items())
    except Exception as error:  # every file system has errors of its own
        raise FdilogError(f"{url}: {_reason(error)}") from error
    for name, info in listed:
        if name == path or (named_like_a_log(_base(name)) and not is_unfinished(_base(name))):
            yield _candidate(system, name, info, url)


def _candidate(system: Any, name: str, info: dict[str, Any], root: str) -> Candidate:
    path = system.unstrip_protocol(name)
    try:
        if info.get("size") is None:  # links on a page, which tell nothing but names
            info = system.info(name)
    except Exception as error:  # noqa: BLE001  a link that leads nowhere is that log's trouble
        return Candidate(path=path, root=root, error=_reason(error))
    return Candidate(path=path, root=root, size=int(info.get("size") or 0), stamp=_stamp(info))


def _reason(error: Exception) -> str:
    if isinstance(error, FileNotFoundError):
        return "no such file or folder, or nobody answers there"
    return str(error) or type(error).__name__


def _listed(system: Any, path: str) -> dict[str, dict[str, Any]]:
    """Return the files at a place, with what the store says of them without being asked twice."""
    found: dict[str, dict[str, Any]]
    # In a web address a question mark begins the query, such as the signature of a link.
    if any(sign in (urlsplit(path).path if _is_web(path) else path) for sign in "*?["):
        found = system.glob(path, detail=True)
    elif not _is_folder(system, path):
        found = {path: system.info(path)}
    else:
        found = system.find(path, detail=True)
    return {name: info for name, info in found.items() if info.get("type") == "file"}


def _is_folder(system: Any, path: str) -> bool:
    """Tell a folder; on the web it is a page of links, which a server also gives as a file."""
    if _is_web(path):
        return str(system.info(path).get("mimetype", "")) == "text/html"
    return not system.isfile(path)


def _is_web(path: str) -> bool:
    return path.startswith(("http://", "https://"))


def _base(name: str) -> str:
    """Return a file's own name, without the query of a web address."""
    path = urlsplit(name).path if _is_web(name) else name
    return unquote(PurePosixPath(path).name) if _is_web(name) else PurePosixPath(path).name


def _stamp(info: dict[str, Any]) -> str:
    """Return what the store says of a file's content or age: its tag, else its time."""
    for key in STAMPS:
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
        local = Path(folder) / f"log{''.join(PurePosixPath(_base(url)).suffixes[-2:])}"
        try:
            with fsspec.open(url, "rb") as source, local.open("wb") as target:
                shutil.copyfileobj(source, target, COPY_BYTES)
        except Exception as error:
            raise UnreadableLogError(f"{url}: {_reason(error)}") from error
        yield local
