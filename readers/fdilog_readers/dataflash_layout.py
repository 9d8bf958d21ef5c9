"""What one DataFlash record holds: the FMT record that says so, as a NumPy layout.

A log describes itself. Each record begins with ``A3 95`` and a type number; an FMT record (type
128) tells the name, length, field characters and field names of one type.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import plain_text

MAGIC = b"\xa3\x95"
HEADER = 3
FMT_TYPE = 128
FMT_LENGTH = 89

# Character of a field: its bytes, and what the number must be divided by (ArduPilot's LogStructure;
# dividing by 100, not multiplying by 0.01, is also what the official reader does, to the last bit).
FIELDS: dict[str, tuple[str, float | None]] = {
    "a": ("(32,)<i2", None),
    "b": ("i1", None),
    "B": ("u1", None),
    "g": ("<f2", None),
    "h": ("<i2", None),
    "H": ("<u2", None),
    "i": ("<i4", None),
    "I": ("<u4", None),
    "f": ("<f4", None),
    "d": ("<f8", None),
    "n": ("S4", None),
    "N": ("S16", None),
    "Z": ("S64", None),
    "c": ("<i2", 1 / 0.01),
    "C": ("<u2", 1 / 0.01),
    "e": ("<i4", 1 / 0.01),
    "E": ("<u4", 1 / 0.01),
    "L": ("<i4", 1 / 1e-7),
    "M": ("i1", None),
    "q": ("<i8", None),
    "Q": ("<u8", None),
}


class BadFormatError(ValueError):
    """An FMT record that cannot be one; the text says why."""


@dataclass(frozen=True)
class Layout:
    """One type of record, as its FMT record has it.

    Parameters
    ----------
    length
        Of the whole record, header and all. [byte]
    format
        One character per field.
    fields
        Field names, as many as there are characters; made visible and unique.
    flaw
        Why the fields cannot be read although the length is known, else empty.
    """

    type: int
    name: str
    length: int
    format: str
    fields: tuple[str, ...]
    flaw: str = ""

    @cached_property
    def dtype(self) -> np.dtype[Any]:
        """The record, header and all; without fields if it has a flaw."""
        if self.flaw:
            return np.dtype({"names": [], "formats": [], "offsets": [], "itemsize": self.length})
        formats = [np.dtype(FIELDS[character][0]) for character in self.format]
        offsets = np.cumsum([HEADER, *(item.itemsize for item in formats)])[:-1]
        return np.dtype(
            {
                "names": list(self.fields),
                "formats": formats,
                "offsets": offsets.tolist(),
                "itemsize": self.length,
            }
        )

    def character(self, field: str) -> str:
        """Return the field character of a field, empty if there is no such field."""
        return self.format[self.fields.index(field)] if field in self.fields else ""


FMT = Layout(FMT_TYPE, "FMT", FMT_LENGTH, "BBnNZ", ("Type", "Length", "Name", "Format", "Columns"))


def parse_fmt(record: bytes) -> Layout:
    """Read one FMT record of 89 bytes, header and all.

    Raises
    ------
    BadFormatError
        If no length of a record can be had from it.
    """
    kind, length = record[3], record[4]
    name = plain_text(record[5:9]) or f"type {kind}"
    format_ = plain_text(record[9:25])
    if length < HEADER:
        raise BadFormatError(f"it gives {name} a length of {length} bytes")
    if kind == FMT_TYPE:
        if length != FMT_LENGTH:
            raise BadFormatError(f"it gives FMT itself a length of {length} bytes")
        return FMT
    fields = field_names(plain_text(record[25:89]), len(format_))
    return Layout(kind, name, length, format_, fields, _flaw(format_, length))


def is_fmt(record: bytes) -> bool:
    """Tell whether the bytes can be nothing but an FMT record, wherever they were found.

    ``A3 95 80`` also occurs by chance: a record is believed without its neighbours only if its
    strings are what firmware writes and its fields fill the length exactly.
    """
    if len(record) < FMT_LENGTH or not record.startswith(MAGIC + bytes([FMT_TYPE])):
        return False
    strings = (record[5:9], record[9:25], record[25:89])
    for string in strings:
        text, _, rest = string.partition(b"\0")
        if rest.strip(b"\0") or not text.decode("latin-1").isprintable() or not text.isascii():
            return False
    return bool(strings[0].strip(b"\0")) and not _flaw(plain_text(strings[1]), record[4])


def _flaw(format_: str, length: int) -> str:
    unknown = [character for character in format_ if character not in FIELDS]
    if unknown:
        return f"its format '{format_}' has a field of unknown kind '{unknown[0]}'"
    made = HEADER + sum(np.dtype(FIELDS[character][0]).itemsize for character in format_)
    return f"its fields make {made} bytes, its length says {length}" if made != length else ""


def field_names(columns: str, count: int) -> tuple[str, ...]:
    """Give every field a name of its own, whatever the log calls them.

    Parameters
    ----------
    columns
        Names as the log has them, between commas.
    count
        How many fields there are.
    """
    named = columns.split(",")[:count]
    names: list[str] = []
    for index in range(count):
        name = named[index] if index < len(named) else ""
        names.append(name if name and name not in names else f"{name or 'field'}#{index}")
    return tuple(names)


def physical(character: str, raw: NDArray[Any]) -> NDArray[Any]:
    """Turn the raw values of one field into numbers of its unit, or into text.

    Parameters
    ----------
    character
        The field character.
    raw : (n_records,) or (n_records, 32)
        As they are in the log; may be used for what is returned.
    """
    divisor = FIELDS[character][1]
    if divisor is not None:
        return np.asarray(raw.astype(np.float64) / divisor)
    if raw.dtype.kind == "S":
        return texts(raw)
    if raw.dtype.kind == "f":
        with np.errstate(invalid="ignore"):
            # Half precision would overflow in a square; a signalling NaN, which damage may leave,
            # would make every later calculation warn.
            raw = raw.astype(np.float32) if character == "g" else raw
            if np.isnan(raw.min(initial=0.0)):
                raw[np.isnan(raw)] = np.nan
    return raw.astype(raw.dtype.newbyteorder("="), copy=False)


def texts(raw: NDArray[np.bytes_]) -> NDArray[np.str_]:
    """Decode fixed-width strings, each up to its first NUL: UTF-8 if it is that, else Latin-1."""
    different, which = np.unique(raw, return_inverse=True)
    decoded = []
    for string in different.tolist():
        text = string.partition(b"\0")[0]
        try:
            decoded.append(text.decode())
        except UnicodeDecodeError:
            decoded.append(text.decode("latin-1"))
    return np.array(decoded, np.str_)[which] if decoded else np.empty(0, "U1")


def is_number(column: NDArray[Any] | None, kinds: str = "fiu") -> bool:
    """Tell whether a field, whatever the log says it is, holds one number in each record."""
    return column is not None and column.dtype.kind in kinds and column.ndim == 1
