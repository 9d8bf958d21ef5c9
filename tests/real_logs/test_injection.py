"""A fault put into the bytes of a recorded flight, as the official library sees it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fdilog.analysis import analyse
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.injection import inject
from fdilog.registry import plugin, read
from fdilog.writing import write_injected

LOGS = [
    ("quad_2imu_50hz_b.bin", "IMU2", None),
    ("quad_3imu_good_prop_hover_1.bin", "IMU", 1),
]


def official(path: Path, kind: str, instance: int | None) -> list[tuple[Any, ...]]:
    from pymavlink.DFReader import DFReader_binary

    reader = DFReader_binary(str(path))
    found = []
    while (message := reader.recv_match(type=kind)) is not None:
        values = message.to_dict()
        if instance is None or values["I"] == instance:
            found.append(tuple(values.items()))
    reader.close()
    return found


@pytest.mark.parametrize(("name", "kind", "instance"), LOGS)
def test_only_the_faulty_axis_changes_and_only_while_it_fails(
    real_logs: Path, tmp_path: Path, name: str, kind: str, instance: int | None
) -> None:
    log, copy = real_logs / "dataflash" / name, tmp_path / "copy.bin"
    bias = Fault(kind="bias", channel="imu1.y", start_s=10.0, end_s=20.0, size=0.125)
    injection = inject(read(log), [bias])
    plugin("writers", "dataflash").patch(log, copy, injection.changes)
    assert copy.stat().st_size == log.stat().st_size
    before, after = official(log, kind, instance), official(copy, kind, instance)
    assert len(before) == len(after) > 100
    apart = [
        (key, new - old)
        for one, other in zip(before, after, strict=True)
        for (key, old), (_, new) in zip(one, other, strict=True)
        if new != old
    ]
    assert {key for key, _ in apart} == {"GyrY"}
    np.testing.assert_allclose([error for _, error in apart], 0.125, atol=1e-6)
    hit = sum(int((column != stream.columns[field]).sum())
              for change in injection.changes
              for stream in [change.stream]
              for field, column in change.columns.items())  # fmt: skip
    assert len(apart) == hit > 200


def test_a_dropout_of_a_real_source_is_a_gap_in_it_alone(real_logs: Path, tmp_path: Path) -> None:
    log, copy = real_logs / "dataflash" / "quad_2imu_50hz_b.bin", tmp_path / "copy.bin"
    silent = Fault(kind="dropout", channel="imu1", start_s=10.0, end_s=12.0)
    injection = inject(read(log), [silent])
    plugin("writers", "dataflash").patch(log, copy, injection.changes)
    removed = int(injection.changes[0].removed.sum())
    assert removed in range(95, 106)
    assert len(official(copy, "IMU2", None)) == len(official(log, "IMU2", None)) - removed
    for kind in ("IMU", "ATT", "GPS"):
        assert official(copy, kind, None) == official(log, kind, None)


@pytest.mark.parametrize("axis", "xyz")
@pytest.mark.parametrize("log", ["tlog/sub_zero_imu2.tlog", "ulog/quad_250hz.ulg"])
def test_a_log_written_anew_keeps_what_its_gyros_are_held_against(
    real_logs: Path, tmp_path: Path, log: str, axis: str
) -> None:
    copy = tmp_path / f"copy{Path(log).suffix}"
    size = float(np.radians(3.0))
    bias = Fault(kind="bias", channel=f"imu0.{axis}", start_s=20.0, end_s=50.0, size=size)
    write_injected(inject(read(real_logs / log), [bias]), real_logs / log, copy)
    (finding,) = analyse(copy, Config().replace("detectors", use=("parity",))).findings
    assert (finding.kind, finding.suspects, finding.witness) == ("bias", (bias.channel,), "att")
