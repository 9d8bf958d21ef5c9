"""What is known of MAVLink messages: lengths, layouts and checksums, as tables over the id."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

V1, V2 = 0xFE, 0xFD
HEADER_V1, HEADER_V2 = 6, 10
CHECKSUM_BYTES = 2
SIGNED = 1  # the only incompatibility flag that there is
SIGNATURE_BYTES = 13
LONGEST_PACKET = HEADER_V2 + 255 + CHECKSUM_BYTES + SIGNATURE_BYTES
UNKNOWN_ID = 1 << 16  # stands for every id beyond: no dialect has any there
POLYNOMIAL = 0x8408  # x^16 + x^12 + x^5 + 1, least significant bit first


@dataclass(frozen=True, eq=False)
class Dialect:
    """All known messages as tables; row 0 stands for every message that is not known.

    Parameters
    ----------
    messages
        The generated class of each message id.
    row : (65537,) int16
        Row of a message id.
    ids, size, base, extra : (n_messages + 1,)
        Id, length of the whole payload and of its part that MAVLink 1 has too, and the seed that
        the message adds to its checksum.
    """

    messages: dict[int, Any]
    row: NDArray[np.int16]
    ids: NDArray[np.int64]
    size: NDArray[np.int64]
    base: NDArray[np.int64]
    extra: NDArray[np.uint16]

    def row_of(self, message_id: int) -> int:
        """Row of one message id."""
        return int(self.row[min(message_id, UNKNOWN_ID)])

    def id_of(self, name: str) -> int | None:
        """Id of the message of that name."""
        return next((k for k, message in self.messages.items() if message.msgname == name), None)

    def name(self, message_id: int) -> str:
        """Name of a message, or one made of its number."""
        message = self.messages.get(message_id)
        return str(message.msgname) if message else f"UNKNOWN_{message_id}"

    def layout(self, message_id: int) -> np.dtype[Any]:
        """Lay out the whole payload of a message as it goes over the wire."""
        message = self.messages[message_id]
        fields: list[tuple[Any, ...]] = []
        for name, code, length in zip(
            message.ordered_fieldnames,
            message.native_format.decode()[1:],
            message.array_lengths,
            strict=True,
        ):
            if code == "c":
                fields.append((name, f"S{length or 1}"))
            elif length:
                fields.append((name, f"<{code}", (length,)))
            else:
                fields.append((name, f"<{code}"))
        return np.dtype(fields)


@cache
def dialect() -> Dialect:
    """Compile the messages that pymavlink knows in any of its dialects."""
    from pymavlink.dialects.v20 import all as generated

    messages: dict[int, Any] = dict(sorted(generated.mavlink_map.items()))
    row = np.zeros(UNKNOWN_ID + 1, np.int16)
    row[list(messages)] = np.arange(1, len(messages) + 1)
    return Dialect(
        messages=messages,
        row=row,
        ids=np.array([-1, *messages]),
        size=np.array([-1, *(m.unpacker.size for m in messages.values())]),
        base=np.array([-1, *(_base_size(m, generated.x25crc) for m in messages.values())]),
        extra=np.array([0, *(m.crc_extra for m in messages.values())], np.uint16),
    )


def _base_size(message: Any, x25: Any) -> int:
    """Length of a payload without the fields that MAVLink 2 added.

    The generated classes do not say which fields these are, but the seed does: it is made of the
    names and types of the fields before them.
    """
    types = dict(zip(message.fieldnames, message.fieldtypes, strict=True))
    checksum = x25(f"{message.msgname} ".encode())
    size = base = 0
    for name, code, length in zip(
        message.ordered_fieldnames,
        message.native_format.decode()[1:],
        message.array_lengths,
        strict=True,
    ):
        checksum.accumulate(f"{types[name]} {name} ".encode() + bytes([length])[: bool(length)])
        size += np.dtype(code).itemsize * (length or 1)
        if (checksum.crc & 0xFF) ^ (checksum.crc >> 8) == message.crc_extra:
            base = size
    return base


@cache
def _checksum_steps() -> tuple[NDArray[np.uint16], NDArray[np.uint16]]:
    """Checksum after 8 and after 16 more bits, by what it was XOR those bits."""
    one = np.arange(256, dtype=np.uint16)
    for _ in range(8):
        one = np.where(one & 1, (one >> 1) ^ POLYNOMIAL, one >> 1).astype(np.uint16)
    two = np.arange(1 << 16, dtype=np.uint32).astype(np.uint16)
    for _ in range(2):
        two = (two >> 8) ^ one[two & 0xFF]
    return one, two


def checksum(covered: bytes, extra: int) -> int:
    """Checksum of one packet, as `checksums`, without the cost of doing many at once."""
    from pymavlink.dialects.v20.all import x25crc

    return int(x25crc(covered + bytes([extra])).crc)


def checksums(
    rows: NDArray[np.uint8], covered: NDArray[np.int64], extra: NDArray[np.uint16]
) -> NDArray[np.uint16]:
    """Checksums (X.25 with the message's own seed) of many packets, the longest first.

    Parameters
    ----------
    rows : (n_packets, n_bytes)
        The header without its magic byte, the payload, and whatever follows.
    covered : (n_packets,)
        How many of these bytes a checksum covers; must not increase. [byte]
    extra : (n_packets,)
        Seed of each packet's message.
    """
    one, two = _checksum_steps()
    state = np.full(len(rows), 0xFFFF, np.uint16)
    words = rows[:, : rows.shape[1] & ~1].view("<u2")
    n_words = covered >> 1
    n_rows = np.searchsorted(-n_words, -np.arange(n_words.max(initial=0)))
    for k, n in enumerate(n_rows.tolist()):
        state[:n] = two.take(state[:n] ^ words[:n, k], mode="wrap")
    odd = np.flatnonzero(covered & 1)
    last = rows[odd, covered[odd] - 1]
    state[odd] = (state[odd] >> 8) ^ one[(state[odd] ^ last) & 0xFF]
    checked: NDArray[np.uint16] = (state >> 8) ^ one[(state ^ extra) & 0xFF]
    return checked
