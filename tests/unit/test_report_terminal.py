"""The summary on a terminal: readable without colour, at any width, whatever the log holds."""

from __future__ import annotations

import dataclasses
import io
import re

import numpy as np
import pytest
from rich.console import Console

from fdilog.analysis import Analysis, Completeness
from fdilog.finding import Size
from fdilog.recording import Problem
from fdilog_reports import text
from fdilog_reports.strip import MARKS, MOST_LANES, strip
from tests.reports_factory import DEG, analysis, bias, failed_analysis, pair_analysis, table

HOSTILE = "\x1b[2J\x1b]0;owned\x07\u009b31m\r\b\x00\u202e[bold red]:bomb: imu"


def shown(made: Analysis, width: int = 80, *, encoding: str = "utf-8") -> str:
    raw = io.BytesIO()
    file = io.TextIOWrapper(raw, encoding=encoding, newline="\n")
    console = Console(
        file=file, width=width, color_system=None, highlight=False, markup=False, emoji=False
    )
    text.show(made, console)
    file.flush()
    return raw.getvalue().decode(encoding)


def impulses(number: int) -> Analysis:
    """Many impulses of one channel, and one of another that is larger."""
    findings = [
        bias(
            ("imu1.y",),
            kind="impulse",
            start_s=float(k),
            end_s=float(k),
            size=Size(
                estimate=(30 + k) * DEG,
                low=(28 + k) * DEG,
                high=(32 + k) * DEG,
                confidence=0.999,
                unit="rad/s",
            ),
        )
        for k in range(number - 1)
    ]
    findings.append(bias(("imu2.z",), kind="stuck", size=None, start_s=70.0, end_s=90.0))
    return failed_analysis(findings=tuple(findings))


def test_verdict_sentence_findings_and_strip_in_this_order() -> None:
    lines = shown(failed_analysis()).splitlines()
    assert lines[0].split() == ["FAILED", "2024-05-01", "copter.bin"]
    assert lines[1].startswith("imu1.y read 2.0 deg/s too much (99.9 %: 1.7 to 2.3) from 40.1 s")
    finding = next(line for line in lines if line.startswith("1  bias"))
    assert "2.0 deg/s (1.7 to 2.3)" in finding
    assert "3 agree" in finding
    lane = next(line for line in lines if line.startswith("imu1.y \u2500"))
    assert lane.endswith("failed")


def test_a_wide_terminal_has_utc_beside_flight_time() -> None:
    assert "2024-05-01 13:05:22.3 to 13:05:42.4 UTC" in shown(failed_analysis(), 120)
    assert "13:05:22.3" not in shown(failed_analysis(), 80)
    made = failed_analysis()
    unknown = dataclasses.replace(made, log=dataclasses.replace(made.log, start_utc=None))
    assert "UTC" not in shown(unknown, 120)


def test_the_strip_marks_the_failed_span_where_it_is() -> None:
    drawn = strip(failed_analysis(), 120)
    assert drawn is not None
    lane = next(lane for lane in drawn.lanes if lane.channel == "imu1.y")
    line = "".join(run.text for run in lane.runs)
    failed = [k for k, mark in enumerate(line) if mark == MARKS["failed"][0]]
    assert len(line) == 120
    assert failed == list(range(failed[0], failed[-1] + 1))
    assert (failed[0], failed[-1] + 1) == (pytest.approx(40, abs=1.1), pytest.approx(60, abs=1.1))
    # The third source is silent from 80 to 90 s.
    silent = next(lane for lane in drawn.lanes if lane.channel == "imu2.x")
    assert "".join(run.text for run in silent.runs)[81:89] == " " * 8
    assert drawn.times.startswith("0")
    assert drawn.times.index("40") == 40


def test_every_state_has_a_mark_of_its_own_with_and_without_blocks() -> None:
    for place in (0, 1):
        assert len({marks[place] for marks in MARKS.values()}) == len(MARKS)
    assert all(marks[1].isascii() for marks in MARKS.values())


def test_a_terminal_of_ascii_gets_ascii() -> None:
    said = shown(failed_analysis(), encoding="ascii")
    assert "#" in said
    assert MARKS["failed"][0] not in said


def test_suspects_that_cannot_be_told_apart_have_a_size_without_sign() -> None:
    said = shown(pair_analysis())
    assert "imu0.x or imu1.x" in said
    assert re.search(r"3\.0 deg/s \(2\.7 to 3\.3\)", said)
    assert "-3.0" not in said


def test_what_was_lost_stands_with_its_place() -> None:
    said = shown(pair_analysis(), width=120)
    assert "The log is not whole" in said
    assert "Lost:\n  damaged records, byte 1\u202f048\u202f576, 12.3 kB" in said
    assert "incomplete last record" not in said


def test_sixty_findings_do_not_flood_the_terminal() -> None:
    said = shown(impulses(60), width=100)
    assert len(said.splitlines()) < 30
    assert re.search(r"59 × +impulse +imu1.y +0\.0 s to 58\.0 s +30\.0 to 88\.0 deg/s", said)
    assert re.search(r"stuck +imu2.z +70\.0 s to 90\.0 s", said)
    assert "60 findings" in said
    assert "-o DIR" in said


def test_on_a_pipe_every_finding_has_a_line() -> None:
    said = text.render(impulses(60))
    assert sum(bool(re.match(r"  \d+\. imu", line)) for line in said.splitlines()) == 60


def test_on_a_pipe_the_only_finding_is_not_said_twice() -> None:
    assert text.render(failed_analysis()).count("imu1.y read") == 1


@pytest.mark.parametrize("width", [1, 12, 20, 33, 59, 60, 80, 140, 400])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    for made in (failed_analysis(), pair_analysis(), impulses(30), analysis(table(sources=1))):
        assert max(len(line.rstrip()) for line in shown(made, width).splitlines()) <= width


def test_nothing_of_a_log_is_obeyed_by_the_terminal() -> None:
    made = failed_analysis()
    channels = tuple(
        dataclasses.replace(channel, name=HOSTILE + channel.name, source=HOSTILE)
        for channel in made.table.channels
    )
    hostile = dataclasses.replace(
        made,
        log=dataclasses.replace(made.log, path=f"{HOSTILE}.bin", vehicle={HOSTILE: HOSTILE}),
        table=dataclasses.replace(made.table, channels=channels),
        findings=(bias((HOSTILE + "imu1.y",), detectors=(HOSTILE,), dissent=(HOSTILE,)),),
        completeness=Completeness(
            whole=False,
            bytes_lost=1,
            seconds_lost=0.0,
            problems=(Problem(what=HOSTILE, offset=1, bytes_lost=1),),
        ),
    )
    for said in (shown(hostile, 120), text.render(hostile)):
        assert all(char.isprintable() or char in "\n\u202f" for char in said)
        assert "[bold red]:bomb:" in said


def test_a_name_of_ten_megabytes_stays_a_line() -> None:
    made = failed_analysis()
    long = dataclasses.replace(made, findings=(bias(("x" * 10_000_000,)),))
    assert len(shown(long, 100)) < 5000


def test_of_many_channels_those_in_doubt_are_drawn() -> None:
    many = table(sources=10, duration_s=20.0)
    states = ["healthy"] * 30
    states[29] = "failed"
    drawn = strip(analysis(many, status=tuple(states)), 80)
    assert drawn is not None
    assert len(drawn.lanes) == MOST_LANES
    assert drawn.lanes[-1].channel == "imu9.z"
    assert drawn.left_out == 30 - MOST_LANES


def test_a_log_of_a_few_samples_is_drawn_as_wide_as_any() -> None:
    drawn = strip(analysis(table(duration_s=0.1)), 60)
    assert drawn is not None
    assert {sum(len(run.text) for run in lane.runs) for lane in drawn.lanes} == {60}


def test_an_empty_table_has_no_strip() -> None:
    empty = table().only(np.zeros(len(table().time_s), bool))
    assert strip(analysis(empty, evidence=()), 80) is None
