from __future__ import annotations

from decimal import Decimal

import pytest

from fdilog.reproduce import TABLES, Row, reproduce
from fdilog.reproduce.row import counted, last_digit, rounded


@pytest.mark.parametrize("name", ["larin", "observer"])
def test_a_table_comes_out_the_same_each_time_and_agrees(name: str) -> None:
    rows = reproduce(name)
    assert rows == reproduce(name)
    assert all(row.agrees for row in rows)


def test_another_seed_gives_other_draws() -> None:
    assert reproduce("larin", seed=1) != reproduce("larin", seed=2)


def test_an_unknown_table_names_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"unknown table 'laurin'; known: " + ", ".join(TABLES)):
        reproduce("laurin")


@pytest.mark.parametrize(("ours", "agrees"), [(1.234, True), (1.2351, False), (1.2249, False)])
def test_a_rounded_figure_agrees_within_half_its_last_place(ours: float, agrees: bool) -> None:
    row = rounded("t", "q", printed=1.23, ours=ours, places=2)
    assert row.agrees is agrees
    assert row.difference == pytest.approx(ours - 1.23)


@pytest.mark.parametrize(
    ("printed", "ours", "agrees"),
    [
        # 1000 trials of one half: 1.96 standard deviations are 3.1 %.
        ("50.0", 0.53, True),
        ("50.0", 0.534, False),
        # Printed to whole per cent it may have been 50.4 %.
        ("50", 0.534, True),
        ("50", 0.54, False),
    ],
)
def test_a_counted_share_agrees_within_chance_and_the_rounding_of_its_print(
    printed: str, ours: float, agrees: bool
) -> None:
    row = counted("t", "q", printed=printed, ours=ours, trials=1000)
    assert row.agrees is agrees
    assert row.printed == 0.5
    assert ("at the edge" in row.note) is (printed == "50" and agrees)


@pytest.mark.parametrize(("printed", "unit"), [("8", 1), ("80.3", 0.1), ("7.30", 0.01)])
def test_the_unit_of_the_last_digit_is_read_off_the_print(printed: str, unit: float) -> None:
    assert float(last_digit(Decimal(printed))) == unit


def test_words_have_no_difference() -> None:
    row = Row(table="t", quantity="q", printed="2, 3", ours="2, 3", agrees=True)
    assert row.difference is None
