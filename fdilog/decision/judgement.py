"""From a table to all that is concluded from it: who is asked, in which order, who decides."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog.config import Config
from fdilog.decision.biases import Hearing, bias_findings
from fdilog.decision.delays import with_delays
from fdilog.decision.disagreement import with_disagreement
from fdilog.decision.findings import guaranteed_findings, self_evident_findings
from fdilog.decision.noises import noise_findings, without_swings
from fdilog.decision.scales import with_scales
from fdilog.decision.testimony import hear
from fdilog.decision.verdict import channel_status, with_witness
from fdilog.decision.windowed import windowed
from fdilog.finding import Evidence, Finding, Status
from fdilog.maths.geometry import blocks, detectable
from fdilog.registry import detectors, plugins
from fdilog.sources.gains import gain_findings, gains, rescaled
from fdilog.sources.mounting import mounting_findings, mountings, turned_back
from fdilog.sources.shocks import Shocks
from fdilog.sources.witness import Witness
from fdilog.table import ChannelTable
from fdilog.windows.calibration import Calibration, with_notes
from fdilog.windows.loudness import loudness_notes
from fdilog.windows.survey import Survey, spans


@dataclass(frozen=True, kw_only=True, eq=False)
class Judgement:
    """What is concluded from a table alone.

    Parameters
    ----------
    table
        What was compared: every device in the unit and the mounting that its rates show.
    """

    table: ChannelTable
    findings: tuple[Finding, ...]
    status: tuple[Status, ...]
    evidence: tuple[Evidence, ...]
    calibration: tuple[Calibration, ...]


def judge(
    table: ChannelTable,
    config: Config,
    progress: Callable[[str], None] = lambda _: None,
    witness: Witness | None = None,
    shocks: Shocks | None = None,
) -> Judgement:
    """Run the detectors on a table and decide.

    First of all every device is brought into the unit and the mounting that its rates show.
    Detectors that judge each channel by itself go next. What they accuse is kept out of the
    comparisons, so that one fault gives one finding and drags no other channel along.

    The gyros decide among themselves. Derived channels are compared only with gyros that no other
    gyro checks, and else only heard where the gyros leave several suspects.
    """
    names = config.detectors.use or _default_order(plugins("detectors"))
    chosen = list(detectors(names))
    progress("mounting")
    multiplied = gains(table)
    table = rescaled(table, multiplied)
    mounted = mountings(table, one_frame=witness is None or witness.one_frame)
    table = turned_back(table, mounted.found)
    gyros = heard = table.gyros
    derived = table.columns([k for k, channel in enumerate(table.channels) if channel.derived])
    whole = spans(gyros, np.array([0]), np.array([len(gyros.time_s)]))
    alone: list[Evidence] = []
    # In the order of their names, whatever was asked for: what is silent (dropout) or repeats
    # itself (flatline) confirms no impulse.
    for name, detector in sorted(chosen, key=lambda each: each[0]):
        if detector.stage == "alone":
            progress(name)
            survey = Survey(
                table=heard, windows=whole, config=config, derived=derived, shocks=shocks
            )
            found = detector.detect(survey)
            heard = without_accused(heard, found)
            alone.extend(found)
    testified = table if heard is gyros else with_derived(heard, table)
    if witness is not None:
        heard = testified.columns(compared_channels(testified))
    sound, calibration, compared = windowed(heard, chosen, config, progress)
    notes = {one.source: one.note for one in multiplied} | mounted.notes()
    calibration = with_notes(with_notes(calibration, notes), loudness_notes(sound.gyros, config))
    sampled: list[Evidence] = []
    each = np.arange(len(sound.time_s))
    for name, detector in chosen:
        if detector.stage == "samples":
            progress(f"{name}, every sample")
            windows = spans(heard, each, each + 1)
            sampled.extend(detector.detect(Survey(table=heard, windows=windows, config=config)))
    # An attitude is smoother than any gyro; only gyros tell noise from motion.
    noisy = [] if heard is not heard.gyros else [item for item in compared if item.kind == "noise"]
    scaled = [item for item in compared if item.kind == "scale"]
    compared = [item for item in compared if item.kind == "bias"]
    hearing = None if witness is None else _hearing(witness, testified, config)
    biased = bias_findings(heard, sound, compared, config, hearing)
    biased = with_scales(heard, sound, scaled, biased, config)
    by_itself = self_evident_findings(gyros, alone)
    noise = noise_findings(heard, noisy, [*biased, *by_itself])
    biased = without_swings(biased, noise)
    findings = [
        *mounting_findings(table, mounted.found),
        *by_itself,
        *noise,
        *guaranteed_findings(heard, sampled, biased, config),
    ]
    findings = with_disagreement(sound.gyros, heard.gyros, findings, config, hearing)
    findings = with_delays(sound.gyros, findings, config)
    findings += gain_findings(table, multiplied)
    findings.sort(key=lambda f: (f.start_s, f.end_s, f.kind, f.suspects))
    decided = dict(zip(sound.names, channel_status(sound, compared, findings), strict=True))
    status: tuple[Status, ...] = tuple(decided.get(name, "insufficient") for name in table.names)
    if witness is not None:
        status = with_witness(table, heard, status, witness.anchors, config)
    return Judgement(
        table=table,
        findings=tuple(findings),
        status=status,
        evidence=(
            *_spread_over(table, gyros, alone),
            *_spread_over(table, heard, sampled),
            *_spread_over(table, heard, compared),
            *_spread_over(table, heard, noisy),
        ),
        calibration=calibration,
    )


def _hearing(witness: Witness, table: ChannelTable, config: Config) -> Hearing:
    return lambda suspects, span: hear(witness, table, suspects, span, config)


def with_derived(gyros: ChannelTable, table: ChannelTable) -> ChannelTable:
    """Put the derived channels of a table behind the gyros."""
    derived = [k for k, channel in enumerate(table.channels) if channel.derived]
    if not derived:
        return gyros
    channels = [table.channels[k] for k in derived]
    return gyros.beside(table.rate_rad_s[:, derived], table.valid[:, derived], channels)


def compared_channels(table: ChannelTable) -> list[int]:
    """Choose what is compared: the gyros, and the derived channels that alone check one of them."""
    gyros = [k for k, channel in enumerate(table.channels) if not channel.derived]
    checked = detectable(table.axes[gyros])
    unchecked = {k for k, can in zip(gyros, checked, strict=True) if not can}
    needed = {k for block in blocks(table.axes) if unchecked & set(block) for k in block}
    return [k for k, channel in enumerate(table.channels) if not channel.derived or k in needed]


def _spread_over(
    table: ChannelTable, part: ChannelTable, evidence: list[Evidence]
) -> Iterator[Evidence]:
    """Lay evidence on some channels of a table out over all of them; the others are not tested.

    Evidence on every sample of a flight is large: what is laid out is taken from the list.
    """
    columns = [table.names.index(name) for name in part.names]
    while evidence:
        item = evidence.pop(0)
        shape = (len(item.windows), len(table.channels))
        laid = partial(_laid, columns=columns, shape=shape)
        yield replace(
            item,
            tested=laid(item.tested, filling=False),
            low=laid(item.low, filling=-np.inf),
            high=laid(item.high, filling=np.inf),
            tolerance=laid(item.tolerance, filling=np.nan),
            accused=laid(item.accused, filling=0),
            least=None if item.least is None else laid(item.least, filling=np.inf),
        )


def _laid(
    values: NDArray[Any], filling: object, columns: list[int], shape: tuple[int, int]
) -> NDArray[Any]:
    """Lay values for some channels out over all; what is the same in all windows is held once."""
    if values.shape == shape:
        return values
    rows = 1 if len(values) and values.strides[0] == 0 else len(values)
    wide = np.full((rows, shape[1]), filling, values.dtype)
    wide[:, columns] = values[:rows]
    return np.broadcast_to(wide, shape)


def _default_order(known: dict[str, object]) -> list[str]:
    """Order every installed detector: parity leads, it names suspects only when it must."""
    return sorted(known, key=lambda name: (name != "parity", name))


def without_accused(table: ChannelTable, evidence: Sequence[Evidence]) -> ChannelTable:
    """Return the table with the readings that a channel's own evidence accuses marked invalid."""
    if not any(item.accused.any() for item in evidence):
        return table
    valid = table.valid.copy()
    for item in evidence:
        for start, stop, accused in zip(
            item.windows.start, item.windows.stop, item.accused, strict=True
        ):
            valid[start:stop, accused > 0] = False
    return replace(table, rate_rad_s=np.where(valid, table.rate_rad_s, np.nan), valid=valid)
