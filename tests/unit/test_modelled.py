"""What a model of the vehicle adds to what the gyros say of one another."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.decision.judgement import Judgement, judge
from fdilog.decision.modelled import with_model
from fdilog.maths.geometry import Floats
from fdilog.table import ChannelTable
from fdilog.windows.survey import Survey
from tests.tables import table_of
from tests.vessels import configured, sailed

MODEL = (
    configured()
    .replace("windows", lengths_s=(1.0, 5.0, 20.0))
    .replace("detectors", use=("parity", "observer"))
)
TIME_S = np.arange(2400) * 0.05


def fault(size: float) -> dict[str, Floats]:
    rows = np.zeros(len(TIME_S))
    rows[1400:1700] = size
    return {"imu0.z": rows}


def asked(
    survey: Survey, table: ChannelTable | None = None, config: Config | None = None
) -> tuple[Judgement, list[str]]:
    table, config = table or survey.table, config or survey.config
    return with_model(judge(table, config), table, survey.signals, config)


def with_copies(survey: Survey, copies: int, *, faulty: bool) -> ChannelTable:
    """More triads that turn with the first one, which may be alone in its fault."""
    rates = survey.table.rate_rad_s
    other = rates.copy()
    if faulty:
        other[1400:1700, 2] -= 0.1
    noise = np.random.default_rng(2).normal(0.0, 0.002, (copies, *rates.shape))
    return table_of(survey.table.time_s, np.hstack([rates, *(other + n for n in noise)]))


def test_a_gyro_that_nothing_else_checks_fails_on_the_word_of_the_model() -> None:
    survey = sailed(MODEL, faults=fault(0.1))
    judged, notes = asked(survey)
    (finding,) = judged.findings
    assert (finding.kind, finding.suspects, finding.detectors) == (
        "bias",
        ("imu0.z",),
        ("observer",),
    )
    assert finding.size is not None
    assert finding.size.low < 0.1 < finding.size.high
    assert judged.status == ("insufficient", "insufficient", "failed")
    assert [note.split(":")[0] for note in notes] == ["observer"]
    assert judged.evidence[-1].detector == "observer"


def test_the_model_acquits_nobody() -> None:
    judged, _ = asked(sailed(MODEL))
    assert judged.findings == ()
    assert set(judged.status) == {"insufficient"}


def test_a_failed_speed_is_a_finding_but_no_gyro_has_failed() -> None:
    rows = np.zeros(len(TIME_S))
    rows[1400:1700] = 0.5
    judged, _ = asked(sailed(MODEL, faults={"boat.sway": rows}))
    (finding,) = judged.findings
    assert (finding.kind, finding.suspects, finding.size) == ("disagreement", ("boat.sway",), None)
    assert "off by" in finding.detail
    assert set(judged.status) == {"insufficient"}


def test_a_fault_that_the_gyros_have_found_gains_a_voice_and_no_second_finding() -> None:
    survey = sailed(MODEL, faults=fault(0.1))
    table = with_copies(survey, 2, faulty=True)
    alone = judge(table, MODEL)
    judged, _ = asked(survey, table)
    (before,), (after,) = alone.findings, judged.findings
    assert after.detectors == (*before.detectors, "observer")
    assert judged.status == alone.status


@pytest.mark.parametrize("copies", [1, 2])
def test_gyros_that_agree_are_believed_before_the_model(copies: int) -> None:
    # All triads turn with the boat: it is the boat that does not follow its model.
    survey = sailed(MODEL, faults=fault(0.1))
    table = with_copies(survey, copies, faulty=False)
    judged, notes = asked(survey, table)
    assert judged.findings == ()
    assert "failed" not in judged.status
    assert any("not believed from 7" in note and "imu0.z failed" in note for note in notes)


def test_of_two_that_disagree_the_model_names_the_failed_one() -> None:
    survey = sailed(MODEL, faults=fault(0.1))
    table = with_copies(survey, 1, faulty=True)
    judged, _ = asked(survey, table)
    pair = next(f for f in judged.findings if len(f.suspects) == 2)
    single = next(f for f in judged.findings if f.suspects == ("imu0.z",))
    assert "observer" not in pair.detectors
    assert single.detectors == ("observer",)
    assert judged.status[2] == "failed"
    assert judged.status[5] == "suspect"


def test_it_is_said_when_it_is_named_but_has_no_model() -> None:
    table = sailed(MODEL).table
    plain = Config().replace("windows", lengths_s=(5.0,))
    judged, notes = with_model(judge(table, plain), table, {}, plain)
    assert notes == []
    named = plain.replace("detectors", use=("parity", "observer"))
    _, notes = with_model(judged, table, {}, named)
    assert notes == ["observer: not asked: the configuration gives it no model"]


def test_a_model_whose_detector_is_not_among_those_named_is_not_asked() -> None:
    survey = sailed(MODEL, faults=fault(0.1))
    others = MODEL.replace("detectors", use=("parity",))
    judged, notes = asked(survey, config=others)
    assert (judged.findings, notes) == ((), [])
