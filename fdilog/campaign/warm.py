"""What a fork server loads once, so that no worker has to: imported for its side effects only."""

from __future__ import annotations

import contextlib
import importlib
import warnings

from fdilog.registry import plugins

LATE = (
    "jinja2.filters",
    "lz4.frame",
    "msgspec",
    "pymavlink.dialects.v20.all",
    "rosbags.typesys.stores",
    "ruamel.yaml",
    "zstandard",
)
"""What readers and reports import only when they come to it, and take their time to."""
REHEARSED_S = 8.0


def _rehearse() -> None:
    """Analyse and report a short made-up flight: what is imported on the way is there then."""
    from fdilog.analysis import analyse_recording
    from fdilog.campaign.measures import measure
    from fdilog.config import Config
    from fdilog.experiments.simulate import simulate

    recording = simulate(REHEARSED_S, 25.0, sources=3, seed=1).recording()
    analysis = analyse_recording(recording, Config())
    measure(analysis)
    for report in plugins("reports").values():
        report.render(analysis)


with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # the parent has warned already
    for group in ("readers", "detectors", "reports"):
        plugins(group)
    for name in LATE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    # Whatever goes wrong here will be the first log's to tell.
    with contextlib.suppress(Exception):
        _rehearse()
