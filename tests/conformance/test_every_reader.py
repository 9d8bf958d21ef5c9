"""What holds for every installed reader, a third party's too; the checks are fdilog.conformance's.

The built-in readers are checked with logs of many kinds and against the official libraries, another
package's reader with the examples that it registers.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from fdilog.conformance import Check, installed_reader_checks, reader_checks
from fdilog.registry import plugins
from tests.reader_examples import EXAMPLES


def checks() -> list[Check]:
    built_in = [
        check
        for name, examples in EXAMPLES.items()
        for check in reader_checks(name, plugins("readers")[name], examples())
    ]
    return built_in + [c for c in installed_reader_checks() if c.reader not in EXAMPLES]


def test_all_of_the_formats_are_installed() -> None:
    assert set(EXAMPLES) <= set(plugins("readers"))


@pytest.mark.parametrize("check", checks(), ids=str)
def test_every_reader(check: Check, tmp_path: Path) -> None:
    check(tmp_path)
