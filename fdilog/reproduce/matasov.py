"""The worked example of [Matasov24]: two gyros of six have failed.

References
----------
[Matasov24] A. I. Matasov, E. V. Shestakova, "Failure determination for a redundant inertial sensor
    unit by guaranteeing estimation", Vestnik MSU ser. 1, 2024, no. 5, 77-81.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import SupportsInt

import numpy as np

from fdilog.detectors.baselines import least_absolute_errors, least_squares_errors
from fdilog.detectors.guaranteed import guaranteed_intervals
from fdilog.maths.geometry import named_axes
from fdilog.reproduce.row import Row, rounded

BOUND_DEG_H, THRESHOLD_DEG_H = 1.0, 10.0
MAX_FAILURES = 2

READINGS_DEG_H = (-393.04, 1075.35, -612.73, -593.11, 1254.79, 761.19)
"""z; the paper prints z_2 = 1085.35, which contradicts its own result: the rate it states, the
fault of 20 and the fluctuation of 0.10 add up to 1075.35."""

PRINTED_PAIR = "2, 3"
PRINTED_RANGE_2 = (1051.72, 1057.20)
PRINTED_ERRORS = (0.0, 20.89, -51.35, 0.0, 0.0, 0.0)
PRINTED_HALF_WIDTHS = (1.00, 2.74, 2.74, 1.00, 1.00, 1.00)


def _channels(indices: Iterable[SupportsInt]) -> str:
    return ", ".join(str(int(i) + 1) for i in indices)


def rows(seed: int) -> list[Row]:  # noqa: ARG001 - nothing is drawn here
    """Compare the example, and what its two rivals make of it."""
    axes = named_axes("matasov")
    readings = np.array([READINGS_DEG_H])
    low, high, feasible = guaranteed_intervals(readings, axes, BOUND_DEG_H, MAX_FAILURES)
    middle, half_width = (low[0] + high[0]) / 2.0, (high[0] - low[0]) / 2.0
    errors = readings[0] - middle

    subsets = list(combinations(range(len(axes)), MAX_FAILURES))
    pairs = "; ".join(_channels(subsets[at]) for at in np.flatnonzero(feasible[0]))
    failed = _channels(np.flatnonzero(np.abs(errors) - half_width > THRESHOLD_DEG_H))
    example = "example"
    found = [
        Row(
            table=example,
            quantity="feasible pairs",
            printed=PRINTED_PAIR,
            ours=pairs,
            agrees=pairs == PRINTED_PAIR,
            note="with z_2 = 1075.35: the 1085.35 in print contradicts the paper's result",
        ),
        Row(
            table=example,
            quantity=f"failed beyond {THRESHOLD_DEG_H:g} deg/h",
            printed=PRINTED_PAIR,
            ours=failed,
            agrees=failed == PRINTED_PAIR,
            note="the whole interval lies beyond the threshold",
        ),
    ]
    figures = [
        ("l_min of channel 2 [deg/h]", PRINTED_RANGE_2[0], low[0, 1]),
        ("l_max of channel 2 [deg/h]", PRINTED_RANGE_2[1], high[0, 1]),
        *(
            (f"error of channel {i + 1} [deg/h]", printed, errors[i])
            for i, printed in enumerate(PRINTED_ERRORS)
        ),
        *(
            (f"guaranteed half-width of channel {i + 1} [deg/h]", printed, half_width[i])
            for i, printed in enumerate(PRINTED_HALF_WIDTHS)
        ),
    ]
    found += [
        rounded(example, quantity, printed=printed, ours=float(ours), places=2)
        for quantity, printed, ours in figures
    ]
    for method, seen, remark in (
        ("least squares", least_squares_errors(readings, axes)[0], "the paper finds neither"),
        (
            "least absolute deviations",
            least_absolute_errors(readings, axes)[0],
            "the mean of several vectors with the same smallest 1-norm; the paper finds one",
        ),
    ):
        beyond = _channels(np.flatnonzero(np.abs(seen) > THRESHOLD_DEG_H))
        found.append(
            Row(
                table="rivals",
                quantity=f"{method}: identifies both faults",
                printed="no",
                ours="yes" if beyond == PRINTED_PAIR else "no",
                agrees=beyond != PRINTED_PAIR,
                note=(
                    f"errors {', '.join(f'{value:.2f}' for value in seen)} deg/h, beyond "
                    f"{THRESHOLD_DEG_H:g}: {beyond}; {remark}, by a rule it does not state"
                ),
            )
        )
    return found
