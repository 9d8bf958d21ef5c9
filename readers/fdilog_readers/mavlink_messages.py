"""MAVLink messages as columns, and the clock they are put on."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem
from fdilog_readers.columns import SAME_CLOCK_NS, Offsets
from fdilog_readers.mavlink_dialect import Dialect
from fdilog_readers.mavlink_packets import NO_STAMP, PacketLog

Times = NDArray[np.int64]

SENSORS = {"RAW_IMU": 0, "SCALED_IMU": 0, "SCALED_IMU2": 1, "SCALED_IMU3": 2, "HIGHRES_IMU": 0}
BOOT_FIELDS = (("time_usec", 1000), ("time_boot_ms", 1_000_000))
SINCE_BOOT, RECEIVED = "time since boot", "receive stamp"
# No log pauses for a day and goes back again: a stamp so far from both its neighbours is damaged.
FAR_US = 86_400_000_000
# Stamps of 32 bits come round after 71.6 minutes; the receive stamps must agree that they did.
WRAP_US, SAME_STEP_US = 1 << 32, 10_000_000
MOST_STANDING = 0.5
ENOUGH_TO_COMPARE = 1000
# Half of what an int64 holds, so that differences of times do not overflow either: 146 years.
LATEST_NS = 2**62


@dataclass(eq=False)
class Messages:
    """All messages of one kind from one sender (and of one sensor), in file order.

    Parameters
    ----------
    kind, name
        The message, and the same with the sensor's number where a sender numbers its sensors.
    sensor
        That number, or what the message itself stands for; None for other than gyros.
    sender
        System times 256 plus component.
    offset : (n,)
        Byte of each packet's magic.
    stamp_ns : (n,)
        When each was received; zero where the log has no such stamps. [ns]
    columns, units
        The fields as they were sent, and the protocol's words for their units.
    time_ns, clock
        As in `Stream`; empty until `set_clocks`.
    """

    kind: str
    name: str
    sensor: int | None
    sender: int
    offset: Offsets
    stamp_ns: Times
    columns: dict[str, NDArray[Any]]
    units: dict[str, str]
    time_ns: Times = field(default_factory=lambda: np.empty(0, np.int64))
    clock: str = ""

    def chosen(self, mine: NDArray[np.bool_]) -> Messages:
        """Keep some of them."""
        if mine.all():
            return self
        return replace(
            self,
            offset=self.offset[mine],
            stamp_ns=self.stamp_ns[mine],
            columns={name: column[mine] for name, column in self.columns.items()},
        )

    def boot_ns(self) -> Times | None:
        """Time since boot that the messages carry, or None. [ns]"""
        for name, ns in BOOT_FIELDS:
            if name in self.columns:
                ticks = self.columns[name]
                if name == "time_usec":
                    ticks = self._unwrapped(ticks)
                whole: Times = np.minimum(ticks.astype(np.uint64), LATEST_NS // ns).astype(np.int64)
                return whole * ns
        return None

    def _unwrapped(self, time_us: NDArray[Any]) -> NDArray[Any]:
        """Go on counting where 32 bits of microseconds came round."""
        if not len(time_us) or int(time_us.max()) >= WRAP_US:
            return time_us
        wide: Times = time_us.astype(np.int64)
        step = np.diff(wide)
        late = np.abs(step + WRAP_US - np.diff(self.stamp_ns) // 1000) < SAME_STEP_US
        rounds: Times = np.concatenate([[0], np.cumsum((step < 0) & late)])
        return wide + WRAP_US * rounds


def messages_of(log: PacketLog, known: Dialect, notes: list[Problem]) -> list[Messages]:
    """Lay out the wanted packets of a log, by name and sender."""
    stamps = _believed(log, notes) if log.stamped else {}
    found: list[Messages] = []
    for number, packets in sorted(log.wanted.items()):
        layout = known.layout(number)
        stamp_ns = stamps.get(number, np.zeros(len(packets.offset), np.int64)) * 1000
        columns = dict(_fields(packets.payload, layout))
        for sender in np.flatnonzero(np.bincount(packets.sender)).tolist():
            everything = Messages(
                kind=known.name(number),
                name=known.name(number),
                sensor=SENSORS.get(known.name(number)),
                sender=sender,
                offset=packets.offset,
                stamp_ns=stamp_ns,
                columns=columns,
                units=dict(known.messages[number].fieldunits_by_name),
            )
            found += _instances(everything.chosen(packets.sender == sender))
    return found


def _instances(messages: Messages) -> Iterator[Messages]:
    """Split gyro messages by the sensor they are of."""
    first, which = messages.sensor, messages.columns.get("id")
    if first is None or which is None:
        yield messages
        return
    numbers = np.flatnonzero(np.bincount(which)).tolist()
    for number in numbers:
        part = messages.chosen(which == number)
        name = f"{messages.kind}[{number}]" if len(numbers) > 1 else messages.kind
        yield replace(part, name=name, sensor=first + number)


def _fields(
    payload: NDArray[np.uint8], layout: np.dtype[Any]
) -> Iterator[tuple[str, NDArray[Any]]]:
    """Split payloads into contiguous columns; an array gives one for each element."""
    table = payload.view(layout)[:, 0]
    for name in layout.names or ():
        column = table[name]
        if column.dtype.kind == "S":
            letters = column.copy().view(np.uint8).reshape(len(column), -1)
            letters *= np.logical_and.accumulate(letters != 0, axis=1)  # a text ends at a zero
            yield name, letters.view(column.dtype)[:, 0]
        elif column.ndim == 1:
            yield name, column.astype(column.dtype.newbyteorder("="))
        else:
            for k, element in enumerate(column.T):
                yield f"{name}[{k}]", element.astype(column.dtype.newbyteorder("="))


def _believed(log: PacketLog, notes: list[Problem]) -> dict[int, Times]:
    """Receive stamps by message id; a packet without one has that of the packet before it. [us]"""
    wanted = log.wanted
    if not any(_doubtful(packets.stamp_us).any() for packets in wanted.values()):
        return {number: packets.stamp_us for number, packets in wanted.items()}
    order = np.argsort(np.concatenate([p.offset for p in wanted.values()]), kind="stable")
    stamps = np.concatenate([p.stamp_us for p in wanted.values()])
    in_order = stamps[order]
    bad = _doubtful(in_order)
    good = np.flatnonzero(~bad)
    if not len(good):
        good = np.arange(len(bad))
    source = np.searchsorted(good, np.arange(len(bad)), side="right") - 1
    stamps[order] = in_order[good[np.maximum(source, 0)]]
    if bad.any():
        what = f"{int(bad.sum())} packets have no receive stamp, or a damaged one"
        notes.append(Problem(what=f"{what}; that of the packet before is taken", note=True))
    ends = np.cumsum([len(p.offset) for p in wanted.values()])
    return dict(zip(wanted, np.split(stamps, ends[:-1]), strict=True))


def _doubtful(stamp_us: Times) -> NDArray[np.bool_]:
    """Tell stamps that are missing, or far from both neighbours, which are near each other."""
    far = np.abs(np.diff(stamp_us)) > FAR_US
    doubtful: NDArray[np.bool_] = stamp_us == NO_STAMP
    doubtful[1:-1] |= far[:-1] & far[1:] & (np.abs(stamp_us[2:] - stamp_us[:-2]) <= FAR_US)
    return doubtful


def fleet(found: Iterable[Messages]) -> list[int]:
    """Senders of gyro messages, the busiest first; without any, the one that tells time most."""
    gyros: Counter[int] = Counter()
    others: Counter[int] = Counter()
    for messages in found:
        if any(name in messages.columns for name, _ in BOOT_FIELDS):
            count = gyros if messages.sensor is not None else others
            count[messages.sender] += len(messages.offset)
    ranked = sorted(gyros, key=lambda sender: (-gyros[sender], sender))
    return ranked or [sender for sender, _ in others.most_common(1)]


def set_clocks(found: list[Messages], senders: list[int], *, stamped: bool) -> Messages | None:
    """Give every message its time, each of the senders with a clock of its own.

    Time since boot is finer than the receive stamps and free of the link's delays; it is used if
    it tells time and is one clock in all gyro messages of a sender. What carries no time, or comes
    from others, is placed between the messages of its sender, or of the first of the senders, that
    do; those of the first are returned.
    """
    references = {}
    for sender in senders:
        mine = [m for m in found if m.sender == sender]
        references[sender] = _set_clock(mine, stamped=stamped)
    first = references[senders[0]] if senders else None
    for messages in found:
        if messages.clock:
            continue
        reference = references.get(messages.sender, first)
        if reference is None or reference.clock != SINCE_BOOT:
            messages.time_ns, messages.clock = messages.stamp_ns, RECEIVED
        else:
            messages.time_ns = _between(messages, reference, stamped=stamped)
            messages.clock = f"{SINCE_BOOT} of the {reference.name} before it"
            messages.clock += ", and receive stamp" if stamped else ""
    return first


def _set_clock(mine: list[Messages], *, stamped: bool) -> Messages:
    """Choose the clock of one sender; return the messages that tell it most often."""
    boots = {m.name: boot for m in mine if (boot := m.boot_ns()) is not None}
    timed = [m for m in mine if m.name in boots]
    gyros = [m for m in timed if m.sensor is not None] or timed
    reference = max(gyros, key=lambda m: len(m.offset))
    doubts = {m.name: _doubt(m, reference, boots) for m in timed}
    doubt = next((doubts[m.name] for m in gyros if doubts[m.name]), "") if stamped else ""
    for m in mine:
        if doubt:
            m.time_ns, m.clock = m.stamp_ns, f"{RECEIVED} ({doubt})"
        elif m.name in boots and not (stamped and doubts[m.name]):
            m.time_ns, m.clock = boots[m.name], SINCE_BOOT
    return reference


def _doubt(messages: Messages, reference: Messages, boots: Mapping[str, Times]) -> str:
    """Say why the time since boot of these messages is not that of the reference, or nothing."""
    boot_ns, reference_ns = boots[messages.name], boots[reference.name]
    if len(boot_ns) > 1 and float(np.mean(boot_ns[1:] == boot_ns[:-1])) > MOST_STANDING:
        return f"{SINCE_BOOT} stands still in {messages.name}"
    some = slice(None, None, max(len(boot_ns) // ENOUGH_TO_COMPARE, 1))
    before, after = _neighbours(messages.offset[some], reference.offset)
    # As floating point: two wild stamps may be further apart than an int64 reaches.
    low, high = reference_ns[before].astype(float), reference_ns[after].astype(float)
    apart_ns = np.maximum(low - boot_ns[some], boot_ns[some] - high)
    if float(np.median(apart_ns)) > SAME_CLOCK_NS:
        return f"{SINCE_BOOT} in {messages.name} is not that in {reference.name}"
    return ""


def _between(messages: Messages, reference: Messages, *, stamped: bool) -> Times:
    """Time of messages by those of the reference before and after them. [ns]"""
    before, after = _neighbours(messages.offset, reference.offset)
    since_ns = np.zeros(len(before), np.int64)
    if stamped:
        room_ns = reference.time_ns[after] - reference.time_ns[before]
        since_ns = messages.stamp_ns - reference.stamp_ns[before]
        since_ns = np.clip(since_ns, 0, np.where(after > before, np.maximum(room_ns, 0), LATEST_NS))
    return np.asarray(reference.time_ns[before] + since_ns)


def _neighbours(offset: Offsets, among: Offsets) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Which of some offsets, in order, lie just before and after each of others."""
    after = np.searchsorted(among, offset, side="right")
    return np.maximum(after - 1, 0), np.minimum(after, len(among) - 1)
