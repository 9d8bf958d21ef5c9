"""The SQLite files of ROS 2 bags: opened without ever writing beside or into them."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cached_property, partial
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem
from fdilog_readers.losses import PLACES_LISTED
from fdilog_readers.message_batch import Batch, side_by_side
from fdilog_readers.message_reading import open_topic
from fdilog_readers.rosbag2_last_page import mend
from fdilog_readers.rosbag2_pages import Leaves, place_of_row
from fdilog_readers.topics import Topic, Topics

MAGIC = b"SQLite format 3\x00"
HEAD_BYTES = 100
RESERVED_AT = 20
# So many rows of a sensor's size stay in the processor's cache while they are sorted.
ROWS_AT_ONCE = 2048
FIRST_ID = -(1 << 62)
MOST_ROWS = (1 << 63) - 1
# Beyond so many messages in a row that cannot be read, nothing more will come.
LONGEST_STRIDE = 1 << 32

# What SQLite has not yet worked into the file itself.
UNFINISHED = ("-wal", "-journal")


def read_into(topics: Topics, path: Path) -> list[Problem]:
    """Add the messages of one file to the topics, and return what was wrong with it.

    Raises
    ------
    UnreadableLogError
        If it is no ROS 2 bag, or so damaged that nothing can be had of it.
    """
    problems: list[Problem] = []
    try:
        with _opened(path, problems) as connection:
            _Messages(topics, connection, problems, path).take_all()
    except sqlite3.Error as error:
        raise UnreadableLogError(f"{path}: no ROS 2 bag can be read from it: {error}") from error
    except OSError as error:
        raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    return problems


@contextmanager
def _opened(path: Path, problems: list[Problem]) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; its folder need not be writable, and stays as it is."""
    with path.open("rb") as file:  # a clear error where it cannot be read at all
        head = file.read(HEAD_BYTES)
        size = file.seek(0, 2)
    if not head.startswith(MAGIC):
        raise UnreadableLogError(f"{path}: no SQLite file: it begins with {head[:8]!r}")
    head = head.ljust(HEAD_BYTES, b"\0")
    page_bytes, pages = struct.unpack(">H10xI", head[16:32])
    page_bytes = page_bytes if page_bytes > 1 else 65536
    missing = pages * page_bytes - size
    if missing > 0 and head[24:28] == head[92:96]:  # else the number of pages is out of date
        problems.append(Problem(what=f"{path.name} is cut", offset=size, bytes_lost=missing))
    elif missing < 0 and head[24:28] == head[92:96]:
        what = f"bytes behind the last page of {path.name}"
        problems.append(Problem(what=what, offset=size + missing, bytes_lost=-missing, note=True))
    beside = [path.with_name(path.name + suffix) for suffix in UNFINISHED]
    beside = [other for other in beside if other.is_file() and other.stat().st_size]
    if beside:
        what = f"{path.name} was not closed; what was left in {beside[0].name} was read too"
        problems.append(Problem(what=what, note=True))
    if not beside and size % page_bytes == 0:
        # Immutable: SQLite must not even look for a journal, or make a lock.
        with _connected(f"{path.absolute().as_uri()}?mode=ro&immutable=1") as connection:
            yield connection
        return
    with tempfile.TemporaryDirectory(prefix="fdilog-") as folder:
        for original in (path, *beside):
            shutil.copyfile(original, Path(folder) / original.name)
        if not beside:
            mend(Path(folder) / path.name, page_bytes, head[RESERVED_AT])
        with _connected((Path(folder) / path.name).as_uri()) as connection:
            yield connection


@contextmanager
def _connected(uri: str) -> Iterator[sqlite3.Connection]:
    with closing(sqlite3.connect(uri, uri=True)) as connection:
        # Nothing is written; but only with this does SQLite open a file that is cut.
        connection.execute("PRAGMA writable_schema = ON")
        yield connection


class _Messages:
    def __init__(
        self,
        topics: Topics,
        connection: sqlite3.Connection,
        problems: list[Problem],
        path: Path,
    ) -> None:
        connection.text_factory = partial(str, encoding="utf-8", errors="replace")
        self.connection = connection
        self._query = ""
        self.problems = problems
        self.path = path
        self.page_bytes = int(self._rows("PRAGMA page_size")[0][0])
        self.name = path.name
        # Of each stretch that is damaged: where it begins, the next row, and how many it has.
        self._disordered: list[tuple[int, int, int]] = []
        self._strange: list[tuple[int, int, int]] = []
        self._counts: Counter[int] = Counter()
        self._topic_of: dict[int, Topic] = {}
        definitions = self._definitions()
        for number, topic, kind, encoding in self._rows(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ):
            schema_encoding, definition = definitions.get(str(kind), ("ros2msg", ""))
            self._topic_of[int(number)] = open_topic(
                topics,
                str(topic),
                str(kind),
                message_encoding=str(encoding),
                schema_encoding=schema_encoding,
                definition=definition.encode(),
            )

    def _rows(self, query: str) -> list[Sequence[Any]]:
        return self.connection.execute(query).fetchall()

    def _definitions(self) -> dict[str, tuple[str, str]]:
        """Return the message definitions, which bags have since schema version 4."""
        if not self._rows("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"):
            return {}
        query = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
        return {str(kind): (str(way), str(text)) for kind, way, text in self._rows(query)}

    def take_all(self) -> None:
        """Read the messages in the order in which they were written."""
        numbers = ",".join(str(n) for n, topic in self._topic_of.items() if topic.wanted)
        self._query = (
            "SELECT id, COALESCE(CAST(topic_id AS INTEGER), 0),"  # noqa: S608  numbers only
            " COALESCE(CAST(timestamp AS INTEGER), 0), CASE WHEN topic_id IN"
            f" ({numbers}) THEN CASE typeof(data) WHEN 'blob' THEN data ELSE x'' END END"
            " FROM messages WHERE id > ? ORDER BY id"
        )
        last = FIRST_ID
        while True:
            try:
                cursor = self.connection.execute(self._query, (last,))
                while rows := cursor.fetchmany(ROWS_AT_ONCE):
                    last = self._take(rows, last)
                break
            except sqlite3.DatabaseError as error:
                behind = self._step_over(self._take_one_by_one(last), error)
                if behind is None:
                    break
                last = behind
        for number, topic in self._topic_of.items():
            topic.count += self._counts.pop(number, 0)
        self._tell(f"rows of {self.name} have impossible numbers", self._disordered)
        self._tell("messages are of topics that are defined nowhere", self._strange)

    def _tell(self, what: str, stretches: list[tuple[int, int, int]]) -> None:
        for first, following, count in stretches[:PLACES_LISTED]:
            self._lost(f"{count} {what}", first, following)
        if more := sum(count for _, _, count in stretches[PLACES_LISTED:]):
            self.problems.append(Problem(what=f"{more} more {what}"))

    def _lost(self, what: str, first: int, following: int) -> None:
        """Report damage between two rows: from the page of the one to that of the other."""
        start, end = self._place_of(first), self._place_of(following)
        lost = None if start is None or end is None else max(self.page_bytes, end - start)
        size = self.path.stat().st_size
        if start is not None and start >= size:  # cut off, and told
            start, lost = size, None
        self.problems.append(Problem(what=what, offset=start, bytes_lost=lost))

    def _place_of(self, row: int) -> int | None:
        """Return where a row's page begins, as far as the file alone can tell. [byte]"""
        try:
            ((root,),) = self._rows("SELECT rootpage FROM sqlite_master WHERE name = 'messages'")
            return place_of_row(self.path, self.page_bytes, int(root), row)
        except (sqlite3.Error, ValueError, UnreadableLogError):
            return None

    def _take_one_by_one(self, last: int) -> int:
        """Take the messages before a damaged place; return the last one's number."""
        rows: list[tuple[Any, ...]] = []
        try:
            cursor = self.connection.execute(self._query, (last,))
            while row := cursor.fetchone():
                rows.append(row)
        except sqlite3.DatabaseError:
            # Python steps on before it hands a row out: the one before the damage came to nothing.
            real = [row[0] for row in rows if row[0] <= self._last_id]
            before = self._reads(max([last, *real]))
            if before:
                rows.append(tuple(before))
        return self._take(rows, last) if rows else last

    def _step_over(self, last: int, error: sqlite3.Error) -> int | None:
        """Find the first message behind a damaged place, and say how many were lost."""
        if last == FIRST_ID:
            last = 0  # SQLite numbers from one
        good = self._first_readable(last)
        saved = self._save(last, self._last_id if good is None else good)
        lost = "" if saved else ", and so is the rest"
        if good is not None:
            lost = f"; {good - last - saved} messages are lost"
        if saved:
            lost += f"; {saved} were found on pages that nothing leads to"
        what = f"{self.name} is damaged ({error}){lost}"
        self._lost(what, last + 1, last + 1 if good is None else good)
        # Rows fill a page from its end: damage may begin inside the first that can be read again.
        return good

    def _save(self, last: int, most: int) -> int:
        """Take the rows behind one number and up to another whose pages are whole; say how many."""
        saved = 0
        for rows in self._leaves.rows(last, most):
            real = [row for row in rows if row[1] in self._topic_of]
            saved += len(real)
            last = self._take(real, last) if real else last
        return saved

    @cached_property
    def _leaves(self) -> Leaves:
        return Leaves.of(self.path, self.page_bytes)

    def _first_readable(self, last: int) -> int | None:
        """Try ever longer strides, then the ones between; None if nothing more can be had."""
        stride = 1
        while stride < LONGEST_STRIDE and not self._reads(last + stride):
            stride *= 2
        low, high = last + stride // 2, last + stride
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if self._reads(middle) else (middle, high)
        row = self._reads(high)
        return int(row[0]) if row else None

    @cached_property
    def _last_id(self) -> int:
        """Number of the last row, which no number that damage made up may exceed."""
        try:
            rows = self._rows("SELECT id FROM messages ORDER BY id DESC LIMIT 1")
        except sqlite3.DatabaseError:
            rows = []
        return int(rows[0][0]) if rows else MOST_ROWS

    def _reads(self, after: int) -> Sequence[Any] | None:
        """Read the first row behind a number, if one can be read that damage did not make up."""
        try:
            row: Sequence[Any] | None = self.connection.execute(
                f"{self._query} LIMIT 1", (after,)
            ).fetchone()
        except sqlite3.DatabaseError:
            return None
        real = row is not None and after < row[0] <= self._last_id and row[1] in self._topic_of
        return row if real else None

    def _take(self, rows: list[tuple[Any, ...]], last: int) -> int:
        """Take rows; return the last one's number, which never goes back.

        In a damaged file a number may be anything, and rows may come again without end.
        """
        ids, numbers, times, messages = zip(*rows, strict=True)
        unknown = not self._topic_of.keys() >= set(numbers)
        if unknown or ids[0] <= last or ids[-1] - ids[0] != len(ids) - 1:
            good = _in_order(np.array(ids, np.int64), last, self._last_id)
            if not good.all():
                good[1:] &= good[:-1].copy()  # see `_step_over`
                bad = np.flatnonzero(~good)
                before = int(ids[bad[0] - 1]) if bad[0] else last
                following = int(ids[bad[-1] + 1]) if bad[-1] + 1 < len(ids) else before + 1
                self._disordered.append((before + 1, following, len(bad)))
                rows = list(compress(rows, good.tolist()))
                return self._take(rows, last) if rows else last
        topic_ids = _integers(numbers)
        for number in np.unique(topic_ids).tolist():
            topic = self._topic_of.get(number)
            here = (topic_ids == number).tolist()
            self._counts[number] += sum(here)
            if topic is None:
                first = here.index(True)
                row = int(ids[first - 1] if first else last) + 1
                self._strange.append((row, int(ids[-1]), sum(here)))
            elif topic.wanted:
                times_ns = np.array(list(compress(times, here)), np.int64)
                self._add(topic, list(compress(messages, here)), times_ns)
        return int(ids[-1])

    def _add(self, topic: Topic, messages: list[bytes], times_ns: NDArray[np.int64]) -> None:
        lengths = np.fromiter(map(len, messages), np.int64, len(messages))
        buffer = np.frombuffer(b"".join(messages), np.uint8)
        if len(buffer) and (lengths == lengths[0]).all():
            topic.add(Batch(buffer.reshape(len(messages), -1), 0, lengths), times_ns)
            return
        starts = np.cumsum(lengths) - lengths
        for part, batch in side_by_side(buffer, starts, 0, lengths):
            topic.add(batch, times_ns[part])


def _in_order(ids: NDArray[np.int64], last: int, most: int) -> NDArray[np.bool_]:
    """Tell which rows are numbered after the last one, and before all that come behind them.

    Numbers that go on by one are believed before others: a recorder counts. What is larger than
    something behind it is out of place, not all that is behind it.
    """
    counted = np.diff(ids) == 1
    sure = np.append(counted, False) | np.append(False, counted)
    before = np.maximum.accumulate(np.append(last, np.where(sure, ids, last)[:-1]))
    after = np.where(sure, ids, MOST_ROWS)[:0:-1]
    after = np.minimum.accumulate(np.append(MOST_ROWS, after))[::-1]
    real = (ids > before) & (ids < after) & (ids <= most)
    smallest = np.minimum.accumulate(np.where(real, ids, MOST_ROWS)[::-1])[::-1]
    return real & (ids < np.append(smallest[1:], MOST_ROWS))


def _integers(values: tuple[int, ...]) -> NDArray[Any]:
    try:
        return np.frombuffer(bytes(values), np.uint8)  # several times faster, and nearly always
    except ValueError:
        return np.array(values, np.int64)
