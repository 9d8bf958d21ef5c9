"""Every check of every installed reader: ``python -m pytest --pyargs fdilog.conformance``."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdilog.conformance import Check, installed_reader_checks


@pytest.mark.parametrize("check", installed_reader_checks(), ids=str)
def test_an_installed_reader(check: Check, tmp_path: Path) -> None:
    """A reader keeps what every reader must."""
    check(tmp_path)
