"""Tables as Parquet, row group by row group, so that a damaged one costs itself only."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem
from fdilog_readers.columns import plain_text
from fdilog_readers.tabular_csv import Cells, check_key

MAGIC = b"PAR1"


def read_parquet(path: Path, key: str) -> Cells:
    """Read a table that has a column ``key``; a row without a finite ``key`` is lost, and told.

    Raises
    ------
    UnreadableLogError
        If pyarrow is not installed, the file's index is not whole, or there is no column ``key``.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise UnreadableLogError(
            f"{path}: reading Parquet needs pyarrow; install it with: pip install 'fdilog[parquet]'"
        ) from None
    try:
        file = pq.ParquetFile(path)
    except (pa.ArrowException, OSError) as error:
        raise UnreadableLogError(
            f"{path}: the index at the end of this Parquet file is lost or damaged, and without it"
            f" nothing can be read: {_first_line(error)}"
        ) from error
    with file:
        return _read(path, file, key)


def _read(path: Path, file: Any, key: str) -> Cells:
    import pyarrow as pa

    schema = file.schema_arrow
    headers = [plain_text(name).strip() for name in schema.names]
    check_key(path, headers, key)
    wordy = {
        number
        for number, kind in enumerate(schema.types)
        if not (
            pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind)
        )
    }
    if headers.index(key) in wordy:
        raise UnreadableLogError(f"{path}: column '{key}' holds no numbers")
    numbers = [number for number in range(len(headers)) if number not in wordy]
    groups: list[list[NDArray[np.float64]]] = []
    problems: list[Problem] = []
    for index in range(file.num_row_groups):
        try:
            group = file.read_row_group(index)
            groups.append([_floats(group.column(number)) for number in numbers])
        except (pa.ArrowException, OSError) as error:
            size = path.stat().st_size
            problems.append(_lost(file.metadata.row_group(index), index, size, error))
    columns = [np.empty(0)] * len(headers)
    for place, number in enumerate(numbers):
        columns[number] = np.concatenate([np.empty(0), *(group[place] for group in groups)])
    timed = np.isfinite(columns[headers.index(key)])
    if not timed.all():
        problems.append(Problem(what=f"{int((~timed).sum())} rows have no number in '{key}'"))
        columns = [column[timed] if len(column) else column for column in columns]
    return Cells(headers, columns, problems, {}, wordy)


def _floats(column: Any) -> NDArray[np.float64]:
    """Return an Arrow column as numbers, NaN where it is null."""
    import pyarrow as pa

    values: NDArray[np.float64] = column.cast(pa.float64(), safe=False).to_numpy()
    return values


def _lost(group: Any, index: int, size: int, error: Exception) -> Problem:
    # Where its columns are pyarrow would say; but of a damaged index it makes an abort, no error.
    return Problem(
        what=f"row group {index}: its {group.num_rows} rows are damaged: {_first_line(error)}",
        bytes_lost=min(max(0, group.total_byte_size), size),
    )


def _first_line(error: Exception) -> str:
    return plain_text((str(error).splitlines() or [""])[0])
