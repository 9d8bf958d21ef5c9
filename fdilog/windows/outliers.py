"""How far readings must stand out for chance alone to stay within the budget of false findings.

What a flight shows above a level that few readings pass is taken for exponential (peaks over
threshold), so that vibration with heavy tails asks for more.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config

Floats = NDArray[np.float64]

# The level is that which so many stay below.
LEVEL = 0.95
# It is three to five middling readings where vibration is even; no reading of a recorded quadcopter
# stands out further if it is five at most.
MIDDLING_LEVELS = 5.0
# Its decay is read off where nine in ten of the peaks above the level are passed, so that faults do
# not stretch it; nor may a dozen faults among few peaks, which leave the middle of them alone.
# Recorded flights show 0.15 to 0.65 levels; half as much again is the most that is believed, and
# too few peaks are taken for middling.
PEAKS_PASSED = 0.9
MOST_STRETCHED = 3.0
FEWEST_PEAKS = 20
MIDDLING_DECAY = 0.3
MOST_DECAY = 1.0


def least_levels(peaks: Floats, per_hour: float, config: Config) -> float:
    """How many levels a reading stands out at least, for chance alone to stay in the budget.

    Parameters
    ----------
    peaks : (n_peaks,)
        Peaks above the level, in levels. [1]
    per_hour
        How many readings are looked at in an hour.
    """
    decay = MIDDLING_DECAY
    if len(peaks) >= FEWEST_PEAKS:
        middle, far = np.quantile(peaks - 1.0, (0.5, PEAKS_PASSED))
        stretched = MOST_STRETCHED * middle / np.log(2.0)
        decay = float(min(far / -np.log(1.0 - PEAKS_PASSED), stretched, MOST_DECAY))
    doubt = config.windows.false_findings_per_hour / per_hour
    return 1.0 + decay * max(0.0, float(np.log((1.0 - LEVEL) / doubt)))
