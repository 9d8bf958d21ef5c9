# ruff: noqa: INP001  a script, not a package
"""Make the logs of this folder again, byte for byte: ``python sample_logs/make.py [FOLDER]``.

(The MCAP files are compressed: another version of zstd gives other bytes with the same content.)
Beside the logs it writes ``truth.json``, what is true of each log and what an analysis is to say of
it, and README.md, the same for people.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from fdilog.experiments.faults import SIZE_UNITS, Fault, FaultKind
from fdilog.experiments.flight import Flight
from fdilog.experiments.simulate import Timing, simulate
from fdilog.recording import Recording
from fdilog.writing import write
from fdilog_readers import mcap_writer, rosbag2_writer

HEAD = """\
# Sample logs

Synthetic flights with a known truth, made by `python sample_logs/make.py` with fixed seeds: running
it again gives the same bytes. A multicopter stands for five seconds, takes off, flies roll and
pitch doublets and random turns, lands, and stands for five seconds. Healthy gyros have biases of
0.1 deg/s, scale errors of 0.5 % and mounting errors of 0.2 deg (one sigma, clamped at three), white
noise of 0.1 deg/s, and the resolution of 16 bits over 2000 deg/s; the airframe shakes by 2 deg/s,
and stamps are up to 1.5 ms early or late. What was drawn for each gyro is in `truth.json`, to the
last digit.

Times are seconds from the first gyro sample. The verdict is what an analysis with default settings
is to say, and the suspects are the channels that it is to name, no more and no fewer; several for
one fault cannot be told apart by anything in the log.

`same_flight*` is one flight with one fault in every format, for whoever wants to compare formats or
to test a reader: the verdict, the channel and the times are the same in all. A bag of ROS 2 is a
folder. `two_imu_topics.mcap` is `two_imus_attitude.bin` as a robot logs it: two topics of
sensor_msgs/Imu and the attitude.

| log | gyros | what is wrong | verdict | suspects |
|---|---|---|---|---|
"""

PHRASES: Mapping[str, str] = {
    "bias": "{channel} reads {size:g} deg/s too much",
    "drift": "{channel} drifts off by {size:g} deg/s every second",
    "scale": "{channel} reads {size:g} times the rate",
    "noise": "the noise of {channel} is {size:g} times as large",
    "impulse": "{count} readings of {channel} are {size:g} deg/s too large",
    "saturated": "{channel} reads no more than {size:g} deg/s",
    "stuck": "{channel} repeats its last reading",
    "dead": "{channel} reads zero",
    "dropout": "{channel} is silent",
}


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One log: how to make it, and what an analysis is to say of it.

    Parameters
    ----------
    suspects
        For each fault the channels that a right analysis names.
    options
        Options of ``fdilog analyse`` that say what the log does not.
    utc_at_zero_ns
        UTC, in nanoseconds since 1970, at zero of the flight's clock. [ns]
    store
        What writes the format, where the suffix does not tell.
    """

    name: str
    gyros: str
    verdict: str
    flight: Mapping[str, Any]
    faults: tuple[Fault, ...] = ()
    suspects: tuple[tuple[str, ...], ...] = ()
    attitude: bool = True
    note: str = ""
    options: tuple[str, ...] = ()
    utc_at_zero_ns: int | None = None
    store: Callable[[Recording, Path], None] = write

    @property
    def wrong(self) -> str:
        """What is wrong with the gyros, or with the log, in words."""
        parts = [_phrase(fault) for fault in self.faults]
        return "; ".join([*parts, self.note] if self.note else parts) or "nothing"


def fault(kind: FaultKind, channel: str, start_s: float, end_s: float, size: float = 0.0) -> Fault:
    """Make a fault whose size, where it is an angle or the like, is in degrees."""
    unit = SIZE_UNITS.get(kind)
    if unit is None:
        return Fault(kind=kind, channel=channel, start_s=start_s, end_s=end_s)
    si = float(np.radians(size)) if unit.startswith("rad") else size
    count = 5 if kind == "impulse" else 1
    return Fault(kind=kind, channel=channel, start_s=start_s, end_s=end_s, size=si, count=count)


def _phrase(one: Fault) -> str:
    size = 0.0 if one.size is None else one.size
    if SIZE_UNITS.get(one.kind, "").startswith("rad"):
        size = round(float(np.degrees(size)), 9)
    text = PHRASES[one.kind].format(channel=one.channel, size=size, count=one.count)
    if np.isinf(one.end_s):
        return f"{text} {f'from {one.start_s:g} s on' if one.start_s else 'all along'}"
    return f"{text} from {one.start_s:g} to {one.end_s:g} s"


def _flight(seed: int, duration_s: float = 100.0, rate_hz: float = 25.0, **more: Any) -> Any:
    return {"seed": seed, "duration_s": duration_s, "rate_hz": rate_hz, **more}


BIAS = fault("bias", "imu1.y", 40.0, 60.0, 3.0)
ALL_ALONG = (0.0, np.inf)

SAME_FLIGHT: Mapping[str, Callable[[Recording, Path], None]] = {
    ".bin": write,
    ".tlog": write,
    ".ulg": write,
    "_cdr.mcap": partial(mcap_writer.write, encoding="cdr"),
    "_protobuf.mcap": partial(mcap_writer.write, encoding="protobuf"),
    "_json.mcap": partial(mcap_writer.write, encoding="json"),
    ".bag": write,
    "_sqlite3": partial(rosbag2_writer.write_folder, storage="sqlite3"),
    "_mcap": partial(rosbag2_writer.write_folder, storage="mcap"),
    ".csv": write,
}
"""What follows ``same_flight`` in the name of a log, and what writes it."""
UTC_NS = 1_700_000_000_000_000_000
"""Robots' stamps are UTC."""

SAMPLES = (
    Sample(
        name="three_imus_healthy.bin", gyros="3 IMUs, 25 Hz", verdict="healthy", flight=_flight(1)
    ),
    Sample(
        name="three_imus_bias.bin",
        gyros="3 IMUs, 50 Hz",
        verdict="failed",
        flight=_flight(2, rate_hz=50.0),
        faults=(BIAS,),
        suspects=(("imu1.y",),),
    ),
    Sample(
        name="two_imus_bias.bin",
        gyros="2 IMUs, 25 Hz, no attitude",
        verdict="failed",
        flight=_flight(3, sources=2),
        faults=(BIAS,),
        suspects=(("imu0.y", "imu1.y"),),
        attitude=False,
    ),
    Sample(
        name="two_imus_attitude.bin",
        gyros="2 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(3, sources=2),
        faults=(BIAS,),
        suspects=(("imu1.y",),),
        note="the attitude tells which",
    ),
    Sample(
        name="one_imu.bin",
        gyros="1 IMU, 25 Hz, no attitude",
        verdict="insufficient",
        flight=_flight(4, 60.0, sources=1),
        attitude=False,
        note="nothing to compare with",
    ),
    Sample(
        name="one_imu_dead_gyro.bin",
        gyros="1 IMU, 25 Hz",
        verdict="failed",
        flight=_flight(5, 60.0, sources=1),
        faults=tuple(fault("dead", f"imu0.{axis}", *ALL_ALONG) for axis in "xyz"),
        suspects=(("imu0.x",), ("imu0.y",), ("imu0.z",)),
        note="the accelerometer is alive",
    ),
    Sample(
        name="drift.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(6, 80.0),
        faults=(fault("drift", "imu0.y", 20.0, 65.0, 0.1),),
        suspects=(("imu0.y",),),
    ),
    Sample(
        name="scale.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(7, 80.0),
        faults=(fault("scale", "imu2.x", *ALL_ALONG, 1.2),),
        suspects=(("imu2.x",),),
    ),
    Sample(
        name="noise.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(8, 60.0, timing=Timing(offset_s=0.0001)),
        faults=(fault("noise", "imu2.x", 20.0, 50.0, 10.0),),
        suspects=(("imu2.x",),),
    ),
    Sample(
        name="stuck.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(9, 60.0),
        faults=(fault("stuck", "imu0.z", 30.0, np.inf),),
        suspects=(("imu0.z",),),
    ),
    Sample(
        name="impulses.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(10, 60.0),
        faults=(fault("impulse", "imu0.x", 15.0, 45.0, 60.0),),
        suspects=(("imu0.x",),),
    ),
    Sample(
        name="dropout.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(11, 60.0),
        faults=(fault("dropout", "imu1", 30.0, 31.0),),
        suspects=(("imu1.x",), ("imu1.y",), ("imu1.z",)),
    ),
    Sample(
        name="skewed_bias.csv",
        gyros="6 skewed gyros, 25 Hz",
        verdict="failed",
        flight=_flight(12, 60.0, geometry="mirrored-triads"),
        faults=(fault("bias", "g2", 20.0, 40.0, 5.0),),
        suspects=(("g2",),),
        options=("--geometry", "mirrored-triads"),
    ),
    Sample(
        name="skewed_two_faults.csv",
        gyros="6 skewed gyros, 25 Hz",
        verdict="failed",
        flight=_flight(13, 60.0, geometry="matasov"),
        faults=(fault("bias", "g2", 20.0, 40.0, 20.0), fault("bias", "g3", 20.0, 40.0, -50.0)),
        suspects=(("g2",), ("g3",)),
        options=("--geometry", "matasov"),
    ),
    Sample(
        name="cut.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="healthy",
        flight=_flight(1),
        note="`three_imus_healthy.bin`, ending in the middle of a record",
    ),
    Sample(
        name="damaged.bin",
        gyros="3 IMUs, 25 Hz",
        verdict="undecided",
        flight=_flight(1),
        note="`cut.bin` with 500 bytes in its middle overwritten",
    ),
    Sample(
        name="two_imu_topics.mcap",
        gyros="2 IMUs, 25 Hz",
        verdict="failed",
        flight=_flight(3, sources=2),
        faults=(BIAS,),
        suspects=(("imu1.y",),),
        note="the attitude tells which",
        utc_at_zero_ns=UTC_NS,
    ),
    *(
        Sample(
            name=f"same_flight{ending}",
            gyros="3 IMUs, 20 Hz, no attitude",
            verdict="failed",
            flight=_flight(27, 40.0, 20.0),
            faults=(fault("bias", "imu1.y", 15.02, 30.02, 5.0),),  # between two samples
            suspects=(("imu1.y",),),
            attitude=False,
            utc_at_zero_ns=UTC_NS,
            store=store,
        )
        for ending, store in SAME_FLIGHT.items()
    ),
)


def make(sample: Sample, folder: Path) -> Flight:
    """Write one log."""
    path = folder / sample.name
    flight = simulate(faults=sample.faults, **sample.flight)
    recording = flight.recording(attitude=sample.attitude)
    if path.is_dir():
        shutil.rmtree(path)
    sample.store(replace(recording, utc_at_zero_ns=sample.utc_at_zero_ns), path)
    if sample.name in ("cut.bin", "damaged.bin"):
        data = bytearray(path.read_bytes())
        # Six tenths of this log end 24 bytes into an IMU record of 54.
        del data[len(data) * 6 // 10 :]
        if sample.name == "damaged.bin":
            # Eight bytes further it begins in an attitude: nothing it spoils could be taken for a
            # reading, by a reader that believes a record before it knows where that ends.
            middle = len(data) // 2 + 8
            data[middle : middle + 500] = np.random.default_rng(1).bytes(500)
        path.write_bytes(data)
    return flight


def main(folder: Path) -> None:
    """Write all logs, their truth, and the table of them."""
    folder.mkdir(parents=True, exist_ok=True)
    truth, lines = {}, []
    for sample in SAMPLES:
        flight = make(sample, folder)
        truth[sample.name] = {
            "verdict": sample.verdict,
            "suspects": [list(channels) for channels in sample.suspects],
            "options": list(sample.options),
            **flight.truth(),
        }
        suspects = ", ".join(" or ".join(channels) for channels in sample.suspects)
        options = f" (`{' '.join(sample.options)}`)" if sample.options else ""
        lines.append(
            f"| `{sample.name}` | {sample.gyros}{options} | {sample.wrong} | {sample.verdict}"
            f" | {suspects or '-'} |\n"
        )
    text = json.dumps(truth, indent=1) + "\n"
    (folder / "truth.json").write_text(text, encoding="utf-8", newline="\n")
    (folder / "README.md").write_text(HEAD + "".join(lines), encoding="utf-8", newline="\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
