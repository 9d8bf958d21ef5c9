"""What is usual of the channels of a flight: their offsets from one another, and their noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, cut, evenly_spaced, spans

Floats = NDArray[np.float64]

WINDOW_S = 5.0
"""Long against vibration, and a short flight holds a dozen."""

MOST_WINDOWS = 200
"""Evenly spaced ones tell what is usual as well as all of them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Usual:
    """What most of a flight is like.

    Parameters
    ----------
    offset : (n_channels,)
        Constant part of the readings that the redundancy sees, ``V' c``, as the middlemost of the
        windows has it. [rad/s]
    sigma : (n_channels,)
        Noise of a channel relative to the others that it is compared with. [1]
    """

    offset: Floats
    sigma: Floats


@lru_cache(maxsize=2)
def usual(table: ChannelTable) -> Usual:
    """Tell what is usual of the channels of a table."""
    from fdilog.windows.isolation import noise_shares

    offset, sigma = np.zeros(len(table.channels)), np.ones(len(table.channels))
    config = Config().replace("windows", lengths_s=(WINDOW_S,))
    for windows in cut(table, config):
        some = evenly_spaced(len(windows), MOST_WINDOWS)
        chosen = spans(table, windows.start[some], windows.stop[some], WINDOW_S)
        survey = Survey(table=table, windows=chosen, config=config)
        done: set[int] = set()
        for moments in sorted(survey.moments, key=lambda m: (-len(m.channels), -len(m.windows))):
            columns = list(moments.channels)
            if not done.isdisjoint(columns):
                continue
            done.update(columns)
            sigma[columns] = np.sqrt(noise_shares(moments))
            offset[columns] = np.median(moments.parity_mean.mean @ moments.parity, axis=0)
    return Usual(offset=offset, sigma=sigma)
