"""Every installed detector of ours has a page, and on it all that a reader is promised."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from fdilog import analyse
from fdilog.config import load_config
from fdilog.registry import plugins

PAGES = Path(__file__).parents[2] / "docs" / "detectors"
NAMES = [
    name for name, kind in plugins("detectors").items() if kind.__module__.startswith("fdilog.")
]
MOST_BYTES = 60_000


@pytest.mark.parametrize("name", NAMES)
def test_a_page_has_formula_assumptions_cost_failings_source_and_a_picture(name: str) -> None:
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    headings = re.findall(r"^## (.*)$", text, re.MULTILINE)
    for heading in ("Formula", "Assumes", "Costs", "Fails", "Source"):
        assert heading in headings, heading
    assert f"](pictures/{name}.svg)" in text
    assert f"[{name}]({name}.md)" in (PAGES / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", sorted(path.name for path in PAGES.glob("*.md")))
def test_what_a_page_links_to_is_there(page: str) -> None:
    text = (PAGES / page).read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", text):
        if "://" not in link:
            assert (PAGES / link).exists(), link


@pytest.mark.parametrize("path", sorted((PAGES / "pictures").glob("*.svg")), ids=lambda p: p.stem)
def test_a_picture_is_small_and_well_formed(path: Path) -> None:
    assert path.stat().st_size < MOST_BYTES
    root = ET.fromstring(path.read_text(encoding="utf-8"))  # noqa: S314  our own file
    assert root.tag.endswith("svg")
    assert len(list(root.iter())) > 10


def test_the_log_of_the_observer_names_both_failures() -> None:
    config = load_config(PAGES / "vessel.toml").replace("detectors", use=("observer",))
    found = analyse(PAGES / "vessel.csv", config).findings
    assert [finding.suspects for finding in found] == [("gyro.z",), ("boat.sway",)]
    assert [finding.start_s for finding in found] == pytest.approx([20.0, 50.0], abs=0.2)
    assert [finding.end_s for finding in found] == pytest.approx([30.0, 70.0], abs=1.0)
