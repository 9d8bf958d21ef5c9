"""Logs to be damaged: one in every format that can be written, with where each sample lies in it.

A *unit* is what a reader must believe or reject as a whole: a chunk where chunks are compressed or
carry a checksum, a page of a database that has none, else one record. Chunks are as large as the
format's library makes them by default, and there are more than forty.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from mcap_logs import CDR_KINDS, write_cdr, write_json, write_protobuf
from numpy.typing import NDArray
from ros_bags import write_rosbag1, write_rosbag2
from ros_traffic import IMU_TOPICS

from fdilog.recording import Recording, Stream

FEWEST_CHUNKS = 40
ROS_MINUTES, JSON_MINUTES = 1.4, 0.7
FLIGHT_S, FLIGHT_HZ, FLIGHT_IMUS = 120.0, 200.0, 3
PAGE_BYTES = 4096
# Opcode, length, channel, sequence and two times stand before a message's data.
MCAP_HEAD_BYTES = 31

Offsets = NDArray[np.int64]
Ranges = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Samples:
    """What one gyro stream of the whole log holds.

    Parameters
    ----------
    values : (n_samples, n_columns)
        Time and readings, every bit of them.
    unit : (n_samples,)
        Which unit each sample lies in.
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.uint64]
    unit: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Log:
    """A log in one format, whole.

    Parameters
    ----------
    file
        Where the bytes lie that are to be damaged.
    path
        What is to be read: the file, or the folder it stands in.
    units : (n_units, 2)
        First byte of each unit, and the one behind it. [byte]
    unseen
        Whether a hole, by its bytes, leaves no trace that any reader could find: first byte,
        filling. None where checksums cover every gyro.
    """

    name: str
    file: Path
    path: Path
    reader: str
    samples: dict[str, Samples]
    units: Ranges
    unseen: Callable[[int, bytes], bool] | None = None
    n_chunks: int = field(default=0)

    def read(self) -> Recording:
        """Read it as it is now."""
        recording: Recording = import_module(f"fdilog_readers.{self.reader}").read(self.path)
        return recording

    def touched(self, start: int, end: int) -> NDArray[np.bool_]:
        """Tell which units share a byte with a stretch."""
        touched: NDArray[np.bool_] = (self.units[:, 0] < end) & (self.units[:, 1] > start)
        return touched


def gyros(recording: Recording) -> dict[str, Stream]:
    """Return the streams that one sensor measured."""
    return {s.name: s for s in recording.streams if s.gyro and s.origin == "sensor"}


def bits(stream: Stream) -> NDArray[np.uint64]:
    """Return the time and the readings of a stream as bits, (n, 1 + n_gyros)."""
    columns = [np.asarray(stream.columns[name], np.float64).view(np.uint64) for name in stream.gyro]
    return np.column_stack([stream.time_ns.view(np.uint64), *columns])


def _log(
    name: str,
    file: Path,
    reader: str,
    units: Ranges,
    unit_of: Callable[[Stream], NDArray[np.intp]],
    **more: Any,
) -> Log:
    path = more.pop("path", file)
    found = gyros(import_module(f"fdilog_readers.{reader}").read(path))
    samples = {s: Samples(g.time_ns, bits(g), unit_of(g)) for s, g in found.items()}
    return Log(name, file, path, reader, samples, units, **more)


def mcap_log(name: str, folder: Path) -> Log:
    """Write an MCAP file of one kind; its chunks are the units, and have checksums."""
    from mcap.reader import make_reader

    path = folder / f"{name.replace(' ', '_')}.mcap"
    kind = name.removeprefix("MCAP ")
    if kind == "JSON":
        write_json(path, JSON_MINUTES)
    elif kind == "Protobuf":
        write_protobuf(path, ROS_MINUTES)
    else:
        write_cdr(path, ROS_MINUTES, **CDR_KINDS[kind][0])
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None  # noqa: S101  it was closed a moment ago
    return _mcap(name, path, path, "mcap", summary)


def _mcap(name: str, file: Path, path: Path, reader: str, summary: Any, **more: Any) -> Log:
    from mcap.stream_reader import StreamReader

    topics = {channel.id: channel.topic for channel in summary.channels.values()}
    places = sorted(summary.chunk_indexes, key=lambda place: place.chunk_start_offset)
    units = np.array(
        [(p.chunk_start_offset, p.chunk_start_offset + p.chunk_length) for p in places], np.int64
    )
    counts: dict[str, list[int]] = {topic: [0] * len(units) for topic in topics.values()}
    hidden: list[tuple[int, int]] = []
    with file.open("rb") as data:
        for k, place in enumerate(places):
            data.seek(place.chunk_start_offset)
            chunk: Any = next(StreamReader(data, skip_magic=True, emit_chunks=True).records)
            first = place.chunk_start_offset + place.chunk_length - len(chunk.data)
            for channel, offset in place.message_index_offsets.items():
                data.seek(offset)
                index: Any = next(StreamReader(data, skip_magic=True).records)
                counts[topics[channel]][k] += len(index.records)
                if (
                    not chunk.uncompressed_crc
                    and not chunk.compression
                    and topics[channel] not in IMU_TOPICS
                ):
                    hidden += [_message(chunk.data, first, at) for _, at in index.records]

    def unit_of(stream: Stream) -> NDArray[np.intp]:
        return np.repeat(np.arange(len(units)), counts[stream.name])

    if hidden:
        more["unseen"] = _inside(hidden)
    return _log(name, file, reader, units, unit_of, path=path, n_chunks=len(units), **more)


def _message(records: bytes, first: int, at: int) -> tuple[int, int]:
    """Where in the file the data of a message lies that begins in a chunk's records. [byte]"""
    length = int.from_bytes(records[at + 1 : at + 9], "little")
    return first + at + MCAP_HEAD_BYTES, first + at + 9 + length


def _inside(hidden: list[tuple[int, int]]) -> Callable[[int, bytes], bool]:
    """Tell of a hole whether it lies wholly inside one of these stretches."""

    def unseen(start: int, filling: bytes) -> bool:
        return any(low <= start and start + len(filling) <= high for low, high in hidden)

    return unseen


def unchunked_log(name: str, folder: Path) -> Log:
    """Write an MCAP file without chunks: every message is a unit, and has no checksum."""
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    path = folder / "unchunked.mcap"
    write_cdr(path, ROS_MINUTES, **CDR_KINDS["unchunked"][0])
    places: dict[str, list[tuple[int, int]]] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Channel):
                topics[record.id] = record.topic
            elif isinstance(record, Message):
                end = file.tell()
                start = end - MCAP_HEAD_BYTES - len(record.data)
                places.setdefault(topics[record.channel_id], []).append((start, end))
    hidden = [
        (start + MCAP_HEAD_BYTES, end)
        for topic, found in places.items()
        if topic not in IMU_TOPICS
        for start, end in found
    ]
    return _of_places(name, path, "mcap", places, unseen=_inside(hidden))


def _of_places(
    name: str, path: Path, reader: str, places: dict[str, list[tuple[int, int]]], **more: Any
) -> Log:
    """Make a log whose units are the records of the gyro streams, at places in file order."""
    own = {topic: np.array(places[topic], np.int64) for topic in IMU_TOPICS}
    edges = np.cumsum([0, *(len(part) for part in own.values())])
    first = dict(zip(own, edges.tolist(), strict=False))

    def unit_of(stream: Stream) -> NDArray[np.intp]:
        return first[stream.name] + np.arange(len(stream.time_ns))

    return _log(name, path, reader, np.concatenate([*own.values()]), unit_of, **more)


def bag_log(name: str, folder: Path) -> Log:
    """Write a ROS 1 bag: chunks are the units, or messages where nothing is compressed."""
    from rosbags.rosbag1 import Reader

    compression = name.removeprefix("ROS 1 ")
    path = folder / f"{compression}.bag"
    write_rosbag1(path, ROS_MINUTES, compression)
    with Reader(path) as bag:
        topics = {c.id: c.topic for c in bag.connections}
        chunks = {info.pos: info.connection_counts for info in bag.chunk_infos}
        indexes = bag.indexes
        entries = {
            topics[number]: sorted((e.chunk_pos, e.offset) for e in found)
            for number, found in indexes.items()
        }
    raw = path.read_bytes()
    starts = sorted(chunks)
    data = {start: _chunk_data(raw, start) for start in starts}
    units = np.array([(start, data[start][1]) for start in starts], np.int64)
    if compression == "none":
        places = {
            topic: [_record(raw, data[chunk][0] + at) for chunk, at in found]
            for topic, found in entries.items()
        }
        hidden = [
            _payload(raw, place) for t, p in places.items() if t not in IMU_TOPICS for place in p
        ]

        return _of_places(
            name, path, "rosbag1", places, unseen=_inside(hidden), n_chunks=len(units)
        )

    def unit_of(stream: Stream) -> NDArray[np.intp]:
        at = np.array([chunk for chunk, _ in entries[stream.name]], np.int64)
        return np.searchsorted(units[:, 0], at)

    if compression == "bz2":
        return _log(name, path, "rosbag1", units, unit_of, n_chunks=len(units))

    def undone(start: int, filling: bytes) -> bool:
        return _lz4_unseen(raw, data, entries, start, filling)

    return _log(name, path, "rosbag1", units, unit_of, unseen=undone, n_chunks=len(units))


def _u32(raw: bytes, at: int) -> int:
    return int.from_bytes(raw[at : at + 4], "little")


def _chunk_data(raw: bytes, at: int) -> tuple[int, int]:
    """Where the data of a bag's record begins and ends. [byte]"""
    at += 4 + _u32(raw, at)
    return at + 4, at + 4 + _u32(raw, at)


def _record(raw: bytes, at: int) -> tuple[int, int]:
    return at, _chunk_data(raw, at)[1]


def _payload(raw: bytes, place: tuple[int, int]) -> tuple[int, int]:
    return _chunk_data(raw, place[0])


def _lz4_unseen(
    raw: bytes,
    data: dict[int, tuple[int, int]],
    entries: dict[str, list[tuple[int, int]]],
    start: int,
    filling: bytes,
) -> bool:
    """Tell whether a damaged chunk still decompresses, to other bytes only where no gyro is."""
    import lz4.frame

    end = start + len(filling)
    for chunk, (low, high) in data.items():
        if low <= start and end <= high:
            before = lz4.frame.decompress(raw[low:high])
            try:
                after = lz4.frame.decompress(raw[low:start] + filling + raw[end:high])
            except RuntimeError:
                return False
            if len(after) != len(before):
                return False
            changed = np.flatnonzero(
                np.frombuffer(before, np.uint8) != np.frombuffer(after, np.uint8)
            )
            free = np.zeros(len(before), bool)
            for topic, found in entries.items():
                for at in (at for pos, at in found if pos == chunk and topic not in IMU_TOPICS):
                    free[slice(*_payload(before, (at, 0)))] = True
            return bool(free[changed].all())
    return False


def sqlite_log(name: str, folder: Path) -> Log:
    """Write a ROS 2 bag as a database: its pages are the units."""
    import sqlite3

    bag = folder / "sqlite3"
    write_rosbag2(bag, ROS_MINUTES)
    path = bag / "sqlite3.db3"
    raw = path.read_bytes()
    with sqlite3.connect(path) as connection:
        topics = dict(connection.execute("SELECT id, name FROM topics"))
        blobs = connection.execute("SELECT topic_id, data FROM messages ORDER BY id").fetchall()
    connection.close()
    pages: dict[str, list[int]] = {topic: [] for topic in IMU_TOPICS}
    at = 0
    for number, blob in blobs:
        if topics[number] in pages:
            # Pages are filled in order, each from its end to its front.
            at = raw.index(blob, max(0, at - 2 * PAGE_BYTES))
            pages[topics[number]].append(at // PAGE_BYTES)
    units = np.arange(len(raw) // PAGE_BYTES)[:, None] * PAGE_BYTES + np.array([0, PAGE_BYTES])
    # A page of a table begins with 5 or 13 (sqlite.org/fileformat2.html), the first with a magic.
    kinds = np.frombuffer(raw, np.uint8)[::PAGE_BYTES]
    overflow = ~np.isin(kinds, [5, 13])
    overflow[0] = False

    def inside(start: int, filling: bytes) -> bool:
        """In pages that hold nothing but the rest of a picture, or the index by time."""
        first, last = start // PAGE_BYTES, (start + len(filling) - 1) // PAGE_BYTES
        return bool(overflow[first : last + 1].all())

    def unit_of(stream: Stream) -> NDArray[np.intp]:
        return np.array(pages[stream.name])

    return _log(name, path, "rosbag2", units, unit_of, path=bag, unseen=inside)


def rosbag2_mcap_log(name: str, folder: Path) -> Log:
    """Write a ROS 2 bag in MCAP storage, as rosbags does."""
    from mcap.reader import make_reader
    from ros_traffic import TYPES, messages, typestore
    from rosbags.rosbag2 import StoragePlugin, Writer

    bag = folder / "mcap"
    store = typestore(2)
    with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in TYPES.items()
        }
        for topic, time_ns, data in messages(ROS_MINUTES):
            writer.write(topics[topic], time_ns, data)
    file = bag / "mcap.mcap"
    with file.open("rb") as data:
        summary = make_reader(data).get_summary()
    return _mcap(name, file, bag, "rosbag2", summary)


def flight_log(name: str, folder: Path) -> Log:
    """Write a simulated flight with three gyros and an attitude; every record is a unit."""
    from fdilog.experiments.simulate import simulate
    from fdilog.writing import write

    suffix, reader = {
        "tlog": (".tlog", "mavlink"),
        "ULog": (".ulg", "ulog"),
        "DataFlash": (".bin", "dataflash"),
        "CSV": (".csv", "tabular"),
    }[name]
    path = folder / f"flight{suffix}"
    write(simulate(FLIGHT_S, FLIGHT_HZ, sources=FLIGHT_IMUS, seed=4).recording(), path)
    recording = import_module(f"fdilog_readers.{reader}").read(path)
    found = gyros(recording)
    if name == "CSV":
        line_ends = np.flatnonzero(np.frombuffer(path.read_bytes(), np.uint8) == ord("\n")) + 1
        starts = dict.fromkeys(found, line_ends[:-1])
        ends = dict.fromkeys(found, line_ends[1:])
    else:
        starts = {s: g.offsets for s, g in found.items() if g.offsets is not None}
        every = np.sort(
            np.concatenate([s.offsets for s in recording.streams if s.offsets is not None])
        )
        after = np.append(every, recording.bytes)
        ends = {s: after[np.searchsorted(every, at) + 1] for s, at in starts.items()}
    edges = np.cumsum([0, *(len(at) for at in starts.values())])
    first = dict(zip(starts, edges.tolist(), strict=False))
    units = np.concatenate([np.column_stack([starts[s], ends[s]]) for s in starts])

    def unit_of(stream: Stream) -> NDArray[np.intp]:
        return first[stream.name] + np.arange(len(stream.time_ns))

    return _log(name, path, reader, units, unit_of)


KINDS: dict[str, Callable[[str, Path], Log]] = {
    **{f"MCAP {kind}": mcap_log for kind in ("zstd", "lz4", "uncompressed", "JSON", "Protobuf")},
    "MCAP unchunked": unchunked_log,
    **{f"ROS 1 {kind}": bag_log for kind in ("none", "lz4", "bz2")},
    "ROS 2 sqlite3": sqlite_log,
    "ROS 2 MCAP": rosbag2_mcap_log,
    **dict.fromkeys(("tlog", "ULog", "DataFlash", "CSV"), flight_log),
}
