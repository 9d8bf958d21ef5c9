"""Logs of every built-in reader, made by our writers and by the official ones."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from fdilog.conformance import Example, simulated_flight
from fdilog_readers import (
    dataflash_writer,
    mavlink_writer,
    mcap_writer,
    rosbag1_writer,
    rosbag2_writer,
    tabular_writer,
    ulog_writer,
)
from tests import bags, mavlink_oracle, official_readers, record_places, ulog_oracle
from tests.bags import IMU, by_time, imu_messages, readings

FLIGHT = simulated_flight()
TWO = {"/imu/left": IMU, "/imu/right": IMU}
CHUNK_BYTES = 20_000


@functools.cache
def two_imus(ros: int) -> list[bags.Message]:
    """Two topics of sensor_msgs/Imu whose messages differ in length."""
    left, right = readings(150, seed=1), readings(149, seed=2)
    return by_time(
        imu_messages("/imu/left", left, ros=ros),
        imu_messages("/imu/right", right, ["a", "bcd"], ros=ros),
    )


def mcap_examples() -> list[Example]:
    from mcap.writer import CompressionType, IndexType

    of = partial(Example, official=official_readers.mcap, records=record_places.mcap, closed=True)

    def two(name: str, ros: int = 2, **options: Any) -> Example:
        def make(path: Path) -> None:
            bags.write_mcap(path, two_imus(ros), TWO, ros=ros, chunk_size=CHUNK_BYTES, **options)

        checked = options.get("enable_crcs", True) and options.get("use_chunking", True)
        return of(name=name, file_name=f"{name}.mcap", make=make, checksums=bool(checked))

    def flown(encoding: str) -> Example:
        make = partial(mcap_writer.write, FLIGHT, encoding=encoding)
        name = f"{encoding}.mcap"
        return of(name=encoding, file_name=name, make=make, flight=FLIGHT, checksums=True)

    return [
        *map(flown, ("cdr", "json", "protobuf")),
        two("zstd"),
        two("lz4", compression=CompressionType.LZ4),
        two("none", compression=CompressionType.NONE),
        two("ros1", ros=1),
        two("unchunked", use_chunking=False),
        two("unindexed", index_types=IndexType.NONE),
        two("no-checksums", enable_crcs=False),
    ]


def rosbag1_examples() -> list[Example]:
    of = partial(
        Example, official=official_readers.rosbags, records=record_places.rosbag1, closed=True
    )

    def two(compression: str) -> Example:
        def make(path: Path) -> None:
            bags.write_rosbag1(path, two_imus(1), TWO, compression)

        return of(name=compression, file_name=f"{compression}.bag", make=make)

    flown = partial(rosbag1_writer.write, FLIGHT)
    return [
        of(name="simulated", file_name="flight.bag", make=flown, flight=FLIGHT),
        *map(two, ("none", "lz4", "bz2")),
    ]


def rosbag2_examples() -> list[Example]:
    of = partial(Example, official=official_readers.rosbags, closed=True, flight=FLIGHT)

    def folder(storage: str, compression: str, *, checksums: bool = False) -> Example:
        make = partial(
            rosbag2_writer.write_folder, FLIGHT, storage=storage, compression=compression
        )
        return of(
            name=f"{storage}-{compression}",
            file_name="bag",
            make=make,
            records=record_places.sqlite if (storage, compression) == ("sqlite3", "none") else None,
            checksums=checksums,
        )

    return [
        replace(
            of(name="db3", file_name="flight.db3", make=partial(rosbag2_writer.write, FLIGHT)),
            official=official_readers.db3,
            records=record_places.sqlite,
        ),
        folder("sqlite3", "none"),
        folder("sqlite3", "message"),
        folder("mcap", "none"),
        folder("sqlite3", "file"),
    ]


def tlog_examples() -> list[Example]:
    of = partial(
        Example, official=official_readers.tlog, records=record_places.tlog, checksums=True
    )

    def packed(name: str, **how: Any) -> Example:
        def make(path: Path) -> None:
            path.write_bytes(mavlink_oracle.stamped(mavlink_oracle.flight(**how)))

        return of(name=name, file_name=f"{name}.tlog", make=make)

    flown = partial(mavlink_writer.write, FLIGHT)
    return [
        of(name="simulated", file_name="flight.tlog", make=flown, flight=FLIGHT),
        packed("mavlink1", version=1),
        packed("signed", signed=True),
    ]


def ulog_examples() -> list[Example]:
    of = partial(Example, official=official_readers.ulog, records=record_places.ulog)

    def packed(path: Path) -> None:
        path.write_bytes(ulog_oracle.log())

    return [
        of(
            name="simulated",
            file_name="flight.ulg",
            make=partial(ulog_writer.write, FLIGHT),
            flight=FLIGHT,
        ),
        of(name="packed", file_name="packed.ulg", make=packed),
    ]


def dataflash_examples() -> list[Example]:
    make = partial(dataflash_writer.write, FLIGHT)
    return [
        Example(
            name="simulated",
            file_name="flight.bin",
            make=make,
            flight=FLIGHT,
            official=official_readers.dataflash,
            records=record_places.dataflash,
        )
    ]


def dataflash_text_examples() -> list[Example]:
    return [
        Example(
            name="converted",
            file_name="flight.log",
            make=convert_to_text,
            flight=FLIGHT,
            official=official_readers.dataflash,
            records=record_places.lines,
        )
    ]


def convert_to_text(path: Path) -> None:
    """Write the simulated flight as ground stations convert it: a message a line."""
    from pymavlink.DFReader import DFReader_binary

    with tempfile.TemporaryDirectory() as folder:
        binary = Path(folder) / "flight.bin"
        dataflash_writer.write(FLIGHT, binary)
        reader = DFReader_binary(str(binary), zero_time_base=True)
        text = []
        while (message := reader.recv_msg()) is not None:
            values = (getattr(message, field) for field in message.get_fieldnames())
            text.append(", ".join([message.get_type(), *(_cell(value) for value in values)]))
        reader.close()
    path.write_text("\n".join(text) + "\n", encoding="utf-8")


def _cell(value: Any) -> str:
    return value.rstrip("\0") if isinstance(value, str) else repr(value)


def table_examples() -> list[Example]:
    of = partial(Example, official=official_readers.table, flight=FLIGHT)

    def parquet(path: Path) -> None:
        from fdilog.export import write_table
        from fdilog.sources.assembly import channel_table

        write_table(channel_table(FLIGHT).gyros, path)

    return [
        of(
            name="csv",
            file_name="flight.csv",
            make=partial(tabular_writer.write, FLIGHT),
            records=record_places.lines,
        ),
        of(name="parquet", file_name="flight.parquet", make=parquet, closed=True),
    ]


EXAMPLES: dict[str, Callable[[], Sequence[Example]]] = {
    "dataflash": dataflash_examples,
    "dataflash-text": dataflash_text_examples,
    "mcap": mcap_examples,
    "rosbag1": rosbag1_examples,
    "rosbag2": rosbag2_examples,
    "table": table_examples,
    "tlog": tlog_examples,
    "ulog": ulog_examples,
}
