"""Tables as text: cells to numbers, and every row and cell that is none told with its line.

Regular lines, nearly all, are parsed at once; a line that has another number of cells, or anything
but numbers in it, is looked at alone.
"""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem
from fdilog_readers.columns import Blocks, Bytes, Offsets, plain_text
from fdilog_readers.losses import Losses

SEPARATORS = (",", ";", "\t")
BYTE_ORDER_MARK = "\ufeff"
UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")
BLOCK_BYTES = 1 << 22
NEWLINE, RETURN, COMMA = b"\n\r,"
# No text holds these; where one stands, what is around it may be parts of two lines.
CONTROL = re.compile(rb"[\x00-\x08\x0b\x0e-\x1f\x7f]")
# Words for a reading that is not there, as pandas, R, MATLAB and spreadsheets write them.
MISSING = {"", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "null", "none"}
NUMBER = re.compile(r"[+-]?((\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|inf|infinity)", re.IGNORECASE)
# What a regular line is made of: numbers, and the letters of NaN, N/A and inf.
PLAIN = np.zeros(256, bool)
PLAIN[list(b'0123456789+-.eE"\r\n aAnNiIfF/')] = True
COLUMNS_LISTED = 20
LONGEST_SHOWN = 40

Rows = NDArray[np.float64]


@dataclass
class Cells:
    """A table as it was read.

    Parameters
    ----------
    headers
        As written, unit and all.
    columns : each (n_rows,)
        NaN where a cell is empty or no number.
    problems
        Of rows.
    bad
        Of single cells, by the number of their column; the cell is NaN.
    wordy
        Which columns hold words and not one number.
    """

    headers: list[str]
    columns: list[Rows]
    problems: list[Problem] = field(default_factory=list)
    bad: dict[int, list[Problem]] = field(default_factory=dict)
    wordy: set[int] = field(default_factory=set)


def header_of(head: bytes, key: str) -> tuple[list[str], str, int]:
    """Read the first row: its cells, the separator, and how many lines it takes.

    The separator is the one that makes ``key`` a cell of its own, else that which makes most cells.
    """
    try:
        text = head.decode()
    except UnicodeDecodeError:
        text = head.decode("latin-1")
    best: tuple[list[str], str, int] = ([], ",", 0)
    for separator in SEPARATORS:
        lines = io.StringIO(text.removeprefix(BYTE_ORDER_MARK), newline="")
        reader = csv.reader(lines, delimiter=separator)
        try:
            cells = [plain_text(cell).strip() for cell in next(reader, [])]
        except csv.Error:
            continue
        if cells:  # numpy.savetxt puts a hash before the first
            cells[0] = cells[0].removeprefix("#").strip()
        if key in cells:
            return cells, separator, reader.line_num
        if len(cells) > len(best[0]):
            best = cells, separator, reader.line_num
    return best


def read_csv(path: Path, key: str) -> Cells:
    """Read a table whose first row names its columns, one of them ``key``.

    A row without a finite ``key`` is lost, and told.

    Raises
    ------
    UnreadableLogError
        If the file cannot be read or has no column ``key``.
    """
    with Blocks(path, BLOCK_BYTES) as blocks:
        buffer = blocks.advance(0)
        if buffer[:2].tobytes() in UTF_16_MARKS:
            raise UnreadableLogError(f"{path}: the table is text in UTF-16; save it as UTF-8")
        ends = np.flatnonzero(buffer == NEWLINE)
        head = buffer[: int(ends[-1]) + 1 if len(ends) else len(buffer)].tobytes()
        headers, separator, lines = header_of(head, key)
        check_key(path, headers, key)
        table = _Table(headers, separator, headers.index(key), lines + 1)
        done = int(ends[lines - 1]) + 1 if len(ends) >= lines else len(buffer)
        while True:
            buffer = blocks.advance(done)
            ends = np.flatnonzero(buffer == NEWLINE)
            done = int(ends[-1]) + 1 if len(ends) else 0
            if done:
                table.take(buffer[:done], ends, blocks.start)
            if blocks.at_end:
                break
        if done < len(buffer):
            table.take_last(buffer[done:], blocks.start + done)
        if blocks.failure is not None:
            what = f"the file could not be read beyond this byte: {blocks.failure}"
            table.losses.add(blocks.end, max(blocks.end, blocks.size), what)
    return table.cells()


def check_key(path: Path, headers: list[str], key: str) -> None:
    """Refuse a table without its time.

    Raises
    ------
    UnreadableLogError
        If no column is named so; the text names those there are.
    """
    if key not in headers:
        listed = ", ".join(headers[:COLUMNS_LISTED]) or "none"
        more = len(headers) - COLUMNS_LISTED
        raise UnreadableLogError(
            f"{path}: no column '{key}', the time in seconds, so this is no table of gyro channels;"
            f" its columns are: {listed}{f' and {more} more' if more > 0 else ''}"
        )


def exact_numbers() -> dict[str, Any]:
    """Return what ``pandas.read_csv`` must be told to read numbers to the last bit."""
    import pandas as pd

    # From pandas 3 on it does so anyway, and asking for it is a warning.
    return {} if int(pd.__version__.partition(".")[0]) >= 3 else {"float_precision": "round_trip"}


class _Table:
    """Rows so far."""

    def __init__(self, headers: list[str], separator: str, key: int, line: int) -> None:
        self.losses = Losses()
        self._headers = headers
        self._separator = separator
        self._key = key
        self._line = line
        self._pieces: list[Rows] = []
        self._notes: list[Problem] = []
        self._bad: dict[int, Losses] = {}
        self._wordy: set[int] = set()

    def take(self, block: Bytes, ends: Offsets, start: int) -> None:
        """Read the lines of a block, each of which ends at one of ``ends``.

        Parameters
        ----------
        start
            Offset in the file of the block's first byte. [byte]
        """
        begins = np.concatenate([[0], ends[:-1] + 1])
        size = ends - begins
        blank = (size == 0) | ((size == 1) & (block[begins] == RETURN))
        regular = self._regular(block, begins, ends) & ~blank
        rows = np.full((len(ends), len(self._headers)), np.nan)
        parsed = self._parse(block[np.repeat(regular, size + 1)].tobytes(), int(regular.sum()))
        if parsed is None:
            regular[:] = False
        else:
            rows[regular] = parsed
        kept = ~blank
        for k in np.flatnonzero(kept & ~regular).tolist():
            line = block[begins[k] : ends[k]].tobytes()
            row, words = self._row(line)
            kept[k] = len(row) == len(self._headers) and not CONTROL.search(line)
            if kept[k]:
                rows[k] = row
                self._tell_words(words, k, start + int(begins[k]))
            else:
                what = f"{len(row)} cells where the header has {len(self._headers)}"
                what = "bytes that are no text" if CONTROL.search(line) else what
                self._tell(k, start + int(begins[k]), start + int(ends[k]) + 1, what)
        for k in np.flatnonzero(kept & ~np.isfinite(rows[:, self._key])).tolist():
            what = f"no number in '{self._headers[self._key]}'"
            self._tell(k, start + int(begins[k]), start + int(ends[k]) + 1, what)
            kept[k] = False
        self._pieces.append(rows[kept])
        self._wordy = self._wordy or self._without_numbers()
        self._line += len(ends)

    def take_last(self, block: Bytes, start: int) -> None:
        """Read a last line that no newline ends: a row if it is whole, else cut short.

        Its last number is not believed: of -9.2e-05 a cut leaves -9.2.
        """
        line = block.tobytes()
        if not line.strip():
            return
        row, words = self._row(line)
        bad = [column for column in words if column not in self._without_numbers()]
        if len(row) == len(self._headers):
            row[-1] = np.nan
        if len(row) == len(self._headers) and np.isfinite(row[self._key]) and not bad:
            self._pieces.append(np.array([row]))
            what = f"line {self._line} has no end: its last cell may be cut short, left out"
            self._notes.append(Problem(what=what, offset=start, note=True))
        else:
            what = f"line {self._line}, the last one, is incomplete: writing stopped there"
            self._notes.append(Problem(what=what, offset=start, bytes_lost=len(line), note=True))

    def cells(self) -> Cells:
        """Return the table, and what was wrong with it."""
        rows = np.concatenate([np.empty((0, len(self._headers))), *self._pieces])
        wordy = self._wordy | self._without_numbers()
        self._pieces.clear()
        return Cells(
            self._headers,
            [np.ascontiguousarray(column) for column in rows.T],
            [*self.losses.problems(), *self._notes],
            {column: list(bad.problems()) for column, bad in self._bad.items()},
            wordy,
        )

    def _regular(self, block: Bytes, begins: Offsets, ends: Offsets) -> NDArray[np.bool_]:
        """Tell which lines can be parsed at once: the right number of cells, and only numbers."""
        separators = np.flatnonzero(block == ord(self._separator))
        count = np.searchsorted(separators, ends) - np.searchsorted(separators, begins)
        regular: NDArray[np.bool_] = count == len(self._headers) - 1
        if not self._wordy:  # else pandas will find what is no number in the other columns
            plain = PLAIN.copy()
            plain[[ord(self._separator), COMMA]] = True
            odd = np.flatnonzero(~plain[block])
            regular[np.searchsorted(ends, odd)] = False
        return regular

    def _parse(self, text: bytes, count: int) -> Rows | None:
        """Parse regular lines, or return None where some cell is no number after all."""
        import pandas as pd

        rows = np.full((count, len(self._headers)), np.nan)
        if not count:
            return rows
        wanted = [c for c in range(len(self._headers)) if c not in self._wordy]
        try:
            frame = pd.read_csv(
                io.BytesIO(text),
                sep=self._separator,
                decimal="," if self._separator != "," and b"," in text else ".",
                header=None,
                index_col=False,
                usecols=wanted,
                dtype=np.float64,
                skipinitialspace=True,
                **exact_numbers(),
            )
        except ValueError:  # pandas' own errors of parsing are of this kind too
            return None
        if len(frame) != count:
            return None
        rows[:, wanted] = frame.to_numpy()
        return rows

    def _row(self, line: bytes) -> tuple[list[float], dict[int, str]]:
        """Read one line alone: its cells as numbers, and by column those that are none."""
        text = line.decode("utf-8", "replace").rstrip("\r\n")
        try:
            cells = next(csv.reader([text], delimiter=self._separator), [])
        except csv.Error:
            return [], {}
        if len(cells) == len(self._headers) + 1 and not cells[-1].strip():
            cells.pop()  # a separator at the end of each line
        row, words = [], {}
        for column, cell in enumerate(cells):
            number = cell.strip()
            if self._separator != ",":
                number = number.replace(",", ".")
            if NUMBER.fullmatch(number):
                row.append(float(number))
            else:
                row.append(np.nan)
                if number.lower() not in MISSING:
                    words[column] = cell
        return row, words

    def _tell(self, k: int, start: int, end: int, what: str) -> None:
        self.losses.add(start, end, f"line {self._line + k}: {what}")

    def _tell_words(self, words: dict[int, str], k: int, start: int) -> None:
        for column, cell in words.items():
            shown = plain_text(cell)[:LONGEST_SHOWN]
            what = (
                f"line {self._line + k}, column '{self._headers[column]}': '{shown}' is no number"
            )
            self._bad.setdefault(column, Losses()).add(start, start + len(cell.encode()), what)

    def _without_numbers(self) -> set[int]:
        """Return the columns that hold words only."""
        return {
            column
            for column in self._bad
            if all(bool(np.isnan(piece[:, column]).all()) for piece in self._pieces)
        }
