"""How long each installed detector takes on an hour of six channels at 200 Hz.

python benchmarks/detectors.py                    # two aligned triads, white noise
python benchmarks/detectors.py --geometry dodecahedron
python benchmarks/detectors.py --faulty           # one channel off by 5 deg/s all along: the
                                                  # dearest case, every window is isolated

The moments of the windows are computed once for all detectors and stand in a line of their own.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from fdilog.config import Config
from fdilog.decision.judgement import without
from fdilog.maths.geometry import GEOMETRIES, named_axes
from fdilog.registry import plugins
from fdilog.table import Channel, ChannelTable
from fdilog.windows.survey import Survey, cut, spans

RATE_HZ = 200.0
NOISE_RAD_S = np.radians(0.1)
FAULT_RAD_S = np.radians(5.0)


def flown(geometry: str, seconds: float, *, faulty: bool) -> ChannelTable:
    """Make a table of slow manoeuvres with white noise."""
    axes = named_axes(geometry)
    rng = np.random.default_rng(0)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    body = np.radians(10.0) * np.sin(2 * np.pi * time_s[:, None] * [0.11, 0.07, 0.05])
    rate = body @ axes.T + rng.normal(0.0, NOISE_RAD_S, (len(time_s), len(axes)))
    if faulty:
        rate[:, 0] += FAULT_RAD_S
    channels = tuple(
        Channel(
            name=f"imu{k // 3}.{'xyz'[k % 3]}",
            source=f"imu{k // 3}",
            axis=(float(axis[0]), float(axis[1]), float(axis[2])),
            rate_hz=RATE_HZ,
            samples=len(time_s),
        )
        for k, axis in enumerate(axes)
    )
    return ChannelTable(
        time_s=time_s, rate_rad_s=rate, valid=np.ones(rate.shape, bool), channels=channels
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--geometry", choices=GEOMETRIES, default="aligned-triads")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--faulty", action="store_true")
    asked = parser.parse_args()
    config = Config()
    table = flown(asked.geometry, asked.minutes * 60.0, faulty=asked.faulty)
    detectors = {name: kind() for name, kind in plugins("detectors").items()}
    spent = dict.fromkeys(["(moments)", *detectors], 0.0)

    def timed(stage: str, survey: Survey) -> list:
        found = []
        for name, detector in detectors.items():
            if detector.stage == stage:
                start = time.process_time()
                found += detector.detect(survey)
                spent[name] += time.process_time() - start
        return found

    whole = spans(table, np.array([0]), np.array([len(table.time_s)]))
    heard = without(table, timed("alone", Survey(table=table, windows=whole, config=config)))
    each = np.arange(len(heard.time_s))
    timed("samples", Survey(table=heard, windows=spans(heard, each, each + 1), config=config))
    n_windows = 0
    for windows in cut(heard, config):
        survey = Survey(table=heard, windows=windows, config=config)
        n_windows += len(windows)
        start = time.process_time()
        _ = survey.moments
        spent["(moments)"] += time.process_time() - start
        timed("windows", survey)

    rows, columns = table.rate_rad_s.shape
    print(f"{asked.geometry}, {rows} x {columns}, {n_windows} windows; seconds of processor time:")
    for name, seconds in sorted(spent.items(), key=lambda item: -item[1]):
        print(f"  {name:16} {seconds:7.2f}")
    print(f"  {'all':16} {sum(spent.values()):7.2f}")


if __name__ == "__main__":
    main()
