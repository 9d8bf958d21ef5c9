from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner, Result

from fdilog.cli import app
from fdilog.errors import UsageError
from fdilog.reproduce import SEED, TABLES, Row, triads
from fdilog.reproduce.report import all_agree, in_words


def run(*arguments: str) -> Result:
    return CliRunner().invoke(app, ["reproduce", *arguments])


@pytest.mark.parametrize("name", TABLES)
def test_a_paper_whose_values_all_agree_exits_with_zero(name: str) -> None:
    said = run(name)
    assert said.exit_code == 0
    assert said.stdout.startswith(f"seed {SEED}\n\n{name}: ")
    assert " NO " not in said.stdout


def test_a_share_that_agrees_only_by_the_rounding_of_its_print_says_so() -> None:
    rows = json.loads(run("triads", "--json").stdout)["tables"]["triads"]
    missed = [row for row in rows if row["quantity"].endswith(": missed")]
    assert len(missed) == 4
    for row in missed:
        assert row["ours"] == pytest.approx(0.1006, abs=5e-5)
        assert "10.06% against 8 %" in row["note"]
        assert "at the edge" in row["note"]
    others = [row for row in rows if "search" in row["quantity"] and row not in missed]
    assert not any("at the edge" in row["note"] for row in others)
    for row in rows:
        if row["difference"] is not None:
            assert row["difference"] == pytest.approx(row["ours"] - row["printed"])


def test_values_that_do_not_agree_are_said_and_exit_with_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(triads.PRINTED_SHARES, "missed", "8.0")
    said = run("triads", "--json")
    told = json.loads(said.stdout)
    wrong = [row["quantity"] for row in told["tables"]["triads"] if row["agrees"] is False]
    assert [quantity.split(": ")[1] for quantity in wrong] == ["missed"] * 4
    assert (said.exit_code, told["agree"], told["seed"]) == (1, False, SEED)


def test_the_printed_value_ours_and_their_difference_stand_side_by_side() -> None:
    rows = [
        Row(table="t", quantity="q", printed=1.5, ours=1.75, agrees=False, note="why"),
        Row(table="t", quantity="r", printed=None, ours=2.0, agrees=None),
    ]
    lines = in_words({"paper": rows}, 7).splitlines()
    assert lines[0] == "seed 7"
    assert lines[2] == "paper: 0 of 1 printed values agree"
    assert lines[5].split() == ["t", "q", "1.5", "1.75", "+0.25", "NO", "[1]"]
    assert lines[6].split() == ["t", "r", "-", "2", "-", "-"]
    assert lines[7] == "[1] why"
    assert not all_agree({"paper": rows})
    assert all_agree({"paper": rows[1:]})


def test_a_seed_is_used_and_told() -> None:
    first, second = (run("larin", "--seed", seed).stdout for seed in ("1", "2"))
    assert first.startswith("seed 1\n")
    assert first.splitlines()[1:] != second.splitlines()[1:]


def test_an_unknown_paper_names_the_nearest() -> None:
    said = run("lorin")
    assert isinstance(said.exception, UsageError)
    assert str(said.exception) == "no table 'lorin'; did you mean 'larin'?"
