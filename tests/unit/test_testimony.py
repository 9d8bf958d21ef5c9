"""What the course of the differences from an attitude tells of two gyros."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision import testimony
from fdilog.sources.anchors import Drift
from fdilog.sources.witness import Witness
from tests.tables import DEG, triads

NO_DRIFT = Drift(
    error_rad_s=np.zeros(3),
    half_width_rad_s=np.ones(3),
    tilt_rad=0.0,
    anchors=("gravity", "compass"),
)


def said(
    *thirds_deg_s: float, anchored_deg_s: float = 0.0, doubt_deg_s: float = 3.0
) -> testimony.Testimony:
    first, middle, last = (size * DEG for size in thirds_deg_s)
    return testimony.Testimony(
        error=(first + middle + last) / 3.0,
        half_width=0.1 * DEG,
        drift=NO_DRIFT,
        anchored=anchored_deg_s * DEG,
        anchored_half_width=doubt_deg_s * DEG,
        tolerance=1.0 * DEG,
        thirds=(first, middle, last),
        confidence=testimony.ANCHOR_CONFIDENCE,
    )


def test_a_gyro_that_left_the_attitude_by_one_step_is_off_by_it() -> None:
    assert said(3.1, 2.8, 3.0).step == pytest.approx(2.97 * DEG, abs=0.01 * DEG)


@pytest.mark.parametrize(
    "thirds",
    [(3.0, 1.5, 0.7), (0.4, 1.4, 2.1), (3.0, 3.0, -3.0), (0.5, 0.6, 0.5)],
    ids=["followed", "comes off", "turns back", "within tolerance"],
)
def test_other_courses_are_no_step(thirds: tuple[float, float, float]) -> None:
    assert said(*thirds).step == 0.0


@pytest.mark.parametrize("tau_s", [5.0, 20.0, 60.0])
def test_what_a_corrected_filter_followed_is_touched(tau_s: float) -> None:
    left = 3.0 * (1.0 - np.exp(-np.array([5.0, 15.0, 25.0]) / tau_s))
    assert not said(*left).untouched(-3.0 * DEG)


def test_what_manoeuvres_do_to_an_attitude_is_no_touch() -> None:
    assert said(0.3, -0.4, 0.1).untouched(3.0 * DEG)


def test_anchors_bear_out_what_they_are_nearer_to() -> None:
    assert said(3.0, 3.0, 3.0, anchored_deg_s=2.0).borne_out(3.0 * DEG, 1.0)
    assert not said(3.0, 3.0, 3.0, anchored_deg_s=1.0).borne_out(3.0 * DEG, 1.0)


def test_a_single_gyro_needs_surer_anchors() -> None:
    vague = said(3.0, 3.0, 3.0, anchored_deg_s=2.0)
    assert not vague.borne_out(3.0 * DEG, testimony.LEAST_ODDS)
    assert replace(vague, anchored_half_width=1.5 * DEG).borne_out(3.0 * DEG, testimony.LEAST_ODDS)


def test_anchors_that_tell_nothing_bear_nothing_out() -> None:
    assert not said(3.0, 3.0, 3.0, doubt_deg_s=np.inf).borne_out(3.0 * DEG, 1.0)


def named(monkeypatch: pytest.MonkeyPatch, *each: testimony.Testimony) -> int | None:
    """Whom the attitude names if it says this of each of some gyros, over ten seconds."""
    table = triads(2, seconds=10.0)
    monkeypatch.setattr(
        testimony, "testimony", lambda _w, _t, channel, _s, **_how: each[channel // 3]
    )
    suspects = range(0, 3 * len(each), 3)
    whole = (0, len(table.time_s))
    return testimony.hear(cast("Witness", None), table, suspects, whole, Config()).named


def test_anchors_choose_which_of_two_is_off(monkeypatch: pytest.MonkeyPatch) -> None:
    off = said(2.7, 1.0, 2.6, anchored_deg_s=2.2, doubt_deg_s=1.0)
    sound = said(-0.3, -2.0, -0.4, anchored_deg_s=-0.8, doubt_deg_s=1.0)
    assert named(monkeypatch, sound, off) == 3
    assert named(monkeypatch, off, sound) == 0


def test_anchors_halfway_between_two_name_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    off = said(2.7, 1.0, 2.6, anchored_deg_s=1.7, doubt_deg_s=0.5)
    sound = said(-0.3, -2.0, -0.4, anchored_deg_s=-1.3, doubt_deg_s=0.5)
    assert off.failed
    assert not sound.failed
    assert named(monkeypatch, sound, off) is None


def test_anchors_that_leave_both_possible_name_neither(monkeypatch: pytest.MonkeyPatch) -> None:
    # One is a hair beyond the tolerance and the other a hair within.
    off = said(-0.8, 2.5, 4.0, anchored_deg_s=27.6, doubt_deg_s=26.4)
    sound = said(2.2, 5.5, 7.0, anchored_deg_s=24.4, doubt_deg_s=26.4)
    assert off.failed
    assert named(monkeypatch, sound, off) is None


def test_a_gyro_is_not_named_against_the_attitude_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    off = said(0.5, 0.3, 0.1, anchored_deg_s=3.0, doubt_deg_s=0.5)
    sound = said(-2.5, -2.7, -2.9, anchored_deg_s=0.0, doubt_deg_s=0.5)
    assert named(monkeypatch, off, sound) is None


def test_a_gyro_alone_must_be_beyond_the_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    assert named(monkeypatch, said(3.0, 1.0, 3.0, anchored_deg_s=2.0, doubt_deg_s=1.1)) is None
    assert named(monkeypatch, said(3.0, 1.0, 3.0, anchored_deg_s=2.0, doubt_deg_s=0.9)) == 0


def test_a_gyro_alone_is_off_on_the_side_on_which_the_attitude_leaves_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert named(monkeypatch, said(-3.0, -1.0, -3.0, anchored_deg_s=4.0, doubt_deg_s=0.9)) is None
    assert named(monkeypatch, said(-3.0, -1.0, -3.0, anchored_deg_s=-4.0, doubt_deg_s=0.9)) == 0


@pytest.mark.parametrize(("suspects", "confidence"), [((0,), 0.999), ((0, 3), 0.99)])
def test_a_gyro_alone_is_named_at_the_confidence_of_windows(
    monkeypatch: pytest.MonkeyPatch, suspects: tuple[int, ...], confidence: float
) -> None:
    asked: list[float] = []

    def heard(*_what: object, config: Config, confidence: float) -> testimony.Testimony:
        assert config == Config()
        asked.append(confidence)
        return said(0.0, 0.0, 0.0)

    monkeypatch.setattr(testimony, "testimony", heard)
    table = triads(2, seconds=10.0)
    testimony.hear(cast("Witness", None), table, suspects, (0, len(table.time_s)), Config())
    assert asked == [confidence] * len(suspects)
