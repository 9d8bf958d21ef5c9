"""Gyros that no other gyro checks: what they are held against, and what that is worth."""

from __future__ import annotations

import numpy as np

from fdilog.analysis import Analysis
from fdilog.maths.geometry import detectable

ROUNDING = 1e-9
"""A cosine below this is a right angle."""


def lone_gyros(analysis: Analysis) -> list[str]:
    """Name the gyros that are compared, but with no other gyro."""
    gyros = analysis.table.gyros
    checked = detectable(gyros.axes).tolist() if gyros.channels else []
    compared = set(analysis.isolability.detectable)
    return [
        name
        for name, by_gyros in zip(gyros.names, checked, strict=True)
        if not by_gyros and name in compared
    ]


def unheld(analysis: Analysis) -> list[str]:
    """Name the lone gyros whose only witness nothing holds to the truth about their axis.

    A filter that follows a failed gyro agrees with it, so agreement decides nothing there.
    """
    lone = set(lone_gyros(analysis))
    unsure = [
        channel
        for channel, status in zip(analysis.table.channels, analysis.status, strict=True)
        if status != "healthy"
    ]
    witness = [channel.axis for channel in unsure if channel.derived]
    return [
        channel.name
        for channel in unsure
        if channel.name in lone
        and any(abs(float(np.dot(axis, channel.axis))) > ROUNDING for axis in witness)
    ]
