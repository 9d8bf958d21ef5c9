from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import fdilog
from fdilog.cli import app
from fdilog.errors import UsageError

FLIGHT = ("simulate", "--duration", "30", "--rate", "25", "--seed", "5")


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def done(*arguments: str | Path) -> Result:
    result = run(*arguments)
    assert result.exit_code == 0, result.output
    return result


def complaint(*arguments: str | Path) -> str:
    result = run(*arguments)
    assert isinstance(result.exception, UsageError)
    return str(result.exception)


def truth(log: Path) -> Any:
    return json.loads(log.with_name(f"{log.name}.truth.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    log = tmp_path_factory.mktemp("flight") / "healthy.bin"
    done(*FLIGHT, "-o", log)
    return log


@pytest.mark.parametrize("suffix", [".bin", ".csv", ".tlog"])
def test_a_simulated_flight_can_be_read_in_the_format_of_its_suffix(
    tmp_path: Path, suffix: str
) -> None:
    log = tmp_path / f"flight{suffix}"
    said = done(*FLIGHT, "-o", log, "--imus", "2")
    assert said.stdout == ""
    assert said.stderr == f"wrote {log}\nwrote {log}.truth.json\n"
    table = fdilog.channel_table(fdilog.read(log))
    assert {channel.source for channel in table.channels if not channel.derived} in (
        {"imu0", "imu1"},
        {"imu1", "imu2"},
    )
    assert 29.0 < table.duration_s < 30.1


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(
    healthy: Path, tmp_path: Path
) -> None:
    again, other = tmp_path / "again.bin", tmp_path / "other.bin"
    done(*FLIGHT, "-o", again)
    done(*FLIGHT[:-1], "6", "-o", other)
    assert again.read_bytes() == healthy.read_bytes() != other.read_bytes()


def test_faults_are_simulated_in_degrees_and_the_truth_is_in_si(
    healthy: Path, tmp_path: Path
) -> None:
    log = tmp_path / "faulty.bin"
    faults = ("bias:imu1.y:10:20:2", "stuck:imu0.x:25:", "impulse:imu2.z:5:15:60:3")
    done(*FLIGHT, "-o", log, *(word for fault in faults for word in ("--fault", fault)))
    told = truth(log)
    assert told["schema"] == "fdilog-truth/1"
    assert [fault["kind"] for fault in told["faults"]] == ["bias", "stuck", "impulse"]
    assert told["faults"][0]["size"] == pytest.approx(math.radians(2.0))
    assert told["faults"][1]["end_s"] is None
    assert told["faults"][2]["count"] == 3
    before, after = (fdilog.channel_table(fdilog.read(path)) for path in (healthy, log))
    apart = (after.rate_rad_s - before.rate_rad_s)[:, before.names.index("imu1.y")]
    inside = (before.time_s >= 10.0) & (before.time_s <= 20.0)
    # A reading is rounded to the sensor's resolution of 16 bits over 2000 deg/s.
    np.testing.assert_allclose(apart[inside], math.radians(2.0), atol=math.radians(0.07))
    np.testing.assert_array_equal(apart[~inside], 0.0)


def test_a_unit_of_skewed_gyros_is_simulated_by_its_name(tmp_path: Path) -> None:
    log = tmp_path / "skewed.csv"
    done(*FLIGHT, "-o", log, "--geometry", "matasov", "--fault", "bias:g2:10:20:20")
    assert log.read_text(encoding="utf-8").startswith("time_s,g1,g2,g3,g4,g5,g6\n")
    assert run("analyse", log, "--geometry", "matasov", "-q").exit_code == 1


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--fault", "bias"), "fault 'bias': must be kind:channel:start:end"),
        (("--fault", "bias:imu0.x:1:2"), "bias of imu0.x: needs a size [deg/s]"),
        (("--fault", "bias:imu0.x:a:2:3"), "start 'a' is no number"),
        (("--fault", "bias:imu0.x:nan:2:3"), "start 'nan' is no number"),
        (("--fault", "impulse:imu0.x:1:2:60:1.5"), "count '1.5' is no whole number"),
        (("--fault", "bais:imu0.x:1:2:3"), "no fault of kind 'bais'; did you mean 'bias'?"),
        (("--fault", "stuck:imu0.x:1:2:3"), "stuck of imu0.x: this kind has no size"),
        (("--fault", "bias:imu7.x:1:2:3"), "no channel 'imu7.x'"),
        (("--fault", "bias:imu0.x:100:200:3"), "the flight lasts"),
        (("--geometry", "matsov"), "matasov"),
        (("--duration", "0"), "has no two readings"),
    ],
)
def test_a_flight_that_cannot_be_is_one_clear_line(
    tmp_path: Path, words: tuple[str, ...], text: str
) -> None:
    log = tmp_path / "flight.bin"
    assert text in complaint(*FLIGHT, "-o", log, *words)
    assert list(tmp_path.iterdir()) == []


def test_a_suffix_that_no_writer_knows_names_those_that_do(tmp_path: Path) -> None:
    assert "no format with suffix '.bim'; did you mean '.bin'?" in complaint(
        *FLIGHT, "-o", tmp_path / "flight.bim"
    )


def test_an_injected_bias_changes_its_readings_and_nothing_else(
    healthy: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.bin"
    done(
        "inject", healthy, "-o", copy, "--fault", "bias", "--channel", "imu1.y",
        "--start", "10", "--end", "20", "--size", "-2",
    )  # fmt: skip
    before, after = (fdilog.channel_table(fdilog.read(path)) for path in (healthy, copy))
    apart = after.rate_rad_s - before.rate_rad_s
    column = before.names.index("imu1.y")
    inside = (before.time_s >= 10.0) & (before.time_s <= 20.0)
    np.testing.assert_allclose(apart[inside, column], math.radians(-2.0), atol=1e-6)
    apart[inside, column] = 0.0
    np.testing.assert_array_equal(np.nan_to_num(apart[:, :9]), 0.0)
    assert copy.stat().st_size == healthy.stat().st_size


def test_the_truth_of_an_injection_tells_what_the_log_had_by_itself(
    healthy: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy.bin"
    done(
        "inject", healthy, "-o", copy, "--fault", "drift", "--channel", "imu1.y",
        "--start", "10", "--end", "20", "--size", "0.5",
    )  # fmt: skip
    told = truth(copy)
    assert told["log"] == {"path": str(copy), "made_from": str(healthy)}
    (fault,) = told["faults"]
    assert (fault["size"], fault["unit"]) == (pytest.approx(math.radians(0.5)), "rad/s^2")
    (changed,) = told["changed"]
    assert changed["removed_records"] == 0
    table = fdilog.channel_table(fdilog.read(healthy))
    inside = (table.time_s >= 10.0) & (table.time_s <= 20.0)
    x = {name: table.rate_rad_s[inside, table.names.index(name)] for name in table.names}
    (own,) = told["own_offset"]
    assert own["mean_rad_s"] == pytest.approx(
        float(np.mean(x["imu1.y"] - (x["imu0.y"] + x["imu2.y"]) / 2.0)), abs=1e-12
    )
    assert (own["samples"], own["against"]) == (int(inside.sum()), ["imu0.y", "imu2.y"])


def test_a_dropout_of_a_source_tells_of_all_its_channels(healthy: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.bin"
    done(
        "inject", healthy, "-o", copy, "--fault", "dropout", "--channel", "imu1",
        "--start", "10", "--end", "11",
    )  # fmt: skip
    told = truth(copy)
    assert [own["channel"] for own in told["own_offset"]] == ["imu1.x", "imu1.y", "imu1.z"]
    assert told["changed"][0]["removed_records"] in (25, 26)


def test_without_a_second_gyro_the_own_offset_is_not_known(tmp_path: Path) -> None:
    log, copy = tmp_path / "one.bin", tmp_path / "copy.bin"
    done(*FLIGHT, "-o", log, "--imus", "1", "--no-attitude")
    done("inject", log, "-o", copy, "--fault", "stuck", "--channel", "imu0.x", "--start", "10")
    assert truth(copy)["own_offset"] == [
        {"channel": "imu0.x", "mean_rad_s": None, "samples": 0, "against": []}
    ]


def test_an_injection_that_makes_no_sense_writes_nothing(healthy: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy.bin"
    at = ("--channel", "imu1.y", "--start", "10", "--end", "20")
    assert "needs a size [deg/s]" in complaint(
        "inject", healthy, "-o", copy, "--fault", "bias", *at
    )
    assert "did you mean 'noise'" in complaint(
        "inject", healthy, "-o", copy, "--fault", "nois", *at
    )
    assert list(tmp_path.iterdir()) == []


def test_a_log_is_never_overwritten_by_its_copy(healthy: Path) -> None:
    before = healthy.read_bytes()
    text = complaint("inject", healthy, "-o", healthy, "--fault", "stuck", "--channel", "imu0.x")
    assert "is the log itself" in text
    assert healthy.read_bytes() == before
