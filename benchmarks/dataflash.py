"""How fast a DataFlash log is read, against pymavlink's message loop, in one run.

Makes a log of three IMUs at 400 Hz among other traffic, reads it both ways, checks that both give
the same numbers to the last bit, and prints one line per measurement; ends with 1 below the goal.

    python benchmarks/dataflash.py [--megabytes 100]
"""

from __future__ import annotations

import argparse
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

GOAL = 35.0
AXES = ("GyrX", "GyrY", "GyrZ")
RATE_HZ = 400
GPS_WEEK = 2200
MAGIC = 0x95A3
# Type number, name, format, fields, records in one turn of the logger: a copter's fast log.
ACCURACY = "EG,EA,T,GH,AH,GHz,AHz"
TYPES = (
    (130, "GPS", "QBBIHBcLLeff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,VZ", 1),
    (131, "IMU", "QBffffffIIfBBHH", f"TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,{ACCURACY}", 3),
    (132, "ATT", "QccccCC", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", 1),
    (133, "RATE", "Qffffffffffff", "TimeUS,RDes,R,ROut,PDes,P,POut,YDes,Y,YOut,ADes,A,AOut", 1),
    (134, "XKF1", "QBccCffffffccc", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ", 2),
    (135, "RCOU", "QHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8", 1),
)
FMT = (128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 0)
CODES = {
    "Q": "<u8", "B": "u1", "f": "<f4", "I": "<u4", "H": "<u2", "c": "<i2", "C": "<u2", "e": "<i4",
    "L": "<i4", "n": "S4", "N": "S16", "Z": "S64",
}  # fmt: skip

Arrays = dict[int, list[NDArray[np.float64]]]


def layout(fmt: str, fields: str) -> np.dtype[np.void]:
    named = zip(fields.split(","), fmt, strict=True)
    return np.dtype([("magic", "<u2"), ("type", "u1"), *((n, CODES[c]) for n, c in named)])


def write_log(path: Path, megabytes: int) -> None:
    """Write FMT records, then turns of the logger as rows of one structured array."""
    rng = np.random.default_rng(7)
    turn = np.dtype(
        [
            (f"{kind}_{k}", layout(fmt, fields))
            for kind, _, fmt, fields, count in TYPES
            for k in range(count)
        ]
    )
    turns = np.zeros(megabytes * 1_000_000 // turn.itemsize, turn)
    for place in turn.names or ():
        kind, _, instance = place.partition("_")
        records = turns[place]
        for name in (records.dtype.names or ())[3:]:
            values = rng.normal(0.0, 1.0, len(turns))
            records[name] = values if records[name].dtype.kind == "f" else np.abs(values * 30)
        records["magic"], records["type"] = MAGIC, int(kind)
        records["TimeUS"] = np.arange(len(turns)) * (1_000_000 // RATE_HZ)
        for name, number in (("I", int(instance)), ("GWk", GPS_WEEK)):
            if name in (records.dtype.names or ()):
                records[name] = number
    with path.open("wb") as file:
        for number, name, fmt, fields, _ in (FMT, *TYPES):
            text = (name.encode(), fmt.encode(), fields.encode())
            file.write(b"\xa3\x95\x80")
            file.write(struct.pack("<BB4s16s64s", number, layout(fmt, fields).itemsize, *text))
        turns.tofile(file)


def official(path: Path) -> Arrays:
    """Read as a user of pymavlink does."""
    from pymavlink import DFReader

    log = DFReader.DFReader_binary(str(path), zero_time_base=True)
    rows: dict[int, list[tuple[float, ...]]] = {}
    while (message := log.recv_match(type=["IMU"])) is not None:
        row = (message.TimeUS, message.GyrX, message.GyrY, message.GyrZ)
        rows.setdefault(message.I, []).append(row)
    return {sensor: list(np.array(columns).T) for sensor, columns in rows.items()}


def ours(path: Path) -> Arrays:
    """Read the same arrays, and the rest of what the reader gives."""
    from fdilog_readers import dataflash

    gyros = [stream for stream in dataflash.read(path).streams if stream.gyro]
    return {s.sensor or 0: [s.time_ns / 1000, *(s.columns[a] for a in AXES)] for s in gyros}


def timed(read: Callable[[Path], Arrays], path: Path, runs: int) -> tuple[float, Arrays]:
    """Median processor time: both ways are one thread, and what else runs here must not count."""
    seconds = []
    for _ in range(runs):
        start = time.process_time()
        arrays = read(path)
        seconds.append(time.process_time() - start)
    return statistics.median(seconds), arrays


MEMORY = """
import sys
from pathlib import Path
from fdilog_readers import dataflash
def megabytes(key):  # Linux; of this process alone
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(key)) / 1024
before = megabytes("VmRSS")
streams = [s for s in dataflash.read(Path(sys.argv[1])).streams if s.columns]
arrays = [a for s in streams for a in (s.time_ns, s.offsets, *s.columns.values())]
print(megabytes("VmHWM") - before, sum(a.nbytes for a in arrays) / 2**20)
"""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--megabytes", type=int, default=100)
    megabytes = parser.parse_args().megabytes
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "three_imus.bin"
        write_log(path, megabytes)
        timed(ours, path, 1)  # into the page cache, and past the imports
        fast_s, fast = timed(ours, path, 5)
        slow_s, slow = timed(official, path, 1)
        command = [sys.executable, "-c", MEMORY, str(path)]
        out = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    peak_mib, columns_mib = map(float, out.split())
    if slow.keys() != fast.keys() or not all(
        np.array_equal(a, b) for s in slow for a, b in zip(slow[s], fast[s], strict=True)
    ):
        print("the two readers do not give the same numbers")
        return 1
    samples = sum(len(columns[0]) for columns in fast.values())
    print(f"log: {megabytes} MB, {samples} IMU records")
    print(f"pymavlink recv_match(type=['IMU']): {slow_s:.2f} s")
    print(f"fdilog dataflash.read: {fast_s:.3f} s ({megabytes / fast_s:.0f} MB/s)")
    print(f"ratio: {slow_s / fast_s:.0f} (goal {GOAL:.0f})")
    print(f"peak memory: {peak_mib:.0f} MiB above the start, {columns_mib:.0f} MiB of it columns")
    return 0 if slow_s / fast_s >= GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
