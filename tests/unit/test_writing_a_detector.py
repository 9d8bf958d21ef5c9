"""The detector that the documentation writes works as it says."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.finding import Evidence
from fdilog.windows.survey import Survey, cut
from tests.tables import biased, unit

PAGE = Path(__file__).parents[2] / "docs" / "detectors" / "writing-one.md"
CONFIG = Config().replace("windows", lengths_s=(5.0,))


@pytest.fixture
def laboratory(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The code of the page as a module."""
    module = ModuleType("laboratory_median")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    code = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec("\n".join(code), module.__dict__)  # noqa: S102  the page is ours
    return module


def evidence(laboratory: ModuleType, geometry: str, channels: int, size_deg_s: float) -> Evidence:
    table = biased(unit(geometry, channels), 4, size_deg_s, 0.0, 30.0)
    (windows,) = cut(table, CONFIG)
    (found,) = laboratory.MedianDetector().detect(
        Survey(table=table, windows=windows, config=CONFIG)
    )
    return found


def test_it_accuses_the_one_of_three_that_is_off(laboratory: ModuleType) -> None:
    accused = evidence(laboratory, "aligned-triads", 9, 5.0).accused > 0
    np.testing.assert_array_equal(np.unique(accused, axis=0), [np.arange(9) == 4])
    assert not evidence(laboratory, "aligned-triads", 9, 0.0).accused.any()


@pytest.mark.parametrize(("geometry", "channels"), [("aligned-triads", 6), ("dodecahedron", 6)])
def test_it_does_not_test_what_has_no_median(
    laboratory: ModuleType, geometry: str, channels: int
) -> None:
    found = evidence(laboratory, geometry, channels, 5.0)
    assert not found.tested.any()
    assert not found.accused.any()


def test_every_page_is_listed() -> None:
    listed = (PAGE.parent / "README.md").read_text(encoding="utf-8")
    pages = {page.stem for page in PAGE.parent.glob("*.md")} - {"README", "writing-one"}
    assert {"parity", "joint", "kalman", "guaranteed", "one-norm"} <= pages
    for page in pages:
        assert f"[{page}]({page}.md)" in listed
