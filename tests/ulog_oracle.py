"""ULogs made record by record, and what the official library reads of them."""

from __future__ import annotations

import struct
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

HEADER = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1_000_000)
SYNC = bytes([0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12])
GYRO = (
    "sensor_gyro:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;"
    "float x;float y;float z;float temperature;uint32_t error_count;"
)
ATTITUDE = "vehicle_attitude:uint64_t timestamp;float[4] q;uint8_t[4] _padding0;"
STATUS = "vehicle_status:uint64_t timestamp;uint8_t arming_state;uint8_t[7] _padding0;"
OTHER = "cpuload:uint64_t timestamp;float load;float ram_usage;"
FORMATS = (GYRO, ATTITUDE, STATUS, OTHER)
GYRO_0, GYRO_1, TURNED, STATE, LOAD = range(5)
TOPICS = ("sensor_gyro", "sensor_gyro", "vehicle_attitude", "vehicle_status", "cpuload")


def record(kind: str, body: bytes) -> bytes:
    return struct.pack("<HB", len(body), ord(kind)) + body


def data(message_id: int, layout: str, *values: Any) -> bytes:
    """A data record; ``layout`` in the letters of struct."""
    return record("D", struct.pack("<H" + layout, message_id, *values))


def subscription(message_id: int, name: str, instance: int = 0) -> bytes:
    return record("A", struct.pack("<BH", instance, message_id) + name.encode())


def keyed(kind: str, key: str, value: bytes) -> bytes:
    return record(kind, bytes([len(key)]) + key.encode() + value)


def flags(*appended: int) -> bytes:
    places = [*appended, 0, 0, 0][:3]
    return record("B", bytes(8) + bytes([bool(appended)]) + bytes(7) + struct.pack("<3Q", *places))


def definitions(*appended: int) -> list[bytes]:
    return [
        flags(*appended),
        *(record("F", text.encode()) for text in FORMATS),
        keyed("I", "char[3] sys_name", b"PX4"),
        keyed("I", "char[6] ver_hw", b"MY_FMU"),
        keyed("I", "uint32_t ver_sw_release", struct.pack("<I", 0x010E03FF)),
        keyed("P", "int32_t CAL_GYRO0_ID", struct.pack("<i", 1310988)),
        keyed("P", "float MC_ROLL_P", struct.pack("<f", 6.5)),
        *(subscription(k, name, int(k == GYRO_1)) for k, name in enumerate(TOPICS)),
    ]


def gyro(message_id: int, now_us: int, *rate: float) -> bytes:
    return data(message_id, "QQIffffI", now_us, now_us - 300, 11 + message_id, *rate, 40.0, 0)


def flight(seconds: float = 4.0, rate_hz: int = 50, first_us: int = 5_000_000) -> list[bytes]:
    """Data records of two gyros among attitude, state, load, texts and sync marks."""
    rng = np.random.default_rng(3)
    records = []
    for k in range(int(seconds * rate_hz)):
        now = first_us + k * 1_000_000 // rate_hz
        rates = rng.normal(0.0, 1.0, (2, 3)).astype(np.float32)
        records.append(gyro(GYRO_0, now, *rates[0]))
        records.append(gyro(GYRO_1, now + 40, *rates[1]))
        if k % 5 == 0:
            turned = rng.normal(0.0, 1.0, 4)
            records.append(data(TURNED, "Q4f", now, *(turned / np.linalg.norm(turned))))
        if k % 10 == 0:
            records.append(data(LOAD, "Qff", now, 0.5, 0.25))
            records.append(data(STATE, "QB", now, 2 if rate_hz <= k < 3 * rate_hz else 1))
        if k % 25 == 0:
            text = f"[commander] at {k}".encode()
            records.append(record("L", b"6" + struct.pack("<Q", now) + text))
            records.append(record("S", SYNC))
    return records


def log(records: list[bytes] | None = None, first: list[bytes] | None = None) -> bytes:
    parts = (definitions() if first is None else first) + (flight() if records is None else records)
    return HEADER + b"".join(parts)


def official(path: Path) -> dict[tuple[str, int], dict[str, np.ndarray[Any, Any]]]:
    """Columns of every topic that the official library reads, by name and instance."""
    from pyulog import ULog

    with redirect_stdout(StringIO()):
        found = ULog(str(path))
    return {(topic.name, topic.multi_id): topic.data for topic in found.data_list}
