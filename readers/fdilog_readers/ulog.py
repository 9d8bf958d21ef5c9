"""PX4 ULog: gyros, attitude, and when the vehicle was armed.

sensor_gyro, sensor_gyro_fifo and vehicle_imu are gyros, and the instance of a topic is the sensor's
number; sensor_combined and vehicle_angular_velocity are what the autopilot selected and filtered
from them. Where a topic has several instances, a stream's name ends in its number
(``sensor_gyro[1]``). Every other topic is listed with its count, and read when it is asked for: its
columns then hold the numbers that the official reader gives.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording, Stream
from fdilog_readers import reported
from fdilog_readers.columns import Blocks, Offsets, rows
from fdilog_readers.ulog_definitions import ID_BYTES, Definitions
from fdilog_readers.ulog_framing import Batch, Framing
from fdilog_readers.ulog_layout import HEADER_BYTES, MAGIC
from fdilog_readers.ulog_topics import LOADED, Table, sensor_numbers, stream, vehicle

suffixes = (".ulg", ".ulog")
description = "PX4 ULog"

GPS = ("vehicle_gps_position", "sensor_gps")
FACTS = ("vehicle_status", *GPS)
ARMED = 2  # vehicle_status.arming_state
LOGGED_TEXTS = "logged messages"
KINDS = "BFIMPQADRLCSO"
MOST_LISTED = 100
NO_CHECKSUMS = Problem(
    what="no checksums in this format: damage inside a record cannot be seen", note=True
)


def sniff(head: bytes) -> bool:
    """Tell a log by its first bytes."""
    return MAGIC in head


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read gyros, attitude and what tells of the vehicle, and the topics in ``also``.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened, or no topic is described in it.
    """
    asked = {*LOADED, *(name.partition("[")[0] for name in also)}
    with Blocks(path) as blocks:
        framing = Framing(blocks)
        found = _Found({*asked, *FACTS})
        for batch in framing.batches():
            found.take(batch, framing.known)
        size = blocks.end
    known = framing.known
    if not known.topics:
        raise UnreadableLogError(
            f"{path}: no topic is described in its {size} bytes, so nothing says what they hold;"
            " either this is no ULog or its beginning is lost"
        )
    tables = found.tables(known)
    numbers = sensor_numbers(tables)
    instances = {(topic.name, topic.instance) for topic in known.topics.values() if topic.name}
    several = Counter(name for name, _ in instances)

    def title(name: str, instance: int) -> str:
        return f"{name}[{instance}]" if several[name] > 1 else name

    streams = [
        stream(table, title(table.name, table.instance), numbers.get((table.name, table.instance)))
        for table in tables
        if table.name in asked
    ]
    loaded = {one.name for one in streams}
    listed = {title(*key): count for key, count in found.listed(known).items()}
    listed[LOGGED_TEXTS] = known.counts["L"] + known.counts["C"]
    streams += [
        Stream(name=name, time_ns=np.empty(0, np.int64), count=count)
        for name, count in sorted(listed.items())
        if name not in loaded and count
    ]
    return Recording(
        path=str(path),
        format="ulog",
        bytes=size,
        streams=tuple(streams),
        problems=(*framing.problems, *found.problems(known), *_told_problems(known), NO_CHECKSUMS),
        vehicle=vehicle(known.info, known.parameters) or None,
        armed=_armed(tables),
        utc_at_zero_ns=_utc_at_zero(tables),
    )


class _Found:
    """What the batches held: records of the wanted topics, counts of all."""

    def __init__(self, wanted: set[str]) -> None:
        self.wanted = wanted
        self.parts: dict[int, list[tuple[Offsets, NDArray[Any]]]] = {}
        self.counts: Counter[int] = Counter()

    def take(self, batch: Batch, known: Definitions) -> None:
        """Copy the wanted records out of a batch."""
        counts = np.bincount(batch.ids)
        for message_id in np.flatnonzero(counts).tolist():
            self.counts[message_id] += int(counts[message_id])
            topic = known.topics[message_id]
            if topic.layout is None or topic.name not in self.wanted:
                continue
            offsets = batch.offsets[batch.ids == message_id]
            fields = rows(batch.buffer, offsets + HEADER_BYTES + ID_BYTES, topic.layout.dtype)
            self.parts.setdefault(message_id, []).append((batch.start + offsets, fields))

    def tables(self, known: Definitions) -> list[Table]:
        """Join the parts of each instance of a topic, in file order; the parts are gone then."""
        joined: dict[tuple[str, int], list[tuple[Offsets, NDArray[Any]]]] = {}
        for message_id in sorted(self.parts):
            topic = known.topics[message_id]
            joined.setdefault((topic.name, topic.instance), []).extend(self.parts.pop(message_id))
        tables = []
        for (name, instance), parts in sorted(joined.items()):
            offsets = np.concatenate([part for part, _ in parts])
            pieces = [part for _, part in parts]
            if (offsets[1:] < offsets[:-1]).any():  # two message ids stood for it
                order = np.argsort(offsets, kind="stable")
                offsets, pieces = offsets[order], [np.concatenate(pieces)[order]]
            tables.append(Table(name, instance, offsets, pieces))
        return tables

    def listed(self, known: Definitions) -> Counter[tuple[str, int]]:
        """Count the records of every instance of a topic."""
        counts: Counter[tuple[str, int]] = Counter()
        for message_id, count in self.counts.items():
            topic = known.topics[message_id]
            if topic.name:
                counts[topic.name, topic.instance] += count
        return counts

    def problems(self, known: Definitions) -> Iterator[Problem]:
        """Say which records cannot be read."""
        for message_id, count in sorted(self.counts.items()):
            topic = known.topics[message_id]
            if topic.layout is None:
                name = topic.name or f"message id {message_id}"
                yield Problem(
                    what=f"the {count} records of {name} cannot be read: {topic.flaw}",
                    bytes_lost=count * int(known.least[message_id] + HEADER_BYTES),
                    note=bool(topic.name) and topic.name not in LOADED,
                )


def _told_problems(known: Definitions) -> Iterator[Problem]:
    """Say what the log says of itself: dropouts, definitions that cannot be read."""
    for offset, milliseconds in known.dropouts[:MOST_LISTED]:
        what = f"the logger lost {milliseconds} ms of data (a dropout record)"
        yield Problem(what=what, offset=offset, seconds_lost=milliseconds / 1e3)
    more = known.dropouts[MOST_LISTED:]
    if more:
        what = f"{len(more)} more dropout records of the logger"
        lost_s = sum(milliseconds for _, milliseconds in more) / 1e3
        yield Problem(what=what, offset=more[0][0], seconds_lost=lost_s)
    for offset, what in known.flaws[:MOST_LISTED]:
        yield Problem(what=what, offset=offset)
    unknown = sum(count for kind, count in known.counts.items() if kind not in KINDS)
    if unknown:
        kinds = ", ".join(sorted(kind for kind in known.counts if kind not in KINDS))
        what = f"{unknown} records of types that are not known ({kinds})"
        yield Problem(what=what, note=True)


def _armed(tables: list[Table]) -> tuple[tuple[int, int], ...] | None:
    status = next((t for t in tables if t.name == "vehicle_status" and t.has("arming_state")), None)
    if status is None:
        return None
    last_ns = max(int(table.ns("timestamp")[-1]) for table in tables)
    armed = status.column("arming_state") == ARMED
    return reported.spans(status.ns("timestamp"), armed, last_ns)


def _utc_at_zero(tables: list[Table]) -> int | None:
    gps = [t for t in tables if t.name in GPS and t.has("time_utc_usec")]
    told = (reported.utc_at_zero(t.ns("time_utc_usec"), t.ns("timestamp")) for t in gps)
    return next((zero_ns for zero_ns in told if zero_ns is not None), None)
