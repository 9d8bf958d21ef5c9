"""Writing tables: a column ``time_s`` and one of each gyro channel, which reads back bit for bit.

A table has one time base. Sources that were not sampled together are put on it exactly as an
analysis would put them, and a reading that is not there is an empty cell.
"""

from __future__ import annotations

from pathlib import Path

from fdilog.config import Config
from fdilog.recording import Recording
from fdilog.sources.clocks import clean_stamps, place, time_base
from fdilog.sources.gyros import choose

suffix = ".csv"


def write(recording: Recording, path: Path) -> None:
    """Write the gyros of a recording as comma-separated values in rad/s.

    Raises
    ------
    NoGyroError
        If there are none.
    """
    import pandas as pd

    config = Config()
    gyros, _ = choose(recording, config)
    clean = clean_stamps([gyro.time_ns for gyro in gyros])
    base = time_base([stamps.time_ns for stamps in clean], config.tolerance.dropout_s)
    columns = {"time_s": (base.time_ns - base.time_ns[0]) / 1e9}
    for gyro, stamps in zip(gyros, clean, strict=True):
        rate, _ = place(stamps.time_ns, gyro.rate_rad_s[stamps.keep], base)
        columns.update(zip(gyro.channel_names, rate.T, strict=True))
    pd.DataFrame(columns).to_csv(path, index=False, lineterminator="\n")
