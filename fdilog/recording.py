"""What a reader found in a log: streams as columns, and what was lost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Origin = Literal["sensor", "selected", "derived"]


@dataclass(frozen=True, kw_only=True)
class Problem:
    """Something wrong with a log, with its place.

    A *note* leaves the evidence whole (an incomplete last record of a format whose recorder simply
    loses power, or "no checksums in this format"); everything else is a loss.
    """

    what: str
    offset: int | None = None
    bytes_lost: int | None = None
    seconds_lost: float | None = None
    note: bool = False


@dataclass(frozen=True, kw_only=True, eq=False)
class Stream:
    """One series of records of one kind, as columns.

    Parameters
    ----------
    name
        The name users of the format know it by: ``IMU[1]``, ``/imu/left``.
    time_ns : (n_records,) int64
        When each record was taken, in file order, on the recording's own clock. [ns]
        It may repeat or run backwards: that is for ``clocks`` to see and say.
    columns : each (n_records,)
        Field name to values, in SI units, in the field's own type where no conversion is needed.
        Empty for a stream that is only listed.
    units
        Field name to SI unit. A field that is missing here has a unit that the log does not tell.
    clock
        What ``time_ns`` is, in words: ``TimeUS``, ``header.stamp``, ``log time (header.stamp is
        constant)``.
    gyro, accelerometer
        The columns that are body angular rates (x, y, z, or any number of single-axis gyros), and
        the accelerations of the same physical device.
    compass
        The columns that are the magnetic field along the vehicle's x, y, z, in any unit.
    velocity
        The columns that are the velocity over ground to north and east, as GPS has it, not-a-number
        where it has no fix. [m/s]
    channel_names
        Names of the gyro channels where the log itself names them (a table of one's own); else
        empty, and they are called ``imu0.x``, ``imu0.y`` ...
    sensor
        Number of the physical device where the format numbers them, else None.
    origin
        ``sensor``: what one gyro measured; ``selected``: chosen or filtered by the autopilot from
        one of them; ``derived``: differentiated from an attitude or odometry, a witness only.
    batched
        Whether it comes in short batches: what lies between them was never recorded, so it is no
        loss and no silence, and a stream that goes on all the time is preferred.
    offsets : (n_records,) int64
        Byte offset of each record in the file, where a record is found at one.
    """

    name: str
    time_ns: NDArray[np.int64]
    columns: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    clock: str = ""
    gyro: tuple[str, ...] = ()
    accelerometer: tuple[str, ...] = ()
    compass: tuple[str, ...] = ()
    velocity: tuple[str, ...] = ()
    channel_names: tuple[str, ...] = ()
    sensor: int | None = None
    origin: Origin = "sensor"
    batched: bool = False
    offsets: NDArray[np.int64] | None = None
    count: int = -1

    def __post_init__(self) -> None:
        if self.count < 0:
            object.__setattr__(self, "count", len(self.time_ns))

    @property
    def rate_hz(self) -> float:
        """Median rate of the records, or 0 where there are too few to tell. [Hz]"""
        steps = np.diff(self.time_ns)
        steps = steps[steps > 0]
        return 1e9 / float(np.median(steps)) if steps.size else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """A log as a reader found it: its streams, and every problem it had.

    Parameters
    ----------
    armed
        Spans (start, end) flown armed, on the streams' clock, or None where the log does not say.
        [ns]
    utc_at_zero_ns
        UTC, in nanoseconds since 1970, at zero of the streams' clock; None where unknown. [ns]
    """

    path: str
    format: str
    bytes: int
    streams: tuple[Stream, ...]
    problems: tuple[Problem, ...] = ()
    vehicle: Mapping[str, str] | None = None
    armed: tuple[tuple[int, int], ...] | None = None
    utc_at_zero_ns: int | None = None
