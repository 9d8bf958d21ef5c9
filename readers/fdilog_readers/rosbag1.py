"""ROS 1 bags: indexed, not closed, and damaged.

A bag has no checksums. Chunks that the index knows are read with their own message indexes; what
it does not know is walked through record by record, and after damage the walk goes on at the next
record.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog_readers import chunks
from fdilog_readers.chunks import DamagedChunkError, ahead, reserve_heap
from fdilog_readers.columns import Bytes
from fdilog_readers.file_bytes import FileBytes, opened
from fdilog_readers.rosbag1_chunks import Piece, Place, chunk_place, load
from fdilog_readers.rosbag1_messages import Messages
from fdilog_readers.rosbag1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    LARGEST_HEADER,
    MAGIC,
    MESSAGE,
    DamagedRecordError,
    Record,
    number,
    parse_record,
)
from fdilog_readers.topics import Topics, utc_at_zero_ns

suffixes = (".bag", ".active")
description = "ROS 1 bags"

SEARCH_BYTES = 1 << 20
HEADER_BYTES = 4096
# What a record's header may hold before its field "op".
BEFORE_OP_BYTES = 64
OP_FIELD = b"\x04\x00\x00\x00op="


def sniff(head: bytes) -> bool:
    """Tell a bag by its first line."""
    return head.startswith(b"#ROSBAG V")


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read every gyro of a ROS 1 bag, and the topics named in ``also``.

    Raises
    ------
    UnreadableLogError
        If the file cannot be opened or is no bag of format 2.0.
    """
    topics = Topics(also)
    with opened(path) as data:
        first = data.at(0, len(MAGIC))
        if first != MAGIC:
            what = "a bag of another version" if sniff(first) else "no ROS 1 bag"
            raise UnreadableLogError(f"{path}: {what}: it begins with {first!r}")
        reserve_heap()
        bag = _Bag(data, topics)
        bag.take_all()
    streams = topics.streams()
    return Recording(
        path=str(path),
        format="rosbag1",
        bytes=data.size,
        streams=streams,
        problems=(*bag.problems, *topics.problems),
        utc_at_zero_ns=utc_at_zero_ns(streams),
    )


class _Bag:
    def __init__(self, data: FileBytes, topics: Topics) -> None:
        self.data = data
        self.problems: list[Problem] = []
        self.places: dict[int, Place] = {}
        self.passed_over = 0
        self.messages = Messages(topics, self.problems)
        self.end = data.size
        self._read_index()

    def take_all(self) -> None:
        for piece in ahead(self._pieces()):
            self._take(piece)
        if self.messages.finish():
            what = "this format has no checksums: damage inside messages cannot be seen"
            self.problems.append(Problem(what=what, note=True))
        if self.passed_over and self.messages.wanted:
            what = f"{self.passed_over} chunks without a gyro were not read, so not checked either"
            self.problems.append(Problem(what=what, note=True))

    def _record(self, at: int) -> Record:
        """Read a record's header; its places are those in the file."""
        try:
            record = parse_record(self.data.at(at, HEADER_BYTES))
        except DamagedRecordError:
            record = parse_record(self.data.at(at, LARGEST_HEADER + 8))
        return Record(record.opcode, record.header, at + record.data_at, record.data_length)

    def _read_index(self) -> None:
        """Read connections and places of chunks from the bag's end, if it was closed."""
        try:
            header = self._record(len(MAGIC)).header
            position = number(header, "index_pos")
            expected = number(header, "chunk_count"), number(header, "conn_count")
        except DamagedRecordError as error:
            what = f"the bag's own header is damaged: {error}"
            self.problems.append(Problem(what=what, offset=len(MAGIC)))
            return
        if position == 0:
            what = "the recording was not closed: it has no index"
            self.problems.append(Problem(what=what, offset=self.data.size))
            return
        try:
            places, connections = self._index_at(position)
            if (len(places), connections) != expected:
                raise DamagedRecordError("it is not complete")  # noqa: TRY301
        except DamagedRecordError as error:
            what = f"the index cannot be used ({error}); every record was read instead"
            self.problems.append(Problem(what=what, offset=min(position, self.data.size)))
            return
        self.end = position
        self.places = {place.start: place for place in places}

    def _index_at(self, position: int) -> tuple[list[Place], int]:
        found: list[tuple[Record, bytes]] = []
        connections = 0
        at = position
        if at >= self.data.size:
            raise DamagedRecordError("the file ends before it")
        while at < self.data.size:
            record = self._record(at)
            if record.end > self.data.size:
                raise DamagedRecordError("the file ends inside it")
            content = self.data.at(record.data_at, record.data_length)
            if record.opcode == CONNECTION:
                self.messages.connect(record.header, content)
                connections += 1
            elif record.opcode == CHUNK_INFO:
                found.append((record, content))
            else:
                raise DamagedRecordError("something else stands in it")
            at = record.end
        found.sort(key=lambda pair: number(pair[0].header, "chunk_pos"))
        starts = [number(record.header, "chunk_pos") for record, _ in found]
        return [
            chunk_place(record, content, end)
            for (record, content), end in zip(found, [*starts, position][1:], strict=True)
        ], connections

    def _pieces(self) -> Iterator[Callable[[], Piece]]:
        """Walk from the first record to the index, or to the end; say how to have each piece."""
        at = len(MAGIC)
        while at < self.end:
            if place := self.places.get(at):
                wanted = self.messages.wanted
                if wanted & place.counts.keys():
                    yield partial(load, self.data, at, place.end, place)
                else:
                    yield partial(Piece, at, place.end - at, place)
                at = place.end
                continue
            end, call = self._unknown(at)
            if call is not None:
                yield call
            at = end if end > at else self._resynchronise(at)

    def _unknown(self, at: int) -> tuple[int, Callable[[], Piece] | None]:
        """Say where what the index does not know ends, and how to have it; the same if nothing."""
        try:
            record = self._record(at)
        except DamagedRecordError:
            return at, None
        if record.opcode in {MESSAGE, CONNECTION}:
            end = self._end_of_loose(at)
            return end, partial(Piece, at, end - at) if end > at else None
        if record.opcode != CHUNK:
            return (record.end if record.end <= self.data.size else at), None
        end = min(record.end, self.data.size)
        if record.data_length == 0 and record.header.get("compression") != b"none":
            end = self.data.size  # its lengths would have been filled in when it was full
        if end == record.data_at:
            return end, None
        return end, partial(load, self.data, at, end, None)

    def _end_of_loose(self, at: int) -> int:
        """Step over messages that stand in no finished chunk."""
        while at < self.end:
            try:
                record = self._record(at)
            except DamagedRecordError:
                break
            if record.opcode not in {MESSAGE, CONNECTION} or record.end > self.data.size:
                break
            at = record.end
        return at

    def _resynchronise(self, at: int) -> int:
        """Find where records go on after damage, and say how much was lost."""
        found = min([start for start in self.places if start > at], default=self.end)
        start = at + 1
        while start < found:
            window = self.data.at(start, SEARCH_BYTES)
            place = self._first_record(window, start)
            if place is not None:
                found = min(found, place)
            if place is not None or len(window) < SEARCH_BYTES:
                break
            start += SEARCH_BYTES - 2 * BEFORE_OP_BYTES
        what = "a damaged part" if found < self.data.size else "the file ends inside a record"
        self.problems.append(Problem(what=what, offset=at, bytes_lost=found - at))
        return found

    def _first_record(self, window: bytes, start: int) -> int | None:
        """Return the first place in a window at which a whole record begins."""
        mark = window.find(OP_FIELD)
        while mark >= 0:
            for at in range(max(0, mark - BEFORE_OP_BYTES), mark - 3):
                try:
                    record = parse_record(memoryview(window)[at : at + HEADER_BYTES])
                except DamagedRecordError:
                    continue
                if self._is_record(start + at + record.end):
                    return start + at
            mark = window.find(OP_FIELD, mark + 1)
        return None

    def _is_record(self, at: int) -> bool:
        """Whether a record begins here, or the bag ends: what follows a real one."""
        if at == self.data.size:
            return True
        try:
            self._record(at)
        except DamagedRecordError:
            return False
        return True

    def _take(self, piece: Piece) -> None:
        place = piece.place
        if piece.records is not None:
            indexed = (
                place is not None
                and not piece.failure
                and self.messages.take_indexed(piece.records, piece.indexes, place.counts)
            )
            if not indexed:
                self.messages.take_records(piece.records, piece.start, piece.plain_at)
                if piece.head is not None and piece.has_false_index:
                    at = piece.start + piece.head.data_at + piece.head.data_length
                    self._index_damaged(piece, at)
        elif piece.head is None and not piece.failure:
            if place is not None:
                self.passed_over += 1
                self.messages.count(place.counts)
            else:
                self._take_windows(piece, self._loose(piece))
        elif piece.head is not None and not piece.failure:
            self._take_windows(piece, chunks.windows(self.data.file, piece.start, piece.head))
        if piece.failure:
            self._damaged(piece, piece.failure)
        if piece.index_damage >= 0:
            self._index_damaged(piece, piece.index_damage)

    def _damaged(self, piece: Piece, why: str) -> None:
        whole = piece.records is None
        problem = Problem(
            what=f"a chunk is damaged: {why}",
            offset=piece.start,
            bytes_lost=piece.length if whole else None,
            seconds_lost=piece.place.seconds if whole and piece.place else None,
        )
        self.problems.append(problem)

    def _index_damaged(self, piece: Piece, at: int) -> None:
        what = "message indexes are damaged; the messages were read one by one"
        lost = max(0, piece.start + piece.length - at)
        self.problems.append(Problem(what=what, offset=at, bytes_lost=lost))

    def _take_windows(self, piece: Piece, windows: Iterator[Bytes]) -> None:
        rest = np.empty(0, np.uint8)
        at = piece.start if piece.head is None else piece.plain_at
        try:
            for window in windows:
                records = np.concatenate([rest, window])
                left = self.messages.take_records(records, piece.start, at, final=False)
                at += 0 if at < 0 else len(records) - left
                rest = records[len(records) - left :]
                if len(rest) > chunks.LARGE_BYTES:
                    break
        except DamagedChunkError as error:
            self._damaged(piece, str(error))
        self.messages.take_records(rest, piece.start, at)

    def _loose(self, piece: Piece) -> Iterator[Bytes]:
        end = piece.start + piece.length
        for at in range(piece.start, end, chunks.WINDOW_BYTES):
            raw = self.data.at(at, min(chunks.WINDOW_BYTES, end - at))
            yield np.frombuffer(raw, np.uint8)
