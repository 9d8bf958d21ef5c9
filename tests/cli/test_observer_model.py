"""`fdilog analyse` with a model of the vehicle, on the timeline of [Observer24]."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from fdilog.cli import app
from fdilog.errors import UsageError
from fdilog.reproduce.observer import vessel
from tests.vessels import write_voyage

RUNNER = CliRunner()


@pytest.fixture(scope="module")
def voyage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("voyage")
    write_voyage(folder / "voyage.csv")
    return folder


def toml(**keys: Any) -> str:
    known = {
        "outputs": ["boat.sway", "gyro.z"],
        "inputs": ["boat.rudder"],
        "healthy_s": [0, 19],
    } | keys
    lines = [
        f"{key} = {json.dumps(value)}" for key, value in known.items()
    ]  # JSON lists, numbers and booleans are TOML too
    return "\n".join(["[observer]", *lines]) + "\n"


def analysed(folder: Path, text: str, code: int = 1) -> dict[str, Any]:
    (folder / "observer.toml").write_text(text, encoding="utf-8")
    said = RUNNER.invoke(
        app,
        [
            "analyse",
            str(folder / "voyage.csv"),
            "--config",
            str(folder / "observer.toml"),
            "--json",
        ],
    )
    if said.exception and not isinstance(said.exception, SystemExit):
        raise said.exception
    told: dict[str, Any] = json.loads(said.stdout)
    assert said.exit_code == code
    return told


@pytest.mark.parametrize("identified", [False, True], ids=["given", "identified"])
def test_the_failed_gyro_and_the_failed_speed_are_named_at_their_times(
    voyage: Path, *, identified: bool
) -> None:
    dynamics, inputs = vessel()
    model = {"identify": True} if identified else {"A": dynamics.tolist(), "B": inputs.tolist()}
    told = analysed(voyage, toml(**model))
    gyro, speed = told["findings"]
    assert (gyro["kind"], gyro["suspects"]) == ("bias", ["gyro.z"])
    assert (gyro["start_s"], gyro["end_s"]) == pytest.approx((20.0, 30.0), abs=1.0)
    assert gyro["size"]["low"] < 0.1 < gyro["size"]["high"]
    assert (speed["kind"], speed["suspects"], speed["size"]) == (
        "disagreement",
        ["boat.sway"],
        None,
    )
    assert (speed["start_s"], speed["end_s"]) == pytest.approx((50.0, 70.0), abs=1.0)
    assert told["verdict"] == "failed"
    assert [channel["status"] for channel in told["table"]["channels"]] == ["failed"]
    assert told["completeness"]["whole"]
    (note,) = [p for p in told["completeness"]["problems"] if p["what"].startswith("observer")]
    assert note["note"] is True


def test_a_name_that_the_log_does_not_hold_names_the_nearest(voyage: Path) -> None:
    told = analysed(voyage, toml(inputs=["boat.ruder"], identify=True), code=2)
    assert "no 'boat.ruder' in this log; did you mean 'boat.rudder'" in told["error"]


def test_a_log_without_the_streams_of_the_model_is_analysed_all_the_same(
    voyage: Path, sample_logs: Path
) -> None:
    (voyage / "observer.toml").write_text(toml(identify=True), encoding="utf-8")
    log = str(sample_logs / "two_imus_bias.bin")
    with_model = ["--config", str(voyage / "observer.toml"), "--detectors", "parity,observer"]
    said = RUNNER.invoke(app, ["analyse", log, *with_model, "--json"])
    told = json.loads(said.stdout)
    assert told["verdict"] == "failed"
    notes = [problem["what"] for problem in told["completeness"]["problems"]]
    missing = "; ".join(f"no '{name}' in this log" for name in toml_names())
    assert f"observer: not asked: {missing}" in notes


def toml_names() -> tuple[str, ...]:
    return ("boat.sway", "gyro.z", "boat.rudder")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('outputs = "imu0.z"', "'observer.outputs' must be a list"),
        ("output = []", "unknown key 'observer.output'; did you mean 'outputs'"),
        ("A = [[1.0], [2.0, 3.0]]", "'observer.A' must hold rows of one length"),
        ('A = [["a"]]', "'observer.A' must hold finite numbers"),
        ("healthy_s = [5, 1]", r"'observer.healthy_s' must be \[from, to\]"),
        ("identify = 1", "'observer.identify' must be true or false"),
        ("eigenvalues_per_s = [1.0]", "'observer.eigenvalues_per_s' must be below zero"),
        ("units = [0.0]", "'observer.units' = 0.0 is out of range"),
        ("step_s = 0", "'observer.step_s' = 0 is out of range"),
        ("threshold = -1", "'observer.threshold' = -1 is out of range"),
    ],
)
def test_a_wrong_key_is_one_line(voyage: Path, text: str, complaint: str) -> None:
    with pytest.raises(UsageError, match=complaint):
        analysed(voyage, f"[observer]\n{text}\n")


def test_every_key_is_printed_with_a_reason() -> None:
    printed = RUNNER.invoke(app, ["config"]).stdout.split("[observer]\n")[1]
    keys = [line for line in printed.splitlines() if line and not line.startswith("# ")]
    assert keys == ["identify = false", "threshold = 0.0", "step_s = 0.1"]
    for key in ("outputs", "inputs", "A", "B", "C", "healthy_s", "eigenvalues_per_s", "K", "units"):
        assert f"\n# {key} = []\n" in f"\n{printed}"
