"""What a fork server loads once, so that no worker has to: imported for its side effects only."""

from __future__ import annotations

import contextlib
import importlib
import warnings

import fdilog.campaign.work  # noqa: F401
from fdilog.registry import plugins

LATE = (
    "fdilog.decision",
    "fdilog.findings",
    "jinja2.filters",
    "pymavlink.dialects.v20.all",
)
"""What an analysis imports only when it comes to it, and takes its time to."""

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the parent has warned already
    for group in ("readers", "detectors", "reports"):
        plugins(group)
    for name in LATE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
