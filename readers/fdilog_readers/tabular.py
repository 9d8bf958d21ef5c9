"""Tables (.csv, .parquet): one column ``time_s`` and one of each gyro channel.

A header is a name and, in brackets, a unit: ``gx [deg/s]``; without one it is rad/s. Columns whose
unit is no angular rate (``ax [m/s^2]``), or that have none and are called as accelerometers,
compasses and thermometers are, are read but are no gyros. Channels are called what their headers
say, without the unit.

A name with a dot belongs to the source before its last dot: ``imu0.x``, ``imu0.y`` and ``imu0.z``
are the stream ``imu0`` with fields x, y, z. So are, where there are several, three gyros beside
each other whose names differ in x, y and z alone: ``gyro1_x``, ``gyro1_y``, ``gyro1_z`` are
``gyro1``, and ``gx1``, ``gy1``, ``gz1`` are ``g1``. All other names without a dot are one stream,
``table``. A row in which a stream has no reading at all is no record of it, so a source that is
slower than the table, or falls silent, is seen to do so.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fdilog.errors import UnreadableLogError
from fdilog.recording import Problem, Recording, Stream
from fdilog_readers.tabular_csv import Cells, header_of, read_csv
from fdilog_readers.tabular_parquet import MAGIC, read_parquet

suffixes = (".csv", ".tsv", ".parquet")
description = "Table of gyro channels (CSV, Parquet)"

TIME = "time_s"
UNDOTTED = "table"
HEADER = re.compile(r"(.*?)\s*(?:\[([^\]]*)\]|\(([^)]*)\))")
AXIS = re.compile(r"(.*?)([xyz])([_ ]?\d*)", re.IGNORECASE)
# Without a unit a column is a rate in rad/s, but for what is called as no gyro is. The shortest
# such names may be any device's, unless gyros that are called as such are beside them.
NO_RATE = re.compile(
    r"(acc|accel|acceleration|mag)_?[xyz]\d*|(temp|temperature|press|pressure)_?\d*",
    re.IGNORECASE,
)
NO_RATE_BESIDE_GYROS = re.compile(r"[am]_?[xyz]\d*", re.IGNORECASE)
CALLED_GYRO = re.compile(r"(|g|gyr|gyro|w|omega)_?[xyz]\d*", re.IGNORECASE)
RATE_RAD_S = {
    "rad/s": 1.0,
    "mrad/s": 1e-3,
    "deg/s": np.pi / 180.0,
    "°/s": np.pi / 180.0,
    "dps": np.pi / 180.0,
    "mdps": np.pi / 180e3,
    "mdeg/s": np.pi / 180e3,
    "deg/h": np.pi / 180.0 / 3600.0,
    "rpm": np.pi / 30.0,
}
SPELLED = ((" ", ""), ("radians", "rad"), ("degrees", "deg"), ("sec", "s"), ("hr", "h"))
LIKE_A_RATE = re.compile(r".*(deg|rad|rev|turn|°).*(/|per|-1).*|.*(rpm|dps)", re.IGNORECASE)
ACCELERATION = {"m/s^2", "m/s²", "m/s/s", "m/s2"}
# Beyond this a nanosecond count does not fit an int64 with its differences: 146 years.
LATEST_S = 2**62 / 1e9


def sniff(head: bytes) -> bool:
    """Tell a table by its magic bytes (Parquet) or by a column ``time_s`` in its first row."""
    return head.startswith(MAGIC) or TIME in header_of(head, TIME)[0]


def read(path: Path, also: Collection[str] = ()) -> Recording:  # noqa: ARG001  all is read anyway
    """Read every column that holds numbers.

    Raises
    ------
    UnreadableLogError
        If the file cannot be read, or has no column ``time_s``.
    """
    try:
        with path.open("rb") as file:
            magic = file.read(len(MAGIC))
            size = file.seek(0, 2)
    except OSError as error:
        raise UnreadableLogError(f"{path}: {(error.strerror or str(error)).lower()}") from error
    parquet = magic == MAGIC or path.suffix.lower() == ".parquet"
    cells = read_parquet(path, TIME) if parquet else read_csv(path, TIME)
    key = cells.headers.index(TIME)
    time_s = cells.columns[key]
    possible = np.abs(time_s) < LATEST_S
    problems = list(cells.problems)
    if not possible.all():
        what = f"{int((~possible).sum())} rows have a {TIME} that cannot be"
        problems.append(Problem(what=what))
    columns = _named(cells, key, problems)
    problems.sort(key=lambda problem: (problem.offset is None, problem.offset or 0))
    return Recording(
        path=str(path),
        format="table",
        bytes=size,
        streams=tuple(_streams(columns, time_s, possible)),
        problems=tuple(problems),
    )


@dataclass(frozen=True)
class _Column:
    name: str
    unit: str
    values: NDArray[np.float64]

    @property
    def field(self) -> str:
        return self.name.rpartition(".")[2] or self.name


def _named(cells: Cells, key: int, problems: list[Problem]) -> list[_Column]:
    """Give every column that holds numbers its name and unit, and say why others are left out."""
    columns: list[_Column] = []
    names: set[str] = set()
    for number, header in enumerate(cells.headers):
        if number == key:
            continue
        matched = HEADER.fullmatch(header)
        name = matched[1] if matched else header
        unit = _unit(matched[2] or matched[3] or "") if matched else "rad/s"
        why = ""
        if not name:
            why = f"column {number + 1} has no name: left out"
        elif number in cells.wordy:
            why = f"column '{name}' holds words, no numbers: left out"
        elif name in names:
            why = f"column '{name}' is there more than once; the later one is not compared"
            name, unit = f"{name}#{number + 1}", ""
        elif not matched and _is_no_rate(name, cells.headers):
            why = f"column '{name}' has no unit, and its name is none of a gyro: not compared"
            unit = ""
        elif unit not in RATE_RAD_S and LIKE_A_RATE.fullmatch(unit):
            why = f"column '{name}' is in {unit}, none of {', '.join(RATE_RAD_S)}: not compared"
        if why:
            problems.append(Problem(what=why, note=True))
        if not name or number in cells.wordy:
            continue
        names.add(name)
        # A cell that is no number is a loss of evidence only if it is a gyro's.
        bad = cells.bad.get(number, [])
        problems += [replace(p, note=unit not in RATE_RAD_S) for p in bad]
        columns.append(_Column(name, unit, cells.columns[number]))
    return columns


def _unit(written: str) -> str:
    """Return a unit as it is spelled here, if it is known; else as it is written."""
    unit = written.strip()
    spelled = unit.lower()
    for long, short in SPELLED:
        spelled = spelled.replace(long, short)
    return spelled if spelled in RATE_RAD_S else unit


def _is_no_rate(name: str, headers: Sequence[str]) -> bool:
    """Tell whether a column without a unit is called as accelerometers and the like are."""
    source, _, field = name.rpartition(".")
    if NO_RATE.fullmatch(field):
        return True
    beside = [other.rpartition(".") for other in headers]
    gyros = any(one[0] == source and CALLED_GYRO.fullmatch(one[2]) for one in beside)
    return gyros and NO_RATE_BESIDE_GYROS.fullmatch(field) is not None


def _streams(
    columns: list[_Column], time_s: NDArray[np.float64], possible: NDArray[np.bool_]
) -> list[Stream]:
    of = _sources(columns)
    return [
        _stream(source, [c for c in columns if of[c.name] == source], time_s, possible)
        for source in dict.fromkeys(of.values())
    ]


def _sources(columns: list[_Column]) -> dict[str, str]:
    """Name the source of every column."""
    sources = {column.name: column.name.rpartition(".")[0] or UNDOTTED for column in columns}
    gyros = [c.name for c in columns if c.unit in RATE_RAD_S and sources[c.name] == UNDOTTED]
    parts = [AXIS.fullmatch(name) for name in gyros]
    triads: dict[str, str] = {}
    for k in range(len(gyros) - 2):
        x, y, z = parts[k : k + 3]
        if x and y and z and (x[2] + y[2] + z[2]).lower() == "xyz":
            others = {(part[1], part[3]) for part in (x, y, z)}
            if len(others) == 1:
                source = (x[1] + x[3]).strip("_ ") or UNDOTTED
                triads |= dict.fromkeys(gyros[k : k + 3], source)
    several = len(set(triads.values())) > 1
    return sources | triads if several else sources


def _stream(
    source: str,
    columns: list[_Column],
    time_s: NDArray[np.float64],
    possible: NDArray[np.bool_],
) -> Stream:
    gyros = [column for column in columns if column.unit in RATE_RAD_S]
    there = np.zeros(len(time_s), bool)
    for column in gyros or columns:
        there |= ~np.isnan(column.values)
    there &= possible
    fields = _fields(columns)
    values = {}
    for column in columns:
        factor = RATE_RAD_S.get(column.unit, 1.0)
        values[fields[column.name]] = column.values[there] * factor
    return Stream(
        name=source,
        time_ns=nanoseconds(time_s[there]),
        columns=values,
        units={
            fields[c.name]: "rad/s" if c.unit in RATE_RAD_S else c.unit for c in columns if c.unit
        },
        clock=TIME,
        gyro=tuple(fields[column.name] for column in gyros),
        channel_names=tuple(column.name for column in gyros),
        accelerometer=tuple(fields[c.name] for c in columns if c.unit in ACCELERATION),
    )


def _fields(columns: list[_Column]) -> dict[str, str]:
    """Field of each column in its stream: what follows the last dot, where that is unambiguous."""
    short = [column.field for column in columns]
    return {c.name: c.field if short.count(c.field) == 1 else c.name for c in columns}


def nanoseconds(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Round seconds to nanoseconds, exactly: the product alone would lose the last digits.

    Parameters
    ----------
    time_s : (n,)
        Finite times. [s]
    """
    whole = np.floor(time_s)
    parts = np.round((time_s - whole) * 1e9)
    return whole.astype(np.int64) * 10**9 + parts.astype(np.int64)
