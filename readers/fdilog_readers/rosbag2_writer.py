"""Writing ROS 2 bags, with the official library: an Imu topic for each gyro."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Literal

from fdilog.recording import Recording
from fdilog_readers.ros_writing import published, serialised, typestore

suffix = ".db3"

VERSION_AT = 96
FIRST_VERSION = (3_007_000).to_bytes(4, "big")
"""Written where a database says which SQLite wrote it, so that every SQLite gives the same bytes:
the first version that said so."""


def write(recording: Recording, path: Path) -> None:
    """Write a recording as the one SQLite file of a bag; see `write_folder`."""
    with tempfile.TemporaryDirectory(prefix=".fdilog-", dir=path.parent) as folder:
        bag = Path(folder) / path.stem
        write_folder(recording, bag)
        (bag / f"{bag.name}.db3").replace(path)


def write_folder(
    recording: Recording,
    folder: Path,
    storage: Literal["sqlite3", "mcap"] = "sqlite3",
    compression: Literal["none", "message", "file"] = "none",
) -> None:
    """Write the gyros of a recording as ``/imu0/data`` ..., and its attitude as ``/attitude``.

    Parameters
    ----------
    folder
        Where the bag is to be; it must not exist yet.

    Raises
    ------
    NoGyroError, UsageError
        If there is no gyro, or one that a message cannot hold.
    FileExistsError
        If there is something already.
    """
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    if folder.exists():
        raise FileExistsError(17, "is there already", str(folder))
    topics = published(recording)
    store = typestore(2)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    writer = Writer(folder, version=9, storage_plugin=plugin)
    if compression != "none":
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = {
            topic.topic: writer.add_connection(topic.topic, topic.type, typestore=store)
            for topic in topics
        }
        for time_ns, topic, data in serialised(topics, store, 2):
            writer.write(connections[topic], time_ns, data)
    for database in folder.glob("*.db3"):
        with database.open("r+b") as file:
            file.seek(VERSION_AT)
            file.write(FIRST_VERSION)
