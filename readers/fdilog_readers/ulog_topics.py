"""What the topics of a ULog mean: which are gyros, in what unit, and by what clock."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Stream
from fdilog_readers import reported
from fdilog_readers.columns import Offsets, choose_time, plain_text
from fdilog_readers.ulog_layout import Value

Columns = dict[str, NDArray[Any]]

GYROS = ("sensor_gyro", "sensor_gyro_fifo", "vehicle_imu")
ACCELEROMETER = "sensor_accel"
# The fields in which the autopilot tells what it selected or filtered.
SELECTED = {
    "sensor_combined": ("gyro_rad", "accelerometer_m_s2"),
    "vehicle_angular_velocity": ("xyz", ""),
}
ATTITUDE = "vehicle_attitude"
# Turned into the vehicle's axes by the autopilot; older versions log it beside the gyro.
COMPASSES = ("vehicle_magnetometer", "sensor_combined")
COMPASS_FIELDS = tuple(f"magnetometer_ga[{k}]" for k in range(3))
GPS = "vehicle_gps_position"
NORTH, EAST, FIX = GROUND = ("vel_n_m_s", "vel_e_m_s", "fix_type")
LOADED = (*GYROS, ACCELEROMETER, *SELECTED, ATTITUDE, "vehicle_magnetometer", GPS)
QUATERNION = {"q[0]": "qw", "q[1]": "qx", "q[2]": "qy", "q[3]": "qz"}
AXES = ("x", "y", "z")
RATES = ("gyro_x", "gyro_y", "gyro_z")
FORCES = ("acceleration_x", "acceleration_y", "acceleration_z")
TELLING_INFO = ("sys_name", "ver_hw", "ver_sw", "sys_mcu", "sys_uuid", "ver_sw_branch")
TELLING_PARAMETERS = re.compile(
    r"CAL_GYRO\d_(ID|PRIO|ROT|EN)|IMU_GYRO_(CUTOFF|RATEMAX)|SENS_BOARD_ROT|SYS_AUTOSTART"
)
RELEASES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))
# Half of what an int64 holds, so that differences of times do not overflow either: 146 years.
LATEST_NS = 2**62
LONGEST_STEP_US = 1e6


@dataclass(eq=False)
class Table:
    """Records of one instance of a topic, in file order.

    Parameters
    ----------
    offsets : (n_records,)
        In the file. [byte]
    parts
        The records as they lie in the file, by the topic's layout, piece by piece.
    """

    name: str
    instance: int
    offsets: Offsets
    parts: list[NDArray[Any]]

    def column(self, name: str) -> NDArray[Any]:
        """Copy a field to a column; arrays stay arrays. (n_records,) or (n_records, length)."""
        field = np.concatenate([part[name] for part in self.parts])
        return field.astype(field.dtype.newbyteorder("="), copy=False)

    def columns(self) -> Columns:
        """Copy all fields to columns; an array gives one for each element."""
        columns: Columns = {}
        for name in self.parts[0].dtype.names or ():
            column = self.column(name)
            if column.ndim == 1:
                columns[name] = column
            else:
                columns |= {f"{name}[{k}]": part.copy() for k, part in enumerate(column.T)}
        return columns

    def has(self, *names: str) -> bool:
        """Whether the topic has all these fields."""
        return {*names} <= {*(self.parts[0].dtype.names or ())}

    def ns(self, name: str) -> NDArray[np.int64]:
        """Return a field of microseconds in nanoseconds. [ns]"""
        whole: NDArray[np.int64] = np.minimum(self.column(name), LATEST_NS // 1000).astype(np.int64)
        return whole * 1000

    def time(self) -> tuple[NDArray[np.int64], str]:
        """Choose the time at which the records were taken, and name its clock."""
        time_ns = self.ns("timestamp")
        if self.has("timestamp_sample") and self.parts[0].dtype["timestamp_sample"] == np.uint64:
            return choose_time(
                self.ns("timestamp_sample"), time_ns, "timestamp_sample", "timestamp"
            )
        return time_ns, "timestamp"


def stream(table: Table, name: str, sensor: int | None) -> Stream:
    """Make a stream of a topic, as what it means."""
    if table.name == "sensor_gyro_fifo" and table.has(*AXES, "scale", "samples", "dt"):
        return _fifo(table, name, sensor)
    time_ns, clock = table.time()
    columns = table.columns()
    columns.pop(clock.partition(" ")[0])
    units: dict[str, str] = {}
    gyro: tuple[str, ...] = ()
    forces: tuple[str, ...] = ()
    velocity: tuple[str, ...] = ()
    if table.name == GPS and _all(columns, GROUND):
        fixed, velocity = columns[FIX] >= reported.FIX_3D, reported.VELOCITY
        for name_of_it, f in zip(velocity, (NORTH, EAST), strict=True):
            columns[name_of_it] = np.where(fixed, columns[f], np.nan)
        units |= dict.fromkeys(velocity, "m/s")
    if table.name == "vehicle_imu":
        gyro = _rates(columns, RATES, "delta_angle")
        forces = _rates(columns, FORCES, "delta_velocity")
    elif table.name == "sensor_gyro":
        gyro = _all(columns, AXES)
    elif table.name == ACCELEROMETER:
        forces = _all(columns, AXES)
    elif table.name in SELECTED:
        gyro, forces = (
            _all(columns, [f"{f}[{k}]" for k in range(3)]) for f in SELECTED[table.name]
        )
    elif table.name == ATTITUDE and _all(columns, QUATERNION):
        columns |= {alias: columns[q] for q, alias in QUATERNION.items()}
        units |= dict.fromkeys((*QUATERNION, *QUATERNION.values()), "1")
    units |= dict.fromkeys(gyro, "rad/s") | dict.fromkeys(forces, "m/s^2")
    if "temperature" in columns and (gyro or forces):
        units["temperature"] = "degC"
    return Stream(
        name=name,
        time_ns=time_ns,
        columns=columns,
        units=units,
        clock=clock,
        gyro=gyro,
        accelerometer=forces,
        compass=_all(columns, COMPASS_FIELDS) if table.name in COMPASSES else (),
        velocity=velocity,
        sensor=sensor if table.name in (*GYROS, ACCELEROMETER) else None,
        origin="selected"
        if table.name in SELECTED
        else "derived"
        if table.name == ATTITUDE
        else "sensor",
        offsets=table.offsets,
    )


def _all(columns: Columns, names: Any) -> tuple[str, ...]:
    """Give these names if there are such columns, else none."""
    return tuple(names) if {*names} <= columns.keys() else ()


def _rates(columns: Columns, names: tuple[str, ...], delta: str) -> tuple[str, ...]:
    """Add the mean rates of an integral over a time, not a number where the time is zero."""
    step = columns.get(f"{delta}_dt", columns.get("dt"))
    parts = _all(columns, [f"{delta}[{k}]" for k in range(3)])
    if step is None or not parts:
        return ()
    step_s = step.astype(np.float64) / 1e6
    step_s[step_s <= 0.0] = np.nan
    for name, part in zip(names, parts, strict=True):
        columns[name] = columns[part] / step_s
    return names


def _fifo(table: Table, name: str, sensor: int | None) -> Stream:
    """Lay the samples of each record out one by one; a record is stamped at its last sample."""
    time_ns, clock = table.time()
    readings = {axis: table.column(axis) for axis in AXES}
    number = np.arange(readings["x"].shape[1])
    count = np.minimum(table.column("samples"), len(number)).astype(np.int64)[:, None]
    step_us = np.nan_to_num(table.column("dt").astype(np.float64), posinf=0.0, neginf=0.0)
    step_ns = np.rint(np.clip(step_us, 0.0, LONGEST_STEP_US) * 1e3).astype(np.int64)[:, None]
    taken = number < count
    each_ns = time_ns[:, None] - (count - 1 - number) * step_ns
    scale = np.repeat(table.column("scale").astype(np.float64), count[:, 0])
    return Stream(
        name=name,
        time_ns=each_ns[taken],
        columns={axis: reading[taken] * scale for axis, reading in readings.items()},
        units=dict.fromkeys(AXES, "rad/s"),
        clock=f"{clock} of the last sample of each record, and dt",
        gyro=AXES,
        sensor=sensor,
    )


def sensor_numbers(tables: list[Table]) -> dict[tuple[str, int], int]:
    """Give each instance of a gyro topic its sensor's number.

    That of sensor_gyro counts; vehicle_imu and the FIFO may have them in another order, and then
    tell which device they mean.
    """
    first: dict[tuple[str, int], int] = {}
    for table in tables:
        field = "gyro_device_id" if table.name == "vehicle_imu" else "device_id"
        if table.name in GYROS and table.has(field):
            devices_told = table.column(field)
            if devices_told.any():
                told = int(devices_told[devices_told != 0][0])
                first[table.name, table.instance] = told
    devices = {device: number for (name, number), device in first.items() if name == "sensor_gyro"}
    return {
        (table.name, table.instance): devices.get(
            first.get((table.name, table.instance), 0), table.instance
        )
        for table in tables
        if table.name in (*GYROS, ACCELEROMETER)
    }


def vehicle(info: Mapping[str, Value], parameters: Mapping[str, Value]) -> dict[str, str]:
    """Say what flew, in the log's words: firmware, board, and parameters that tell of the gyros."""
    facts = {key: plain_text(str(info[key])) for key in TELLING_INFO if key in info}
    release = info.get("ver_sw_release")
    if isinstance(release, int) and release:
        kind = next(word for least, word in RELEASES if release & 0xFF >= least)
        facts["firmware"] = ".".join(str(release >> k & 0xFF) for k in (24, 16, 8)) + kind
    for name, value in sorted(parameters.items()):
        if TELLING_PARAMETERS.fullmatch(name):
            facts[name] = f"{value:.9g}" if isinstance(value, float) else str(value)
    return facts
