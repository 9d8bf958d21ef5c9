"""MCAP logs: ROS 2 and ROS 1 messages, JSON and Protobuf, chunked or not, whole or damaged."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog_readers.chunks import reserve_heap
from fdilog_readers.file_bytes import FileBytes, opened
from fdilog_readers.mcap_messages import Messages
from fdilog_readers.mcap_records import MAGIC
from fdilog_readers.mcap_scan import read_summary
from fdilog_readers.topics import Topics, utc_at_zero_ns

suffixes = (".mcap",)
description = "MCAP recordings (ROS 2, ROS 1, JSON, Protobuf)"


def sniff(head: bytes) -> bool:
    """Tell an MCAP file by its magic."""
    return head.startswith(MAGIC)


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read every gyro of an MCAP file, and the topics named in ``also``.

    A damaged chunk is left out and counted, and reading goes on behind it. The records of a chunk
    that has a checksum are used only if it is right.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened or is no MCAP file.
    """
    topics = Topics(also)
    with opened(path) as data:
        problems = read_into(topics, data, str(path))
    streams = topics.streams()
    return Recording(
        path=str(path),
        format="mcap",
        bytes=data.size,
        streams=streams,
        problems=(*problems, *topics.problems),
        utc_at_zero_ns=utc_at_zero_ns(streams),
    )


def read_into(topics: Topics, data: FileBytes, name: str) -> list[Problem]:
    """Add the messages of an open MCAP file to the topics, and return what was wrong with it.

    Raises
    ------
    UnreadableLogError
        If the file is no MCAP file.
    """
    if data.at(0, len(MAGIC)) != MAGIC:
        raise UnreadableLogError(f"{name}: no MCAP file: it begins with {data.at(0, 8)!r}")
    reserve_heap()
    contents = read_summary(data)
    Messages(topics, contents, data).take_all()
    return contents.problems
