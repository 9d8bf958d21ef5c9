"""What is left of a log that was cut: every file of a folder, at 200 evenly spaced places.

Reads each piece, and compares the number of gyro samples with what the format's official library
gives of the same piece: pymavlink, pyulog, mcap (its record reader, which goes on as long as it
can), rosbags; what a library refuses to open counts as nothing. Prints one line per file; ends with
1 where a read fails otherwise than with one line, takes longer than 2 s, gives fewer samples than
the library, or tells of no loss where the format would.

    python benchmarks/cuts.py [sample_logs] [--cuts 200] [--only .mcap]
"""

from __future__ import annotations

import argparse
import contextlib
import io
import shutil
import sys
import tempfile
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import fdilog
from fdilog.errors import FdilogError
from fdilog.recording import Recording

MOST_SECONDS = 2.0
# A recorder that lost power ends these with an incomplete record, and nothing is missing.
OPEN_ENDED = (".bin", ".tlog", ".ulg", ".csv")
GYRO_MESSAGES = ("IMU", "IMU2", "IMU3")
GYRO_PACKETS = ("RAW_IMU", "SCALED_IMU", "SCALED_IMU2", "SCALED_IMU3", "HIGHRES_IMU")
GYRO_TOPICS = ("sensor_gyro", "sensor_gyro_fifo", "vehicle_imu")


def of_pymavlink_bin(path: Path) -> int:
    from pymavlink import DFReader

    log = DFReader.DFReader_binary(str(path))
    count = 0
    while log.recv_match(type=[*GYRO_MESSAGES]) is not None:
        count += 1
    return count


def of_pymavlink_tlog(path: Path) -> int:
    from pymavlink import mavutil

    log = mavutil.mavlogfile(str(path))
    count = 0
    try:
        while (message := log.recv_msg()) is not None:
            count += message.get_type() in GYRO_PACKETS
    finally:
        log.close()
    return count


def of_pyulog(path: Path) -> int:
    from pyulog import ULog

    found = ULog(str(path), message_name_filter_list=[*GYRO_TOPICS])
    return sum(len(topic.data["timestamp"]) for topic in found.data_list)


def of_mcap(path: Path) -> int:
    from mcap.records import Channel, Message
    from mcap.stream_reader import StreamReader

    count = 0
    wanted: set[int] = set()
    with path.open("rb") as file, contextlib.suppress(Exception):
        for record in StreamReader(file).records:
            if isinstance(record, Channel) and "imu" in record.topic:
                wanted.add(record.id)
            count += isinstance(record, Message) and record.channel_id in wanted
    return count


def of_rosbags(path: Path) -> int:
    from rosbags.highlevel import AnyReader

    count = 0
    with AnyReader([path.parent if path.parent.name == "bag" else path]) as reader:
        wanted = [c for c in reader.connections if c.msgtype == "sensor_msgs/msg/Imu"]
        with contextlib.suppress(Exception):
            for _ in reader.messages(wanted):
                count += 1
    return count


ORACLES: dict[str, Callable[[Path], int]] = {
    ".bin": of_pymavlink_bin,
    ".tlog": of_pymavlink_tlog,
    ".ulg": of_pyulog,
    ".mcap": of_mcap,
    ".bag": of_rosbags,
    ".db3": of_rosbags,
}


def official(path: Path) -> int:
    """Gyro samples that the official library gives; none where it breaks off before the first."""
    quiet = io.StringIO()
    try:
        with contextlib.redirect_stdout(quiet), contextlib.redirect_stderr(quiet):
            return ORACLES[path.suffix](path)
    except Exception:  # noqa: BLE001  whatever it raises, it gives nothing
        return 0


@dataclass
class Tally:
    """What the cuts of one file came to."""

    cuts: int = 0
    refused: int = 0
    failed: int = 0
    fewer: int = 0
    more: int = 0
    untold: int = 0
    slowest_s: float = 0.0
    whole_samples: int = 0

    @property
    def passed(self) -> bool:
        """Whether everything holds that is promised of a cut log."""
        return not (self.failed or self.fewer or self.untold) and self.slowest_s < MOST_SECONDS


def samples(recording: Recording) -> int:
    """Count what the sensors measured; what a filter made of it is not counted."""
    return sum(len(s.time_ns) for s in recording.streams if s.gyro and s.origin == "sensor")


def _is_told(recording: Recording | None, suffix: str, base: bool) -> bool:
    """Whether the loss is in ``completeness`` as the contract has it for this format."""
    if recording is None or not base:
        return True  # refused in one line; or the whole file has losses of its own
    losses = [problem for problem in recording.problems if not problem.note]
    return not losses if suffix in OPEN_ENDED else bool(losses)


def tally(log: Path, n_cuts: int, folder: Path) -> Tally:
    """Cut a file at evenly spaced places and read each piece."""
    raw = log.read_bytes()
    whole = fdilog.read(log)
    base = not any(not problem.note for problem in whole.problems)
    found = Tally(whole_samples=samples(whole))
    for place in np.linspace(0, len(raw), n_cuts, endpoint=False).astype(int).tolist():
        piece = folder / log.name
        piece.write_bytes(raw[:place])
        found.cuts += 1
        recording: Recording | None = None
        start = time.process_time()
        try:
            recording = fdilog.read(piece)
        except FdilogError as error:
            found.refused += 1
            found.failed += "\n" in str(error)
        except Exception:  # noqa: BLE001  that is what is looked for
            found.failed += 1
            traceback.print_exc()
        found.slowest_s = max(found.slowest_s, time.process_time() - start)
        ours = samples(recording) if recording is not None else 0
        if log.suffix in ORACLES:
            theirs = official(piece)
            found.fewer += ours < theirs
            found.more += ours > theirs
            if ours < theirs:
                print(f"  {log.name} cut at {place}: {ours} samples, the library gives {theirs}")
        if not _is_told(recording, log.suffix, base):
            found.untold += 1
            words: Any = [p.what for p in recording.problems] if recording else []
            print(f"  {log.name} cut at {place}: told is {words}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path("sample_logs"))
    parser.add_argument("--cuts", type=int, default=200)
    parser.add_argument("--only", default="", help="files with this in their name")
    arguments = parser.parse_args()
    met = True
    print(
        f"{'file':<28} {'samples':>7} {'cuts':>4} {'refused':>7} {'failed':>6} {'fewer':>5}"
        f" {'more':>4} {'untold':>6} {'slowest':>7}"
    )
    logs = [
        path
        for path in sorted(arguments.folder.rglob("*"))
        if path.suffix in {*ORACLES, ".csv"} and arguments.only in path.name
    ]
    for log in logs:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            if log.suffix == ".db3":  # the library needs the description that belongs to it
                folder /= "bag"
                shutil.copytree(log.parent, folder)
            found = tally(log, arguments.cuts, folder)
        met &= found.passed
        print(
            f"{log.name:<28} {found.whole_samples:>7} {found.cuts:>4} {found.refused:>7}"
            f" {found.failed:>6} {found.fewer:>5} {found.more:>4} {found.untold:>6}"
            f" {found.slowest_s:>6.2f}s",
            flush=True,
        )
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
