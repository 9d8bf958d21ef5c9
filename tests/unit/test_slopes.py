"""Scale errors of a part of a flight: found where the rate varies, and told from all else."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.judgement import judge
from fdilog.finding import Finding
from fdilog.table import ChannelTable
from fdilog.windows.slopes import slopes
from tests.tables import DEG, table_of

CONFIG = Config().replace("detectors", use=("parity",))
RATE_HZ = 50.0


def motion(time_s: NDArray[np.float64], size_deg_s: float) -> NDArray[np.float64]:
    """Turns about all axes, of other periods each."""
    turns = np.sin(2 * np.pi * time_s[:, None] * [0.31, 0.23, 0.17] + [0.0, 1.0, 2.0])
    return size_deg_s * DEG * np.asarray(turns, np.float64)


def flown(
    n_triads: int, size_deg_s: float, *, seconds: float = 80.0, late_s: float = 0.0
) -> ChannelTable:
    """Triads in turns, with noise and a little misalignment; the last is read a little later."""
    rng = np.random.default_rng(5)
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    columns = [motion(time_s, size_deg_s) for _ in range(n_triads - 1)]
    columns.append(motion(time_s - late_s, size_deg_s))
    rate = np.hstack(columns)
    rate[:, 3] += 0.01 * rate[:, 1]
    return table_of(time_s, rate + rng.normal(0.0, 0.5 * DEG, rate.shape))


def scaled(table: ChannelTable, channel: int, factor: float, a: float, b: float) -> ChannelTable:
    rate = table.rate_rad_s.copy()
    rate[(table.time_s >= a) & (table.time_s < b), channel] *= factor
    return table_of(table.time_s, rate)


def only(findings: tuple[Finding, ...]) -> Finding:
    assert len(findings) == 1, findings
    return findings[0]


@pytest.mark.parametrize("factor", [1.2, 0.85])
def test_a_scale_error_of_twenty_seconds_is_one_finding_of_its_channel(factor: float) -> None:
    table = scaled(flown(3, 12.0), 4, factor, 30.0, 50.0)
    finding = only(judge(table, CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("scale", ("imu1.y",))
    assert finding.start_s == pytest.approx(30.0, abs=1.5)
    assert finding.end_s == pytest.approx(50.0, abs=1.5)
    assert finding.size is not None
    assert finding.size.low < factor < finding.size.high
    assert finding.size.high - finding.size.low < 0.1


def test_of_two_gyros_both_are_suspects_of_a_scale_error() -> None:
    finding = only(judge(scaled(flown(2, 12.0), 5, 1.2, 30.0, 50.0), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("scale", ("imu0.z", "imu1.z"))
    assert finding.size is not None
    # The first suspect's, if it is the one.
    assert finding.size.low < 1 / 1.2 < finding.size.high


def test_what_hardly_turns_shows_no_scale_error() -> None:
    assert judge(scaled(flown(3, 0.5), 4, 1.2, 30.0, 50.0), CONFIG).findings == ()


def test_gyros_read_at_other_instants_have_no_scale_error() -> None:
    # Half a radian a second squared: five milliseconds make 0.1 deg/s of it.
    assert judge(flown(2, 15.0, late_s=0.005), CONFIG).findings == ()


def test_a_bias_that_comes_in_a_turn_is_no_scale_error() -> None:
    table = flown(3, 12.0)
    rate = table.rate_rad_s.copy()
    rate[(table.time_s >= 30.0) & (table.time_s < 50.0), 4] += 3.0 * DEG
    finding = only(judge(table_of(table.time_s, rate), CONFIG).findings)
    assert (finding.kind, finding.suspects) == ("bias", ("imu1.y",))


def test_the_noise_of_another_gyro_is_no_scale_error() -> None:
    table = flown(3, 0.5)
    rate = table.rate_rad_s.copy()
    rng = np.random.default_rng(6)
    rows = (table.time_s >= 30.0) & (table.time_s < 50.0)
    rate[rows, 4] += rng.normal(0.0, 8.0 * DEG, int(rows.sum()))
    assert judge(table_of(table.time_s, rate), CONFIG).findings == ()


def test_a_slope_is_exact_without_noise_whatever_else_follows_the_motion() -> None:
    time_s = np.arange(40) / 2.0
    u = np.sin(time_s)[None]
    across, late = np.cos(0.3 * time_s)[None], np.gradient(u, 0.5, axis=1)
    error = 0.03 * u + 0.004 * across + 0.001 * late + 0.02
    beside = np.stack([across - across.mean(), late - late.mean()], axis=2)
    found = slopes(error, u, 0.01 * beside, CONFIG)
    assert found.slope[0] == pytest.approx(0.03, rel=1e-3)
    assert found.moving[0]


def test_the_interval_of_a_slope_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(7)
    n, s = 4000, 40
    u = 10.0 * np.sin(np.arange(s) / 2.0 + rng.uniform(0, 6, (n, 1)))
    error = 0.1 * u + rng.normal(0.0, 0.5, (n, s))
    found = slopes(error, u, np.zeros((n, s, 1)), CONFIG)
    covered = np.abs(found.slope - 0.1) <= found.half_width(0.95)
    # Three binomial standard deviations below, and not much wider than it need be.
    assert 0.94 <= covered.mean() <= 0.985
