"""ArduPilot DataFlash logs as text (.log): one message a line, as ground stations convert them.

    FMT, 131, 43, IMU, IffffffIIf, TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,ErrG,ErrA,Temp
    IMU, 1234, 0.01, -0.02, 0.03, 0.1, 0.2, -9.8, 0, 0, 30.5

Lines of numbers are parsed a type at a time; lines with words, or with another number of cells than
their format has, are looked at alone.
"""

from __future__ import annotations

import io
import re
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording
from fdilog_readers.columns import Bytes, plain_text, whole
from fdilog_readers.dataflash_layout import FIELDS, FMT, Layout, field_names
from fdilog_readers.dataflash_streams import DEFAULT, GYRO_NAME, INSTANCE, Table, recording
from fdilog_readers.losses import Losses
from fdilog_readers.tabular_csv import exact_numbers

suffixes = (".log",)
description = "ArduPilot DataFlash as text"

NEWLINE, COMMA = b"\n,"
FIRST_FORMAT = re.compile(rb"(?:^|\n)FMT, ?\d+, ?\d+, ?\w+, ?[a-zA-Z]+, ?\w")
LONGEST_NAME = 16
TEXT = "anNZM"  # and M, the flight mode, which may be a number or a name


def sniff(head: bytes) -> bool:
    """Tell a log by a line that defines a message."""
    return FIRST_FORMAT.search(head) is not None


def read(path: Path, also: Collection[str] = ()) -> Recording:
    """Read gyros, attitude, outputs and what tells of the vehicle, and the types in ``also``.

    Raises
    ------
    UnreadableLogError
        If the file cannot be read or no line of it defines a message.
    """
    buffer = whole(path)
    log = _Lines(buffer)
    layouts = {"FMT": FMT} | {layout.name: layout for layout in log.formats()}
    if len(layouts) == 1 and "FMT" not in log.names:
        raise UnreadableLogError(
            f"{path}: no line that begins with 'FMT,', so nothing says what the others hold"
        )
    tables: dict[str, Table] = {}
    counts: dict[str, int] = {}
    for name in sorted(log.names):
        lines = log.lines_of(name)
        if name not in layouts:
            log.lose(
                lines, f"{plain_text(name)}: no FMT line describes it" if name else "no message"
            )
            continue
        shown = plain_text(name)
        counts[shown] = len(lines)
        if shown in also or DEFAULT.fullmatch(shown):
            tables |= _by_instance(shown, log.table(layouts[name], lines))
    return recording(
        path,
        tables,
        form="dataflash-text",
        size=len(buffer),
        layouts={layout.type: layout for layout in layouts.values()},
        counts=counts,
        problems=log.problems(),
        also=also,
    )


def _by_instance(name: str, table: Table) -> dict[str, Table]:
    """Divide the records of several sensors in one message."""
    instances = table.columns.get(INSTANCE)
    if not GYRO_NAME.fullmatch(name) or instances is None or instances.dtype.kind not in "iu":
        return {name: table}
    return {
        f"{name}[{number}]": Table(
            table.offsets[instances == number],
            {f: column[instances == number] for f, column in table.columns.items()},
        )
        for number in np.unique(instances).tolist()
    }


class _Lines:
    """The lines of a log, each with the name it begins with."""

    def __init__(self, buffer: Bytes) -> None:
        self._buffer = buffer
        self._losses = Losses()
        self._notes: list[Problem] = []
        ends = np.flatnonzero(buffer == NEWLINE)
        self._cut = bool(len(buffer)) and buffer[-1] != NEWLINE
        if self._cut:
            ends = np.append(ends, len(buffer))
        self._ends = ends
        self._begins = np.concatenate([[0], ends[:-1] + 1])[: len(ends)]
        self._commas = np.flatnonzero(buffer == COMMA)
        self._which, self.names = self._named()

    def _named(self) -> tuple[NDArray[np.intp], dict[str, int]]:
        """Give every line the number of its name, which is empty if there is none at its start."""
        first = np.searchsorted(self._commas, self._begins)
        comma = np.append(self._commas, len(self._buffer))[first]
        size = np.where(comma < self._ends, comma - self._begins, 0)
        size[size > LONGEST_NAME] = 0
        padded = np.concatenate([self._buffer, np.zeros(LONGEST_NAME, np.uint8)])
        window = np.lib.stride_tricks.sliding_window_view(padded, LONGEST_NAME)[self._begins]
        window = np.where(np.arange(LONGEST_NAME) < size[:, None], window, 0)
        keys = np.ascontiguousarray(window, np.uint8).view(f"S{LONGEST_NAME}")[:, 0]
        different, which = np.unique(keys, return_inverse=True)
        names = [key.decode("latin-1") for key in different.tolist()]
        return which, {name: number for number, name in enumerate(names)}

    def lines_of(self, name: str) -> NDArray[np.intp]:
        """Return the numbers of the lines that begin with a name; blank lines are none."""
        lines = np.flatnonzero(self._which == self.names[name])
        return lines if name else np.array([k for k in lines if self._text(k)], np.intp)

    def formats(self) -> list[Layout]:
        """Read the FMT lines; one that cannot be one is lost."""
        layouts = []
        for line in self.lines_of("FMT") if "FMT" in self.names else ():
            cells = [cell.strip() for cell in self._text(line).split(",", 5)][1:]
            if len(cells) < 5 or not (cells[0].isdecimal() and cells[1].isdecimal()):
                self.lose([line], "a format line is incomplete")
                continue
            kind, length, name, form, columns = cells
            unknown = [character for character in form if character not in FIELDS]
            flaw = f"its format '{form}' has a field of unknown kind" if unknown else ""
            fields = field_names(plain_text(columns), len(form))
            layouts.append(Layout(int(kind), name, int(length), form, fields, flaw))
        return layouts

    def lose(self, lines: Collection[int] | NDArray[np.intp], what: str) -> None:
        """Note lines as lost; the last one of a log, if nothing ended it, as cut short."""
        for line in lines:
            begin, end = int(self._begins[line]), int(self._ends[line])
            if self._cut and line == len(self._ends) - 1:
                what = f"line {line + 1}, the last one, is incomplete: writing stopped there"
                self._notes.append(
                    Problem(what=what, offset=begin, bytes_lost=end - begin, note=True)
                )
            else:
                end = min(end + 1, len(self._buffer))
                self._losses.add(begin, end, f"line {line + 1}: {what}")

    def problems(self) -> list[Problem]:
        """Return losses, then notes."""
        return [*self._losses.problems(), *self._notes]

    def table(self, layout: Layout, lines: NDArray[np.intp]) -> Table:
        """Read the lines of one type."""
        if layout.flaw:
            self.lose(lines, layout.flaw)
            lines = lines[:0]
        begins, ends = self._begins[lines], self._ends[lines]
        cells = np.searchsorted(self._commas, ends) - np.searchsorted(self._commas, begins)
        regular = cells == len(layout.fields)
        columns = None
        if regular.all() and not set(layout.format) & set(TEXT):
            columns = self._numbers(layout, lines)
        if columns is None:
            rows = {int(line): self._row(layout, self._text(line)) for line in lines}
            self.lose([line for line, row in rows.items() if not row], f"no whole {layout.name}")
            lines = np.array([line for line, row in rows.items() if row], np.intp)
            values = list(zip(*(row for row in rows.values() if row), strict=True))
            columns = {
                f: np.array(values[k] if values else [], _kind(layout.character(f)))
                for k, f in enumerate(layout.fields)
            }
        return Table(self._begins[lines].astype(np.int64), columns)

    def _numbers(self, layout: Layout, lines: NDArray[np.intp]) -> dict[str, NDArray[Any]] | None:
        """Parse lines that hold numbers only, or return None if they do not."""
        import pandas as pd

        if not len(lines):
            return None
        chosen = np.zeros(len(self._ends), bool)
        chosen[lines] = True
        kept = np.repeat(chosen, self._ends - self._begins + 1)[: len(self._buffer)]
        try:
            frame = pd.read_csv(
                io.BytesIO(self._buffer[kept].tobytes()),
                header=None,
                index_col=False,
                usecols=range(1, len(layout.fields) + 1),
                dtype={k: _kind(c) for k, c in enumerate(layout.format, start=1)},
                skipinitialspace=True,
                **exact_numbers(),
            )
        except (ValueError, OverflowError):
            return None
        if len(frame) != len(lines):
            return None
        return {f: frame[k].to_numpy() for k, f in enumerate(layout.fields, start=1)}

    def _row(self, layout: Layout, text: str) -> list[Any] | None:
        """Read one line alone; its last field has the rest of it, commas and all."""
        cells = [cell.strip() for cell in text.split(",", len(layout.fields))][1:]
        if len(cells) < len(layout.fields):
            return None
        try:
            return [
                cell if kind is np.str_ else kind(float(cell) if kind is np.float64 else int(cell))
                for cell, kind in zip(cells, map(_kind, layout.format), strict=True)
            ]
        except (ValueError, OverflowError):
            return None

    def _text(self, line: int | np.integer[Any]) -> str:
        raw = self._buffer[self._begins[line] : self._ends[line]].tobytes()
        return raw.decode("utf-8", "replace").strip()


def _kind(character: str) -> Any:
    """Type of a field in text: numbers with a factor are written with it, as decimals."""
    if character in TEXT:
        return np.str_
    kind, divisor = FIELDS[character]
    return np.float64 if divisor else _WIDE[np.dtype(kind).kind]


_WIDE = {"f": np.float64, "i": np.int64, "u": np.uint64}
