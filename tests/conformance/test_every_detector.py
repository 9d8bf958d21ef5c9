"""What holds for every installed detector, a third party's too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.finding import SIZE_UNIT, Evidence
from fdilog.registry import Detector, plugins
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey, cut, spans
from tests.tables import DEG, biased, put, triads, unit

NAMES = tuple(plugins("detectors"))
CONFIG = Config().replace("windows", lengths_s=(1.0, 5.0))
# Where answers are compared with those on other motions, the tolerance must not follow the rate.
STILL = (
    CONFIG.replace("tolerance", scale=1e-9)
    .replace("noise", time_sigma_s=0.0)
    .replace("noise", scale_sigma=0.0)
)


def made(name: str) -> Detector:
    detector: Detector = plugins("detectors")[name]()
    return detector


def surveys(name: str, table: ChannelTable, config: Config = CONFIG) -> list[Survey]:
    """What the detector is shown of a table, by its stage."""
    stage = made(name).stage
    if stage in {"alone", "model"}:
        family = [spans(table, np.array([0]), np.array([len(table.time_s)]))]
    elif stage == "samples":
        each = np.arange(len(table.time_s))
        family = [spans(table, each, each + 1)]
    else:
        family = cut(table, config)
    if stage == "model":
        config = modelled(table, config)
    return [Survey(table=table, windows=windows, config=config) for windows in family]


def modelled(table: ChannelTable, config: Config) -> Config:
    """A model of two channels that were seen to be healthy at first, without commands."""
    names = sorted(table.names)
    first, second = names[0], names[4 % len(names)]
    return config.replace(
        "observer",
        outputs=(first, second),
        A=((-1.0, 0.3), (0.2, -2.0)),
        healthy_s=(0.0, 5.0),
        eigenvalues_per_s=(-8.0, -8.0),
    )


def answers(name: str, table: ChannelTable, config: Config = CONFIG) -> list[Evidence]:
    return [e for survey in surveys(name, table, config) for e in made(name).detect(survey)]


def check(name: str, found: Evidence, table: ChannelTable) -> None:
    shape = (len(found.windows), len(table.channels))
    assert found.detector == name
    assert found.kind in {*SIZE_UNIT, "stuck", "dead", "saturated", "dropout", "mounting"}
    assert 0.0 < found.confidence <= 1.0
    for array in (found.low, found.high, found.tolerance):
        assert array.shape == shape
        assert array.dtype == np.float64
    assert found.tested.shape == found.accused.shape == shape
    assert found.tested.dtype == np.bool_
    assert found.accused.dtype == np.int8
    assert (found.accused >= 0).all()
    assert found.tested[found.accused > 0].all(), "accused without having been tested"
    assert not (found.low > found.high).any()
    assert (found.windows.start < found.windows.stop).all()
    assert (found.windows.stop <= len(table.time_s)).all()


def troubled() -> ChannelTable:
    """Three triads with something in them for every kind of detector."""
    table = biased(triads(3, seconds=40.0), 4, 6.0, 20.0, 30.0)
    rate, time_s = table.rate_rad_s.copy(), table.time_s
    rate[(time_s >= 5.0) & (time_s < 8.0), 3:6] = np.nan
    rate[(time_s >= 10.0) & (time_s < 13.0), 0] = rate[500, 0]
    rate[800, 2] += 400.0 * DEG
    rate[::7, 7] = np.nan
    return put(table, rate)


def test_all_of_the_suite_is_installed() -> None:
    assert {"parity", "difference", "guaranteed", "joint", "flatline", "dropout"} <= set(NAMES)
    assert "observer" in NAMES


@pytest.mark.parametrize("name", NAMES)
def test_a_detector_says_what_it_is(name: str) -> None:
    detector = made(name)
    assert detector.description
    assert "\n" not in detector.description
    assert detector.stage in {"alone", "samples", "windows", "model"}


@pytest.mark.parametrize("name", NAMES)
def test_evidence_has_a_row_a_window_and_a_column_a_channel(name: str) -> None:
    for table in (triads(3, seconds=20.0), unit("dodecahedron"), triads(1, seconds=20.0)):
        for found in answers(name, table):
            check(name, found, table)


@pytest.mark.parametrize("name", NAMES)
def test_gaps_and_silences_are_no_obstacle(name: str) -> None:
    table = troubled()
    for found in answers(name, table):
        check(name, found, table)
    mute = table.rate_rad_s.copy()
    mute[:, 1] = np.nan
    for found in answers(name, put(table, mute)):
        check(name, found, table)
        assert not found.tested[:, 1].any() or found.kind == "dropout"


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("samples", [1, 2, 3])
def test_a_table_of_hardly_any_samples_accuses_nobody(name: str, samples: int) -> None:
    keep = np.arange(len(unit("dodecahedron").time_s)) < samples
    for table in (unit("dodecahedron").only(keep), unit("aligned-triads", 6).only(keep)):
        # A bound that is not known is infinite, and BLAS may flag what it multiplies it with in
        # lanes that it throws away.
        with np.errstate(invalid="ignore"):
            found_here = answers(name, table)
        for found in found_here:
            check(name, found, table)
            assert not found.accused.any()


@pytest.mark.parametrize("name", [n for n in NAMES if made(n).stage in {"samples", "windows"}])
def test_neither_no_sample_nor_no_window_is_an_obstacle(name: str) -> None:
    table = unit("dodecahedron")
    for found in answers(name, table.only(np.zeros(len(table.time_s), bool))):
        assert found.tested.shape == found.low.shape == found.accused.shape == (0, 6)
    if made(name).stage == "windows":
        none = np.zeros(0, np.int64)
        for found in made(name).detect(
            Survey(table=table, windows=spans(table, none, none, 1.0), config=CONFIG)
        ):
            check(name, found, table)


@pytest.mark.parametrize("name", NAMES)
def test_the_table_is_left_as_it_was(name: str) -> None:
    table = troubled()
    before = [a.copy() for a in (table.time_s, table.rate_rad_s, table.valid)]
    for survey in surveys(name, table):
        at = [a.copy() for a in (survey.windows.start, survey.windows.stop)]
        made(name).detect(survey)
        np.testing.assert_array_equal([survey.windows.start, survey.windows.stop], at)
    for was, is_now in zip(before, (table.time_s, table.rate_rad_s, table.valid), strict=True):
        np.testing.assert_array_equal(is_now, was)


@pytest.mark.parametrize("name", NAMES)
def test_asking_twice_gives_the_same_answer(name: str) -> None:
    table = troubled()
    for first, second in zip(answers(name, table), answers(name, table), strict=True):
        np.testing.assert_array_equal(first.accused, second.accused)
        np.testing.assert_array_equal(first.low, second.low)


# To a model of the vehicle its motion is all there is.
@pytest.mark.parametrize("name", [n for n in NAMES if made(n).stage != "model"])
@pytest.mark.parametrize(("geometry", "channels"), [("aligned-triads", 9), ("dodecahedron", 6)])
def test_the_motion_of_the_body_changes_no_comparison(
    name: str, geometry: str, channels: int
) -> None:
    table = biased(unit(geometry, channels), 2, 6.0, 10.0, 20.0)
    motion = np.random.default_rng(3).normal(0.0, 1.0, (len(table.time_s), 3))
    moved = put(table, table.rate_rad_s + motion @ table.axes.T)
    for still, turned in zip(answers(name, table, STILL), answers(name, moved, STILL), strict=True):
        if still.kind == "bias":
            np.testing.assert_array_equal(still.accused, turned.accused)
            np.testing.assert_allclose(still.low, turned.low, rtol=1e-6, atol=1e-9)
            np.testing.assert_allclose(still.high, turned.high, rtol=1e-6, atol=1e-9)


def found(name: str, table: ChannelTable) -> list[Evidence]:
    """Answers in the order of time: what judges channels alone lists them channel by channel."""
    listed = []
    for item in answers(name, table):
        order = np.lexsort((item.windows.stop, item.windows.start))
        arrays = {k: getattr(item, k)[order] for k in ("tested", "accused", "low", "high")}
        listed.append(replace(item, **arrays))
    return listed


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("seed", [0])
def test_permuting_the_channels_permutes_the_answer(name: str, seed: int) -> None:
    for table in (biased(unit("dodecahedron"), 2, 6.0, 10.0, 20.0), troubled()):
        order = np.random.default_rng(seed).permutation(len(table.channels))
        permuted = replace(
            table,
            rate_rad_s=table.rate_rad_s[:, order],
            valid=table.valid[:, order],
            channels=tuple(table.channels[k] for k in order),
        )
        for mine, theirs in zip(found(name, table), found(name, permuted), strict=True):
            np.testing.assert_array_equal(mine.tested[:, order], theirs.tested)
            np.testing.assert_array_equal(mine.accused[:, order] > 0, theirs.accused > 0)
            for one, other in ((mine.low, theirs.low), (mine.high, theirs.high)):
                np.testing.assert_allclose(one[:, order], other, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("factor", [57.3])
def test_scaling_the_readings_and_the_tolerances_scales_the_sizes(name: str, factor: float) -> None:
    config = CONFIG.replace("noise", bound_deg_s=2.0)
    scaled_config = (
        config.replace("tolerance", bias_deg_s=factor * config.tolerance.bias_deg_s)
        .replace("tolerance", impulse_deg_s=factor * config.tolerance.impulse_deg_s)
        .replace("noise", bias_sigma_deg_s=factor * config.noise.bias_sigma_deg_s)
        .replace("noise", bound_deg_s=factor * config.noise.bound_deg_s)
    )
    table = troubled()
    scaled = replace(
        table,
        rate_rad_s=table.rate_rad_s * factor,
        channels=tuple(replace(c, step_rad_s=c.step_rad_s * factor) for c in table.channels),
    )
    for plain, large in zip(
        answers(name, table, config), answers(name, scaled, scaled_config), strict=True
    ):
        grows = factor if SIZE_UNIT.get(plain.kind, "").startswith("rad") else 1.0
        np.testing.assert_array_equal(plain.accused, large.accused)
        np.testing.assert_allclose(large.low, plain.low * grows, rtol=1e-6, atol=1e-9 * grows)
        np.testing.assert_allclose(large.high, plain.high * grows, rtol=1e-6, atol=1e-9 * grows)
