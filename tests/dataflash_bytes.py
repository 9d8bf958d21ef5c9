"""DataFlash logs made from bytes, for the tests that read them whole and damaged."""

from __future__ import annotations

import contextlib
import io
import struct
from pathlib import Path

from fdilog.recording import Recording, Stream

HEADER = b"\xa3\x95"
SIZES = {"a": "64s", "g": "e", "n": "4s", "N": "16s", "Z": "64s", "c": "h", "C": "H", "e": "i"}
SIZES |= {"E": "I", "L": "i", "M": "b"} | {c: c for c in "bBhHiIfdqQ"}
IMU_FIELDS = "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"
FMT_FIELDS = "Type,Length,Name,Format,Columns"


def code(fmt: str) -> str:
    """The format in the words of ``struct``."""
    return "<" + "".join(SIZES[c] for c in fmt)


def fmt(kind: int, name: str | bytes, form: str, fields: str | bytes, length: int = -1) -> bytes:
    """An FMT record; ``length`` where it should not be what the format makes."""
    texts = [t.encode() if isinstance(t, str) else t for t in (name, form, fields)]
    if length < 0:
        length = 3 + struct.calcsize(code(form))
    return HEADER + struct.pack("<BBB4s16s64s", 128, kind, length, *texts)


def record(kind: int, form: str, *values: float | bytes) -> bytes:
    """One record of a type."""
    return HEADER + bytes([kind]) + struct.pack(code(form), *values)


HEAD = (
    fmt(128, "FMT", "BBnNZ", FMT_FIELDS)
    + fmt(131, "IMU", "Qffffff", IMU_FIELDS)
    + fmt(132, "EV", "QB", "TimeUS,Id")
    + fmt(133, "BAT", "Qffc", "TimeUS,Volt,Curr,Temp")
)


def imu(k: int) -> bytes:
    """The k-th IMU record, told from all others by its time and its rates."""
    return record(131, "Qffffff", 10_000 * k, k + 0.5, -k, k / 8, 0.25, -0.5, -9.75)


def bat(k: int) -> bytes:
    return record(133, "Qffc", 10_000 * k + 7, 12.5, k, 2150)


def flight(count: int) -> list[bytes]:
    """The records of a short log without its head: IMU, and BAT after every third of it."""
    records: list[bytes] = []
    for k in range(1, count + 1):
        records += [imu(k), bat(k)] if k % 3 == 0 else [imu(k)]
    return records


def samples(recording: Recording, name: str = "IMU") -> set[tuple[int, float, float, float]]:
    """What a stream holds, as a set of time and rates; every sample of ``flight`` is different."""
    found = [s for s in recording.streams if s.name == name and s.columns]
    if not found:
        return set()
    return set(rows(found[0]))


def rows(stream: Stream) -> list[tuple[int, float, float, float]]:
    axes = (stream.columns[axis].tolist() for axis in ("GyrX", "GyrY", "GyrZ"))
    return list(zip(stream.time_ns.tolist(), *axes, strict=True))


def sample(k: int) -> tuple[int, float, float, float]:
    """What ``imu(k)`` says."""
    return 10_000_000 * k, k + 0.5, -float(k), k / 8


def official(path: Path) -> set[tuple[int, float, float, float]]:
    """The same by pymavlink, whose complaints are not ours to print."""
    from pymavlink import DFReader

    found = set()
    with (
        contextlib.redirect_stderr(io.StringIO()),
        contextlib.redirect_stdout(io.StringIO()),
        DFReader.DFReader_binary(str(path), zero_time_base=True) as log,
    ):
        while (m := log.recv_match(type=["IMU"])) is not None:
            found.add((1000 * m.TimeUS, m.GyrX, m.GyrY, m.GyrZ))
    return found


def accounted(recording: Recording, lengths: dict[str, int]) -> int:
    """Bytes that are either in a record or in a problem."""
    parsed = sum(stream.count * lengths[stream.name] for stream in recording.streams)
    return parsed + sum(problem.bytes_lost or 0 for problem in recording.problems)


LENGTHS = {"FMT": 89, "IMU": 35, "EV": 12, "BAT": 21}
