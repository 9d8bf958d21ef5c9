from __future__ import annotations

import copy
import itertools
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from fdilog.cli import app
from fdilog.comparison import as_json, compare, in_words
from fdilog.errors import UsageError


@pytest.fixture(scope="module")
def result(sample_logs: Path) -> Any:
    said = CliRunner().invoke(app, ["analyse", "--json", str(sample_logs / "three_imus_bias.bin")])
    return json.loads(said.stdout)


def compared(folder: Path, before: Any, after: Any, *options: str) -> Result:
    paths = [folder / "a.json", folder / "b.json"]
    for path, content in zip(paths, (before, after), strict=True):
        text = content if isinstance(content, str) else json.dumps(content)
        path.write_text(text, encoding="utf-8")
    return CliRunner().invoke(app, ["compare", *map(str, paths), *options])


def differences(folder: Path, before: Any, after: Any) -> list[tuple[str, str]]:
    said = compared(folder, before, after, "--json")
    told = json.loads(said.stdout)
    assert said.exit_code == int(not told["same"])
    return [(one["what"], one["of"]) for one in told["differences"]]


def changed(result: Any, **values: Any) -> Any:
    """Return the result with some values of its first finding changed."""
    other = copy.deepcopy(result)
    other["findings"][0].update(values)
    return other


def test_a_result_is_the_same_as_itself(tmp_path: Path, result: Any) -> None:
    said = compared(tmp_path, result, result)
    assert said.exit_code == 0
    assert said.stdout.endswith("no difference\n")


def test_a_finding_that_is_gone_has_vanished_and_one_that_is_new_has_appeared(
    tmp_path: Path, result: Any
) -> None:
    other = copy.deepcopy(result)
    title = "bias of imu1.y at 40.0 s"
    del other["findings"][0]
    assert differences(tmp_path, result, other) == [("vanished", title)]
    assert differences(tmp_path, other, result) == [("appeared", title)]
    assert compared(tmp_path, result, other).exit_code == 1


def test_a_size_changes_only_beyond_its_interval(tmp_path: Path, result: Any) -> None:
    size = result["findings"][0]["size"]
    half = (size["high"] - size["low"]) / 2.0
    for shift, says in ((0.9 * half, []), (1.1 * half, [("changed", "size")])):
        other = changed(
            result,
            size={**size, **{key: size[key] + shift for key in ("estimate", "low", "high")}},
        )
        found = differences(tmp_path, result, other)
        assert [(what, of.split(": ")[1]) for what, of in found] == says
        assert differences(tmp_path, other, result) == found


def test_an_unbounded_interval_holds_any_estimate(tmp_path: Path, result: Any) -> None:
    size = {**result["findings"][0]["size"], "low": None, "high": None}
    far = {**size, "estimate": 100.0}
    assert differences(tmp_path, changed(result, size=size), changed(result, size=far)) == []


@pytest.mark.parametrize(
    ("values", "of"),
    [
        ({"kind": "drift"}, "kind"),
        ({"suspects": ["imu0.y", "imu1.y"], "isolated": False}, "suspects"),
        ({"start_s": 38.0}, "start"),
        ({"end_s": 70.0}, "end"),
        ({"size": None}, "size"),
    ],
)
def test_what_changes_in_a_finding_is_named(
    tmp_path: Path, result: Any, values: dict[str, Any], of: str
) -> None:
    found = differences(tmp_path, result, changed(result, **values))
    assert [(what, name.split(": ")[1]) for what, name in found] == [("changed", of)]


def test_findings_of_one_channel_at_other_times_are_others(tmp_path: Path, result: Any) -> None:
    other = changed(result, start_s=70.0, end_s=80.0)
    assert [what for what, _ in differences(tmp_path, result, other)] == ["vanished", "appeared"]


def another_flight(result: Any, *findings: dict[str, Any]) -> Any:
    """Return a result about another log, with the first finding changed as given, once each."""
    other = copy.deepcopy(result)
    other["log"]["sha256"] = "0" * 64
    other["findings"] = [{**copy.deepcopy(result["findings"][0]), **values} for values in findings]
    return other


def test_the_same_fault_in_another_flight_is_the_same_whenever_it_was(
    tmp_path: Path, result: Any
) -> None:
    later = another_flight(result, {"start_s": 200.0, "end_s": 230.0})
    assert differences(tmp_path, result, later) == []
    size = result["findings"][0]["size"]
    worse = {key: 3.0 * size[key] for key in ("estimate", "low", "high")}
    title = "bias of imu1.y at 40.0 s"
    larger = another_flight(result, {"start_s": 200.0, "end_s": 230.0, "size": {**size, **worse}})
    assert differences(tmp_path, result, larger) == [("changed", f"{title}: size")]
    stuck = another_flight(result, {"kind": "stuck", "size": None})
    assert [what for what, _ in differences(tmp_path, result, stuck)] == ["vanished", "appeared"]


def test_of_several_in_another_flight_those_of_like_size_are_the_same(
    tmp_path: Path, result: Any
) -> None:
    size = result["findings"][0]["size"]
    large = {**size, **{key: 3.0 * size[key] for key in ("estimate", "low", "high")}}
    both = another_flight(
        result,
        {"start_s": 5.0, "end_s": 9.0, "size": large},
        {"start_s": 70.0, "end_s": 80.0},
    )
    assert differences(tmp_path, result, both) == [("appeared", "bias of imu1.y at 5.0 s")]


def test_the_sign_of_a_size_counts_only_where_one_channel_is_accused(
    tmp_path: Path, result: Any
) -> None:
    size = result["findings"][0]["size"]
    turned = {
        **size,
        "estimate": -size["estimate"],
        "low": -size["high"],
        "high": -size["low"],
    }
    pair = {"suspects": ["imu0.y", "imu1.y"], "isolated": False, "size": turned}
    found = differences(tmp_path, result, changed(result, **pair))
    assert [of.split(": ")[1] for _, of in found] == ["suspects"]
    found = differences(tmp_path, result, changed(result, size=turned))
    assert [of.split(": ")[1] for _, of in found] == ["size"]
    gone = changed(result, **pair)
    gone["findings"].clear()
    said = compared(tmp_path, changed(result, **pair), gone).stdout
    assert re.search(r"vanished  bias of imu0.y, imu1.y at 40.0 s: .*, 2\.\d+ deg/s \(2", said)


def test_names_from_a_result_are_not_obeyed_by_the_terminal(tmp_path: Path, result: Any) -> None:
    other = changed(result, suspects=["imu1.y\x1b[2J\u202e"])
    said = compared(tmp_path, result, other).stdout
    assert "\\x1b[2J\\u202e" in said
    assert "\x1b" not in said


def test_verdict_status_completeness_noise_and_calibration_are_compared(
    tmp_path: Path, result: Any
) -> None:
    other = copy.deepcopy(result)
    other["verdict"] = "undecided"
    other["completeness"].update(whole=False, bytes_lost=89, seconds_lost=1.5)
    channel = other["table"]["channels"][2]
    channel.update(status="undecided", sigma_rad_s=channel["sigma_rad_s"] * 2.0)
    other["calibration"][1]["bias_rad_s"][0] += math.radians(1.0)
    source = other["calibration"][1]["source"]
    assert differences(tmp_path, result, other) == [
        ("changed", "verdict"),
        ("changed", f"channel {channel['name']}"),
        ("changed", f"channel {channel['name']}: noise"),
        ("changed", "completeness: whole"),
        ("changed", "completeness: bytes lost"),
        ("changed", "completeness: seconds lost"),
        ("changed", f"calibration of {source}: bias"),
    ]


def test_what_does_not_matter_is_a_note_and_no_difference(tmp_path: Path, result: Any) -> None:
    other = copy.deepcopy(result)
    other["fdilog_version"] = "99"
    other["log"]["sha256"] = "0"
    other["table"]["channels"][0]["sigma_rad_s"] *= 1.2
    said = compared(tmp_path, result, other)
    assert said.exit_code == 0
    assert "note: the two are about different logs: findings are paired by kind" in said.stdout
    assert "note: they were made with different versions of fdilog\n" in said.stdout


def test_a_log_that_could_not_be_read_is_different_from_one_that_was(
    tmp_path: Path, result: Any
) -> None:
    broken = {"schema": "fdilog/1", "log": {"path": "a"}, "error": "a: empty", "verdict": None}
    found = differences(tmp_path, result, broken)
    assert ("appeared", "error") in found
    assert ("vanished", "verdict") in found


@pytest.mark.parametrize(
    ("content", "text"),
    [
        ("", "b.json: not a JSON result"),
        ("[]", "its schema is None, not 'fdilog/1'"),
        ('{"schema": "fdilog/2"}', "its schema is 'fdilog/2', not 'fdilog/1'"),
        ('{"schema": "fdilog/1"}', "lacks what fdilog/1 promises: KeyError('log')"),
        ("{}\n{}", "it holds several results, one a line"),
        ("[" * 100_000, "nested too deeply"),
    ],
)
def test_a_file_that_is_no_result_is_one_clear_line(
    tmp_path: Path, result: Any, content: str, text: str
) -> None:
    said = compared(tmp_path, result, content)
    assert isinstance(said.exception, UsageError)
    assert text in str(said.exception)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    said = CliRunner().invoke(app, ["compare", str(tmp_path / "a"), str(tmp_path / "b")])
    assert isinstance(said.exception, UsageError)
    assert "no such file" in str(said.exception)


def test_a_result_that_breaks_its_schema_anywhere_is_an_error_and_no_traceback(
    result: Any,
) -> None:
    """Replace every value in turn by things of other types."""
    wrong = (None, "x", -1, [], {}, [None], 10**400, math.nan)
    for place, value in itertools.product(_places(result), wrong):
        broken = copy.deepcopy(result)
        inner = broken
        for key in place[:-1]:
            inner = inner[key]
        inner[place[-1]] = value
        try:
            seen = compare(result, broken)
        except UsageError as error:
            assert "fdilog/1 promises" in str(error)  # noqa: PT017
        else:
            assert in_words(seen)
            assert json.loads(as_json(seen))["same"] == (not seen.differences)


def _places(value: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if place:
        yield place
    # Two elements stand for all of a list.
    if isinstance(value, dict):
        for key, one in value.items():
            yield from _places(one, (*place, key))
    elif isinstance(value, list):
        for key, one in enumerate(value[:2]):
            yield from _places(one, (*place, key))
