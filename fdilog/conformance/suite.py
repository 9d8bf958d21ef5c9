"""All checks of a reader, each to be run by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fdilog.conformance import of_any_file, of_damaged_logs, of_whole_logs
from fdilog.conformance.examples import Example, written_examples
from fdilog.registry import Reader, plugins


@dataclass(frozen=True)
class Check:
    """One check of one reader: call it with an empty folder that it may write to.

    Its text is what it checks, so that it can be the id of a test.
    """

    reader: str
    example: str
    claim: str
    run: Callable[[Path], None]

    def __call__(self, folder: Path) -> None:
        """Run it.

        Raises
        ------
        NonconformanceError
            If the reader does not keep what every reader must.
        """
        self.run(folder)

    def __str__(self) -> str:
        return "-".join(part for part in (self.reader, self.example, self.claim) if part)


def reader_checks(name: str, reader: Reader, examples: Sequence[Example] = ()) -> list[Check]:
    """Return all checks of a reader.

    Parameters
    ----------
    name
        The reader's name: that of its entry point.
    reader
        The module, or whatever has ``suffixes``, ``description``, ``sniff`` and ``read``.
    examples
        Whole logs of its format. Without any, only what holds for files of every other kind can be
        checked.
    """
    checks = [
        Check(name, "", claim.__name__, partial(claim, name, reader))
        for claim in of_any_file.CLAIMS
    ]
    checks += [
        Check(name, example.name, claim.__name__, partial(claim, reader, example))
        for example in examples
        for claim in (*of_whole_logs.CLAIMS, *of_damaged_logs.CLAIMS)
    ]
    return checks


def installed_reader_checks() -> list[Check]:
    """Return the checks of every installed reader.

    Its examples are those that its package gives under the entry-point group ``fdilog.examples``
    (the reader's name, and a function that returns them); else, where a writer of that name is
    installed, a simulated flight.
    """
    given, written = plugins("examples"), written_examples()
    checks: list[Check] = []
    for name, reader in plugins("readers").items():
        examples = given[name]() if name in given else [written[name]] if name in written else []
        checks += reader_checks(name, reader, examples)
    return checks
