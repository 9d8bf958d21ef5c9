"""The gyros of a log as the official libraries read them, under the names that our readers give.

Of a log that is cut, what a library gave before it broke off counts.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import sqlite3
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import numpy as np

from fdilog.conformance import Columns
from tests import mavlink_oracle, record_places, ulog_oracle

RATES = tuple(f"angular_velocity.{axis}" for axis in "xyz")


def _columns(rows: dict[str, list[tuple[int, ...]]], fields: tuple[str, ...]) -> Columns:
    return {
        name: dict(zip(("time_ns", *fields), map(np.array, zip(*values, strict=True)), strict=True))
        for name, values in rows.items()
    }


def _imus(messages: Iterable[tuple[str, Any]]) -> Columns:
    """Stamps and rates of all messages that are a sensor_msgs/Imu, by topic."""
    rows: dict[str, list[tuple[int, ...]]] = defaultdict(list)
    with suppress(Exception):
        for topic, message in messages:
            rate = _part(message, "angular_velocity")
            if rate is not None:
                values = (_part(rate, axis) for axis in "xyz")
                rows[topic].append((_stamp_ns(message), *values))
    return _columns(rows, RATES)


def _part(message: Any, name: str) -> Any:
    return message.get(name) if isinstance(message, dict) else getattr(message, name, None)


def _stamp_ns(message: Any) -> int:
    stamp = _part(_part(message, "header"), "stamp")
    return int(_part(stamp, "sec")) * 10**9 + int(_part(stamp, "nanosec"))


def mcap(path: Path) -> Columns:
    """By ``mcap`` and its decoders of ROS 2 and Protobuf; ROS 1 messages by ``rosbags``."""
    with path.open("rb") as file:
        return _imus(_mcap_messages(file))


def _mcap_messages(file: Any) -> Iterator[tuple[str, Any]]:
    from mcap.reader import NonSeekingReader
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    factories = [Ros2(), Protobuf()]
    decoders: dict[int, Callable[[bytes], Any]] = {}
    for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
        if channel.id not in decoders:
            found = [f.decoder_for(channel.message_encoding, schema) for f in factories]
            if channel.message_encoding == "json":
                found = [json.loads]
            elif channel.message_encoding == "ros1":
                found = [_ros1(schema)]
            decoders[channel.id] = next(decoder for decoder in found if decoder)
        yield channel.topic, decoders[channel.id](message.data)


def _ros1(schema: Any) -> Callable[[bytes], Any]:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    package, _, name = schema.name.rpartition("/")
    return lambda data: store.deserialize_ros1(data, f"{package.removesuffix('/msg')}/msg/{name}")


def rosbags(path: Path) -> Columns:
    """ROS 1 and ROS 2 bags, by ``rosbags``."""
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / path.name
        (shutil.copytree if path.is_dir() else shutil.copyfile)(path, bag)
        for database in bag.glob("*.db3"):
            _keep_whole_pages(database)
        return _imus(_rosbags_messages(bag))


def _keep_whole_pages(database: Path) -> None:
    """SQLite fills a page that is cut with zeros, and calls them readings."""
    size = database.stat().st_size
    os.truncate(database, size - size % record_places.SQLITE_PAGE)


def _rosbags_messages(path: Path) -> Iterator[tuple[str, Any]]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, raw in reader.messages():
            yield connection.topic, reader.deserialize(raw, connection.msgtype)


def db3(path: Path) -> Columns:
    """The SQLite file of a bag without its folder, by ``sqlite3`` and ``rosbags``."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(shutil.copyfile(path, Path(folder) / path.name))
        _keep_whole_pages(copy)
        return _imus(_db3_messages(copy))


def _db3_messages(path: Path) -> Iterator[tuple[str, Any]]:
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    query = (
        "SELECT topics.name, topics.type, messages.data FROM messages JOIN topics"
        " ON messages.topic_id = topics.id ORDER BY messages.id"
    )
    with closing(sqlite3.connect(path)) as connection:
        for topic, kind, data in connection.execute(query):
            yield topic, store.deserialize_cdr(data, kind)


def tlog(path: Path) -> Columns:
    """By ``pymavlink``, in SI: its own numbers are whole mrad/s."""
    found: dict[str, list[tuple[int, ...]]] = defaultdict(list)
    for (_, _, name), messages in mavlink_oracle.official(path).items():
        for m in messages:
            if name.endswith("_IMU") or "SCALED_IMU" in name:
                time_ns = 1000 * m.time_usec if name == "RAW_IMU" else 10**6 * m.time_boot_ms
                rates = np.array([m.xgyro, m.ygyro, m.zgyro]) * 1.0 / 1000.0
                found[name].append((time_ns, *rates))
            elif name == "ATTITUDE":
                rates = (m.rollspeed, m.pitchspeed, m.yawspeed)
                found[name].append((10**6 * m.time_boot_ms, *rates))
    attitude = {k: v for k, v in found.items() if k == "ATTITUDE"}
    sensors = {k: v for k, v in found.items() if k != "ATTITUDE"}
    return {
        **_columns(sensors, ("xgyro", "ygyro", "zgyro")),
        **_columns(attitude, ("rollspeed", "pitchspeed", "yawspeed")),
    }


def dataflash(path: Path) -> Columns:
    """By ``pymavlink``, of a binary log or of one in text."""
    from pymavlink.DFReader import DFReader_binary, DFReader_text

    read = DFReader_text if path.suffix == ".log" else DFReader_binary
    reader = read(str(path), zero_time_base=True)
    rows: dict[str, list[tuple[int, ...]]] = defaultdict(list)
    while (m := reader.recv_msg()) is not None:
        if m.get_type() == "IMU":
            rows[f"IMU[{m.I}]"].append((1000 * m.TimeUS, m.GyrX, m.GyrY, m.GyrZ))
    reader.close()
    return _columns(rows, ("GyrX", "GyrY", "GyrZ"))


def ulog(path: Path) -> Columns:
    """By ``pyulog``."""
    return {
        f"sensor_gyro[{instance}]": {
            "time_ns": columns["timestamp_sample"].astype(np.int64) * 1000,
            **{axis: columns[axis] for axis in "xyz"},
        }
        for (topic, instance), columns in ulog_oracle.official(path).items()
        if topic == "sensor_gyro"
    }


def table(path: Path) -> Columns:
    """By Python's own ``csv`` and ``float``, or by pyarrow.

    That a row of text is cut these cannot tell, so none is shown to them.
    """
    if path.suffix == ".parquet":
        import pyarrow.parquet

        whole = pyarrow.parquet.read_table(path)
        columns = {name: whole[name].to_numpy() for name in whole.column_names}
    else:
        lines = path.read_text(encoding="utf-8").rpartition("\n")[0].splitlines()
        head, *rows = csv.reader(lines)
        cells = np.array([[float(cell or "nan") for cell in row] for row in rows])
        columns = dict(zip(head, cells.reshape(-1, len(head)).T, strict=True))
    time_ns = np.round(columns.pop("time_s") * 1e9).astype(np.int64)
    found: dict[str, dict[str, Any]] = defaultdict(lambda: {"time_ns": time_ns})
    for name, values in columns.items():
        source, _, axis = name.rpartition(".")
        found[source or "table"][axis] = values
    return found
