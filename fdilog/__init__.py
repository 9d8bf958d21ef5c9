"""Post-flight forensics: which gyro failed, when, by how much, and how sure that is.

This package is the ground floor: the nouns, the maths, the detectors, the decision and the command
line. Readers and reports are found through entry points; nothing here imports them.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fdilog.analysis import Analysis, analyse
    from fdilog.config import Config
    from fdilog.detectors.guaranteed import guaranteed_intervals
    from fdilog.finding import Evidence, Finding
    from fdilog.recording import Recording
    from fdilog.registry import read
    from fdilog.sources.assembly import channel_table
    from fdilog.table import ChannelTable

__version__ = "0.1.0"

# Loaded on first use, so that `fdilog --help` imports nothing heavy.
_HOME = {
    "Analysis": "analysis",
    "ChannelTable": "table",
    "Config": "config",
    "Evidence": "finding",
    "Finding": "finding",
    "Recording": "recording",
    "analyse": "analysis",
    "channel_table": "sources.assembly",
    "guaranteed_intervals": "detectors.guaranteed",
    "read": "registry",
}

__all__ = [
    "Analysis",
    "ChannelTable",
    "Config",
    "Evidence",
    "Finding",
    "Recording",
    "__version__",
    "analyse",
    "channel_table",
    "guaranteed_intervals",
    "read",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"fdilog.{_HOME[name]}"), name)
    raise AttributeError(f"module 'fdilog' has no attribute '{name}'")
