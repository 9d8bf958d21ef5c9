"""What DataFlash messages mean: which are gyros, what time they carry, what they say of the flight.

Shared by the binary and the text form of the log, which differ in how records are found only.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem, Recording, Stream
from fdilog_readers import reported
from fdilog_readers.columns import Offsets, choose_time, plain_text
from fdilog_readers.dataflash_batches import BLOCK, HEADER, batch_streams
from fdilog_readers.dataflash_layout import FIELDS, Layout, is_number
from fdilog_readers.dataflash_vehicle import (
    ARMED,
    DISARMED,
    EVENTS,
    armed_spans,
    utc_at_zero,
    vehicle,
)

# Read without being asked for: gyros, what corroborates them, and what tells of the vehicle.
DEFAULT = re.compile(r"(IMU|GYR)\d?|ISB[HD]|ATT|MAG|RCOU|GPS|EV|ARM|MSG|PARM|VER|FMTU|UNIT|MULT")
INSTANCE = "I"
GYRO_NAME = re.compile(r"(IMU|GYR)(\d?)(?:\[(\d+)\])?")
GYRO_AXES = ("GyrX", "GyrY", "GyrZ")
ACCELEROMETER_AXES = ("AccX", "AccY", "AccZ")
COMPASS_AXES = ("MagX", "MagY", "MagZ")
SPEED, COURSE, FIX = GROUND = ("Spd", "GCrs", "Status")
ANGLES = ("DesRoll", "Roll", "DesPitch", "Pitch", "DesYaw", "Yaw")
SENSOR_UNITS = {
    **dict.fromkeys(GYRO_AXES, "rad/s"),
    **dict.fromkeys(ACCELEROMETER_AXES, "m/s^2"),
    "T": "degC",
    "Temp": "degC",
}
# Half of what an int64 holds, so that differences of times do not overflow either: 146 years.
LATEST_NS = 2**62
NO_CHECKSUMS = Problem(
    what="no checksums in this format: damage inside a record cannot be seen", note=True
)


@dataclass
class Table:
    """Records of one name as columns, in file order.

    Parameters
    ----------
    offsets : (n_records,)
        In the file. [byte]
    columns : each (n_records,)
        Field name to values, as the official reader gives them.
    time_ns : (n_records,)
        Time since the autopilot started. [ns]
    clock
        What the time is, in words; empty until it is known.
    """

    offsets: Offsets
    columns: dict[str, NDArray[Any]]
    time_ns: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    clock: str = ""

    def __post_init__(self) -> None:
        """Take the time that the records themselves carry, if they do."""
        if {"T", "Week", "TimeMS"} <= set(self.columns):  # TimeMS is the GPS's own time of week
            self._stamp("T", 10**6)
        elif "TimeUS" in self.columns:
            self._stamp("TimeUS", 10**3)
        elif "TimeMS" in self.columns:
            self._stamp("TimeMS", 10**6)

    def _stamp(self, name: str, ns: int) -> None:
        if not is_number(self.columns[name], "ui"):
            return
        self.time_ns, self.clock = self._ns(name, ns), name
        if is_number(self.columns.get("SampleUS"), "ui"):
            sampled_ns = self._ns("SampleUS", 10**3)
            self.time_ns, self.clock = choose_time(sampled_ns, self.time_ns, "SampleUS", name)

    def _ns(self, name: str, ns: int) -> NDArray[np.int64]:
        whole = self.columns[name].astype(np.uint64)
        np.minimum(whole, LATEST_NS // ns, out=whole)
        whole *= np.uint64(ns)
        return whole.view(np.int64)


def recording(
    path: Path,
    tables: Mapping[str, Table],
    *,
    form: str,
    size: int,
    layouts: Mapping[int, Layout],
    counts: Mapping[str, int],
    problems: list[Problem],
    also: Collection[str] = (),
) -> Recording:
    """Make the recording of what was read and what was only counted.

    Parameters
    ----------
    tables
        What was read, by stream name.
    form
        Name of the format.
    size
        Of the file. [byte]
    layouts
        Of every type of message.
    counts
        Number of records by message name, of all of them.
    also
        What was asked for by name.
    """
    _fill_in_time(tables)
    batches, flaws = batch_streams(tables)
    problems = [*problems, *flaws]
    if batches:  # in their place the raw records are only listed
        tables = {n: t for n, t in tables.items() if n not in (HEADER, BLOCK) or n in also}
    units = _told_units(tables, layouts)
    streams = [_stream(name, table, units) for name, table in tables.items()]
    streams += batches
    loaded = {name.partition("[")[0] for name in tables}
    streams += [
        Stream(name=name, time_ns=np.empty(0, np.int64), count=count)
        for name, count in sorted(counts.items())
        if name not in loaded
    ]
    gps = tables.get("GPS")
    return Recording(
        path=str(path),
        format=form,
        bytes=size,
        streams=tuple(streams),
        problems=(*problems, *_impossible_stamps(tables), NO_CHECKSUMS),
        vehicle=_vehicle(tables) or None,
        armed=_armed(tables),
        utc_at_zero_ns=utc_at_zero(gps.columns, gps.time_ns) if gps and gps.clock else None,
    )


def _fill_in_time(tables: Mapping[str, Table]) -> None:
    """Give records without a time that of the record before them, in the longest table with one."""
    timed = [table for table in tables.values() if table.clock]
    reference = max(timed, key=lambda table: len(table.offsets), default=None)
    for table in tables.values():
        if table.clock:
            continue
        if reference is None:
            table.time_ns = np.zeros(len(table.offsets), np.int64)
            table.clock = "none: no record that was read has a time"
        else:
            before = np.searchsorted(reference.offsets, table.offsets) - 1
            table.time_ns = reference.time_ns[np.maximum(before, 0)]
            table.clock = "time of the record before it"


def _impossible_stamps(tables: Mapping[str, Table]) -> list[Problem]:
    counts = {name: int((table.time_ns > LATEST_NS // 2).sum()) for name, table in tables.items()}
    return [
        Problem(what=f"{count} records of {name} have a stamp that cannot be", note=True)
        for name, count in counts.items()
        if count
    ]


def _stream(name: str, table: Table, told: Mapping[tuple[str, str], str]) -> Stream:
    used = {table.clock, INSTANCE} if "[" in name else {table.clock}
    columns = {f: column for f, column in table.columns.items() if f not in used}
    message = name.partition("[")[0]
    units = {f: told[message, f] for f in columns if (message, f) in told}
    gyro: tuple[str, ...] = ()
    accelerometer: tuple[str, ...] = ()
    compass = _all_numeric(COMPASS_AXES, columns) if message == "MAG" else ()
    velocity: tuple[str, ...] = ()
    first = _of_first_instance(columns)
    if compass and not first.all():
        own = {f"{f} of the first": np.where(first, columns[f], np.nan) for f in compass}
        columns, compass = columns | own, tuple(own)
    if message == "GPS" and _all_numeric(GROUND, columns):
        fixed = first & (columns[FIX] >= reported.FIX_3D)
        columns |= reported.velocity(columns[SPEED], columns[COURSE], fixed)
        velocity = reported.VELOCITY
        units |= dict.fromkeys(velocity, "m/s")
    sensor = None
    known = GYRO_NAME.fullmatch(name)
    if known:
        number, instance = known.group(2), known.group(3)
        sensor = int(instance) if instance else max(int(number or 1) - 1, 0)
        gyro = _all_numeric(GYRO_AXES, columns)
        accelerometer = _all_numeric(ACCELEROMETER_AXES, columns)
        units |= {f: unit for f, unit in SENSOR_UNITS.items() if f in columns}
    if name == "ATT":
        for f in (angle for angle in ANGLES if is_number(columns.get(angle))):
            columns[f] = np.radians(columns[f].astype(np.float64))
            units[f] = "rad"
    return Stream(
        name=name,
        time_ns=table.time_ns,
        columns=columns,
        units=units,
        clock=table.clock,
        gyro=gyro,
        accelerometer=accelerometer,
        compass=compass,
        velocity=velocity,
        sensor=sensor,
        origin="derived" if name == "ATT" else "sensor",
        offsets=table.offsets,
    )


def _of_first_instance(columns: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
    """Tell which records of a message are of the first sensor of its kind."""
    instance = columns.get(INSTANCE)
    if instance is not None and is_number(instance) and len(instance):
        return np.asarray(instance == instance.min(), np.bool_)
    return np.ones(len(next(iter(columns.values()), ())), bool)


def _all_numeric(names: tuple[str, ...], columns: Mapping[str, NDArray[Any]]) -> tuple[str, ...]:
    """Return the names if all of them are columns of numbers, else none."""
    return names if all(is_number(columns.get(name)) for name in names) else ()


def _told_units(
    tables: Mapping[str, Table], layouts: Mapping[int, Layout]
) -> dict[tuple[str, str], str]:
    """Return the units that the log itself tells, by message and field name.

    FMTU has a character per field that UNIT spells out, and another that MULT gives as a factor;
    a field character that brings its own factor has been divided by it already.
    """
    labels = dict(zip(*_lists(tables, "UNIT", ("Id", "i"), ("Label", "U")), strict=False))
    factors = dict(zip(*_lists(tables, "MULT", ("Id", "i"), ("Mult", "f")), strict=False))
    told = {}
    columns = _lists(tables, "FMTU", ("FmtType", "u"), ("UnitIds", "U"), ("MultIds", "U"))
    for kind, unit_ids, factor_ids in zip(*columns, strict=False):
        layout = layouts.get(kind)
        if layout is None or layout.flaw:
            continue
        for f, unit_id, factor_id in zip(layout.fields, unit_ids, factor_ids, strict=False):
            unit, factor = labels.get(ord(unit_id), ""), factors.get(ord(factor_id), 1.0)
            if unit and unit_id != "#":
                plain = factor in (0.0, 1.0) or FIELDS[layout.character(f)][1] is not None
                told[layout.name, f] = plain_text(unit if plain else f"{factor:.7g} {unit}")
    return told


def _vehicle(tables: Mapping[str, Table]) -> dict[str, str]:
    (messages,) = _lists(tables, "MSG", ("Message", "U"))
    (versions,) = _lists(tables, "VER", ("FWS", "U"))
    names, values = _lists(tables, "PARM", ("Name", "U"), ("Value", "f"))
    return vehicle(messages, dict(zip(names, values, strict=False)), "".join(versions[:1]))


def _armed(tables: Mapping[str, Table]) -> tuple[tuple[int, int], ...] | None:
    events: list[tuple[int, int, int]] = []
    for name, field_name, number_of in (
        ("EV", "Id", {number: number for number in EVENTS}),
        ("ARM", "ArmState", {1: ARMED, 0: DISARMED}),
    ):
        (numbers,) = _lists(tables, name, (field_name, "iu"))
        events += [
            (int(tables[name].offsets[k]), int(tables[name].time_ns[k]), number_of[number])
            for k, number in enumerate(numbers)
            if number in number_of
        ]
    told = [(time_ns, number) for _, time_ns, number in sorted(events)]
    ends = [table.time_ns[[0, -1]].tolist() for table in tables.values() if len(table.time_ns)]
    if not ends:
        return None
    return armed_spans(told, min(first for first, _ in ends), max(last for _, last in ends))


def _lists(
    tables: Mapping[str, Table], name: str, *wanted: tuple[str, str]
) -> tuple[list[Any], ...]:
    """Return columns of a table by field name and kinds of dtype; empty lists where one lacks."""
    columns = tables[name].columns if name in tables else {}
    found = [columns[f] for f, kinds in wanted if f in columns and columns[f].dtype.kind in kinds]
    if len(found) < len(wanted) or any(column.ndim > 1 for column in found):
        return tuple([] for _ in wanted)
    return tuple(column.tolist() for column in found)
