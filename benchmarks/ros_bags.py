"""How fast ROS bags are read, against the message loop of rosbags, in one run.

Writes ten minutes of two gyros at 500 Hz among odometry, pictures and diagnostics, reads them both
ways in turn, checks that both give the same numbers to the last bit, and prints one line per file;
ends with 1 below a goal.

    python benchmarks/ros_bags.py [--minutes 10] [--rounds 3] [--only "ROS 1"]
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from ros_comparison import ROUNDS, Arrays, Case, Rows, arrays, compare
from ros_traffic import IMU_TOPICS, TYPES, messages, typestore

ROS1_GOAL, ROS2_GOAL = 15.0, 4.0


def write_rosbag1(path: Path, minutes: float, compression: str) -> None:
    from rosbags.rosbag1 import Writer

    writer, store = Writer(path), typestore(1)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in TYPES.items()
        }
        for topic, time_ns, data in messages(minutes, ros=1):
            writer.write(topics[topic], time_ns, data)


def write_rosbag2(path: Path, minutes: float) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = typestore(2)
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topics = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, kind in TYPES.items()
        }
        for topic, time_ns, data in messages(minutes):
            writer.write(topics[topic], time_ns, data)


def official(path: Path) -> Arrays:
    """Read as a user of rosbags does."""
    from rosbags.highlevel import AnyReader

    rows: Rows = {topic: [] for topic in IMU_TOPICS}
    with AnyReader([path]) as reader:
        wanted = [c for c in reader.connections if c.topic in IMU_TOPICS]
        for connection, _, raw in reader.messages(wanted):
            imu = reader.deserialize(raw, connection.msgtype)
            stamp, rate = imu.header.stamp, imu.angular_velocity
            row = (stamp.sec * 10**9 + stamp.nanosec, rate.x, rate.y, rate.z)
            rows[connection.topic].append(row)
    return arrays(rows)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--only", action="append", help="name of a file; may be repeated")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help="how often both take turns")
    arguments = parser.parse_args()
    rounds = arguments.rounds
    minutes = arguments.minutes
    kinds: dict[str, tuple[Callable[[Path], None], str, float]] = {
        "ROS 1": (lambda path: write_rosbag1(path, minutes, "none"), "rosbag1", ROS1_GOAL),
        "ROS 1 lz4": (lambda path: write_rosbag1(path, minutes, "lz4"), "rosbag1", ROS1_GOAL),
        "ROS 2 sqlite3": (lambda path: write_rosbag2(path, minutes), "rosbag2", ROS2_GOAL),
    }
    met = True
    for name, (write, reader, goal) in kinds.items():
        if arguments.only and name not in arguments.only:
            continue
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / ("bag" if reader == "rosbag2" else "benchmark.bag")
            write(path)
            met &= compare(Case(name, path, reader, official, goal), rounds)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
