"""Numbers, times and foreign strings as the reports print them."""

from __future__ import annotations

import math
import os

import pytest

from fdilog_reports.words import (
    between,
    count,
    figure,
    flight_time,
    listed,
    percent,
    rounded,
    several,
    shown,
    size_of,
    utc,
)


@pytest.mark.parametrize(
    ("raw", "safe"),
    [
        ("imu1.y", "imu1.y"),
        ("a\nb\tc", r"a\nb\tc"),
        ("\x1b[31mred", r"\x1b[31mred"),
        ("evil\u202egnp.exe", r"evil\u202egnp.exe"),
        ("zero\u200bwidth", r"zero\u200bwidth"),
        ("a\u2028b", r"a\u2028b"),
        (os.fsdecode(b"caf\xe9"), r"caf\xe9"),
        ("lone\ud800", r"lone\ud800"),
        ("гироскоп", "гироскоп"),
        ("a\u3000b", "a b"),
        ("\U000e0001", r"\U000e0001"),
    ],
)
def test_a_foreign_string_shows_what_is_in_it(raw: str, safe: str) -> None:
    assert shown(raw) == safe


def test_right_to_left_text_is_isolated_from_its_surroundings() -> None:
    assert shown("גירו") == "\u2068גירו\u2069"


def test_a_long_string_keeps_both_ends_and_says_how_long_it_was() -> None:
    text = shown("start" + "x" * 10_000_000 + "end")
    assert len(text) < 120
    assert text.startswith("startx")
    assert text.endswith("xend")
    assert "10\u202f000\u202f008 characters" in text


@pytest.mark.parametrize(
    ("value", "printed"),
    [
        (0.0, "0"), (2.0, "2"), (0.05, "0.05"), (1234.4, "1234"), (-1772992.5, "-1772992"),
        (0.00012345, "0.000123"), (1.5e-9, "1.50e-09"), (3e9, "3.00e+09"), (99.96, "100"),
        (math.nan, "unknown"), (math.inf, "unbounded"),
    ],
)  # fmt: skip
def test_a_figure_has_three_digits_and_no_needless_exponent(value: float, printed: str) -> None:
    assert figure(value) == printed


@pytest.mark.parametrize(
    ("ends", "estimate", "printed"),
    [
        ((1.7, 2.3), 2.0, ("1.7", "2.3", "2.0")),
        ((1.71, 2.29), 2.0, ("1.71", "2.29", "2.00")),
        ((-2.34, -1.66), -2.0, ("-2.4", "-1.6", "-2.0")),
        ((1200.0, 1900.0), 1550.0, ("1200", "1900", "1550")),
        ((-0.04, 0.5), 0.23, ("-0.04", "0.50", "0.23")),
        ((-math.inf, 2.0), 1.5, ("", "2.00", "1.50")),
        ((-math.inf, math.inf), math.nan, ("", "", "unknown")),
        ((math.nan, math.nan), 3.0, ("", "", "3.00")),
        ((2.0, 2.0), 2.0, ("2.00", "2.00", "2.00")),
    ],
)
def test_an_interval_is_printed_to_the_digits_it_supports(
    ends: tuple[float, float], estimate: float, printed: tuple[str, str, str]
) -> None:
    assert rounded(*ends, estimate) == printed


def test_an_unbounded_end_is_said_to_be_one() -> None:
    assert between("1.7", "2.3") == "1.7 to 2.3"
    assert between("1.7", "") == "at least 1.7"
    assert between("", "2.3") == "at most 2.3"
    assert between("", "") == "unbounded"


def test_spans_are_flight_time_and_utc() -> None:
    assert flight_time(40.1, 60.2) == "from 40.1 s to 60.2 s"
    assert flight_time(27.75, 27.751) == "at 27.75 s"
    assert utc("2024-05-01T13:04:42.200Z", 40.1, 60.2) == "2024-05-01 13:05:22.3 to 13:05:42.4 UTC"
    assert utc("2024-05-01T23:59:59Z", 2.0) == "2024-05-02 00:00:01.0 UTC"
    assert utc("2024-05-01T13:04:42", 0.0) == "2024-05-01 13:04:42.0 UTC"


@pytest.mark.parametrize("start", [None, "", "yesterday", "9999-12-31T23:59:59Z"])
def test_a_start_that_is_no_date_gives_no_utc(start: str | None) -> None:
    assert utc(start, 1e12) == ""


def test_the_day_is_said_again_when_a_span_crosses_midnight() -> None:
    assert (
        utc("2024-05-01T23:59:59Z", 0.0, 2.0)
        == "2024-05-01 23:59:59.0 to 2024-05-02 00:00:01.0 UTC"
    )


def test_counts_nouns_and_bytes() -> None:
    assert count(9999) == "9999"
    assert count(720_000) == "720\u202f000"
    assert several(1, "sample") == "1 sample"
    assert size_of(56) == "56 bytes"
    assert size_of(12_345) == "12.3 kB (12\u202f345 bytes)"
    assert percent(0.999) == "99.9 %"
    assert percent(0.05) == "5 %"


def test_names_are_listed_as_a_sentence_does() -> None:
    assert listed([]) == ""
    assert listed(["a"]) == "a"
    assert listed(["a", "b"], "or") == "a or b"
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert listed(list("abcdefg"), "or", 4) == "a, b, c and 4 more"
