"""A log of one format becomes a log of another, with the same gyros in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fdilog.config import Config
from fdilog.errors import UsageError
from fdilog.experiments.simulate import simulate
from fdilog.export import export
from fdilog.recording import Recording
from fdilog.registry import plugins, read
from fdilog.sources.gyros import choose
from fdilog.writing import write

NAMES = [
    *("f.bin", "f.tlog", "f.ulg", "f.bag", "f.db3", "f.csv", "f.parquet"),
    *("f.mcap", "f.json.mcap", "f.protobuf.mcap"),
]
MRAD_S = 1e-3


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("log") / "flight.bin"
    write(simulate(12.0, 25.0, sources=2, seed=5).recording(), path)
    return read(path)


@pytest.mark.parametrize("name", NAMES)
def test_every_format_holds_the_gyros_of_the_log(log: Recording, tmp_path: Path, name: str) -> None:
    export(log, tmp_path / name, Config())
    found, before = (choose(r, Config())[0] for r in (read(tmp_path / name), log))
    assert [gyro.channel_names for gyro in found] == [gyro.channel_names for gyro in before]
    coarse = name.endswith(".tlog")
    for gyro, logged in zip(found, before, strict=True):
        apart = np.abs(gyro.rate_rad_s - logged.rate_rad_s).max()
        assert apart <= (0.5001 * MRAD_S if coarse else 0.0)
        assert np.ptp(gyro.time_ns - logged.time_ns) <= (1_000_000 if coarse else 0)


def test_every_writer_can_be_asked_for() -> None:
    suffixes = {writer.suffix for writer in plugins("writers").values()}
    assert suffixes <= {Path(name).suffix for name in NAMES}


def test_an_unknown_suffix_is_one_line_with_the_known_ones(log: Recording, tmp_path: Path) -> None:
    known = r"\.bag, \.bin, \.csv, \.db3, \.mcap, \.npz, \.parquet, \.tlog, \.ulg"
    with pytest.raises(UsageError, match=rf"cannot write '\.xls'; known: {known}$"):
        export(log, tmp_path / "a.xls", Config())


def test_the_log_itself_is_not_overwritten(log: Recording) -> None:
    path = Path(log.path)
    before = path.read_bytes()
    with pytest.raises(UsageError, match="is the log itself"):
        export(log, path, Config())
    assert path.read_bytes() == before


def test_messages_in_json_are_json(log: Recording, tmp_path: Path) -> None:
    from mcap.reader import make_reader

    for name, encoding in (("f.json.mcap", "json"), ("f.protobuf.mcap", "protobuf")):
        export(log, tmp_path / name, Config())
        with (tmp_path / name).open("rb") as file:
            encodings = {
                channel.message_encoding for _, channel, _ in make_reader(file).iter_messages()
            }
        assert encodings == {encoding}
