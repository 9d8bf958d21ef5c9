"""Windows laid where a fault seems to lie."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.alignment import aligned_windows
from fdilog.decision.judgement import judge
from fdilog.finding import Evidence
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, cut, spans
from tests.tables import DEG, changed, put, table_of, triads

CONFIG = Config().replace("detectors", use=("parity",))
# Independent noise with which ten seconds know a mean to a deg/s, and twenty to 0.7.
SHAKE_DEG_S = 6.0


def shaken(seed: int) -> ChannelTable:
    table = triads(3, seconds=90.0)
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, SHAKE_DEG_S * DEG, table.rate_rad_s.shape)
    return put(table, table.rate_rad_s + noise)


def evidence(table: ChannelTable) -> list[Evidence]:
    from fdilog.registry import detectors

    ((_, parity),) = detectors(["parity"])
    surveys = (Survey(table=table, windows=each, config=CONFIG) for each in cut(table, CONFIG))
    return [item for survey in surveys for item in parity.detect(survey)]


@pytest.mark.parametrize("seed", range(4))
def test_a_window_is_laid_over_a_fault_that_no_regular_window_fits(seed: int) -> None:
    table = changed(shaken(seed), "imu1.y", 25.3, 45.3, add=2.2 * DEG)
    aligned = aligned_windows(table, evidence(table))
    assert aligned is not None
    off = np.abs(aligned.start_s - 25.3) + np.abs(aligned.end_s - 45.3)
    assert float(off.min()) < 5.0


def test_no_window_laid_to_fit_accuses_a_sound_gyro() -> None:
    for seed in range(6):
        table = changed(shaken(seed), "imu1.y", 25.3, 45.3, add=2.2 * DEG)
        assert {finding.suspects for finding in judge(table, CONFIG).findings} <= {("imu1.y",)}


def test_quiet_gyros_give_no_hint() -> None:
    table = triads(3)
    assert aligned_windows(table, evidence(table)) is None


def test_a_window_laid_to_fit_is_held_against_all_of_its_size_and_not_against_itself() -> None:
    table = triads(3, seconds=100.0, sigma_deg_s=3.0)
    quiet = (table.time_s >= 40.0) & (table.time_s < 47.0)
    rate = table.rate_rad_s.copy()
    rate[quiet] = triads(3, seconds=100.0, sigma_deg_s=0.3).rate_rad_s[quiet]
    table = table_of(table.time_s, rate)
    rows = np.flatnonzero(quiet)
    laid = spans(table, rows[:1], rows[-1:] + 1)
    for moments in Survey(table=table, windows=laid, config=Config()).moments:
        own = moments.parity_mean.covariance[0]
        assert np.trace(own) < 0.05 * np.trace(moments.typical)
        usual = (3.0 * DEG) ** 2 / len(rows)
        # The quieter half of windows, each known to a fifth or so.
        np.testing.assert_allclose(np.diag(moments.typical), usual, rtol=0.5)
