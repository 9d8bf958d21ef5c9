"""The messages of one ROS 1 bag, sorted into topics."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem
from fdilog_readers.columns import Bytes, Offsets, rows
from fdilog_readers.message_batch import Batch, side_by_side
from fdilog_readers.message_reading import open_topic
from fdilog_readers.rosbag1_records import (
    CONNECTION,
    MESSAGE,
    CutRecordError,
    DamagedRecordError,
    Header,
    Heads,
    MessageChain,
    MessageShape,
    number,
    parse_header,
    parse_record,
    times_in,
)
from fdilog_readers.topics import Topic, Topics

# One recorder writes one shape of header; a bag put together by several has a few.
MOST_SHAPES = 8

Timed = tuple[NDArray[np.int64], Batch]


class Messages:
    """Sorts messages into topics by their connections."""

    def __init__(self, topics: Topics, problems: list[Problem]) -> None:
        self.topics = topics
        self.problems = problems
        self._topic_of: dict[int, Topic] = {}
        self._counts: Counter[int] = Counter()
        self._shapes: list[MessageShape] = []

    @property
    def wanted(self) -> frozenset[int]:
        """The connections whose messages are read."""
        return frozenset(n for n, topic in self._topic_of.items() if topic.wanted)

    def connect(self, header: Header, content: bytes | memoryview) -> None:
        """Take a Connection record: which topic a number means, and its type.

        Raises
        ------
        DamagedRecordError
            If it is not whole.
        """
        connection = number(header, "conn")
        if connection in self._topic_of:
            return
        fields = parse_header(content)
        if "type" not in fields or "topic" not in {*header, *fields}:
            raise DamagedRecordError("a connection lacks its topic or type")
        self._topic_of[connection] = open_topic(
            self.topics,
            header.get("topic", fields.get("topic", b"")).decode(errors="replace"),
            fields.get("type", b"").decode(errors="replace"),
            message_encoding="ros1",
            schema_encoding="ros1msg",
            definition=fields.get("message_definition", b""),
        )

    def count(self, counts: Mapping[int, int]) -> None:
        """Count messages that need not be looked at."""
        self._counts.update(counts)

    def finish(self) -> int:
        """Give every topic its count; return how many messages there are."""
        for connection, count in self._counts.items():
            if connection in self._topic_of:
                self._topic_of[connection].count += count
        strange = sum(n for c, n in self._counts.items() if c not in self._topic_of)
        if strange:
            what = f"{strange} messages are of connections that are defined nowhere"
            self.problems.append(Problem(what=what))
        return sum(self._counts.values())

    def take_indexed(
        self, records: Bytes, indexes: Mapping[int, NDArray[np.void]], counts: Mapping[int, int]
    ) -> bool:
        """Take the messages that a chunk's indexes name; nothing, if they do not hold true."""
        connections = self.wanted & counts.keys()
        if any(len(indexes.get(c, ())) != counts[c] for c in connections):
            return False
        if not self._lie_end_to_end(records, indexes):
            return False
        found: list[tuple[Topic, list[Timed]]] = []
        for topic in {self._topic_of[c] for c in connections}:
            own = [c for c in connections if self._topic_of[c] is topic]
            entries = indexes[own[0]]
            if len(own) > 1:
                entries = np.concatenate([indexes[c] for c in own])
            batches = self._at_entries(records, entries, own)
            if batches is None:
                return False
            found.append((topic, batches))
        for topic, batches in found:
            for times_ns, batch in batches:
                topic.add(batch, times_ns)
        self.count(counts)
        return True

    def _lie_end_to_end(self, records: Bytes, indexes: Mapping[int, NDArray[np.void]]) -> bool:
        """Tell whether all that the indexes name are messages, with but connections in between.

        Without checksums this alone shows damage to messages that are not looked at.
        """
        found = [entries["offset"].astype(np.int64) for entries in indexes.values() if len(entries)]
        offsets = np.sort(np.concatenate(found)) if found else np.empty(0, np.int64)
        shape = self._shape_at(records, int(offsets[0])) if len(offsets) else None
        if shape is None or offsets[-1] > len(records) - shape.lead:
            return False
        if not shape.begins_at(records, offsets).all():
            return False
        ends = np.concatenate([[0], offsets + shape.lead + shape.lengths_at(records, offsets)])
        starts = np.append(offsets, len(records))
        for k in np.flatnonzero(ends != starts):
            if not self._are_connections(records, int(ends[k]), int(starts[k])):
                return False
        return True

    def _are_connections(self, records: Bytes, at: int, end: int) -> bool:
        try:
            while at < end:
                record = parse_record(records.data, at)
                if record.opcode != CONNECTION:
                    return False
                at = record.end
        except DamagedRecordError:
            return False
        return at == end

    def _at_entries(
        self, records: Bytes, entries: NDArray[np.void], own: list[int]
    ) -> list[Timed] | None:
        """Copy the messages that an index names, in file order; None if it names anything else."""
        if not len(entries):
            return []
        offsets: Offsets = entries["offset"].astype(np.int64)
        if not (offsets[1:] > offsets[:-1]).all():
            order = np.argsort(offsets)
            entries, offsets = entries[order], offsets[order]
        shape = self._shape_at(records, int(offsets[0]))
        if shape is None or not (offsets[1:] > offsets[:-1]).all():
            return None
        if offsets[-1] > len(records) - shape.lead:
            return None
        one_length = _of_one_length(records, offsets, shape)
        rows_of = _heads(records, offsets, shape) if one_length is None else one_length.rows
        heads = shape.heads(rows_of)
        ends = offsets + shape.lead + heads.lengths
        if not (
            shape.begins(rows_of).all()
            and (heads.times_ns == times_in(entries)).all()
            and np.isin(heads.connections, own).all()
            and (ends <= len(records)).all()
        ):
            return None
        if one_length is not None and (heads.lengths == one_length.lengths[0]).all():
            return [(heads.times_ns, one_length)]
        return list(_batches(records, offsets, heads, shape))

    def _shape_at(self, records: Bytes, at: int) -> MessageShape | None:
        """Return the shape of the message record that begins at a place, if one does."""
        for shape in self._shapes:
            if shape.matches(records[at : at + shape.lead].data):
                return shape
        try:
            shape = MessageShape(records[at:].data)
        except DamagedRecordError:
            return None
        self._shapes = [shape, *self._shapes[: MOST_SHAPES - 1]]
        return shape

    def take_records(
        self, records: Bytes, start: int, plain_at: int = -1, *, final: bool = True
    ) -> int:
        """Take records that lie end to end, and go on behind damage.

        Parameters
        ----------
        start
            Where the chunk begins that they come from, for the list of problems. [byte]
        plain_at
            Where they stand in the file as they are, or -1. [byte]
        final
            Whether nothing follows them.

        Returns
        -------
        Bytes at the end that may be the beginning of a record.
        """
        chains: dict[MessageShape, MessageChain] = {}
        at = 0
        while at < len(records):
            step = self._step(records, at, chains)
            if step > at:
                at = step
                continue
            later = [chain.next_after(at + 1) for chain in chains.values()]
            found = min((place for place in later if place is not None), default=None)
            if found is None:
                if not final:
                    break
                found = len(records)
            what = "damaged messages"
            offset = start if plain_at < 0 else plain_at + at
            self.problems.append(Problem(what=what, offset=offset, bytes_lost=found - at))
            at = found
        return len(records) - at

    def _step(self, records: Bytes, at: int, chains: dict[MessageShape, MessageChain]) -> int:
        """Take what begins here; return where it ends, or the same place if nothing begins."""
        try:
            record = parse_record(records.data, at)
            if record.end > len(records):
                return at
            if record.opcode == CONNECTION:
                self.connect(record.header, records[record.data_at : record.end].data)
                return record.end
        except DamagedRecordError:
            return at
        shape = self._shape_at(records, at) if record.opcode == MESSAGE else None
        if shape is None:
            return at
        if shape not in chains:
            chains[shape] = shape.chain(records)
        offsets, end = chains[shape].follow(at)
        if len(offsets) and not _may_begin(records, end):
            # The damage may have begun inside the last message; nothing else would show it.
            offsets, end = offsets[:-1], int(offsets[-1])
        self._sort(records, offsets, shape)
        return end

    def _sort(self, records: Bytes, offsets: Offsets, shape: MessageShape) -> None:
        """Hand messages of any connections to their topics."""
        heads = shape.heads(_heads(records, offsets, shape))
        numbers, counts = np.unique(heads.connections, return_counts=True)
        self._counts.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
        for topic in {self._topic_of.get(n) for n in numbers.tolist()}:
            if topic is not None and topic.wanted:
                own = [n for n in numbers.tolist() if self._topic_of.get(n) is topic]
                here = np.isin(heads.connections, own)
                part = heads.select(here)
                for times_ns, batch in _batches(records, offsets[here], part, shape):
                    topic.add(batch, times_ns)


def _may_begin(records: Bytes, at: int) -> bool:
    """Whether a record begins here, or what is left may be the beginning of one."""
    try:
        parse_record(records.data, at)
    except CutRecordError:
        return True
    except DamagedRecordError:
        return False
    return True


def _heads(records: Bytes, offsets: Offsets, shape: MessageShape) -> Bytes:
    opaque = np.dtype((np.void, shape.lead))
    return rows(records, offsets, opaque).view(np.uint8).reshape(-1, shape.lead)


def _of_one_length(records: Bytes, offsets: Offsets, shape: MessageShape) -> Batch | None:
    """Copy messages as if all had the first one's length; None if they cannot have it."""
    lengths = records[int(offsets[0]) + shape.lead - 4 :][:4].view("<u4")
    if not len(lengths):
        return None
    width = -(-(shape.lead + int(lengths[0])) // 8) * 8
    if offsets[-1] > len(records) - width:
        return None
    found = rows(records, offsets, np.dtype((np.void, width))).view(np.uint8).reshape(-1, width)
    return Batch(found, shape.lead, np.full(len(found), lengths[0], np.int64))


def _batches(
    records: Bytes, offsets: Offsets, heads: Heads, shape: MessageShape
) -> Iterator[Timed]:
    for part, batch in side_by_side(records, offsets, shape.lead, heads.lengths):
        yield heads.times_ns[part], batch
