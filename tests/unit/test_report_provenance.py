"""What a report says about itself must give the same report again."""

from __future__ import annotations

import os
import subprocess
import tomllib

import pytest

from fdilog.analysis import Part
from fdilog.config import Config, Geometry, GyroSource, config_from_dict
from fdilog_reports.provenance import command, configuration


def settings() -> Config:
    return (
        Config()
        .replace("tolerance", bias_deg_s=0.25)
        .replace("windows", lengths_s=(0.5, 7.0))
        .replace("sources", use=("imu0",))
    )


@pytest.mark.parametrize(
    "config",
    [
        Config(),
        settings(),
        Config(
            geometry=Geometry(
                axes=((1.0, 0.0, 0.0), (0.0, -1.0, 0.0)),
                mounting={
                    "imu1": {"quaternion": (1.0, 0.0, 0.0, 0.0)},
                    'odd "name".]': {"quaternion": (0.0, 1.0, 0.0, 0.0)},
                },
            )
        ),
        Config().replace(
            "sources",
            gyro=(
                GyroSource(name="left", topic="/imu/left\n\\", fields=("x", "y", "z")),
                GyroSource(name="𝛚 \u202e", topic="b", fields=("w",), unit="deg/s"),
            ),
        ),
    ],
)
def test_the_printed_configuration_reads_back_as_the_same(config: Config) -> None:
    again = config_from_dict(tomllib.loads(configuration(config)))
    assert again == config
    assert again.sha256 == config.sha256


def test_the_command_names_the_configuration_only_if_it_is_not_the_default() -> None:
    assert command("flight.bin", Config()) == "fdilog analyse flight.bin"
    assert command("flight.bin", settings()) == "fdilog analyse flight.bin --config fdilog.toml"


def test_the_command_repeats_the_part_that_was_asked_for() -> None:
    part = Part(start_s=30.25, end_s=90.0, armed=True)
    assert command("flight.bin", Config(), part) == (
        "fdilog analyse flight.bin --from 30.25 --to 90.0 --armed"
    )
    assert command("a.bin", Config(), Part(end_s=1e-7)) == "fdilog analyse a.bin --to 1e-07"


@pytest.mark.parametrize(
    "name",
    [
        b"plain.bin", b"two words.bin", b"it's.bin", b"$(reboot).bin", b"caf\xe9.bin",
        b"new\nline.bin", b"esc\x1b'\\.bin", b"--help", b"\xe2\x80\xae.bin", b"\xd1\x8f.bin",
    ],
)  # fmt: skip
def test_a_shell_gives_the_command_the_very_path(name: bytes) -> None:
    line = command(os.fsdecode(name), Config()).replace("fdilog analyse", "printf %s", 1)
    assert line.isprintable()
    got = subprocess.run(["bash", "-c", line], capture_output=True, check=True).stdout
    assert got.removeprefix(b"./") == name
