"""What the detectors say of windows: who is asked first, what that settles, and the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fdilog.config import Config
from fdilog.decision.alignment import aligned_windows
from fdilog.decision.steps import steps_as_logged
from fdilog.finding import Evidence
from fdilog.registry import Detector
from fdilog.table import ChannelTable
from fdilog.windows.bursts import burst_windows
from fdilog.windows.calibration import Calibration, calibrate
from fdilog.windows.slopes import scale_evidence
from fdilog.windows.survey import Survey, cut


@dataclass(frozen=True, kw_only=True)
class _Asked:
    """A detector of windows, by name."""

    name: str
    detector: Detector
    progress: Callable[[str], None]

    def of(self, surveys: Sequence[Survey]) -> list[Evidence]:
        """Ask it about some windows."""
        found: list[Evidence] = []
        for survey in surveys:
            length_s = survey.windows.length_s
            where = f"{length_s:g} s windows" if length_s else "windows laid to fit"
            self.progress(f"{self.name}, {where}")
            found += self.detector.detect(survey)
        return found


@dataclass(frozen=True, kw_only=True, eq=False)
class _Lead:
    """The first detector that tells of biases, and where the others are to look.

    Parameters
    ----------
    leader
        None if no detector tells of biases.
    evidence
        What it says of biases.
    regular, laid
        Windows of every length; windows laid where hints of a bias point, and where something
        stands out for a moment.
    """

    leader: _Asked | None
    evidence: list[Evidence]
    regular: list[Survey]
    laid: list[Survey]

    @classmethod
    def of(cls, table: ChannelTable, asked: Sequence[_Asked], config: Config) -> _Lead:
        """Ask one detector after another until one tells of biases."""
        regular = [
            Survey(table=table, windows=windows, config=config) for windows in cut(table, config)
        ]
        leader, found = None, list[Evidence]()
        for one in asked:
            found = _of_biases(one.of(regular))
            if found:
                leader = one
                break
        # What stands off for a moment does so by more than this flight's swells in all the hours of
        # the budget; that is asked already, and too much of a few readings.
        screened = config.replace("windows", false_findings_per_hour=float("inf"))
        hinted, bursts = aligned_windows(table, found), burst_windows(table, config)
        laid = [
            Survey(table=table, windows=windows, config=settings)
            for windows, settings in ((hinted, config), (bursts, screened))
            if windows is not None
        ]
        if leader is not None:
            found += _of_biases(leader.of(laid))
        return cls(leader=leader, evidence=found, regular=regular, laid=laid)


def windowed(
    table: ChannelTable,
    chosen: Sequence[tuple[str, Detector]],
    config: Config,
    progress: Callable[[str], None],
) -> tuple[ChannelTable, tuple[Calibration, ...], list[Evidence]]:
    """Calibrate a table and compare its channels; where there are faults, calibrate without.

    The evidence of the detector that leads settles the calibration, and the windows that are looked
    at. Then the others are asked.
    """
    asked = [
        _Asked(name=name, detector=detector, progress=progress)
        for name, detector in chosen
        if detector.stage == "windows"
    ]
    sound, calibration = calibrate(table, config)
    lead = _Lead.of(sound, asked, config)
    steps = steps_as_logged(table, sound, lead.evidence, config)
    if steps.any():
        sound, calibration = calibrate(table, config, steps)
        lead = _Lead.of(sound, asked, config)
    found = list(lead.evidence)
    for one in asked:
        if one is not lead.leader:
            said = one.of(lead.regular)
            found += [*said, *(_of_biases(one.of(lead.laid)) if _of_biases(said) else [])]
    found += [scale_evidence(survey) for survey in lead.regular]
    return sound, calibration, found


def _of_biases(evidence: Sequence[Evidence]) -> list[Evidence]:
    return [item for item in evidence if item.kind == "bias"]
