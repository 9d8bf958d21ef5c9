"""The step that some accusations speak of."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.accusations import Accusation, Cluster
from fdilog.decision.steps import step_of
from fdilog.table import ChannelTable
from tests.tables import DEG, changed, put, triads

START_S, END_S = 40.0, 60.0


def accused(table: ChannelTable, start_s: float, end_s: float) -> Cluster:
    start, stop = np.searchsorted(table.time_s, [start_s, end_s]).tolist()
    return Cluster.of(
        Accusation(
            kind="bias",
            detector="parity",
            suspects=frozenset({table.names.index("imu1.y")}),
            start=start,
            stop=stop,
            length_s=end_s - start_s,
        )
    )


@pytest.mark.parametrize("size_deg_s", [-2.0, 3.0])
def test_a_step_is_placed_to_the_sample_where_it_is_larger_than_the_noise(
    size_deg_s: float,
) -> None:
    table = changed(triads(3, seconds=90.0), "imu1.y", START_S, END_S, add=size_deg_s * DEG)
    fault = step_of(table, accused(table, START_S + 4.0, END_S + 4.0), Config())
    assert table.time_s[fault.start] == pytest.approx(START_S, abs=0.1)
    assert table.time_s[fault.stop - 1] == pytest.approx(END_S, abs=0.1)


def test_a_shock_beside_what_is_accused_is_not_taken_for_it() -> None:
    shaken = changed(triads(3, seconds=90.0), "imu1.y", START_S, END_S, add=2.0 * DEG)
    rate = shaken.rate_rad_s.copy()
    shock = (shaken.time_s >= 30.0) & (shaken.time_s < 31.5)
    rate[shock, shaken.names.index("imu1.y")] += 60.0 * DEG
    table = put(shaken, rate)
    fault = step_of(table, accused(table, START_S, END_S), Config())
    assert table.time_s[fault.start] >= START_S - 0.1
    assert table.time_s[fault.stop - 1] <= END_S + 0.1
