"""The JSON result: its keys, its numbers, and the schema that describes it."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.analysis import Analysis, Part
from fdilog.decision.autopilot import AutopilotNote
from fdilog.finding import Interval, Size
from fdilog_reports import json as report
from tests.reports_factory import analysis, bias, failed_analysis, pair_analysis, table

SCHEMA = Path(__file__).parents[2] / "docs" / "schema" / "fdilog-1.schema.json"


def validate(result: Any) -> None:
    from jsonschema import Draft202012Validator

    schema = json.loads(SCHEMA.read_text(encoding="utf-8"))
    Draft202012Validator.check_schema(schema)
    Draft202012Validator(schema).validate(result)


def at_path(made: Analysis, path: str) -> Analysis:
    return dataclasses.replace(made, log=dataclasses.replace(made.log, path=path))


@pytest.mark.parametrize("made", [analysis(), failed_analysis(), pair_analysis()])
def test_a_result_obeys_the_schema(made: Analysis) -> None:
    validate(json.loads(report.render(made)))


def test_the_line_of_an_unreadable_log_obeys_the_schema() -> None:
    validate({"schema": "fdilog/1", "log": {"path": "a"}, "error": "is empty", "verdict": None})


@pytest.mark.parametrize(
    ("place", "value"),
    [
        (("verdict",), "fine"),
        (("schema",), "fdilog/2"),
        (("extra",), 1),
        (("findings", 0, "kind"), "gremlin"),
        (("findings", 0, "size", "unit"), "deg/s"),
        (("table", "channels", 0, "axis"), [1.0, 0.0]),
        (("completeness", "whole"), "yes"),
    ],
)
def test_the_schema_refuses_what_the_contract_does_not_allow(
    place: tuple[Any, ...], value: Any
) -> None:
    from jsonschema import ValidationError

    result = json.loads(report.render(failed_analysis()))
    inner = result
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    with pytest.raises(ValidationError):
        validate(result)


def test_keys_come_in_the_order_of_the_contract() -> None:
    result = json.loads(report.render(failed_analysis()))
    assert list(result) == [
        "schema", "fdilog_version", "config_sha256", "log", "completeness", "sources", "table",
        "clocks", "calibration", "isolability", "revealed", "verdict", "findings", "part",
        "autopilot",
    ]  # fmt: skip
    assert list(result["log"]) == [
        "path", "format", "bytes", "sha256", "start_utc", "duration_s", "vehicle",
    ]  # fmt: skip
    assert list(result["table"]["channels"][0]) == [
        "name", "source", "axis", "rate_hz", "samples", "sigma_rad_s", "derived", "status",
    ]  # fmt: skip
    assert list(result["findings"][0]) == [
        "kind", "suspects", "isolated", "start_s", "end_s", "size", "guaranteed", "detectors",
        "dissent", "witness", "detail",
    ]  # fmt: skip


def test_the_part_that_was_asked_for_and_the_quotes_are_in_the_result() -> None:
    quote = AutopilotNote(
        source="IMU[1]", gyro="imu1", what="flagged unhealthy", start_s=1.0, end_s=2.5
    )
    told = analysis(part=Part(start_s=30.0, armed=True), autopilot=(quote,))
    result = json.loads(report.render(told))
    assert result["part"] == {"start_s": 30.0, "end_s": None, "armed": True}
    assert result["autopilot"] == [
        {
            "source": "IMU[1]",
            "gyro": "imu1",
            "what": "flagged unhealthy",
            "start_s": 1.0,
            "end_s": 2.5,
        }
    ]
    validate(result)


def test_problems_carry_what_was_lost_and_where() -> None:
    result = json.loads(report.render(pair_analysis()))
    assert result["completeness"]["problems"][0] == {
        "offset": 1_048_576,
        "what": "damaged records",
        "bytes": 12_345,
        "seconds": 4.2,
        "note": False,
    }


def test_the_result_is_one_line_and_the_same_each_time() -> None:
    text = report.render(failed_analysis())
    assert text.count("\n") == 1
    assert text.endswith("}\n")
    assert text == report.render(failed_analysis())


def test_numbers_survive_to_the_last_bit() -> None:
    third = 1.0 / 3.0
    size = Size(estimate=third, low=0.1, high=np.nextafter(1.0, 2.0), confidence=0.999, unit="1")
    made = failed_analysis(findings=(bias(size=size),))
    got = json.loads(report.render(made))["findings"][0]["size"]
    assert got == {"estimate": third, "low": 0.1, "high": 1.0000000000000002,
                   "confidence": 0.999, "unit": "1"}  # fmt: skip


def test_what_is_not_finite_is_null() -> None:
    size = Size(estimate=math.nan, low=-math.inf, high=math.inf, confidence=0.999, unit="rad/s")
    found = bias(size=size, guaranteed=Interval(low=-math.inf, high=0.5))
    made = failed_analysis(findings=(found,), sigma_rad_s=(math.nan,) * 9)
    result = json.loads(report.render(made))
    validate(result)
    assert result["findings"][0]["size"]["estimate"] is None
    assert result["findings"][0]["guaranteed"] == {"low": None, "high": 0.5}
    assert result["table"]["channels"][0]["sigma_rad_s"] is None


def test_numpy_numbers_are_numbers() -> None:
    made = failed_analysis(
        findings=(bias(start_s=np.float64(1.5), end_s=np.float64(2.5)),),
        sigma_rad_s=tuple(np.full(9, 0.25)),
    )
    changed = dataclasses.replace(
        made, log=dataclasses.replace(made.log, bytes=np.int64(7), duration_s=np.float32(0.5))
    )
    result = json.loads(report.render(changed))
    assert result["log"]["bytes"] == 7
    assert result["log"]["duration_s"] == 0.5
    assert result["findings"][0]["start_s"] == 1.5


def test_a_file_name_that_is_not_utf8_comes_back_byte_for_byte() -> None:
    path = os.fsdecode(b"caf\xe9.bin")
    text = report.render(at_path(analysis(), path))
    assert text.encode("utf-8")  # what a file or a pipe in UTF-8 does with it
    assert os.fsencode(json.loads(text)["log"]["path"]) == b"caf\xe9.bin"


def test_other_names_stay_as_they_are_written() -> None:
    assert "журнал.bin" in report.render(at_path(analysis(), "журнал.bin"))


def test_an_empty_table_has_no_rate() -> None:
    result = json.loads(report.render(analysis(table(duration_s=0.01), verdict="insufficient")))
    validate(result)
    assert result["table"]["rate_hz"] == 50.0
    assert result["table"]["samples"] == 1


def test_json_on_a_terminal_holds_nothing_that_it_obeys() -> None:
    made = failed_analysis()
    name = "a\x1b[2J\x7f\u009b31m\u202eb\u2066\u200f\u2028\udcff"
    hostile = dataclasses.replace(made, log=dataclasses.replace(made.log, path=name))
    text = report.render(hostile)
    assert all(char.isprintable() for char in text.rstrip("\n"))
    assert json.loads(text)["log"]["path"] == name
