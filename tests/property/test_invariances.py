"""What no answer may depend on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from fdilog.config import Config
from fdilog.detectors.parity import ParityDetector
from fdilog.finding import Evidence
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, cut
from tests.tables import DEG, changed, triads

CONFIG = Config().replace("tolerance", scale=1e-9).replace("noise", time_sigma_s=0.0)


def evidence(table: ChannelTable, config: Config = CONFIG) -> Evidence:
    windows = cut(table, config)[2]
    return ParityDetector().detect(Survey(table=table, windows=windows, config=config))[0]


def with_rates(table: ChannelTable, rate: np.ndarray) -> ChannelTable:
    return replace(table, rate_rad_s=rate)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), size=st.sampled_from([0.0, 3.0, 40.0]))
def test_the_motion_of_the_body_changes_no_answer(seed: int, size: float) -> None:
    table = changed(triads(3, seed=seed, seconds=30.0), "imu1.z", 10.0, 20.0, add=size * DEG)
    motion = np.random.default_rng(seed).normal(0, 1, (len(table.time_s), 3))
    moved = evidence(with_rates(table, table.rate_rad_s + motion @ table.axes.T))
    still = evidence(table)
    assert (moved.accused == still.accused).all()
    np.testing.assert_allclose(moved.low, still.low, atol=1e-9)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), order=st.permutations(range(9)))
def test_permuting_channels_permutes_the_answer(seed: int, order: list[int]) -> None:
    table = changed(triads(3, seed=seed, seconds=30.0), "imu0.x", 10.0, 20.0, add=3.0 * DEG)
    permuted = replace(
        table,
        rate_rad_s=table.rate_rad_s[:, order],
        valid=table.valid[:, order],
        channels=tuple(table.channels[k] for k in order),
    )
    mine, theirs = evidence(table), evidence(permuted)
    assert ((mine.accused[:, order] > 0) == (theirs.accused > 0)).all()
    np.testing.assert_allclose(mine.high[:, order], theirs.high, rtol=1e-6, atol=1e-9)


@settings(max_examples=10)
@given(seed=st.integers(0, 1000), factor=st.sampled_from([0.01, 57.3, 1000.0]))
def test_scaling_the_readings_scales_the_sizes(seed: int, factor: float) -> None:
    table = changed(triads(3, seed=seed, seconds=30.0), "imu0.x", 10.0, 20.0, add=3.0 * DEG)
    scaled_config = CONFIG.replace("tolerance", bias_deg_s=factor).replace(
        "noise", bias_sigma_deg_s=CONFIG.noise.bias_sigma_deg_s * factor
    )
    config = CONFIG.replace("tolerance", bias_deg_s=1.0, scale=1e-9)
    plain = evidence(table, config)
    scaled = evidence(
        with_rates(table, table.rate_rad_s * factor),
        scaled_config.replace("tolerance", scale=1e-9),
    )
    assert (plain.accused == scaled.accused).all()
    np.testing.assert_allclose(scaled.low, plain.low * factor, rtol=1e-6, atol=1e-9 * factor)
