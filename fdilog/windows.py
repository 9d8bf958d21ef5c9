"""Cutting a table into windows; what detectors share about each window."""

from __future__ import annotations

from dataclasses import dataclass

from fdilog.config import Config
from fdilog.finding import Windows
from fdilog.table import ChannelTable


@dataclass(frozen=True, kw_only=True, eq=False)
class Survey:
    """A table with its windows of one length: what a detector is shown."""

    table: ChannelTable
    windows: Windows
    config: Config
