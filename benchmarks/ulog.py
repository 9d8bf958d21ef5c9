"""How fast a PX4 log is read, against pyulog filtered to the wanted topics, in one run.

Makes a log of ten minutes with two gyros at 500 Hz among other traffic, reads it both ways, checks
that both give the same numbers to the last bit, and prints one line per measurement; ends with 1
below the goal.

    python benchmarks/ulog.py [--minutes 10]
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

from fdilog_readers import ulog
from fdilog_readers.ulog_writer import ATTITUDE, GYRO, Topic
from fdilog_readers.ulog_writer import ulog as log_of

GOAL = 4.0
STAMPS = "uint64_t timestamp;uint64_t timestamp_sample;"
# Definition, instance and rate of each topic: a flight with high-rate logging on. [Hz]
TRAFFIC = (
    (GYRO, 0, 500),
    (GYRO, 1, 500),
    (ATTITUDE, 0, 100),
    (f"estimator_states:{STAMPS}float[24] states;float[24] covariances;uint8_t n_states;", 0, 200),
    (f"actuator_outputs:{STAMPS}uint32_t noutputs;float[16] output;", 0, 400),
    (f"vehicle_local_position:{STAMPS}double ref_lat;double ref_lon;float[18] state;", 0, 200),
    (f"vehicle_rates_setpoint:{STAMPS}float roll;float pitch;float yaw;float[3] thrust;", 0, 250),
    (f"sensor_mag:{STAMPS}uint32_t device_id;float x;float y;float z;float temperature;", 0, 100),
    ("cpuload:uint64_t timestamp;float load;float ram_usage;", 0, 2),
)
WANTED = {"sensor_gyro"}

Arrays = dict[int, list[NDArray[Any]]]


def random_topic(rng: np.random.Generator, form: str, instance: int, n: int, hz: int) -> Topic:
    """Make records with numbers of a plausible size in every field."""
    time_us = 10**6 + (np.arange(n) * 1_000_000) // hz + rng.integers(0, 50, n)
    fields: dict[str, Any] = {}
    for kind, name in (field.split(" ") for field in form.partition(":")[2].split(";") if field):
        count = kind.rstrip("]").partition("[")[2]
        if name.startswith("_padding"):
            continue
        shape = (n, int(count)) if count else (n,)
        fields[name] = rng.normal(size=shape) if kind[0] in "fd" else rng.integers(0, 100, shape)
    fields["timestamp"] = time_us
    if "timestamp_sample" in fields:
        fields["timestamp_sample"] = time_us - 200
    return Topic(form, instance, fields)


def write_log(path: Path, minutes: float) -> None:
    rng = np.random.default_rng(7)
    topics = [
        random_topic(rng, form, instance, int(60 * minutes * hz), hz)
        for form, instance, hz in TRAFFIC
    ]
    path.write_bytes(log_of(topics, {"sys_name": "PX4"}))


def official(path: Path) -> Arrays:
    """Read as a user of pyulog does who knows which topics are needed."""
    from pyulog import ULog

    found = ULog(str(path), message_name_filter_list=[*WANTED])
    return {
        topic.multi_id: [topic.data[name] for name in ("timestamp_sample", "x", "y", "z")]
        for topic in found.data_list
    }


def official_whole(path: Path) -> Arrays:
    """Read as a user of pyulog does who does not."""
    from pyulog import ULog

    ULog(str(path))
    return {}


def ours(path: Path) -> Arrays:
    """Read the same arrays, and the rest of what the reader gives."""
    gyros = [s for s in ulog.read(path).streams if s.gyro and s.origin == "sensor"]
    return {s.sensor or 0: [s.time_ns // 1000, *(s.columns[axis] for axis in "xyz")] for s in gyros}


def timed(read: Callable[[Path], Arrays], path: Path, runs: int) -> tuple[float, Arrays]:
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        arrays = read(path)
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds), arrays


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    minutes = parser.parse_args().minutes
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "two_gyros.ulg"
        write_log(path, minutes)
        megabytes = path.stat().st_size / 1e6
        timed(ours, path, 1)  # into the page cache, and past the imports
        fast_s, fast = timed(ours, path, 7)
        slow_s, slow = timed(official, path, 3)
        whole_s, _ = timed(official_whole, path, 1)
    if slow.keys() != fast.keys() or not all(
        np.array_equal(a, b) for s in slow for a, b in zip(slow[s], fast[s], strict=True)
    ):
        print("the two readers do not give the same numbers")
        return 1
    print(f"log: {minutes:g} minutes, {megabytes:.0f} MB, two gyros at 500 Hz")
    print(f"pyulog, all topics: {whole_s:.2f} s; filtered to {', '.join(WANTED)}: {slow_s:.2f} s")
    print(f"fdilog ulog.read: {fast_s:.3f} s ({megabytes / fast_s:.0f} MB/s)")
    print(f"ratio: {slow_s / fast_s:.1f} (goal {GOAL:.0f})")
    return 0 if slow_s / fast_s >= GOAL else 1


if __name__ == "__main__":
    sys.exit(main())
