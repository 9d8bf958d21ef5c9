"""The level that readings about each stay below, against a loop over its definition."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.detectors.impulse import FEWEST_AROUND, LEVEL, _levels
from tests.tables import table_of


@given(samples=st.integers(1, 600), seed=st.integers(0, 99))
def test_each_third_of_a_neighbourhood_has_the_quantile_of_all_of_it(
    samples: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=samples)
    rates = rng.normal(size=(samples, 3))
    rates[rng.random((samples, 3)) < 0.2] = np.nan
    # Ten readings a second: the fewest that are asked for are more than two seconds hold.
    found = _levels(table_of(np.arange(samples) / 10.0, rates), 0, values)
    rows = np.flatnonzero(np.isfinite(rates[:, 0]))
    third = FEWEST_AROUND // 3
    for place, row in enumerate(rows):
        first = place // third * third
        around = np.abs(values[rows])[max(0, first - third) : first + 2 * third]
        assert found[row] == np.quantile(around, LEVEL)
    assert not found[np.setdiff1d(np.arange(samples), rows)].any()
