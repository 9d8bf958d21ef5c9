"""What lies where in an MCAP file: its summary, and its data section record by record.

A chunk that the summary knows is stepped over in one stride; everything else is looked at, so a
file without an index, with a broken one, or with damage in the middle is read by the same walk.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from fdilog.recording import Problem
from fdilog_readers.chunks import checksum
from fdilog_readers.columns import Bytes, Offsets
from fdilog_readers.file_bytes import FileBytes, read_at
from fdilog_readers.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_FIELDS,
    MAGIC,
    MESSAGE,
    MESSAGE_FIELDS_BYTES,
    MESSAGE_INDEX,
    PRIVATE,
    RECORD,
    SCHEMA,
    STATISTICS,
    ChannelRecord,
    ChunkPlace,
    DamagedRecordError,
    MessageChain,
    SchemaRecord,
    parse_channel,
    parse_chunk_head,
    parse_chunk_index,
    parse_schema,
    parse_statistics,
)

LOOSE_BYTES = 4 << 20
SEARCH_BYTES = 1 << 20
HEAD_BYTES = 128

# A channel or schema record longer than this is no definition; the largest in use are below 1 MB.
DEFINITION_BYTES = 16 << 20

# A length of eight bytes that are anything else is nearly always more than this.
LONGEST_RECORD = 1 << 40


@dataclass
class Contents:
    """What is known of a file apart from its messages."""

    schemas: dict[int, SchemaRecord] = field(default_factory=dict)
    channels: dict[int, ChannelRecord] = field(default_factory=dict)
    places: dict[int, ChunkPlace] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    problems: list[Problem] = field(default_factory=list)
    data_crc: int = 0
    data_end: int = 0
    checked: bool | None = None
    """Whether chunks have checksums; None until one has been seen."""

    def define(self, opcode: int, content: bytes | memoryview) -> None:
        """Take a Schema or Channel record, which may stand at the top, in a chunk or at the end.

        Raises
        ------
        DamagedRecordError
            If its lengths contradict each other.
        """
        if opcode == SCHEMA:
            number, schema = parse_schema(content)
            self.schemas.setdefault(number, schema)
        elif opcode == CHANNEL:
            channel = parse_channel(content)
            self.channels.setdefault(channel.id, channel)


@dataclass(frozen=True, eq=False)
class Loose:
    """Messages that stand in no chunk."""

    records: Bytes
    offsets: Offsets


def read_summary(data: FileBytes) -> Contents:
    """Read what stands behind the data section, if the file was closed and it can be believed."""
    contents = Contents(data_end=data.size)
    footer_at = data.size - len(MAGIC) - RECORD.size - FOOTER_FIELDS.size
    tail = data.at(max(0, footer_at), data.size - max(0, footer_at))
    head = RECORD.pack(FOOTER, FOOTER_FIELDS.size)
    if footer_at < len(MAGIC) or not (tail.startswith(head) and tail.endswith(MAGIC)):
        what = "the recording was not closed or is cut: it has no footer"
        contents.problems.append(Problem(what=what, offset=data.size))
        return contents
    start, _, crc = FOOTER_FIELDS.unpack_from(tail, RECORD.size)
    if start == 0:
        contents.problems.append(
            Problem(what="the recording has no index; every record was read", note=True)
        )
        return contents
    if not len(MAGIC) <= start <= footer_at:
        what = f"the footer says that the index begins at byte {start}"
        contents.problems.append(Problem(what=what, offset=footer_at))
        return contents
    summary = data.at(start, footer_at - start)
    covered = RECORD.size + FOOTER_FIELDS.size - 4
    if crc and checksum(tail[:covered], checksum(summary)) != crc:
        what = "the index's checksum is wrong; every record was read instead"
        contents.problems.append(Problem(what=what, offset=start, bytes_lost=len(summary)))
        return contents
    trusted = Contents(data_end=start)
    try:
        _parse_summary(trusted, memoryview(summary))
    except DamagedRecordError as error:
        what = f"the index is damaged ({error}); every record was read instead"
        contents.problems.append(Problem(what=what, offset=start, bytes_lost=len(summary)))
        return contents
    return trusted


def _parse_summary(contents: Contents, summary: memoryview) -> None:
    at = 0
    while at < len(summary):
        if at + RECORD.size > len(summary):
            raise DamagedRecordError("it is cut")
        opcode, length = RECORD.unpack_from(summary, at)
        at += RECORD.size
        if length > len(summary) - at:
            raise DamagedRecordError("a record in it is longer than it")
        content = summary[at : at + length]
        at += length
        if opcode == CHUNK_INDEX:
            place = parse_chunk_index(content)
            contents.places[place.start] = place
        elif opcode == STATISTICS:
            contents.counts = parse_statistics(content)
        else:
            contents.define(opcode, content)


def walk(data: FileBytes, contents: Contents) -> Iterator[ChunkPlace | Loose]:
    """Yield the data section's chunks, and its messages outside of chunks, in file order.

    Definitions met on the way go into ``contents``, damage into its problems.
    """
    at = len(MAGIC)
    while at < contents.data_end:
        if place := contents.places.get(at):
            yield place
            at = place.end
            continue
        head = data.at(at, RECORD.size)
        opcode, length = RECORD.unpack(head) if len(head) == RECORD.size else (0, 0)
        end = at + RECORD.size + length
        if opcode == DATA_END and length == 4:
            contents.data_crc = int.from_bytes(data.at(at + RECORD.size, 4), "little")
            contents.data_end = at
            return
        if opcode == MESSAGE and length >= MESSAGE_FIELDS_BYTES and end <= data.size:
            records = data.at(at, max(LOOSE_BYTES, RECORD.size + length))
            buffer = np.frombuffer(records, np.uint8)
            offsets, taken = MessageChain(buffer).follow(0)
            if _is_confirmed(data, at + taken):
                yield Loose(buffer, offsets)
                at += taken
            else:  # the damage may have begun inside the last message
                yield Loose(buffer, offsets[:-1])
                at = _resynchronise(data, contents, at + int(offsets[-1]))
        elif opcode == CHUNK and _is_chunk(data, contents, at) and end <= data.size:
            yield ChunkPlace(at, RECORD.size + length)
            at = end
        elif opcode not in {MESSAGE, CHUNK, DATA_END} and is_known(opcode) and end <= data.size:
            _look_at(data, contents, at, opcode, length)
            at = end
        else:
            at = _resynchronise(data, contents, at)


def is_known(opcode: int) -> bool:
    """Whether the format has such a record, or allows one."""
    return 0 < opcode <= DATA_END or opcode >= PRIVATE


def _is_chunk(data: FileBytes, contents: Contents, at: int) -> bool:
    try:
        head = parse_chunk_head(data.at(at, HEAD_BYTES))
    except DamagedRecordError:
        return False
    contents.checked = bool(contents.checked or head.crc)
    return True


def _look_at(data: FileBytes, contents: Contents, at: int, opcode: int, length: int) -> None:
    if opcode >= PRIVATE:
        what = f"a record of the unknown kind {opcode:#04x} was passed over"
        contents.problems.append(
            Problem(what=what, offset=at, bytes_lost=RECORD.size + length, note=True)
        )
    elif opcode in {SCHEMA, CHANNEL} and length <= DEFINITION_BYTES:
        try:
            contents.define(opcode, data.at(at + RECORD.size, length))
        except DamagedRecordError as error:
            what = f"a definition is damaged: {error}"
            contents.problems.append(Problem(what=what, offset=at, bytes_lost=length))


def _resynchronise(data: FileBytes, contents: Contents, at: int) -> int:
    """Find where records go on after damage, and say how much was lost.

    Where chunks have checksums, messages that are found in what may be the rest of one are not
    believed: nothing tells that they are whole.
    """
    if contents.checked is None:
        first = next(iter(contents.places), None)
        if first is None:
            first = _search(data, contents, at, (CHUNK,))
        contents.checked = False
        if first is not None:
            _is_chunk(data, contents, first)
    ends = (CHUNK, MESSAGE_INDEX, DATA_END, FOOTER)
    place = _search(data, contents, at, ends if contents.checked else (MESSAGE, *ends))
    known = [start for start in contents.places if start > at]
    found = min([place or data.size, contents.data_end, *known])
    what = "a damaged part" if found < data.size else "the file ends inside a record"
    contents.problems.append(Problem(what=what, offset=at, bytes_lost=found - at))
    return found


def _search(data: FileBytes, contents: Contents, at: int, kinds: tuple[int, ...]) -> int | None:
    """Return the next place at which a record of one of these kinds surely begins."""
    start = at + 1
    while start < contents.data_end:
        window = np.frombuffer(data.at(start, SEARCH_BYTES), np.uint8)
        place = _first_record(data, contents, window, start, kinds)
        if place is not None or len(window) < SEARCH_BYTES:
            return place
        start += len(window) - 64  # a record's beginning may lie across two windows
    return None


def _first_record(
    data: FileBytes, contents: Contents, window: Bytes, start: int, kinds: tuple[int, ...]
) -> int | None:
    """Return the first place in a window at which a record surely begins.

    Chunks, message indexes and the ends carry their length twice; a message must be of a known
    channel and be followed by another record.
    """
    room = max(0, len(window) - RECORD.size)
    places = np.flatnonzero(np.isin(window[:room], np.array(kinds, np.uint8)))
    if not len(places):
        return None
    lengths = np.ndarray((room,), "<u8", window, 1, (1,))[places]
    inside = lengths <= np.uint64(max(0, data.size - start))
    candidates: list[tuple[int, int]] = list(
        zip(places[inside].tolist(), lengths[inside].tolist(), strict=True)
    )
    for offset, length in candidates:
        at = start + offset
        end = at + RECORD.size + length
        if end <= data.size and _surely(data, contents, int(window[offset]), at, end):
            return at
    return None


def _surely(data: FileBytes, contents: Contents, opcode: int, at: int, end: int) -> bool:
    length = end - at - RECORD.size
    head = read_at(data.file, HEAD_BYTES, at)
    if opcode == CHUNK:
        try:
            parse_chunk_head(head)
        except DamagedRecordError:
            return False
        return True
    if opcode == MESSAGE_INDEX:
        entries = int.from_bytes(head[11:15], "little")
        return length == 6 + entries and entries % 16 == 0 and _follows(data, end)
    if opcode == MESSAGE:
        channel = int.from_bytes(head[9:11], "little")
        known = channel in contents.channels
        return length >= MESSAGE_FIELDS_BYTES and known and _follows(data, end)
    return length == (4 if opcode == DATA_END else FOOTER_FIELDS.size) and _follows(data, end)


def _is_confirmed(data: FileBytes, at: int) -> bool:
    """Whether what begins here says that the record before it ended well: a record, or a cut."""
    head = data.at(at, RECORD.size)
    if len(head) < RECORD.size or head == MAGIC:
        return True
    opcode, length = RECORD.unpack(head)
    return is_known(opcode) and length <= LONGEST_RECORD


def _follows(data: FileBytes, at: int) -> bool:
    """Whether a record may begin here: a known opcode and a length that fits; or the end."""
    head = read_at(data.file, RECORD.size, at)
    if head == MAGIC or not head:
        return True
    if len(head) < RECORD.size:
        return False
    opcode: int
    length: int
    opcode, length = RECORD.unpack(head)
    return 0 < opcode <= DATA_END and at + RECORD.size + length <= data.size
