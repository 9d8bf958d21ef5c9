"""What counts as a log, and which vehicle it is of."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import pytest

from fdilog.campaign.discovery import discover
from fdilog.campaign.identity import sensor_ids, vehicle_of
from fdilog.errors import UsageError
from tests.campaign_logs import flight


def names(folder: Path, *targets: str, output: Path | None = None) -> list[str]:
    found = discover([str(folder / target) for target in targets] or [str(folder)], output)
    return [Path(candidate.path).relative_to(folder).as_posix() for candidate in found]


def test_bytes_or_suffix_make_a_log_and_each_is_found_once(tmp_path: Path) -> None:
    log = flight(tmp_path / "a" / "known.bin", 1)
    shutil.copy(log, tmp_path / "nameless")
    (tmp_path / "notes.txt").write_text("no log")
    (tmp_path / ".known.bin.XyZ").write_bytes(log.read_bytes())  # rsync has not finished it
    (tmp_path / "packed.bin.gz").write_bytes(gzip.compress(log.read_bytes()))
    (tmp_path / "packed.gz").write_bytes(gzip.compress(log.read_bytes()))
    (tmp_path / "other.gz").write_bytes(gzip.compress(b"no log"))
    expected = ["a/known.bin", "nameless", "packed.bin.gz", "packed.gz"]
    assert names(tmp_path) == expected
    assert names(tmp_path, "", "a", "a/known.bin") == expected


def test_a_folder_that_takes_the_results_as_well_is_searched_but_for_these(tmp_path: Path) -> None:
    flight(tmp_path / "known.bin", 1)
    (tmp_path / "audit.sqlite").write_bytes(b"SQLite format 3\0" + bytes(100))
    (tmp_path / "bag.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    assert names(tmp_path, output=tmp_path) == ["bag.db3", "known.bin"]


def test_a_pattern_and_a_file_that_is_named_are_taken_as_they_are(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("named, so it is a log")
    (tmp_path / "b.bin").touch()
    assert names(tmp_path, "*.xyz") == ["a.xyz"]
    assert names(tmp_path, "*.nothing") == []
    with pytest.raises(UsageError, match="no such file"):
        discover([str(tmp_path / "absent.bin")])


def test_links_in_a_circle_are_followed_once(tmp_path: Path) -> None:
    flight(tmp_path / "a" / "f.bin", 1)
    (tmp_path / "a" / "up").symlink_to(tmp_path)
    (tmp_path / "b").symlink_to(tmp_path / "a")
    assert len(names(tmp_path)) == 1


DESCRIBED = "rosbag2_bagfile_information:\n  relative_file_paths: [{}]\n"


def files(folder: Path, *names: str) -> None:
    """Make files that are known by their names; those of bags begin as theirs do."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"SQLite format 3\0" if name.endswith(".db3") else b"")


def test_a_bag_with_its_description_is_one_log_and_a_folder_of_files_is_not(
    tmp_path: Path,
) -> None:
    for folder in ("bag", "files"):
        files(tmp_path / folder, "part_0.db3", "part_1.db3")
    (tmp_path / "bag" / "metadata.yaml").write_text(DESCRIBED.format("part_0.db3, part_1.db3"))
    for link in ("a link", "link to the bag"):
        (tmp_path / link).symlink_to(tmp_path / "bag")
    assert names(tmp_path) == ["bag", "files/part_0.db3", "files/part_1.db3"]
    assert names(tmp_path, "bag") == ["bag"]


@pytest.mark.parametrize("logs", [("a.mcap", "b.mcap"), ("flight_1.mcap", "flight_2.mcap")])
def test_mcap_files_side_by_side_are_logs_of_their_own(
    tmp_path: Path, logs: tuple[str, ...]
) -> None:
    files(tmp_path / "flights", *logs)
    assert names(tmp_path) == [f"flights/{name}" for name in logs]


def test_a_description_of_something_else_makes_no_bag_of_a_campaign(tmp_path: Path) -> None:
    """Data sets have a metadata.yaml, too; their logs must not vanish behind it."""
    (tmp_path / "metadata.yaml").write_text("title: two years of flights\nlicense: none\n")
    files(tmp_path, "b.bin", "c.tlog")
    files(tmp_path / "a", "x.mcap", "y.mcap")
    assert names(tmp_path) == ["a/x.mcap", "a/y.mcap", "b.bin", "c.tlog"]


def test_what_lies_in_a_bag_and_is_no_part_of_it_is_a_log_of_its_own(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    files(bag, "bag_0.db3", "bag_1.db3", "other.mcap", "autopilot.bin", "notes.txt")
    files(bag / "more", "later.ulg")
    (bag / "metadata.yaml").write_text(DESCRIBED.format("bag_0.db3, bag_1.db3"))
    others = ["bag/autopilot.bin", "bag/more/later.ulg", "bag/other.mcap"]
    assert names(tmp_path) == ["bag", *others]
    (bag / "other.mcap").unlink()
    assert names(tmp_path) == ["bag", *others[:2]]


@pytest.mark.parametrize("suffix", [".tmp", ".part", ".crdownload", ".TMP"])
def test_what_is_still_being_copied_is_no_log_yet(tmp_path: Path, suffix: str) -> None:
    log = flight(tmp_path / "f.bin", 1)
    log.rename(tmp_path / f"f.bin{suffix}")
    assert names(tmp_path) == []
    assert names(tmp_path, f"f.bin{suffix}") == [f"f.bin{suffix}"]  # but if it is named, it is one


@pytest.mark.parametrize(
    ("facts", "path", "root", "expected"),
    [
        ({"board": "Cube 1 2 3", "system": "7.1"}, "r/x.bin", "r", ("Cube 1 2 3", "board serial")),
        ({"uid": "00ff"}, "r/x.tlog", "r", ("00ff", "unique id")),
        ({"system": "7.1"}, "r/a/x.tlog", "r", ("system 7.1", "system id")),
        (
            {"system": "1.1"},
            "r/a/x.tlog",
            "r",
            ("a", "folder"),
        ),  # what every autopilot has at first
        ({}, "r/a/2024-05-01/x.bin", "r", ("a", "folder")),
        ({}, "fleet/r/x.bin", "fleet/r", ("r", "folder")),
        ({}, "s3://bucket/r/a/x.bin", "s3://bucket/r", ("a", "folder")),
    ],
)
def test_the_vehicle_is_named_by_the_log_or_by_its_folder(
    facts: dict[str, str], path: str, root: str, expected: tuple[str, str]
) -> None:
    assert vehicle_of(facts, path, root) == expected


def test_gyros_have_the_ids_that_parameters_give_them() -> None:
    facts = {"INS_GYR_ID": "2621706", "INS_GYR2_ID": "3080714", "INS_GYR3_ID": "0", "INS_USE": "1"}
    assert sensor_ids(facts) == {"imu0": "2621706", "imu1": "3080714"}
