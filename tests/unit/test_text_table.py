from __future__ import annotations

from fdilog.text_table import text_table

HEAD = ["name", "size"]
ROWS = [["a", "1.5"], ["longer", "-"]]


def test_columns_are_as_wide_as_their_widest_cell_and_numbers_stand_right() -> None:
    assert text_table(HEAD, ROWS) == "name    size\na        1.5\nlonger     -\n"


def test_markdown_has_a_ruler_and_no_bar_inside_a_cell() -> None:
    assert text_table(HEAD, [["a|b", "2"]], markdown=True) == (
        "| name | size |\n| ---- | ---: |\n| a\\|b |    2 |\n"
    )


def test_a_table_without_rows_is_its_head() -> None:
    assert text_table(HEAD, []) == "name  size\n"
