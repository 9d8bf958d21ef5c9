"""Everything a ULog says besides its data: formats, subscriptions, information, parameters."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fdilog_readers.columns import plain_text
from fdilog_readers.ulog_layout import (
    NAME,
    SYNC,
    BadDefinitionError,
    Field,
    Layout,
    Value,
    layout_of,
    parse_format,
    parse_value,
)

N_IDS = 1 << 16
ID_BYTES = 2
FLAG_BYTES, N_APPENDED = 8, 3
DATA_APPENDED = 1
LOG_LEVELS = range(ord("0"), ord("8"))


@dataclass(frozen=True, eq=False)
class Topic:
    """What a message id stands for.

    Parameters
    ----------
    name, instance
        Topic and number of its instance.
    layout
        None if the records cannot be read; then ``flaw`` says why.
    """

    name: str
    instance: int
    layout: Layout | None
    flaw: str = ""


class Definitions:
    """What the records that are no data have said so far.

    Attributes
    ----------
    topics
        By message id.
    least, most : (65536,)
        Shortest and longest body of a data record by message id; ``most`` is 0 where nothing
        describes it. [byte]
    revision
        Grows whenever these lengths change.
    dropouts
        Offset of the record, and milliseconds for which the logger lost data.
    appended
        Where data was appended after the log had been closed. [byte]
    flaws
        What is wrong with definitions, and where.
    """

    def __init__(self) -> None:
        self.formats: dict[str, tuple[Field, ...]] = {}
        self.topics: dict[int, Topic] = {}
        self.least = np.ones(N_IDS, np.uint16)
        self.most = np.zeros(N_IDS, np.uint16)
        self.revision = 0
        self.info: dict[str, Value] = {}
        self.parameters: dict[str, Value] = {}
        self.dropouts: list[tuple[int, int]] = []
        self.appended: list[int] = []
        self.counts: Counter[str] = Counter()
        self.flaws: list[tuple[int, str]] = []

    def fits(self, message_id: int, size: int) -> bool:
        """Whether a data record of this id can have a body of this length."""
        return bool(self.least[message_id] <= size <= self.most[message_id])

    def learn(self, message_id: int, size: int) -> None:
        """Take records of an id that nothing describes to be of one length."""
        flaw = "no subscription says what they are"
        self.topics.setdefault(message_id, Topic("", message_id, None, flaw))
        self._set_lengths(message_id, size, size)

    def take(self, kind: str, offset: int, body: bytes) -> None:
        """Read one record whose body is plausible, or whose type is not known."""
        self.counts[kind] += 1
        parsed = parse_format(body) if kind == "F" else None
        if parsed is not None:
            self.formats[parsed[0]] = parsed[1]
        elif kind == "A":
            self._subscribe(offset, body)
        elif kind in "IP":
            pair = parse_value(body)
            if pair is not None:
                (self.info if kind == "I" else self.parameters)[pair[0]] = pair[1]
        elif kind == "O":
            self.dropouts.append((offset, int.from_bytes(body, "little")))
        elif kind == "B":
            self._flags(offset, body)

    def _subscribe(self, offset: int, body: bytes) -> None:
        message_id, name = int.from_bytes(body[1:3], "little"), body[3:].decode()
        known = self.topics.get(message_id)
        if known is not None and known.name:
            if (known.name, known.instance) != (name, body[0]):
                self.flaws.append((offset, f"message id {message_id} is subscribed to twice"))
            return
        try:
            layout = layout_of(name, self.formats)
        except BadDefinitionError as error:
            self.topics[message_id] = Topic(name, body[0], None, str(error))
            return
        self.topics[message_id] = Topic(name, body[0], layout)
        self._set_lengths(message_id, ID_BYTES + layout.least, ID_BYTES + layout.most)

    def _set_lengths(self, message_id: int, least: int, most: int) -> None:
        self.least[message_id], self.most[message_id] = least, most
        self.revision += 1

    def _flags(self, offset: int, body: bytes) -> None:
        flags = body[FLAG_BYTES : 2 * FLAG_BYTES]
        if flags[0] & ~DATA_APPENDED or any(flags[1:]):
            what = "the log says that readers must know something that this one does not"
            self.flaws.append((offset, f"{what} (flags {flags.hex()}): it may be misread"))
        if flags[0] & DATA_APPENDED:
            offsets = struct.unpack_from(f"<{N_APPENDED}Q", body, 2 * FLAG_BYTES)
            self.appended = sorted(place for place in offsets if place)


def is_plausible(kind: str, body: bytes) -> bool:
    """Whether the body of a record is what its type must have."""
    return kind in PLAUSIBLE and PLAUSIBLE[kind](body)


def may_begin(kind: str, size: int, beginning: bytes) -> bool:
    """Whether the first bytes of a body are such as its type can have, the rest being cut off."""
    if kind in "LC":
        text_at = 9 if kind == "L" else 11
        return not beginning or (beginning[0] in LOG_LEVELS and _is_text(beginning[text_at:]))
    if kind in "IPMQ":
        key_at = 1 + (kind in "MQ")
        length = beginning[key_at - 1] if len(beginning) >= key_at else 0
        return _is_text(beginning[key_at : key_at + length])
    if kind in "FA":
        return _is_text(beginning[3 * (kind == "A") :])
    return SYNC.startswith(beginning) if kind == "S" else kind in "OR" and size == 2


def _is_text(body: bytes) -> bool:
    text = body.strip(b"\n\t\r\0").decode(errors="replace")
    return plain_text(text) == text


def _is_flags(body: bytes) -> bool:
    """Tell flags, of which no more than the first eight of each kind have a meaning so far."""
    rest = body[1:FLAG_BYTES] + body[FLAG_BYTES + 1 : 2 * FLAG_BYTES]
    return len(body) >= 2 * FLAG_BYTES + 8 * N_APPENDED and not any(rest)


def _is_subscription(body: bytes) -> bool:
    return len(body) > 3 and NAME.fullmatch(body[3:]) is not None


def _is_logged(body: bytes, text_at: int) -> bool:
    return len(body) > text_at and body[0] in LOG_LEVELS and _is_text(body[text_at:])


PLAUSIBLE: dict[str, Callable[[bytes], bool]] = {
    "A": _is_subscription,
    "B": _is_flags,
    "C": lambda body: _is_logged(body, 11),
    "F": lambda body: parse_format(body) is not None,
    "I": lambda body: parse_value(body) is not None,
    "L": lambda body: _is_logged(body, 9),
    "M": lambda body: parse_value(body[1:]) is not None,
    "O": lambda body: len(body) == 2,
    "P": lambda body: parse_value(body) is not None,
    "Q": lambda body: parse_value(body[1:]) is not None,
    "R": lambda body: len(body) == 2,
    "S": lambda body: body == SYNC,
}
