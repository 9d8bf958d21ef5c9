"""The gyros of a recording for a format whose messages hold x, y, z and number the sensors."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.recording import Recording
from fdilog.sources.gyros import Gyro, choose


def numbered_triads(recording: Recording, path: Path, lacking: str) -> Mapping[int, Gyro]:
    """Choose the gyros that an analysis would use, each physical sensor once, by their numbers.

    A source called ``imu1`` has the number 1, so that it is read back under its name; any other
    takes the next number that is free.

    Parameters
    ----------
    lacking
        What the format has none of, such as "a ULog has no topic".

    Raises
    ------
    NoGyroError
        If there is no gyro.
    UsageError
        If a source has not the three gyros x, y, z.
    """
    gyros = choose(recording, Config())[0]
    named = [re.fullmatch(r"imu(\d{1,2})", gyro.name) for gyro in gyros]
    taken = {int(match[1]) for match in named if match}
    free = (k for k in range(len(gyros) + 100) if k not in taken)
    triads = {}
    for gyro, match in zip(gyros, named, strict=True):
        if "".join(name[-1:] for name in gyro.channel_names).lower() != "xyz":
            count = len(gyro.channel_names)
            which = f"the {count} gyros of {gyro.stream.name} ({', '.join(gyro.channel_names)})"
            raise UsageError(f"{path}: {lacking} for {which}; write .csv")
        triads[int(match[1]) if match else next(free)] = gyro
    return dict(sorted(triads.items()))
