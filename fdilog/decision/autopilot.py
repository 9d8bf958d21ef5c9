"""What the autopilot itself thought of its gyros: quoted, never taken as proof.

Autopilots keep health flags, error counters, lanes and failure detectors of their own. They see
sensors at full rate and from inside, and they are wrong in both ways: a flag stays up while a gyro
drifts, and goes down when a bus is slow. So what they say is put beside the findings with its time,
and no finding and no verdict depends on it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fdilog.finding import Finding
from fdilog.recording import Recording, Stream

Bools = NDArray[np.bool_]

STREAMS = (
    "ERR", "XKF4", "NKF4",
    "SYS_STATUS", "EKF_STATUS_REPORT", "STATUSTEXT",
    "vehicle_imu_status", "sensors_status_imu", "estimator_selector_status",
    "failure_detector_status", "sensor_selection",
)  # fmt: skip
"""Streams that are read for this alone: of DataFlash, MAVLink and PX4."""

TEXTS = (("MSG", "Message"), ("STATUSTEXT", "text"))
TELLING = re.compile(
    r"\b(gyro\w*|IMU\d?|EKF\d?|AHRS|DCM|lane)\b.*"
    r"\b(fail\w*|unhealthy|inconsistent|bad|error\w*|primary|switch\w*|reset|stopped|variance|lost)\b",
    re.IGNORECASE,
)
"""Messages that complain of gyros or of what is made of them."""

HEALTHY_FLAG = "GH"
ERROR_COUNTS = ("EG", "ErrG", "error_count", "gyro_error_count")

# ArduPilot's log of errors: subsystem, and what its codes mean.
EKF_CHECK, EKF_FAILSAFE, EKF_PRIMARY = 16, 17, 24
ERRORS = {
    (EKF_CHECK, 2): "EKF check: the variances are too large",
    (EKF_CHECK, 0): "EKF check: the variances are small again",
    (EKF_FAILSAFE, 1): "EKF failsafe",
    (EKF_FAILSAFE, 0): "EKF failsafe is over",
}
# Bits of MAVLink's SYS_STATUS; ArduPilot's first one stands for all of its gyros.
SYS_STATUS_GYROS = ((0x1, None, "gyros"), (0x20000, "imu1", "second gyro"))
EKF_ATTITUDE = 0x1
FAILURES = ("fd_roll", "fd_pitch", "fd_ext", "fd_motor", "fd_imbalanced_prop")

LARGEST_WHOLE = 2.0**53
"""Beyond this a float counts nothing; neither does not-a-number."""

NEAR_S = 1.0
"""Complaints no further apart are one, and complaints as near to a finding are quoted with it."""
MOST_NOTES = 100


@dataclass(frozen=True, kw_only=True)
class AutopilotNote:
    """One thing that the autopilot logged about its own sensors.

    Parameters
    ----------
    source
        Stream in which it stands.
    gyro
        Source of gyro channels that it is about, if it is about one.
    what
        In words.
    start_s, end_s
        First and last record that says so. [s of flight time]
    """

    source: str
    gyro: str | None
    what: str
    start_s: float
    end_s: float


def autopilot_notes(
    recording: Recording, zero_ns: int, span: tuple[float, float], gyros: Sequence[str]
) -> tuple[AutopilotNote, ...]:
    """List what an autopilot said of its gyros during a flight, in order of time.

    Parameters
    ----------
    span
        Flight times between which to look. [s]
    gyros
        Names of the sources in use: of a device that is not there nothing is quoted.
    """
    found = [
        note
        for stream in recording.streams
        if len(stream.time_ns)
        for note in _notes(stream, zero_ns, recording)
        if note.end_s >= span[0] and note.start_s <= span[1]
        if note.gyro is None or note.gyro in gyros
    ]
    found.sort(key=lambda note: (note.start_s, note.end_s, note.source, note.what))
    return tuple(found)


def with_quotes(
    findings: Sequence[Finding],
    notes: Sequence[AutopilotNote],
    recording: Recording,
) -> tuple[Finding, ...]:
    """Quote beside each finding what the autopilot said of the same device meanwhile."""
    flags = {
        f"imu{stream.sensor}": stream.name
        for stream in recording.streams
        if stream.sensor is not None
        and HEALTHY_FLAG in stream.columns
        and bool((_whole(stream, HEALTHY_FLAG) != 0).all())
    }
    return tuple(_quoted(finding, notes, flags) for finding in findings)


def _quoted(finding: Finding, notes: Sequence[AutopilotNote], flags: dict[str, str]) -> Finding:
    devices = list(dict.fromkeys(name.rpartition(".")[0] for name in finding.suspects))
    said = [
        f"{note.source}: {note.what}"
        for note in notes
        if note.gyro in devices
        and note.start_s <= finding.end_s + NEAR_S
        and note.end_s >= finding.start_s - NEAR_S
    ]
    said += [
        f"{flags[device]}.{HEALTHY_FLAG} called it healthy all along"
        for device in devices
        if device in flags
    ]
    if not said:
        return finding
    quote = f"the autopilot itself, which proves nothing: {'; '.join(dict.fromkeys(said))}"
    return replace(finding, detail=f"{finding.detail}; {quote}" if finding.detail else quote)


UNHEALTHY = "flagged unhealthy"


def _notes(stream: Stream, zero_ns: int, recording: Recording) -> Iterator[AutopilotNote]:
    """List what one stream says."""
    name = stream.name.rpartition("/")[2].partition("[")[0]
    said = {
        "ERR": _logged_errors,
        "XKF4": _lanes,
        "NKF4": _lanes,
        "SYS_STATUS": _system_status,
        "EKF_STATUS_REPORT": _attitude_flag,
        "failure_detector_status": _failure_detector,
    }.get(name)
    of_devices = {
        "sensors_status_imu": _healthy_by_number,
        "estimator_selector_status": _selected,
        "sensor_selection": _selected,
    }.get(name)
    texts = next((field for one, field in TEXTS if one == name), None)
    if said is not None:
        parts = said(stream)
    elif of_devices is not None:
        parts = of_devices(stream, recording)
    elif texts is not None and texts in stream.columns:
        parts = _messages(stream, texts)
    else:
        parts = _own_flags(stream)
    for gyro, what, rows in parts:
        # A clock that restarts may put the last record before the first.
        first, last = sorted(float(stream.time_ns[row] - zero_ns) / 1e9 for row in rows)
        yield AutopilotNote(source=stream.name, gyro=gyro, what=what, start_s=first, end_s=last)


Said = Iterator[tuple[str | None, str, tuple[int, int]]]
"""Which device, what, and the first and last record that say it."""


def _own_flags(stream: Stream) -> Said:
    """Read the flags and counters that are logged with a gyro's own rates, or of one instance."""
    number = stream.sensor
    if number is None:
        instance = re.fullmatch(r".*vehicle_imu_status\[(\d+)\]", stream.name)
        if instance is None:
            return
        number = int(instance[1])
    gyro = f"imu{number}"
    if HEALTHY_FLAG in stream.columns:
        bad = _whole(stream, HEALTHY_FLAG) == 0
        yield from ((gyro, UNHEALTHY, rows) for rows in _runs(stream, bad))
    for field in ERROR_COUNTS:
        if field in stream.columns:
            count = _whole(stream, field)
            rose = np.concatenate([[False], np.diff(count) > 0])
            for first, last in _runs(stream, rose):
                what = f"{field} rose from {count[max(first - 1, 0)]} to {count[last]}"
                yield gyro, what, (first, last)


def _logged_errors(stream: Stream) -> Said:
    codes = zip(_whole(stream, "Subsys").tolist(), _whole(stream, "ECode").tolist(), strict=True)
    for row, (subsystem, code) in enumerate(codes):
        if subsystem == EKF_PRIMARY:
            yield None, f"EKF primary changed to lane {code}", (row, row)
        elif (subsystem, code) in ERRORS:
            yield None, ERRORS[subsystem, code], (row, row)


def _lanes(stream: Stream) -> Said:
    """Read which lane of the filter leads, and which lanes have faults."""
    filter_name = "EKF3" if "XKF" in stream.name else "EKF2"
    core = _whole(stream, "C")
    if "PI" in stream.columns:
        rows = np.flatnonzero(core == core.min())
        lead = _whole(stream, "PI")[rows]
        for k in np.flatnonzero(np.diff(lead)).tolist():
            what = f"{filter_name} primary changed from lane {lead[k]} to {lead[k + 1]}"
            yield None, what, (int(rows[k + 1]), int(rows[k + 1]))
    for lane in np.unique(core).tolist() if "FS" in stream.columns else ():
        rows = np.flatnonzero(core == lane)
        faults = _whole(stream, "FS")[rows]
        for first, last in _runs(stream, faults != 0, rows):
            yield None, f"{filter_name} lane {lane} reports faults", (first, last)


def _system_status(stream: Stream) -> Said:
    present, enabled, health = (
        _whole(stream, f"onboard_control_sensors_{field}")
        for field in ("present", "enabled", "health")
    )
    for bit, gyro, who in SYS_STATUS_GYROS:
        bad = ((present & enabled & bit) != 0) & ((health & bit) == 0)
        yield from ((gyro, f"{who} {UNHEALTHY}", rows) for rows in _runs(stream, bad))


def _attitude_flag(stream: Stream) -> Said:
    if "flags" not in stream.columns:
        return
    for rows in _runs(stream, (_whole(stream, "flags") & EKF_ATTITUDE) == 0):
        yield None, "the EKF does not call its attitude good", rows


def _healthy_by_number(stream: Stream, recording: Recording) -> Said:
    """Read PX4's vote on its gyros, which are known there by the numbers of their devices."""
    devices = _devices(recording)
    for k in range(len([name for name in stream.columns if name.startswith("gyro_healthy[")])):
        device = _whole(stream, f"gyro_device_ids[{k}]")
        bad = (_whole(stream, f"gyro_healthy[{k}]") == 0) & (device != 0)
        for rows in _runs(stream, bad):
            yield devices.get(int(device[rows[0]]), f"imu{k}"), UNHEALTHY, rows


def _selected(stream: Stream, recording: Recording) -> Said:
    """Read which gyro PX4 flies by, and which instance of its filter."""
    devices = _devices(recording)
    for field, what in (("gyro_device_id", "gyro"), ("primary_instance", "filter instance")):
        value = _whole(stream, field)
        for k in (1 + np.flatnonzero(np.diff(value))).tolist():
            before, after = int(value[k - 1]), int(value[k])
            if what == "gyro":
                said = f"{devices.get(before, before)} to {devices.get(after, after)}"
            else:
                said = f"{before} to {after}"
            yield None, f"selected {what} changed from {said}", (k, k)


def _devices(recording: Recording) -> dict[int, str]:
    """Look sources of gyro channels up by PX4's numbers of their devices."""
    return {
        int(stream.columns["device_id"][0]): f"imu{stream.sensor}"
        for stream in recording.streams
        if stream.sensor is not None and len(stream.columns.get("device_id", ()))
    }


def _failure_detector(stream: Stream) -> Said:
    for field in FAILURES:
        if field in stream.columns:
            bad = _whole(stream, field) != 0
            yield from ((None, f"{field} is set", rows) for rows in _runs(stream, bad))


def _messages(stream: Stream, field: str) -> Said:
    for row, text in enumerate(stream.columns[field].tolist()):
        said = text.decode("utf-8", "replace") if isinstance(text, bytes) else str(text)
        if TELLING.search(said):
            yield None, said.strip("\0 "), (row, row)


def _runs(
    stream: Stream, bad: Bools, rows: NDArray[np.int64] | None = None
) -> list[tuple[int, int]]:
    """Find the first and last record of every stretch of bad ones, near ones together.

    Parameters
    ----------
    rows
        Records of the stream that ``bad`` is about; all of them by default.
    """
    rows = np.arange(len(bad)) if rows is None else rows
    here = rows[bad]
    if not len(here):
        return []
    step_ns = float(np.median(np.diff(stream.time_ns[rows]))) if len(rows) > 1 else 0.0
    apart = np.diff(stream.time_ns[here]) > max(NEAR_S * 1e9, 2.0 * step_ns)
    first = here[np.concatenate([[True], apart])]
    last = here[np.concatenate([apart, [True]])]
    return list(zip(first.tolist(), last.tolist(), strict=True))


def _whole(stream: Stream, field: str) -> NDArray[np.int64]:
    """Read a column of whole numbers; zeros where the log has none, or something else."""
    column = np.asarray(stream.columns.get(field, ()))
    if len(column) != len(stream.time_ns) or column.dtype.kind not in "iufb":
        return np.zeros(len(stream.time_ns), np.int64)
    if column.dtype.kind == "f":
        column = np.where(np.abs(column) < LARGEST_WHOLE, column, 0.0)
    return column.astype(np.int64)
