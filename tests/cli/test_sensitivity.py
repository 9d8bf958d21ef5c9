from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner, Result

from fdilog.analysis import analyse_recording
from fdilog.cli import app
from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.experiments.faults import Fault
from fdilog.experiments.sensitivity import RESOLUTION, VOTERS, Sensitivity, sensitivity, smallest
from fdilog.experiments.sensitivity_report import as_json, as_svg, in_words
from fdilog.experiments.simulate import simulate
from fdilog.registry import plugins
from fdilog.writing import write

FLIGHT = simulate(50.0, 20.0, seed=3).recording(attitude=False)
QUICK: dict[str, Any] = {"kinds": ("bias", "dropout"), "channels": ("imu1.y",), "trials": 1}


@pytest.fixture(scope="module")
def seen() -> Sensitivity:
    """Two channels, tried once."""
    return sensitivity(FLIGHT, kinds=["stuck"], channels=["imu0.x", "imu1.z"], trials=1)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["sensitivity", *map(str, arguments)])


@given(st.floats(0.01, 100.0), st.floats(0.001, 1000.0))
def test_bisection_finds_a_threshold_to_its_resolution_from_any_guess(
    threshold: float, guess: float
) -> None:
    found = smallest(lambda size: size >= threshold, 0.001, 1000.0, guess)
    assert found is not None
    assert threshold <= found <= threshold * RESOLUTION * (1.0 + 1e-9)


@given(st.floats(0.001, 1000.0))
def test_bisection_stops_at_both_ends(guess: float) -> None:
    assert smallest(lambda _: False, 0.001, 1000.0, guess) is None
    assert smallest(lambda _: True, 0.001, 1000.0, guess) == 0.001


def test_detectors_that_only_vote_make_no_finding() -> None:
    faults = [
        Fault(kind="bias", channel="imu1.y", start_s=20.0, end_s=40.0, size=0.05),
        Fault(kind="stuck", channel="imu2.x", start_s=10.0, end_s=15.0),
    ]
    recording = simulate(50.0, 20.0, seed=3, faults=faults).recording(attitude=False)
    everyone = sorted(plugins("detectors"), key=lambda name: (name != "parity", name))
    asked = [everyone, [name for name in everyone if name not in VOTERS]]
    findings = [
        [
            (f.kind, f.suspects, f.start_s, f.end_s, f.size)
            for f in analyse_recording(
                recording, Config().replace("detectors", use=tuple(names))
            ).findings
        ]
        for names in asked
    ]
    assert set(everyone) >= VOTERS
    assert len(findings[0]) >= 2
    assert findings[0] == findings[1]


def test_a_bias_is_found_from_its_tolerance_on_and_a_silence_from_its_limit_on() -> None:
    seen = sensitivity(FLIGHT, **QUICK)
    bias, dropout = seen.answers
    assert bias.found is not None
    assert dropout.found is not None
    # The tolerance is 1 deg/s and half a second; between two readings lies 0.04 s.
    assert math.radians(0.7) < bias.found < math.radians(4.0)
    assert bias.isolated is not None
    assert bias.isolated >= bias.found
    assert 0.45 < dropout.found < 0.55 * RESOLUTION
    assert seen.runs == sum(trial.runs for answer in seen.answers for trial in answer.trials) > 4


def test_the_answer_does_not_depend_on_the_number_of_processes() -> None:
    assert sensitivity(FLIGHT, **QUICK) == sensitivity(FLIGHT, jobs=2, **QUICK)


def test_two_aligned_gyros_find_a_bias_and_never_isolate_it() -> None:
    recording = simulate(50.0, 20.0, seed=3, sources=2).recording(attitude=False)
    seen = sensitivity(recording, kinds=["bias"], channels=["imu1.y"], trials=1)
    assert seen.answers[0].found is not None
    assert seen.answers[0].isolated is None
    assert " / -" in in_words(seen)


def test_a_channel_that_is_accused_already_is_not_tried_and_that_is_said() -> None:
    stuck = Fault(kind="stuck", channel="imu1.y", start_s=2.0)
    recording = simulate(50.0, 20.0, seed=3, faults=[stuck]).recording(attitude=False)
    seen = sensitivity(recording, kinds=["bias"], channels=["imu1.y"], trials=1)
    assert seen.answers[0].trials == ()
    assert "imu1.y, bias: not tried, accused in the log as it is" in in_words(seen)


def test_the_table_the_json_and_the_picture_say_the_same(seen: Sensitivity) -> None:
    told = json.loads(as_json(seen))
    assert [one["channel"] for one in told["answers"]] == ["imu0.x", "imu1.z"]
    assert all(0.1 < one["found"] < 2.0 and one["unit"] == "s" for one in told["answers"])
    words = in_words(seen)
    assert "stuck [s]" in words
    assert f"{told['runs']} analyses" in words
    assert "Not tried: two faults at once" in words
    lines = [line.split() for line in words.splitlines()]
    for one in told["answers"]:
        assert [one["channel"], f"{one['found']:.2g}"] in lines
    picture = ET.fromstring(as_svg(seen))  # noqa: S314
    assert len(list(picture.iter("{http://www.w3.org/2000/svg}circle"))) == 2


def test_a_picture_escapes_the_names_of_a_log(seen: Sensitivity) -> None:
    answers = (replace(seen.answers[0], channel="<a&b>"),)
    ET.fromstring(as_svg(replace(seen, channels=("<a&b>",), answers=answers)))  # noqa: S314


def test_the_command_prints_json_and_writes_the_format_of_the_suffix(tmp_path: Path) -> None:
    log, path = tmp_path / "flight.bin", tmp_path / "seen.md"
    write(FLIGHT, log)
    some = ("--kinds", "dropout", "--channels", "imu0.x", "--trials", "1", "-j", "1")
    said = run(log, "--json", "-o", path, *some)
    assert said.exit_code == 0
    assert json.loads(said.stdout)["log"]["path"] == str(log)
    assert said.stderr == f"wrote {path}\n"
    assert "| imu0.x" in path.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--kinds", "bais"), "no kind 'bais'; did you mean 'bias'?"),
        (("--channels", "imu9.x"), "no channel 'imu9.x'"),
        (("--duration", "0"), "some duration"),
        (("-o", "x.png"), "must end in .json, .md, .svg or .txt"),
    ],
)
def test_a_wrong_option_is_one_clear_line(
    sample_logs: Path, options: tuple[str, ...], text: str
) -> None:
    said = run(sample_logs / "stuck.bin", *options)
    assert isinstance(said.exception, UsageError)
    assert text in str(said.exception)


def test_a_flight_of_seconds_is_too_short() -> None:
    with pytest.raises(UsageError, match="too short"):
        sensitivity(simulate(3.0, 25.0).recording())
