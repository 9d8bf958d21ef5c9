"""Which channel a search statistic names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdilog.geometry import Floats


def named_channel(statistic: Floats, *, largest: bool) -> NDArray[np.intp]:
    """Channel with the extreme statistic in each sample.

    Parameters
    ----------
    statistic : (n_samples, n_channels)
        One figure a channel; not-a-number where the channel was not compared.
    largest
        Whether the failed channel is the one with the largest figure, or the smallest.

    Returns
    -------
    channel : (n_samples,)
        Index of the channel, -1 where none was compared. The first of several equal ones.
    """
    # -inf loses against every comparison that was made, an infinite ratio included.
    signed = np.where(np.isnan(statistic), -np.inf, statistic if largest else -statistic)
    return np.where(np.isnan(statistic).all(axis=1), -1, signed.argmax(axis=1))
