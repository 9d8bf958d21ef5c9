"""The sample logs are what their script makes, and hold the faults that their table promises."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.registry import read
from fdilog.sources.gyros import choose

KILOBYTE = 1000

TRUTH = Path(__file__).parents[2] / "sample_logs" / "truth.json"


@pytest.fixture(scope="module")
def script(sample_logs: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_samples", sample_logs / "make.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def truth(sample_logs: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((sample_logs / "truth.json").read_text(encoding="utf-8"))
    return found


def test_the_script_makes_the_same_bytes_again(
    script: ModuleType, sample_logs: Path, tmp_path: Path
) -> None:
    script.main(tmp_path)
    made = [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.parts[0] for path in made} >= {sample.name for sample in script.SAMPLES}
    for path in made:
        again, shipped = tmp_path / path, sample_logs / path
        if path.suffix == ".mcap" and len(path.parts) == 1:
            assert messages(again) == messages(shipped), path
        else:
            assert again.read_bytes() == shipped.read_bytes(), path


@pytest.mark.parametrize("name", ["same_flight_json.mcap", "same_flight_sqlite3"])
def test_making_a_log_over_itself_changes_nothing(
    script: ModuleType, tmp_path: Path, name: str
) -> None:
    sample = next(sample for sample in script.SAMPLES if sample.name == name)
    made = []
    for _ in range(2):
        script.make(sample, tmp_path)
        files = sorted(path for path in tmp_path.rglob("*") if path.is_file())
        made.append([(path, path.read_bytes()) for path in files])
    assert made[0] == made[1]


def messages(path: Path) -> list[tuple[str, int, bytes]]:
    """What an MCAP file says, however it is compressed: versions of zstd differ."""
    from mcap.reader import make_reader

    with path.open("rb") as file:
        found = make_reader(file).iter_messages()
        return [(channel.topic, message.log_time, message.data) for _, channel, message in found]


def test_every_log_is_small_and_has_its_truth_and_its_line(
    sample_logs: Path, truth: dict[str, Any]
) -> None:
    table = (sample_logs / "README.md").read_text(encoding="utf-8")
    others = {"README.md", "make.py", "truth.json", "__pycache__"}
    assert {path.name for path in sample_logs.iterdir()} - others == set(truth)
    files = [path for path in sample_logs.rglob("*") if path.is_file()]
    assert max(path.stat().st_size for path in files) < 1000 * KILOBYTE
    assert sum(path.stat().st_size for path in files) < 10_000 * KILOBYTE
    assert all(f"| `{name}` |" in table for name in truth)


def test_channels_of_the_truth_are_those_of_the_logs(
    sample_logs: Path, truth: dict[str, Any]
) -> None:
    for name, said in truth.items():
        gyros, _ = choose(read(sample_logs / name), Config())
        channels = {channel for gyro in gyros for channel in gyro.channel_names}
        assert {channel for source in said["sources"] for channel in source["channels"]} == channels
        assert {channel for suspects in said["suspects"] for channel in suspects} <= channels
        faults = [Fault.from_dict(fault) for fault in said["faults"]]
        assert bool(faults) == (said["verdict"] == "failed")


def test_the_biased_gyro_reads_three_degrees_per_second_too_much(sample_logs: Path) -> None:
    gyros, _ = choose(read(sample_logs / "three_imus_bias.bin"), Config())
    first, second, third = (gyro.rate_rad_s[:, 1] for gyro in gyros)
    apart = np.degrees(second - (first + third) / 2)
    time_s = (gyros[0].time_ns - gyros[0].time_ns[0]) / 1e9
    inside = (time_s >= 40.0) & (time_s <= 60.0)
    assert apart[inside].mean() - apart[~inside].mean() == pytest.approx(3.0, abs=0.2)


def test_the_cut_log_ends_in_the_middle_of_a_record(sample_logs: Path) -> None:
    recording = read(sample_logs / "cut.bin")
    assert any("incomplete" in problem.what and problem.note for problem in recording.problems)
    assert all(problem.note for problem in recording.problems)


def test_the_damaged_log_has_lost_bytes(sample_logs: Path) -> None:
    recording = read(sample_logs / "damaged.bin")
    lost = [problem for problem in recording.problems if not problem.note]
    assert sum(problem.bytes_lost or 0 for problem in lost) >= 500


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in sorted(json.loads(TRUTH.read_text(encoding="utf-8")))
        if not name.startswith("same_flight")  # tests/conformance/test_same_flight.py
    ],
)
def test_the_analysis_says_what_is_true_of_a_sample_log(sample_logs: Path, name: str) -> None:
    from fdilog.analysis import analyse
    from fdilog.config import Config, read_geometry

    said = json.loads(TRUTH.read_text(encoding="utf-8"))[name]
    options = said["options"]
    config = Config()
    if "--geometry" in options:
        config = read_geometry(config, options[options.index("--geometry") + 1])
    analysis = analyse(sample_logs / name, config)
    assert analysis.verdict == said["verdict"]
    accused = {finding.suspects for finding in analysis.findings}
    assert accused == {tuple(suspects) for suspects in said["suspects"]}
    kinds = {fault["kind"] for fault in said["faults"]}
    assert {finding.kind for finding in analysis.findings} == kinds
