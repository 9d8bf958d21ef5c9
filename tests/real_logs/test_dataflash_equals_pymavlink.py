"""Recorded DataFlash logs, every field of every message against pymavlink, to the last bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink import DFReader

from fdilog.recording import Recording, Stream
from fdilog_readers import dataflash

# The gyros' records are all compared; of other types so many, spread over the log.
MOST_OF_A_TYPE = 200
LOGS = [
    "copter_2imu_50hz",
    "copter_3imu_vibration_crash",
    "hexa_2imu_25hz",
    "quad_2imu_50hz_a",
    "quad_2imu_50hz_b",
    "quad_3imu_10_mm_cut_straight_line_2",
    "quad_3imu_25_mm_cut_hover_1",
    "quad_3imu_good_prop_hover_1",
    "quad_3imu_good_prop_straight_line_1",
    "rover_1imu_rcout",
    "rover_dead_gyro",
    "truncated_600_bytes",
    "truncated_64k",
]
ANGLES = {"Roll", "Pitch", "Yaw", "DesRoll", "DesPitch", "DesYaw"}


def messages(log: Any, kind: int) -> list[tuple[int, Any]]:
    """Messages of one type with their numbers, as pymavlink reads them."""
    layout = log.formats[kind]
    offsets = [o for o in log.offsets[kind] if o + layout.len <= log.data_len]
    chosen = range(len(offsets))
    if not layout.name.startswith("IMU"):
        chosen = range(0, len(offsets), 1 + len(offsets) // MOST_OF_A_TYPE)
    found = []
    for number in chosen:
        log.offset = offsets[number]
        found.append((number, log.recv_msg()))
    return found


def joined(recording: Recording, name: str) -> tuple[list[Stream], NDArray[np.intp]]:
    """The streams of one message name and the order that puts their records as in the file."""
    streams = [s for s in recording.streams if s.name.partition("[")[0] == name]
    offsets = np.concatenate([s.offsets for s in streams if s.offsets is not None])
    return streams, np.argsort(offsets)


def column(streams: list[Stream], order: NDArray[np.intp], field: str) -> NDArray[Any]:
    """One field in file order, with what became stamp or instance number turned back."""
    parts: list[NDArray[Any]] = []
    for stream in streams:
        if field in stream.columns:
            parts.append(stream.columns[field])
        elif field == "I":
            parts.append(np.full(stream.count, stream.sensor))
        else:
            assert field == stream.clock
            assert field in {"TimeUS", "TimeMS", "T"}
            parts.append(stream.time_ns // (10**3 if field == "TimeUS" else 10**6))
    return np.concatenate(parts)[order]


@pytest.mark.parametrize("name", LOGS)
def test_every_field_of_every_message_is_what_pymavlink_gives(real_logs: Path, name: str) -> None:
    path = real_logs / "dataflash" / f"{name}.bin"
    compared = 0
    with DFReader.DFReader_binary(str(path), zero_time_base=True) as log:
        kinds = {k: f for k, f in log.formats.items() if log.counts[k]}
        recording = dataflash.read(path, also={layout.name for layout in kinds.values()})
        for kind, layout in kinds.items():
            theirs = messages(log, kind)
            streams, order = joined(recording, layout.name)
            whole = [o for o in log.offsets[kind] if o + layout.len <= log.data_len]
            assert len(order) == len(whole), layout.name
            numbers = [number for number, _ in theirs]
            for field, _ in zip(layout.columns, layout.format.strip("\0"), strict=False):
                expected = np.array([getattr(message, field) for _, message in theirs])
                if layout.name == "ATT" and field in ANGLES:
                    expected = np.radians(expected)
                ours = column(streams, order, field)[numbers]
                nan = ours.dtype.kind == "f"
                assert np.array_equal(ours, expected, equal_nan=nan), f"{layout.name}.{field}"
                compared += 1
    assert compared >= 4


@pytest.mark.parametrize("name", LOGS)
def test_healthy_recordings_lose_nothing_but_a_last_record(real_logs: Path, name: str) -> None:
    recording = dataflash.read(real_logs / "dataflash" / f"{name}.bin")
    assert all(problem.note for problem in recording.problems)
    cut = [p for p in recording.problems if "incomplete" in p.what]
    assert [p.offset + (p.bytes_lost or 0) for p in cut if p.offset] in ([], [recording.bytes])


def test_the_crash_log_has_three_gyros_a_vehicle_and_an_armed_span(real_logs: Path) -> None:
    path = real_logs / "dataflash" / "copter_3imu_vibration_crash.bin"
    recording = dataflash.read(path)
    gyros = [s for s in recording.streams if s.gyro]
    assert [(s.name, s.sensor, s.count) for s in gyros] == [
        ("IMU", 0, 11916),
        ("IMU2", 1, 11916),
        ("IMU3", 2, 11916),
    ]
    assert recording.vehicle is not None
    assert recording.vehicle["firmware"] == "APM:Copter V3.3-dev (ae3192b8)"
    assert recording.vehicle["board"] == "PX4v2 004A002F 33345119 32383433"
    assert recording.armed is not None
    ((start_ns, end_ns),) = recording.armed
    last_ns = max(int(s.time_ns[-1]) for s in recording.streams if s.columns)
    assert (start_ns, end_ns) == (72_606_000_000, last_ns)
    assert recording.utc_at_zero_ns is not None
    # The firmware is of 2015; its log was made in the months after.
    assert 2015.0 < 1970 + recording.utc_at_zero_ns / 1e9 / 86400 / 365.2425 < 2016.0
