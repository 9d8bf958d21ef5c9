"""The linked plots: what a page's script draws, and the script with the library it draws with."""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from fdilog.analysis import Analysis
from fdilog.finding import Evidence
from fdilog.maths.geometry import blocks
from fdilog_reports.figures import RateAxis, TimeAxis
from fdilog_reports.residuals import Residual, drawn_evidence, intervals, mirrored, residuals
from fdilog_reports.sentences import KIND_NAME, finding_sentence, taken_out
from fdilog_reports.series import Floats, Pack, compressed, decimate
from fdilog_reports.template import FOLDER, SCRIPT_SAFE, html_environment
from fdilog_reports.words import DEG_PER_RAD, figure, listed, percent, shown

MOST_VALUES = 110_000
"""Numbers that the lines of a page are made of; two and a half bytes each when compressed."""
FEWEST, MOST = 400, 4000
"""Points of a line: never fewer than a screen shows, never more than it can."""
MOST_PLACES = 8
"""Starts and ends of findings about which every sample is kept."""
MOST_SHADED = 200
"""Findings that are shaded; as many as a report lists."""
MOST_INTERVALS = 1500
"""Windows whose intervals make a band: one can zoom in on these, unlike on paper."""

SCRIPTS = ("bokeh.min.js", "bokeh-api.min.js")


@dataclass(frozen=True, kw_only=True)
class Plots:
    """What a page needs to draw: words and numbers in JSON, and the lines as compressed bytes.

    ``panels`` counts all plots, ``residuals`` those of a channel against the others.
    ``statistical`` and ``guaranteed`` say what the bands are, empty where there is none.
    """

    facts: str
    lines: str
    statistical: str
    guaranteed: str
    residuals: int
    panels: int


def plots(analysis: Analysis) -> Plots | None:
    """Return what is to be drawn of an analysis, or nothing where there is no sample."""
    from markupsafe import Markup

    table = analysis.table
    if not len(table.time_s) or not table.channels:
        return None
    axis, tolerance = TimeAxis.of(analysis), analysis.config.tolerance.bias_deg_s
    pack = Pack(start_s=axis.start_s, span_s=axis.end_s - axis.start_s)
    series = {residual.channel: residual for residual in residuals(analysis)}
    drawing = _Drawing(analysis, pack, most=_most(analysis, len(series)))
    rates = RateAxis(tolerance=tolerance, top=1.5 * max(3.0 * tolerance, *_peaks(series)))
    facts: dict[str, Any] = {
        "utc": _epoch_ms(analysis.log.start_utc),
        "span": [axis.start_s, axis.end_s],
        "step": pack.step_s,
        "tolerance": tolerance,
        "hop": drawing.hop_s,
        "top": rates.top,
        "ticks": [(rate, label) for rate, label in rates.round_rates()],
        "channels": [drawing.channel(i) for i in range(len(table.channels))],
        "groups": [
            {
                "title": listed([shown(table.channels[i].name) for i in block]),
                "channels": list(block),
                "panels": [
                    drawing.panel(series[members[0]], members) for members in _panels(block, series)
                ],
            }
            for block in _groups(table.axes)
        ],
        "findings": [
            {
                "number": number,
                "kind": KIND_NAME[finding.kind],
                "state": "failed" if finding.isolated else "suspect",
                "start": finding.start_s,
                "end": finding.end_s,
                "channels": [i for i, name in enumerate(table.names) if name in finding.suspects],
                "sentence": finding_sentence(finding, analysis),
            }
            for number, finding in enumerate(analysis.findings[:MOST_SHADED], start=1)
        ],
    }
    facts["arrays"] = pack.lengths
    residuals_drawn = sum(len(group["panels"]) for group in facts["groups"])
    text = json.dumps(facts, ensure_ascii=False, separators=(",", ":"))
    return Plots(
        facts=Markup(text.translate(SCRIPT_SAFE)),  # noqa: S704  escaped for where it goes
        lines=pack.text(),
        statistical=drawing.statistical_words,
        guaranteed=drawing.guaranteed_words,
        residuals=residuals_drawn,
        panels=len(facts["groups"]) + residuals_drawn,
    )


def _groups(axes: Floats) -> list[tuple[int, ...]]:
    """Channels that are drawn over one another: those that check each other, any other alone."""
    checked = blocks(axes)
    alone = set(range(len(axes))).difference(*checked)
    return sorted([*checked, *((i,) for i in alone)])


def _panels(block: Sequence[int], series: dict[int, Residual]) -> list[list[int]]:
    """Channels of each panel: one, or both of a pair that has only one another."""
    members = [i for i in block if i in series]
    if mirrored(members, series):
        return [members]
    return [[i] for i in members]


def _peaks(series: dict[int, Residual]) -> list[float]:
    """Largest residual of each channel. [deg/s]"""
    return [0.0, *(DEG_PER_RAD * float(np.nanmax(np.abs(r.value))) for r in series.values())]


def _epoch_ms(start_utc: str | None) -> float | None:
    """Return UTC at flight time zero as scripts count it. [ms since 1970]"""
    try:
        moment = datetime.fromisoformat(start_utc or "")
    except ValueError:
        return None
    return 1e3 * (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _most(analysis: Analysis, residual_lines: int) -> int:
    """Points a line may have so that all of them together stay within their share of the page."""
    arrays = 2 * len(analysis.table.channels) + 4 * residual_lines
    return int(np.clip(MOST_VALUES // max(1, arrays), FEWEST, MOST))


class _Drawing:
    """Puts lines and bands into a pack."""

    def __init__(self, analysis: Analysis, pack: Pack, most: int) -> None:
        self.analysis, self.pack, self.most = analysis, pack, most
        ends = [time for f in analysis.findings for time in (f.start_s, f.end_s)]
        self.places = sorted(dict.fromkeys(ends[:MOST_PLACES]))
        self.statistical = drawn_evidence(analysis, MOST_INTERVALS)
        self.guaranteed = next(
            (item for item in analysis.evidence if _is_guarantee(item, analysis)), None
        )

    def channel(self, column: int) -> dict[str, Any]:
        """Return one channel's rate."""
        table = self.analysis.table
        channel = table.channels[column]
        return {
            "name": shown(channel.name),
            "source": shown(channel.source),
            "status": self.analysis.status[column],
            "derived": channel.derived,
            **self._line(table.rate_rad_s[:, column], table.rate_rad_s[:, column]),
        }

    def panel(self, residual: Residual, members: Sequence[int]) -> dict[str, Any]:
        """Return one residual with its bands."""
        names = [shown(channel.name) for channel in self.analysis.table.channels]
        made: dict[str, Any] = {
            "channels": list(members),
            "peers": len(residual.peers),
            "against": listed([names[i] for i in residual.peers]),
            **self._line(residual.value, residual.value),
        }
        bars = intervals(self.statistical, residual.channel)
        if bars is not None:
            made["statistical"] = {
                "t": self.pack.times(bars.middle_s),
                "low": self.pack.values(DEG_PER_RAD * bars.low),
                "high": self.pack.values(DEG_PER_RAD * bars.high),
            }
        if self.guaranteed is not None:
            tested = self.guaranteed.tested[:, residual.channel]
            low, high = (
                np.where(tested, edge[:, residual.channel], np.nan)
                for edge in (self.guaranteed.low, self.guaranteed.high)
            )
            if tested.any():
                made["guaranteed"] = self._line(low, high)
        return made

    @property
    def hop_s(self) -> float:
        """Time from one window of the statistical intervals to the next. [s]"""
        if self.statistical is None:
            return 0.0
        starts = self.statistical.windows.start_s
        return float(np.median(np.diff(starts))) if len(starts) > 1 else self._length_s

    @property
    def _length_s(self) -> float:
        return self.statistical.windows.length_s if self.statistical is not None else 0.0

    @property
    def statistical_words(self) -> str:
        """Say what the band of statistical intervals is."""
        if (item := self.statistical) is None:
            return ""
        return (
            f"{percent(item.confidence)} interval of the error over"
            f" {figure(item.windows.length_s)} s ({shown(item.detector)}{taken_out(self.analysis)})"
        )

    @property
    def guaranteed_words(self) -> str:
        """Say what the band of guaranteed intervals is."""
        if self.guaranteed is None:
            return ""
        stated = self.analysis.config.noise.bound_deg_s > 0
        bound = "stated bound" if stated else "bound estimated from this log"
        return f"guaranteed interval of the error, as long as the {bound} holds"

    def _line(self, low: Floats, high: Floats) -> dict[str, int]:
        line = decimate(
            self.analysis.table.time_s,
            DEG_PER_RAD * low,
            DEG_PER_RAD * high,
            self.most,
            self.places,
        )
        return {
            "t": self.pack.times(line.time_s),
            "low": self.pack.values(line.low),
            "high": self.pack.values(line.high),
        }


def _is_guarantee(item: Evidence, analysis: Analysis) -> bool:
    """Whether an evidence holds guaranteed intervals for every sample of the table."""
    each = len(item.windows) == len(analysis.table.time_s)
    return item.kind == "bias" and item.confidence >= 1.0 and each and bool(item.tested.any())


# --- the library and the script -----------------------------------------------------------------


@cache
def library() -> str:
    """Return the plotting library's own script, as its package brings it."""
    spec = find_spec("bokeh")
    if spec is None or not spec.submodule_search_locations:
        raise ModuleNotFoundError("bokeh is not installed")
    folder = Path(spec.submodule_search_locations[0]) / "server" / "static" / "js"
    return "\n".join((folder / name).read_text("utf-8") for name in SCRIPTS)


@cache
def library_compressed() -> str:
    """Return the library as gzip in base64, the form in which a single page carries it."""
    return compressed(library().encode())


@cache
def shared_name() -> str:
    """Return the file name under which the pages of one folder share the library."""
    return f"bokeh-{version('bokeh')}.js"


@cache
def script() -> str:
    """Return our own script, which draws."""
    return (FOLDER / "plots.js").read_text("utf-8")


@cache
def source_hash(text: str) -> str:
    """Return the source expression by which a content security policy knows a script."""
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def script_parts(*, shared: bool) -> dict[str, str]:
    """Return what a template needs to let a page draw: its policy, the library, our script."""
    from markupsafe import Markup

    # A page from a folder knows its neighbour as 'self' on a server and by its scheme on a disk.
    beside = "'self' file:" if shared else source_hash(library())
    return {
        "policy": f"{source_hash(script())} {beside}",
        "library": "" if shared else library_compressed(),
        "library_name": shared_name() if shared else "",
        "script": Markup(script()),  # noqa: S704  our own file
    }


# --- by itself ----------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class LinkedFigure:
    """The linked plots of one analysis as a page of their own; shows itself in a notebook."""

    page: str
    height_px: int

    def _repr_html_(self) -> str:
        """Return a frame that holds the page, so that page and notebook leave each other alone."""
        return (
            f'<iframe title="Linked plots" srcdoc="{html.escape(self.page)}" width="100%"'
            f' height="{self.height_px}" style="border:0"></iframe>'
        )

    def save(self, path: str | Path) -> None:
        """Write the page to a file."""
        Path(path).write_text(self.page, encoding="utf-8", newline="\n")


def linked_figure(analysis: Analysis) -> LinkedFigure:
    """Return the linked plots of an analysis: rates, residuals, intervals, findings.

    Raises
    ------
    ValueError
        If the analysis holds no sample to draw.
    """
    drawn = plots(analysis)
    if drawn is None:
        raise ValueError("there is no gyro sample to draw")
    page = (
        html_environment()
        .get_template("plots.html")
        .render(
            title=f"Plots of {shown(Path(analysis.log.path).name)}",
            plots=drawn,
            **script_parts(shared=False),
        )
    )
    return LinkedFigure(page=page, height_px=160 + 170 * drawn.panels)
