"""How a device is mounted, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fdilog.sources.turned import FIT, Turn
from fdilog.table import PARALLEL

Floats = NDArray[np.float64]

AXES = "xyz"
HALF_TURN_DEG = 179.0
SMALL = 0.1
"""Parts of an axis below this are not written: the rest is misalignment."""


def described(
    turn: Turn, source: str, among: Sequence[str], witness: str | None, *, alone: bool = False
) -> str:
    """Say how a device is mounted, as far as its rates tell.

    Parameters
    ----------
    source
        The device whose readings were turned back.
    among
        The devices that may be the one.
    witness
        The derived source that told which.
    alone
        Whether there is no other device, and it is held against that source alone.
    """
    said = f"{source} {_words(turn)}"
    if len(among) > 1:
        said = f"as {_listed([one for one in among if one != source])} sees it, {said}"
    if alone:
        said += ", or the attitude is, with which alone it was compared"
    elif witness:
        said += "; the attitude tells that it is the one"
    return f"{said}; the comparison goes on with its rates turned back"


def _words(turn: Turn) -> str:
    """Describe a mounting: how it is turned, and which channel reads which axis."""
    reads = [f"{AXES[k]} reads {_reads(turn.matrix[k])}" for k in range(3)]
    if len(turn.standing) == 1:
        diagonal = np.diag(turn.matrix)
        if np.linalg.det(turn.matrix) < 0 and bool((np.abs(diagonal) > PARALLEL).all()):
            return f"has {_listed([AXES[k] for k in np.flatnonzero(diagonal < 0)])} inverted"
        return f"is {_turned(turn.matrix)} ({', '.join(reads)})"
    told = [reads[k] for k in range(3) if float(np.ptp(turn.standing[:, k], axis=0).max()) < FIT]
    said = f"is mounted otherwise ({', '.join(told)})" if told else "is mounted otherwise"
    return (
        f"{said}; the flight turned too little about other axes to tell more, it may be"
        f" {_turned(turn.matrix)}"
    )


def _reads(row: Floats) -> str:
    """Write which body axis a channel reads."""
    parts = [
        f"{'-' if part < 0 else '+'}{'' if abs(part) > PARALLEL else f'{abs(part):.2f} '}{axis}"
        for part, axis in zip(row, AXES, strict=True)
        if abs(part) > SMALL
    ]
    return " ".join(parts).removeprefix("+")


def _turned(matrix: Floats) -> str:
    """Write by what turn a device comes to read this, from where it should be."""
    sensor = matrix.T
    if np.linalg.det(sensor) < 0:
        return "mounted with axes swapped and inverted as by a mirror"
    degrees = float(np.degrees(np.arccos(np.clip((np.trace(sensor) - 1.0) / 2.0, -1.0, 1.0))))
    values, vectors = np.linalg.eig(sensor)
    axis = np.real(vectors[:, np.abs(values - 1.0).argmin()])
    skew = np.array(
        [sensor[2, 1] - sensor[1, 2], sensor[0, 2] - sensor[2, 0], sensor[1, 0] - sensor[0, 1]]
    )
    # Half a turn is the same either way about; the axis is then written with its largest part up.
    upright = float(skew @ axis) if degrees < HALF_TURN_DEG else float(axis[np.abs(axis).argmax()])
    axis = axis * (1.0 if upright >= 0 else -1.0)
    return f"turned by {degrees:.0f} deg about {_reads(axis)}"


def _listed(words: Sequence[str]) -> str:
    return f"{', '.join(words[:-1])} and {words[-1]}" if len(words) > 1 else words[0]
