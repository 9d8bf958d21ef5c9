"""Writing ROS 1 bags, with the official library: an Imu topic for each gyro."""

from __future__ import annotations

from pathlib import Path

from fdilog.recording import Recording
from fdilog_readers.ros_writing import published, replacing, serialised, typestore

suffix = ".bag"


def write(recording: Recording, path: Path) -> None:
    """Write the gyros of a recording as ``/imu0/data`` ..., and its attitude as ``/attitude``.

    Raises
    ------
    NoGyroError, UsageError
        If there is no gyro, or one that a message cannot hold.
    """
    from rosbags.rosbag1 import Writer

    topics = published(recording)
    store = typestore(1)
    part = replacing(path)
    part.unlink(missing_ok=True)
    try:
        with Writer(part) as writer:
            connections = {
                topic.topic: writer.add_connection(topic.topic, topic.type, typestore=store)
                for topic in topics
            }
            for time_ns, topic, data in serialised(topics, store, 1):
                writer.write(connections[topic], time_ns, data)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
