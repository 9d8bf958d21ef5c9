"""The messages of one MCAP file, sorted into topics.

Chunks are read ahead of their use and decompressed beside it; of each only the messages of topics
that hold a gyro are looked at, found by the chunk's own index where the file has one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from fdilog.recording import Problem
from fdilog_readers import chunks
from fdilog_readers.chunks import ChunkHead, DamagedChunkError, ahead, checksum, windows
from fdilog_readers.columns import Bytes, Offsets
from fdilog_readers.file_bytes import FileBytes
from fdilog_readers.mcap_chunks import Chunk, batches_at, load, message_heads
from fdilog_readers.mcap_records import (
    MESSAGE,
    RECORD,
    ChannelRecord,
    ChunkPlace,
    DamagedRecordError,
    MessageChain,
)
from fdilog_readers.mcap_scan import LONGEST_RECORD, Contents, Loose, is_known, walk
from fdilog_readers.message_reading import open_topic
from fdilog_readers.topics import Topic, Topics


class Messages:
    """Sorts the messages of one file into topics."""

    def __init__(self, topics: Topics, contents: Contents, data: FileBytes) -> None:
        self.topics = topics
        self.contents = contents
        self.data = data
        self.checked = self.unchecked = False
        self.passed_over = 0
        self._topic_of: dict[int, Topic] = {}
        self._counts: Counter[int] = Counter()
        for channel in list(contents.channels.values()):
            self._open(channel)

    def take_all(self) -> None:
        """Read the whole file."""
        for item in ahead(self._calls()):
            self._take(item)
        for number, count in self._counts.items():
            if number in self._topic_of:
                self._topic_of[number].count += count
        if self.passed_over and self._wanted:
            what = f"{self.passed_over} chunks without a gyro were not read, so not checked either"
            self.contents.problems.append(Problem(what=what, note=True))
        self._check_counts()
        self._check_data()

    def _open(self, channel: ChannelRecord) -> None:
        schema = self.contents.schemas.get(channel.schema)
        self._topic_of[channel.id] = open_topic(
            self.topics,
            channel.topic,
            schema.name if schema else "",
            message_encoding=channel.encoding,
            schema_encoding=schema.encoding if schema else "",
            definition=schema.data if schema else b"",
        )

    @property
    def _wanted(self) -> frozenset[int]:
        return frozenset(n for n, topic in self._topic_of.items() if topic.wanted)

    def _topic(self, number: int) -> Topic | None:
        if number not in self._topic_of and number in self.contents.channels:
            self._open(self.contents.channels[number])
        return self._topic_of.get(number)

    def _calls(self) -> Iterator[Callable[[], Chunk | Loose]]:
        """Say how each piece of the file is to be had."""
        for item in walk(self.data, self.contents):
            if isinstance(item, Loose):
                yield partial(_as_it_is, item)
            elif self._only_counted(item):
                yield partial(Chunk, item)
            else:
                topics = self._topics_in(item) if self._is_indexed(item) else ()
                yield partial(load, self.data.file, item, topics)

    def _topics_in(self, place: ChunkPlace) -> tuple[tuple[int, ...], ...]:
        """Return the channels of each topic that is wanted of a chunk."""
        found: dict[Topic, list[int]] = {}
        for number in sorted(self._wanted & place.indexes.keys()):
            found.setdefault(self._topic_of[number], []).append(number)
        return tuple(map(tuple, found.values()))

    def _is_indexed(self, place: ChunkPlace) -> bool:
        return bool(place.indexes) and place.indexes.keys() <= self._topic_of.keys()

    def _only_counted(self, place: ChunkPlace) -> bool:
        """Whether the index tells all that is wanted of a chunk: it holds no gyro."""
        return self._is_indexed(place) and not self._wanted & place.indexes.keys()

    def _take(self, item: Chunk | Loose) -> None:
        if isinstance(item, Loose):
            self.unchecked = True
            self._sort(item.records, item.offsets)
        else:
            self._take_chunk(item)

    def _take_chunk(self, item: Chunk) -> None:
        if item.failure:
            self._lost(item.place, item.failure)
        elif item.head is None:
            self.passed_over += 1
            self._counts.update(item.place.counts())
        elif item.records is None:
            self._take_large(item, item.head)
        elif item.batches is not None:
            for numbers, batches in item.batches.items():
                for times_ns, batch in batches:
                    self._topic_of[numbers[0]].add(batch, times_ns)
            self._counts.update(item.place.counts())
        elif self._take_records(item.records) < len(item.records):
            self._lost(item.place, "its records contradict each other")
        if item.head:
            self.checked |= item.head.crc != 0
            self.unchecked |= item.head.crc == 0
            if item.index_damage >= 0:
                self._index_lost(item.place, item.index_damage)

    def _lost(self, place: ChunkPlace, why: str) -> None:
        problem = Problem(
            what=f"a chunk is damaged: {why}",
            offset=place.start,
            bytes_lost=place.length,
            seconds_lost=place.seconds,
        )
        self.contents.problems.append(problem)

    def _index_lost(self, place: ChunkPlace, offset: int) -> None:
        what = "the message indexes behind a chunk are damaged; its records were read one by one"
        offset = min(max(offset, place.start), place.end)  # it may be the damaged number
        self.contents.problems.append(
            Problem(what=what, offset=offset, bytes_lost=max(0, place.end - offset))
        )

    def _take_records(self, records: Bytes) -> int:
        """Take records that lie end to end; return how many bytes of them make sense."""
        chain = MessageChain(records)
        at = 0
        while True:
            offsets, at = chain.follow(at)
            if at + RECORD.size > len(records):
                self._sort(records, offsets)
                return at
            opcode, length = RECORD.unpack_from(records.data, at)
            end = at + RECORD.size + length
            if not is_known(opcode) or length > LONGEST_RECORD:
                # Damage that no checksum shows may have begun inside the last message.
                at = int(offsets[-1]) if len(offsets) else at
                self._sort(records, offsets[:-1])
                return at
            self._sort(records, offsets)
            if opcode == MESSAGE or end > len(records):
                return at
            try:
                self.contents.define(opcode, records[at + RECORD.size : end].data)
            except DamagedRecordError:
                return at
            at = end

    def _take_large(self, chunk: Chunk, head: ChunkHead) -> None:
        """Take a chunk that is too large to have whole; forget it if it proves damaged."""
        marks = {topic: topic.mark() for topic in self.topics.topics.values()}
        counts = self._counts.copy()
        rest = np.empty(0, np.uint8)
        failure = ""
        try:
            for window in windows(self.data.file, chunk.place.start, head):
                records = np.concatenate([rest, window])
                rest = records[self._take_records(records) :]
                if len(rest) > chunks.LARGE_BYTES:
                    break
        except DamagedChunkError as error:
            failure = str(error)
        if failure or len(rest):
            self._lost(chunk.place, failure or "its records contradict each other")
            self._counts = counts
            for topic in self.topics.topics.values():
                topic.roll_back(marks.get(topic, (0, 0)))

    def _sort(self, records: Bytes, offsets: Offsets) -> None:
        """Hand messages of any channels to their topics."""
        heads = message_heads(records, offsets)
        if heads is None:
            return
        channels = heads.channels
        numbers, counts = np.unique(channels, return_counts=True)
        self._counts.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
        topics = {self._topic(number) for number in numbers.tolist()}
        for topic in topics:
            if topic and topic.wanted:
                own = [n for n in numbers.tolist() if self._topic_of.get(n) is topic]
                here = np.isin(channels, own)
                for times_ns, batch in batches_at(records, offsets[here], heads.select(here)):
                    topic.add(batch, times_ns)

    def _check_counts(self) -> None:
        """Compare with the recorder's own statistics, unless losses are known already."""
        strange = sum(n for number, n in self._counts.items() if number not in self._topic_of)
        if strange:
            what = f"{strange} messages are of channels that are defined nowhere"
            self.contents.problems.append(Problem(what=what))
        expected, found = sum(self.contents.counts.values()), sum(self._counts.values())
        losses = any(not problem.note for problem in self.contents.problems)
        if self.contents.counts and expected != found and not losses:
            what = f"the recorder counted {expected} messages, the file holds {found}"
            self.contents.problems.append(Problem(what=what))

    def _check_data(self) -> None:
        """Check the checksum over everything, where not every message has one of its own."""
        if not self.unchecked:
            return
        if not self.contents.data_crc:
            what = "some" if self.checked else "the"
            what += " messages have no checksum: damage inside them cannot be seen"
            self.contents.problems.append(Problem(what=what, note=True))
            return
        crc = 0
        for at in range(0, self.contents.data_end, chunks.LARGE_BYTES):
            crc = checksum(
                self.data.at(at, min(chunks.LARGE_BYTES, self.contents.data_end - at)), crc
            )
        if crc != self.contents.data_crc:
            what = "the checksum over all messages is wrong: some bytes are not as recorded"
            self.contents.problems.append(Problem(what=what))


def _as_it_is(item: Loose) -> Loose:
    return item
