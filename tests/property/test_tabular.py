"""Whatever stands in a table: it is read or refused in one line, and no good row is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import tabular, tabular_csv

READINGS = st.lists(
    st.tuples(st.floats(-1e9, 1e9), st.none() | st.floats(allow_nan=False, allow_infinity=False)),
    max_size=30,
)
BAD_LINES = st.sampled_from(["", "1", "1,2,3", "a,b", '"1,2', "1;2", "\x00,\x00", "µ,1", ",,,,"])


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables") / "log.csv"


def read(path: Path, text: str) -> Recording:
    path.write_bytes(text.encode())
    return tabular.read(path)


def cell(value: float | None) -> str:
    return "" if value is None else repr(value)


@given(READINGS, st.sampled_from(["\n", "\r\n"]), st.sampled_from([",", ";", "\t"]))
def test_what_is_written_is_read_to_the_last_bit(
    path: Path, rows: list[tuple[float, float | None]], newline: str, separator: str
) -> None:
    lines = ["time_s" + separator + "g1", *(cell(t) + separator + cell(v) for t, v in rows)]
    (stream,) = read(path, newline.join(lines) + newline).streams
    there = [(t, v) for t, v in rows if v is not None]
    assert stream.columns["g1"].tolist() == [v for _, v in there]
    exact = [t.as_integer_ratio() for t, _ in there]
    for (numerator, denominator), ns in zip(exact, stream.time_ns.tolist(), strict=True):
        assert abs(numerator * 10**9 - ns * denominator) * 2 <= denominator


@given(READINGS, st.lists(st.tuples(st.integers(0, 30), BAD_LINES), max_size=6))
def test_bad_lines_cost_no_good_one(
    path: Path, rows: list[tuple[float, float | None]], bad: list[tuple[int, str]]
) -> None:
    lines = [f"{cell(t)},{cell(v)}" for t, v in rows]
    for place, line in bad:
        lines.insert(min(place, len(lines)), line)
    lines.append("0.0,0.5")  # a column without any number would be one of words
    recording = read(path, "\n".join(["time_s,g1", *lines]) + "\n")
    (stream,) = recording.streams
    assert stream.columns["g1"].tolist() == [*(v for _, v in rows if v is not None), 0.5]
    told = " ".join(problem.what for problem in recording.problems)
    for number, line in enumerate(lines, start=2):
        if line in {"1", "1,2,3", "a,b", '"1,2', "1;2"}:
            assert f"line {number}" in told


@given(st.data())
def test_the_size_of_the_blocks_changes_nothing(path: Path, data: st.DataObject) -> None:
    rows = data.draw(st.lists(st.sampled_from(["1,2", "3,4.5", "5,", "x,1", "7", "8,9,10", ""])))
    text = "\n".join(["time_s,g1", *rows])
    whole = read(path, text)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tabular_csv, "BLOCK_BYTES", data.draw(st.integers(16, 64)))
        parts = tabular.read(path)
    assert parts.problems == whole.problems
    for one, other in zip(parts.streams, whole.streams, strict=True):
        assert np.array_equal(one.columns["g1"], other.columns["g1"], equal_nan=True)


@given(
    st.binary(max_size=300), st.sampled_from([b"", b"time_s,g1\n", b"PAR1", b"\xef\xbb\xbftime_s;"])
)
def test_bytes_of_any_kind_are_read_or_refused_in_one_line(
    path: Path, data: bytes, head: bytes
) -> None:
    path.write_bytes(head + data)
    tabular.sniff(head + data)
    try:
        recording = tabular.read(path)
    except UnreadableLogError as error:
        line = str(error)
    else:
        line = str(path)
        assert recording.bytes == len(head + data)
    assert line.startswith(str(path))
    assert line.isprintable()


@given(st.integers(0, 60))
def test_a_table_cut_anywhere_keeps_its_whole_rows(path: Path, cut: int) -> None:
    text = "time_s,g1,g2\n" + "".join(f"{k},{k}.5,-{k}.25\n" for k in range(1, 9))
    start = len("time_s,g1,g2\n")
    (stream,) = read(path, text[: start + cut]).streams
    whole = text[start : start + cut].count("\n")
    assert stream.columns["g1"][:whole].tolist() == [k + 0.5 for k in range(1, whole + 1)]
    assert len(stream.columns["g1"]) <= whole + 1
