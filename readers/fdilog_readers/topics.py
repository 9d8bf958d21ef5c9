"""From messages of many topics to streams: which are read, on which time, under which name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem, Stream
from fdilog_readers.columns import choose_time, plain_text
from fdilog_readers.gyro_search import Gyro, Stamp
from fdilog_readers.message_batch import Batch, Columns, Layout

# What other formats call the parts of an attitude.
ATTITUDE_NAMES = ("qw", "qx", "qy", "qz")

# In so many places of a log it is looked whether a topic holds a gyro after all.
PROBES = 10

UNIX_2000_NS = 946_684_800_000_000_000


@dataclass(frozen=True)
class Reading:
    """What to read of one message type, and how.

    Parameters
    ----------
    gyros
        The gyros in it.
    others
        Leaves that were asked for beside them.
    stamps
        Times that the message carries at its top, for a topic without a gyro.
    """

    layout: Layout
    gyros: tuple[Gyro, ...] = ()
    others: tuple[str, ...] = ()
    stamps: tuple[Stamp, ...] = ()

    @cached_property
    def every_stamp(self) -> tuple[Stamp, ...]:
        """Each time once."""
        found = [*self.stamps, *(stamp for gyro in self.gyros for stamp in gyro.stamps)]
        return tuple(dict.fromkeys(found))

    @cached_property
    def every_leaf(self) -> frozenset[str]:
        """The leaves that become columns; of a list of numbers the path of the list."""
        return frozenset((*(leaf for gyro in self.gyros for leaf in gyro.values), *self.others))


@dataclass(eq=False)
class Topic:
    """One topic while its log is being read."""

    name: str
    type: str
    reading: Reading | None = None
    count: int = 0
    tried: bool = False
    probe: Callable[[bytes], Reading | None] | None = None
    misfits: int = 0
    _probes: int = PROBES
    _pending: list[tuple[Batch, NDArray[np.int64]]] = field(default_factory=list)
    _pending_bytes: int = 0
    _pieces: list[Columns] = field(default_factory=list)

    @property
    def wanted(self) -> bool:
        """Whether its messages are read, or may be once the first has been seen."""
        return self.reading is not None or self.probe is not None

    def add(self, batch: Batch, times_ns: NDArray[np.int64]) -> None:
        """Take messages and the times at which they were recorded. [ns]"""
        if self.probe is not None and self.reading is None:
            self._look_at(batch, self.probe)
        if self.reading is None:
            return
        if self._pending and not self._pending[0][0].is_like(batch):
            self.decode()
        self._pending.append((batch, times_ns))
        self._pending_bytes += batch.rows.size
        if self._pending_bytes >= self.reading.layout.batch_bytes:
            self.decode()

    def _look_at(self, batch: Batch, probe: Callable[[bytes], Reading | None]) -> None:
        """Find out from messages what is in them; a list of sensors may be empty at first."""
        for row in sorted({0, len(batch) // 2, len(batch) - 1}):
            end = batch.lead + int(batch.lengths[row])
            self.reading = self.reading or probe(batch.rows[row, batch.lead : end].tobytes())
        self._probes -= 1
        if self.reading is not None or not self._probes:
            self.probe = None

    def decode(self) -> None:
        """Turn what has come together into columns."""
        if not self._pending:
            return
        batches, times = zip(*self._pending, strict=True)
        self._pending, self._pending_bytes = [], 0
        batch, times_ns = batches[0], times[0]
        if len(batches) > 1:
            batch = Batch(
                np.concatenate([b.rows for b in batches]),
                batch.lead,
                np.concatenate([b.lengths for b in batches]),
            )
            times_ns = np.concatenate(times)
        assert self.reading is not None  # noqa: S101  else nothing is pending
        columns, fits = self.reading.layout.columns(batch)
        piece: Columns = {"": times_ns}
        for stamp in self.reading.every_stamp:
            seconds, nanoseconds = columns.get(stamp.seconds), columns.get(stamp.nanoseconds)
            if seconds is not None and nanoseconds is not None:
                piece[f"@{stamp.name}"] = _whole(seconds) * 1_000_000_000 + _whole(nanoseconds)
        wanted = self.reading.every_leaf
        for leaf, values in columns.items():
            if leaf in wanted or (leaf[-1] == "]" and leaf.rpartition("[")[0] in wanted):
                piece[leaf] = values
        if not fits.all():
            self.misfits += int(np.count_nonzero(~fits))
            piece = {leaf: values[fits] for leaf, values in piece.items()}
        if len(piece[""]):
            self._pieces.append(piece)

    def mark(self) -> tuple[int, int]:
        """Remember how much there is, for ``roll_back``."""
        self.decode()
        return len(self._pieces), self.misfits

    def roll_back(self, mark: tuple[int, int]) -> None:
        """Forget what was added since."""
        self._pending, self._pending_bytes = [], 0
        pieces, self.misfits = mark
        del self._pieces[pieces:]

    def columns(self) -> Columns:
        """Join the pieces; the empty name is the time of recording, ``@`` begins a stamp's."""
        self.decode()
        lengths = [len(piece[""]) for piece in self._pieces]
        whole: Columns = {}
        for leaf in dict.fromkeys(leaf for piece in self._pieces for leaf in piece):
            parts = [
                piece.pop(leaf) if leaf in piece else np.full(n, np.nan)
                for piece, n in zip(self._pieces, lengths, strict=True)
            ]
            whole[leaf] = parts[0] if len(parts) == 1 else np.concatenate(parts)
        self._pieces = []
        return whole


class Topics:
    """All topics of a log.

    Parameters
    ----------
    also
        Topics whose numbers are wanted though they hold no gyro.
    """

    def __init__(self, also: Collection[str] = ()) -> None:
        self.also = {name.partition(":")[0] for name in also}
        self.topics: dict[tuple[str, str], Topic] = {}
        self.problems: list[Problem] = []

    def topic(self, name: str, type_name: str) -> Topic:
        """Return the topic of this name and type; a second type under one name is another topic."""
        name, type_name = plain_text(name), plain_text(type_name)
        key = (name, type_name)
        if key not in self.topics:
            taken = any(other == name for other, _ in self.topics)
            self.topics[key] = Topic(f"{name} [{type_name}]" if taken else name, type_name)
        return self.topics[key]

    def streams(self) -> tuple[Stream, ...]:
        """Make the streams, sorted by name, and add what was wrong to ``problems``."""
        found: list[Stream] = []
        for topic in self.topics.values():
            found += self._of_topic(topic)
        return tuple(sorted(found, key=lambda stream: stream.name))

    def _of_topic(self, topic: Topic) -> Iterable[Stream]:
        reading = topic.reading
        listed = Stream(name=topic.name, time_ns=np.empty(0, np.int64), count=topic.count)
        if reading is None:
            yield listed
            return
        columns = topic.columns()
        if topic.misfits:
            what = f"{topic.misfits} messages on {topic.name} do not fit their type {topic.type}"
            self.problems.append(Problem(what=what))
        others = {k: v for k, v in columns.items() if k and not k.startswith("@")}
        own = [gyro for gyro in reading.gyros if not gyro.owner]
        if not own and (reading.others or len(reading.gyros) == 0):
            time_ns, clock = _time(columns, reading.stamps)
            yield replace(listed, time_ns=time_ns, clock=clock, columns=others, count=-1)
        for gyro in reading.gyros:
            extra = others if gyro in own and reading.others else {}
            yield self._gyro_stream(topic, gyro, columns, extra)

    def _gyro_stream(self, topic: Topic, gyro: Gyro, columns: Columns, extra: Columns) -> Stream:
        prefix = f"{gyro.owner}." if gyro.owner else ""
        name = f"{topic.name}:{gyro.owner}" if gyro.owner else topic.name
        time_ns, clock = _time(columns, gyro.stamps)
        names = {leaf: leaf.removeprefix(prefix) for leaf in gyro.values}
        names |= dict(zip(gyro.attitude, ATTITUDE_NAMES, strict=False))
        units = dict.fromkeys(gyro.rate, "rad/s") | dict.fromkeys(gyro.accelerometer, "m/s^2")
        missing = np.full(len(time_ns), np.nan)
        kept = extra | {names[leaf]: columns.get(leaf, missing) for leaf in names}
        if not gyro.known_unit and len(time_ns):
            what = f"{name} ({topic.type}) tells no unit; rad/s and m/s^2 are assumed"
            self.problems.append(Problem(what=what, note=True))
        return Stream(
            name=name,
            time_ns=time_ns,
            columns=kept,
            units={names[leaf]: units.get(leaf, "1") for leaf in names},
            clock=clock,
            gyro=tuple(names[leaf] for leaf in gyro.rate),
            accelerometer=tuple(names[leaf] for leaf in gyro.accelerometer),
            origin=gyro.origin,
        )


def _whole(values: NDArray[Any]) -> NDArray[np.int64]:
    """Make integers of a part of a time: what is none, or beyond any calendar, becomes zero.

    Seconds beyond this would not fit in 64 bits once they are nanoseconds.
    """
    if values.dtype.kind in "iu" and values.dtype.itemsize <= 4:
        return values.astype(np.int64)
    with np.errstate(invalid="ignore"):
        whole: NDArray[np.int64] = values.astype(np.int64)
    return np.where((whole > -9 * 10**9) & (whole < 9 * 10**9), whole, 0)


def _time(columns: Columns, stamps: tuple[Stamp, ...]) -> tuple[NDArray[np.int64], str]:
    """Choose the nearest stamp that tells the time, else the time of recording."""
    record_ns = columns.get("", np.empty(0, np.int64))
    why = ""
    for stamp in stamps:
        if f"@{stamp.name}" in columns:
            stamp_ns = columns[f"@{stamp.name}"]
            time_ns, words = choose_time(stamp_ns, record_ns, stamp.name, "log time")
            if words == stamp.name:
                return time_ns, f"{words}{why}"
            why = why or words[len("log time") :]
    return record_ns, f"log time{why}"


def utc_at_zero_ns(streams: Iterable[Stream]) -> int | None:
    """Tell whether the times are UTC since 1970: simulated ones begin near zero. [ns]"""
    first = [int(stream.time_ns[0]) for stream in streams if len(stream.time_ns)]
    return 0 if first and min(first) > UNIX_2000_NS else None
