"""The command line: exit codes, what goes where, and one line per error."""

from __future__ import annotations

import gzip
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest


def fdilog(*arguments: object, stdin: bytes | None = None) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "fdilog", *map(str, arguments)],
        capture_output=True,
        input=stdin,
        check=False,
        timeout=120,
    )


def one_line(stderr: bytes) -> str:
    text = stderr.decode()
    assert text.count("\n") == 1, text
    assert "Traceback" not in text
    return text


@pytest.mark.parametrize(
    ("log", "code", "verdict"),
    [
        ("three_imus_healthy.bin", 0, "healthy"),
        ("three_imus_bias.bin", 1, "failed"),
        ("one_imu.bin", 3, "insufficient"),
        ("damaged.bin", 3, "undecided"),
    ],
)
def test_the_exit_code_is_the_verdict(sample_logs: Path, log: str, code: int, verdict: str) -> None:
    done = fdilog("analyse", "--json", sample_logs / log)
    assert done.returncode == code
    assert json.loads(done.stdout)["verdict"] == verdict
    assert done.stderr == b""


def test_the_same_log_gives_the_same_bytes(sample_logs: Path) -> None:
    log = sample_logs / "three_imus_bias.bin"
    assert fdilog("analyse", "--json", log).stdout == fdilog("analyse", "--json", log).stdout


def test_several_logs_give_one_object_a_line_in_the_order_given(
    sample_logs: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "broken.bin"
    broken.write_bytes(bytes(range(256)) * 16)
    logs = [sample_logs / "one_imu.bin", broken, sample_logs / "three_imus_healthy.bin"]
    done = fdilog("analyse", "--json", *logs)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["log"]["path"] for line in lines] == [str(log) for log in logs]
    assert lines[1]["verdict"] is None
    assert str(broken) in lines[1]["error"]
    assert done.returncode == 3
    one_line(done.stderr)


@pytest.mark.parametrize(
    ("content", "word"),
    [(b"", "empty"), (b"\x00\xff" * 5000, "not a log"), (b"time_s,gx\n", "no records")],
)
def test_what_cannot_be_analysed_is_one_line_and_exit_code_2(
    tmp_path: Path, content: bytes, word: str
) -> None:
    path = tmp_path / "log.csv" if content.startswith(b"time") else tmp_path / "log.xyz"
    path.write_bytes(content)
    done = fdilog("analyse", path)
    assert done.returncode == 2
    assert done.stdout == b""
    line = one_line(done.stderr)
    assert str(path) in line
    assert word in line


def test_a_missing_path_and_a_directory_are_one_line(tmp_path: Path) -> None:
    for path in (tmp_path / "nothing.bin", tmp_path):
        done = fdilog("analyse", path)
        assert done.returncode == 2
        assert str(path) in one_line(done.stderr)


@pytest.mark.parametrize(
    "arguments",
    [
        ("--tolerance", "-1"),
        ("--geometry", "matasow"),
        ("--detectors", "parita"),
        ("--from", "5", "--to", "4"),
        ("--format", "html"),
        ("--armed",),
    ],
)
def test_a_wrong_option_is_one_line_that_helps(
    sample_logs: Path, arguments: tuple[str, ...]
) -> None:
    log = sample_logs / ("skewed_bias.csv" if "--armed" in arguments else "one_imu.bin")
    extra = ("--geometry", "mirrored-triads") if "--armed" in arguments else ()
    done = fdilog("analyse", log, *extra, *arguments)
    assert done.returncode == 2
    one_line(done.stderr)


def test_a_table_without_a_geometry_is_named_with_what_to_do(sample_logs: Path) -> None:
    done = fdilog("analyse", sample_logs / "skewed_bias.csv")
    assert done.returncode == 2
    line = one_line(done.stderr)
    assert "skewed_bias.csv: where channel 'g1' points is not known; add --geometry" in line


def test_an_unknown_key_names_the_nearest_one(sample_logs: Path, tmp_path: Path) -> None:
    config = tmp_path / "fdilog.toml"
    config.write_text("[tolerance]\nbias_deg = 2.0\n")
    done = fdilog("analyse", sample_logs / "one_imu.bin", "--config", config)
    assert done.returncode == 2
    assert "bias_deg_s" in one_line(done.stderr)


def test_the_default_configuration_reads_back_as_itself(tmp_path: Path) -> None:
    from fdilog.config import Config, load_config

    config = tmp_path / "fdilog.toml"
    config.write_bytes(fdilog("config").stdout)
    assert load_config(config) == Config()


def test_reports_are_written_for_every_log_even_of_one_name(
    sample_logs: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other" / "one_imu.bin"
    other.parent.mkdir()
    other.write_bytes((sample_logs / "one_imu.bin").read_bytes())
    out = tmp_path / "out"
    done = fdilog("analyse", sample_logs / "one_imu.bin", other, "-o", out)
    assert done.returncode == 3
    assert sorted(path.name for path in out.iterdir()) == sorted(
        f"one_imu{number}{suffix}" for number in ("", "-2") for suffix in (".html", ".md", ".json")
    )


def test_pictures_stand_beside_the_markdown_and_are_linked_in_it(
    sample_logs: Path, tmp_path: Path
) -> None:
    log = tmp_path / "my flight.bin"
    log.write_bytes((sample_logs / "stuck.bin").read_bytes())
    out = tmp_path / "out"
    assert fdilog("analyse", log, "-o", out, "--format", "md", "--pictures").returncode == 1
    assert sorted(path.name for path in out.iterdir()) == ["my flight.md", "my flight_files"]
    text = (out / "my flight.md").read_text(encoding="utf-8")
    for picture in (out / "my flight_files").iterdir():
        assert f"](my%20flight_files/{picture.name})" in text
    assert "fdilog: --pictures" in one_line(fdilog("analyse", log, "--pictures").stderr)


def test_what_export_writes_analyse_reads(sample_logs: Path, tmp_path: Path) -> None:
    table = tmp_path / "table.csv"
    assert fdilog("export", sample_logs / "three_imus_bias.bin", "-o", table).returncode == 0
    done = fdilog("analyse", "--json", table)
    finding = json.loads(done.stdout)["findings"][0]
    assert finding["suspects"] == ["imu1.y"]
    assert finding["isolated"] is True


def test_standard_input_and_compressed_logs_are_read(sample_logs: Path, tmp_path: Path) -> None:
    content = (sample_logs / "stuck.bin").read_bytes()
    packed = tmp_path / "stuck.bin.gz"
    packed.write_bytes(gzip.compress(content))
    for done in (
        fdilog("analyse", "--json", "-", stdin=content),
        fdilog("analyse", "--json", packed),
    ):
        assert json.loads(done.stdout)["findings"][0]["kind"] == "stuck"


def test_a_part_of_the_flight_keeps_its_flight_times(sample_logs: Path) -> None:
    log = sample_logs / "three_imus_bias.bin"
    inside = fdilog("analyse", "--json", log, "--from", "30", "--to", "70")
    finding = json.loads(inside.stdout)["findings"][0]
    assert abs(finding["start_s"] - 40.0) < 1.0
    assert fdilog("analyse", log, "--from", "0", "--to", "35").returncode in {0, 3}
    assert fdilog("analyse", log, "--from", "500").returncode == 2


def test_inspect_lists_streams_sources_and_the_table(sample_logs: Path) -> None:
    done = fdilog("inspect", sample_logs / "three_imus_bias.bin")
    text = done.stdout.decode()
    assert done.returncode == 0
    assert "IMU[1]" in text
    assert "imu1.y" in text


def test_every_detector_and_reader_is_listed() -> None:
    assert b"parity" in fdilog("detectors").stdout
    assert b"dataflash" in fdilog("readers").stdout


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys, fdilog.cli; print([m for m in ('numpy','pandas','scipy') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
    assert done.stdout.strip() == b"[]"
    start = time.perf_counter()
    assert fdilog("--help").returncode == 0
    # Far above what it takes; only a heavy import could reach it.
    assert time.perf_counter() - start < 5.0


def test_a_log_that_does_not_fit_the_options_has_its_line_and_the_others_are_analysed(
    sample_logs: Path,
) -> None:
    logs = [sample_logs / name for name in ("skewed_bias.csv", "three_imus_bias.bin")]
    done = fdilog("analyse", "--json", *logs)
    first, second = (json.loads(line) for line in done.stdout.splitlines())
    assert "--geometry" in first["error"]
    assert second["verdict"] == "failed"
    assert done.returncode == 1
    one_line(done.stderr)


@pytest.mark.skipif(os.name == "nt", reason="closed pipes end a program otherwise there")
@pytest.mark.parametrize("arguments", [("config",), ("analyse", "-q")])
def test_a_closed_pipe_is_no_verdict(sample_logs: Path, arguments: tuple[str, ...]) -> None:
    log = [sample_logs / "three_imus_healthy.bin"] if arguments[0] == "analyse" else []
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "fdilog", *map(str, (*arguments, *log))]
    done = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, check=False, timeout=120)
    os.close(writing)
    assert (done.returncode, done.stderr) == (141, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("arguments", [("config",), ("analyse", "-q")])
def test_a_full_disk_is_one_line(sample_logs: Path, arguments: tuple[str, ...]) -> None:
    log = [sample_logs / "three_imus_healthy.bin"] if arguments[0] == "analyse" else []
    command = [sys.executable, "-m", "fdilog", *map(str, (*arguments, *log))]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            command, stdout=full, stderr=subprocess.PIPE, check=False, timeout=120
        )
    assert done.returncode == 2
    assert "no space left" in one_line(done.stderr)


def test_a_file_in_the_place_of_the_folder_is_told_before_anything_is_analysed(
    sample_logs: Path, tmp_path: Path
) -> None:
    (tmp_path / "out").write_text("")
    done = fdilog("analyse", sample_logs / "three_imus_bias.bin", "-o", tmp_path / "out")
    assert (done.returncode, done.stdout) == (2, b"")
    assert "is a file, not a folder" in one_line(done.stderr)


def test_of_a_packed_log_that_ends_early_all_that_is_there_is_read(
    sample_logs: Path, tmp_path: Path
) -> None:
    packed = gzip.compress((sample_logs / "three_imus_bias.bin").read_bytes())
    cut = tmp_path / "cut.bin.gz"
    cut.write_bytes(packed[: len(packed) * 3 // 4])
    done = fdilog("analyse", "--json", cut)
    result = json.loads(done.stdout)
    assert result["verdict"] == "failed"
    assert any("ends early" in one["what"] for one in result["completeness"]["problems"])


def test_an_empty_standard_input_is_called_so() -> None:
    done = fdilog("analyse", "-", stdin=b"")
    assert done.returncode == 2
    assert one_line(done.stderr) == "fdilog: -: the file is empty\n"
