"""How fast a telemetry log is read, against pymavlink's message loop, in one run.

Makes a log of two million packets (three IMUs among other traffic), reads it both ways, checks that
both give the same numbers to the last bit, and prints one line per measurement; ends with 1 below
the goal. Ours checks the checksum of every packet, not only of those that are wanted.

    python benchmarks/tlog.py [--packets 2000000]
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers import mavlink
from fdilog_readers.mavlink_dialect import dialect
from fdilog_readers.mavlink_writer import Messages, messages, tlog

GOAL = 20.0
UTC_NS = 1_700_000_000 * 10**9
IMUS = ("RAW_IMU", "SCALED_IMU2", "SCALED_IMU3")
AXES = ("xgyro", "ygyro", "zgyro")
# Message and its share of the packets; for a plane in flight, with faster IMUs.
TRAFFIC = {
    **dict.fromkeys(IMUS, 0.12),
    "ATTITUDE": 0.15,
    "GLOBAL_POSITION_INT": 0.10,
    "VFR_HUD": 0.10,
    "SERVO_OUTPUT_RAW": 0.10,
    "SYS_STATUS": 0.05,
    "VIBRATION": 0.05,
    "GPS_RAW_INT": 0.03,
    "EKF_STATUS_REPORT": 0.03,
    "AHRS2": 0.03,
}
MEAN_STEP_NS = 2_500_000

Arrays = dict[str, NDArray[np.float64]]


def random_messages(rng: np.random.Generator, name: str, time_ns: NDArray[np.int64]) -> Messages:
    """Make messages with numbers of a plausible size in every field."""
    known = dialect()
    layout = known.layout(known.id_of(name) or 0)
    fields: dict[str, Any] = {}
    for field in layout.names or ():
        kind = layout[field].base.kind
        shape = (len(time_ns), *layout[field].shape)
        values = rng.normal(0.0, 1.0 if kind == "f" else 30.0, shape)
        fields[field] = values if kind in "fi" else np.abs(values)
    fields |= {f: time_ns // 1000 for f in ("time_usec",) if f in fields}
    fields |= {f: time_ns // 1_000_000 for f in ("time_boot_ms",) if f in fields}
    if name in IMUS:
        fields |= {f: np.zeros(len(time_ns)) for f in ("id", "temperature") if f in fields}
    return messages(name, time_ns, **fields)


def write_log(path: Path, packets: int) -> None:
    rng = np.random.default_rng(7)
    span_ns = packets * MEAN_STEP_NS
    sent = []
    for name, share in TRAFFIC.items():
        time_ns = np.sort(rng.integers(0, span_ns, int(share * packets)))
        sent.append(random_messages(rng, name, time_ns))
    seconds = np.arange(0, span_ns, 10**9)
    sent.append(messages("HEARTBEAT", seconds, type=1, autopilot=3, base_mode=128))
    path.write_bytes(tlog(sent, UTC_NS))


def official(path: Path) -> Arrays:
    """Read as a user of pymavlink does."""
    from pymavlink import mavutil

    log = mavutil.mavlink_connection(str(path))
    rows: dict[str, list[tuple[float, ...]]] = {name: [] for name in IMUS}
    while (message := log.recv_match(type=list(IMUS))) is not None:
        row = (message._timestamp, message.xgyro, message.ygyro, message.zgyro)  # noqa: SLF001
        rows[message.get_type()].append(row)
    log.close()
    return {name: np.array(columns).T for name, columns in rows.items()}


def ours(path: Path) -> Arrays:
    """Read the same arrays, and the rest of what the reader gives."""
    streams = {stream.name: stream for stream in mavlink.read(path).streams}
    return {
        name: np.array(
            [
                streams[name].columns["tlog_time_ns"] // 1000 * 1e-6,
                *(streams[name].columns[axis] * 1000 for axis in AXES),
            ]
        )
        for name in IMUS
    }


def timed(read: Callable[[Path], Arrays], path: Path, runs: int) -> tuple[float, Arrays]:
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        arrays = read(path)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), arrays


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--packets", type=int, default=2_000_000)
    packets = parser.parse_args().packets
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "three_imus.tlog"
        write_log(path, packets)
        megabytes = path.stat().st_size / 1e6
        timed(ours, path, 1)  # into the page cache, and past the imports
        fast_s, fast = timed(ours, path, 5)
        slow_s, slow = timed(official, path, 1)
    for name in IMUS:
        stamps, *rates = slow[name]
        if not (
            np.array_equal(fast[name][0], stamps)
            and np.array_equal(np.rint(fast[name][1:]), np.array(rates))
            and np.allclose(fast[name][1:], np.rint(fast[name][1:]), rtol=0, atol=1e-9)
        ):
            print("the two readers do not give the same numbers")
            return 1
    print(f"log: {packets} packets, {megabytes:.0f} MB")
    print(f"pymavlink recv_match(type=[...]): {slow_s:.2f} s")
    print(f"fdilog mavlink.read, every checksum checked: {fast_s:.3f} s")
    print(f"ratio: {slow_s / fast_s:.0f} (goal {GOAL:.0f})")
    return 0 if slow_s / fast_s >= GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
