"""What every reader must keep, as checks that anybody can run on a reader of their own.

`reader_checks` gives them, `Example` is what they need to know of a log; see
docs/readers/writing-one.md. Nothing in fdilog imports this; plug-ins' tests may.
"""

from fdilog.conformance.claims import NonconformanceError
from fdilog.conformance.examples import Columns, Example, simulated_flight
from fdilog.conformance.suite import Check, installed_reader_checks, reader_checks

__all__ = [
    "Check",
    "Columns",
    "Example",
    "NonconformanceError",
    "installed_reader_checks",
    "reader_checks",
    "simulated_flight",
]
