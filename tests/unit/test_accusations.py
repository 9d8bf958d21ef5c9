"""Accusations that speak of one fault are joined."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog.decision.accusations import Accusation, Cluster, clusters

TIME_S = np.arange(400) * 0.5

spoken = st.builds(
    lambda start, samples, length_s, suspects: Accusation(
        suspects=frozenset(suspects),
        start=start,
        stop=start + samples,
        length_s=length_s,
        detector="d",
        kind="bias",
    ),
    st.integers(0, 350),
    st.integers(1, 40),
    st.sampled_from([0.0, 2.0, 20.0]),
    st.sets(st.integers(0, 3), min_size=1, max_size=2),
)


def all_compared(accused: Sequence[Accusation], reach_s: float) -> list[Cluster]:
    """Join each with every one before it, however long ago."""
    found: list[Cluster] = []
    for item in sorted(accused, key=lambda a: (a.start, a.stop, -a.length_s, sorted(a.suspects))):
        merged, apart = Cluster.of(item), []
        for other in found:
            gap_s = TIME_S[merged.start] - TIME_S[other.stop - 1]
            near = gap_s <= max(merged.longest_s / 2, other.longest_s / 2, reach_s)
            if near and other.suspects & merged.suspects:
                merged = merged.joined(other)
            else:
                apart.append(other)
        found = [*apart, merged]
    return found


@given(st.lists(spoken, max_size=12), st.sampled_from([0.0, 5.0]))
def test_those_out_of_reach_need_no_comparison(accused: list[Accusation], reach_s: float) -> None:
    assert clusters(TIME_S, accused, reach_s) == all_compared(accused, reach_s)
