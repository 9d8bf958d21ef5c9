"""Writing what a log says of its gyros to a file that other tools, and fdilog itself, can read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fdilog.config import Config
from fdilog.errors import FdilogError, UsageError
from fdilog.recording import Recording
from fdilog.registry import plugins
from fdilog.sources.assembly import channel_table
from fdilog.table import ChannelTable
from fdilog.writing import write

SUFFIXES = (".csv", ".npz", ".parquet")


def export(recording: Recording, path: Path, config: Config) -> None:
    """Write the channel table, or the recording as a log of the format that the suffix names.

    The table is what an analysis with this configuration would compare; another format gets the
    gyros, accelerometers and attitude that a log of it would have held.

    Raises
    ------
    UsageError
        If the suffix names no format, the format cannot hold these gyros, or the path is the log.
    FdilogError
        If the file cannot be written, or there is no gyro.
    """
    suffix = path.suffix.lower()
    formats = sorted({*SUFFIXES, *(writer.suffix for writer in plugins("writers").values())})
    if suffix not in formats:
        raise UsageError(f"{path}: cannot write '{suffix}'; known: {', '.join(formats)}")
    if path.exists() and Path(recording.path).exists() and path.samefile(recording.path):
        raise UsageError(f"{path}: is the log itself; name another file")
    if suffix in SUFFIXES:
        write_table(channel_table(recording, config), path)
    else:
        write(recording, path)


def write_table(table: ChannelTable, path: Path) -> None:
    """Write a table in the format that the suffix names.

    A .csv or .parquet holds ``time_s`` and one column per channel in rad/s, empty where there is
    no valid reading; a .npz the table's arrays, with names and axes. Derived channels are left out:
    read back, they would be taken for gyros.

    Raises
    ------
    UsageError
        If the suffix is not one of `SUFFIXES`, or what it needs is not installed.
    FdilogError
        If the file cannot be written.
    """
    table = table.gyros
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise UsageError(f"{path}: cannot write '{suffix}'; known: {', '.join(SUFFIXES)}")
    try:
        if suffix == ".npz":
            np.savez_compressed(
                path,
                time_s=table.time_s,
                rate_rad_s=table.rate_rad_s,
                valid=table.valid,
                axes=table.axes,
                names=np.array(table.names),
            )
        elif suffix == ".csv":
            table.to_pandas().to_csv(path, lineterminator="\n")
        else:
            table.to_pandas().reset_index().to_parquet(path, index=False)
    except ImportError as error:
        raise UsageError(f"{path}: needs pyarrow: pip install 'fdilog[parquet]'") from error
    except OSError as error:
        raise FdilogError(
            f"{path}: cannot write: {(error.strerror or str(error)).lower()}"
        ) from error
