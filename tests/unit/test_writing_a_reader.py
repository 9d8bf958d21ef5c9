"""The reader that the documentation writes works as it says, and keeps what every reader must."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fdilog.conformance import Check, Example, NonconformanceError, reader_checks
from fdilog.recording import Recording

PAGE = Path(__file__).parents[2] / "docs" / "readers" / "writing-one.md"
READER, EXAMPLES, TESTS = re.findall(
    r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL
)
(ENTRY_POINTS,) = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def module(name: str, code: str) -> ModuleType:
    made = ModuleType(name)
    exec(code, made.__dict__)  # noqa: S102  the page is ours
    return made


BOXLOG = module("boxlog", READER)
with pytest.MonkeyPatch.context() as patch:
    patch.setitem(sys.modules, "boxlog", BOXLOG)
    MADE = module("boxlog_examples", EXAMPLES)


def checks(reader: Any) -> list[Check]:
    examples: list[Example] = MADE.examples()
    return reader_checks("boxlog", reader, examples)


@pytest.mark.parametrize("check", checks(BOXLOG), ids=str)
def test_the_reader_keeps_what_every_reader_must(check: Check, tmp_path: Path) -> None:
    check(tmp_path)


def test_the_table_lists_every_check() -> None:
    words = PAGE.read_text(encoding="utf-8").replace("rad/s", "rad s")
    listed = [check.claim.replace("_", " ") for check in checks(BOXLOG)]
    assert len(set(listed)) == len(listed)
    assert [claim for claim in listed if claim not in words] == []


def test_it_is_found_once_it_is_installed(tmp_path: Path) -> None:
    """As pip would leave it: two modules, and the entry points beside them."""
    (tmp_path / "boxlog.py").write_text(READER)
    (tmp_path / "boxlog_examples.py").write_text(EXAMPLES)
    (tmp_path / "test_box.py").write_text(TESTS)
    described = tmp_path / "boxlog-1.0.dist-info"
    described.mkdir()
    (described / "METADATA").write_text("Metadata-Version: 2.1\nName: boxlog\nVersion: 1.0\n")
    groups = ENTRY_POINTS.replace('[project.entry-points."', "[").replace('"]', "]")
    (described / "entry_points.txt").write_text(groups.replace('"', ""))
    MADE.write(tmp_path / "flight.box")

    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", *arguments],
            capture_output=True,
            check=False,
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(tmp_path)},
            text=True,
            timeout=120,
        )

    assert "boxlog          laboratory box logger (.box)" in run("fdilog", "readers").stdout
    result = json.loads(run("fdilog", "analyse", "--json", "flight.box").stdout)
    assert result["log"]["format"] == "boxlog"
    assert [source["name"] for source in result["sources"]] == ["imu0", "imu1"]
    installed = run("pytest", "-q", "--pyargs", "fdilog.conformance", "-k", "boxlog-flight")
    assert re.search(r"^1\d passed, \d+ deselected", installed.stdout.splitlines()[-1])
    own = run("pytest", "-q", "test_box.py")
    assert re.search(r"^19 passed", own.stdout.splitlines()[-1]), own.stdout


def changed(change: Callable[[Recording], Recording]) -> Any:
    """The reader, with something done to what it reads."""
    parts = {name: getattr(BOXLOG, name) for name in ("suffixes", "description", "sniff")}
    return SimpleNamespace(**parts, read=lambda path, also=(): change(BOXLOG.read(path, also)))


def failing(reader: Any, folder: Path) -> set[str]:
    """The checks that a reader does not pass."""
    failed = set()
    for number, check in enumerate(checks(reader)):
        place = folder / str(number)
        place.mkdir()
        try:
            check(place)
        except NonconformanceError:
            failed.add(check.claim)
    return failed


def scaled(recording: Recording, factor: float) -> Recording:
    streams = (
        replace(s, columns={k: factor * v for k, v in s.columns.items()}) if s.gyro else s
        for s in recording.streams
    )
    return replace(recording, streams=tuple(streams))


def without_last(recording: Recording) -> Recording:
    first, *others = recording.streams
    columns = {name: column[:-1] for name, column in first.columns.items()}
    assert first.offsets is not None
    short = replace(
        first,
        time_ns=first.time_ns[:-1],
        columns=columns,
        offsets=first.offsets[:-1],
        count=first.count - 1,
    )
    return replace(recording, streams=(short, *others))


CHANGES: dict[str, tuple[Callable[[Recording], Recording], set[str]]] = {
    "rates in deg/s": (
        lambda recording: scaled(recording, float(np.degrees(1.0))),
        {"it_reads_the_flight_that_was_logged", "it_reads_what_the_official_library_reads"},
    ),
    "rates off by a trifle": (
        lambda recording: scaled(recording, 1.0 + 1e-15),
        {"it_reads_what_the_official_library_reads"},
    ),
    "another unit": (
        lambda r: replace(r, streams=tuple(replace(s, units={}) for s in r.streams)),
        {"it_reads_what_the_official_library_reads", "a_hole_is_told"},
    ),
    "no word of what is lost": (
        lambda recording: replace(recording, problems=()),
        {
            "what_a_cut_costs_is_told",
            "a_flipped_bit_is_no_disaster",
            "a_hole_is_told",
            "bytes_that_do_not_belong_are_told",
            "bytes_behind_the_end_are_told",
        },
    ),
    "the last sample left out": (
        without_last,
        {"it_reads_what_the_official_library_reads", "it_reads_the_flight_that_was_logged"},
    ),
}


@pytest.mark.parametrize("name", CHANGES)
def test_the_checks_find_a_reader_that_gives_something_else(name: str, tmp_path: Path) -> None:
    change, found = CHANGES[name]
    assert found <= failing(changed(change), tmp_path)


def test_the_checks_find_a_reader_that_believes_a_wrong_checksum(tmp_path: Path) -> None:
    lax = module("lax", READER.replace("right = covered == ", "right = covered != -1 - "))
    assert "a_flipped_bit_is_no_disaster" in failing(lax, tmp_path)


def test_the_checks_find_a_reader_that_takes_everything_for_its_own(tmp_path: Path) -> None:
    greedy = module("greedy", READER.replace("head.startswith(MAGIC)", "True"))
    assert failing(greedy, tmp_path) == {"it_takes_no_other_file_for_its_own"}


def test_the_checks_find_a_reader_that_fails_with_any_exception(tmp_path: Path) -> None:
    code = READER.replace("raise UnreadableLogError(", "raise ValueError(")
    assert {"it_refuses_a_file_without_a_log", "it_makes_no_sample_of_noise"} <= failing(
        module("careless", code), tmp_path
    )


def test_the_checks_find_a_reader_that_writes_beside_the_log(tmp_path: Path) -> None:
    def read(path: Path, also: tuple[str, ...] = ()) -> Recording:
        recording: Recording = BOXLOG.read(path, also)
        path.with_suffix(".index").write_bytes(b"")
        return recording

    parts = {name: getattr(BOXLOG, name) for name in ("suffixes", "description", "sniff")}
    assert failing(SimpleNamespace(**parts, read=read), tmp_path) == {"the_log_is_left_as_it_was"}


def test_the_checks_find_a_reader_that_remembers(tmp_path: Path) -> None:
    calls: list[int] = []

    def count(recording: Recording) -> Recording:
        calls.append(1)
        first, *others = recording.streams
        return replace(recording, streams=(replace(first, clock=str(len(calls))), *others))

    assert "reading_again_gives_the_same" in failing(changed(count), tmp_path)
