"""An analysis as pandas tables: one row a finding, one row a channel."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from fdilog.analysis import Analysis
    from fdilog.finding import Finding

_NAN = float("nan")


def findings_frame(analysis: Analysis) -> pd.DataFrame:
    """Return one row a finding, in the order of `Analysis.findings`, sizes in SI units.

    An interval end that is not bounded is infinite, what is not known NaN, None or NaT. The
    column ``unit`` holds the unit of ``size``, ``size_low`` and ``size_high``; ``suspects``,
    ``detectors`` and ``dissent`` are tuples, for ``frame.explode("suspects")``.
    """
    import pandas as pd

    columns = {
        "kind": "str", "suspects": "object", "isolated": "bool",
        "start_s": "float64", "end_s": "float64",
        "size": "float64", "size_low": "float64", "size_high": "float64",
        "confidence": "float64", "unit": "object",
        "guaranteed_low_rad_s": "float64", "guaranteed_high_rad_s": "float64",
        "detectors": "object", "dissent": "object", "witness": "object", "detail": "str",
    }  # fmt: skip
    rows = [_row(finding) for finding in analysis.findings]
    frame = pd.DataFrame(
        {name: pd.Series([row[name] for row in rows], dtype=kind) for name, kind in columns.items()}
    )
    start = pd.to_datetime(analysis.log.start_utc or "unknown", utc=True, errors="coerce")
    start_us = 1e6 * start.timestamp() if isinstance(start, pd.Timestamp) else float("nan")
    for place, end in ((5, "start"), (6, "end")):
        micros = (start_us + 1e6 * frame[f"{end}_s"]).round()
        moment = pd.to_datetime(micros, unit="us", utc=True, errors="coerce")
        frame.insert(place, f"{end}_utc", moment.astype("datetime64[us, UTC]"))
    return frame


def _row(finding: Finding) -> dict[str, Any]:
    size, guaranteed = finding.size, finding.guaranteed
    return {
        "kind": finding.kind,
        "suspects": finding.suspects,
        "isolated": finding.isolated,
        "start_s": finding.start_s,
        "end_s": finding.end_s,
        "size": size.estimate if size else _NAN,
        "size_low": size.low if size else _NAN,
        "size_high": size.high if size else _NAN,
        "confidence": size.confidence if size else _NAN,
        "unit": size.unit if size else None,
        "guaranteed_low_rad_s": guaranteed.low if guaranteed else _NAN,
        "guaranteed_high_rad_s": guaranteed.high if guaranteed else _NAN,
        "detectors": finding.detectors,
        "dissent": finding.dissent,
        "witness": finding.witness,
        "detail": finding.detail,
    }


def channels_frame(analysis: Analysis) -> pd.DataFrame:
    """Return one row a channel, indexed by its name, in the order of the table's columns."""
    import pandas as pd

    table = analysis.table
    return pd.DataFrame(
        {
            "source": [channel.source for channel in table.channels],
            "status": list(analysis.status),
            "derived": [channel.derived for channel in table.channels],
            "axis_x": [channel.axis[0] for channel in table.channels],
            "axis_y": [channel.axis[1] for channel in table.channels],
            "axis_z": [channel.axis[2] for channel in table.channels],
            "rate_hz": [channel.rate_hz for channel in table.channels],
            "samples": [channel.samples for channel in table.channels],
            "sigma_rad_s": list(analysis.sigma_rad_s),
        },
        index=pd.Index(list(table.names), name="channel"),
    )
