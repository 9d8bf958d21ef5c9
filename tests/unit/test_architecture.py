"""The folders of the ground floor stand in the order of the way from a log to findings."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

GROUND = Path(__file__).parents[2] / "fdilog"
FLOORS = ("maths", "sources", "windows", "detectors", "decision", "experiments")


def imported(module: Path) -> Iterator[str]:
    """Every module that a file imports when it runs; what only a type checker reads is left out."""
    waiting: list[ast.AST] = [ast.parse(module.read_text("utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            yield node.module
        elif isinstance(node, ast.Import):
            yield from (name.name for name in node.names)
        waiting.extend(ast.iter_child_nodes(node))


@pytest.mark.parametrize("floor", FLOORS)
def test_a_folder_imports_none_that_comes_after_it(floor: str) -> None:
    later = FLOORS[FLOORS.index(floor) + 1 :]
    modules = sorted((GROUND / floor).glob("*.py"))
    assert len(modules) > 1
    for module in modules:
        up = [name for name in imported(module) if name.startswith("fdilog.")]
        assert not [name for name in up if name.split(".")[1] in later], module


def test_the_ground_floor_imports_neither_wing() -> None:
    for module in GROUND.rglob("*.py"):
        wings = [name for name in imported(module) if name.startswith("fdilog_")]
        assert not wings, module
