"""A log without a gyro says what is in it, and why that is none."""

from __future__ import annotations

import numpy as np
import pytest

from fdilog.errors import NoGyroError
from fdilog.recording import Problem, Recording, Stream
from fdilog.sources.assembly import channel_table


def told(*problems: Problem) -> str:
    streams = [
        Stream(name=name, time_ns=np.empty(0, np.int64), count=9) for name in ("/gps", "/imu")
    ]
    made = Recording(
        path="a.mcap", format="mcap", bytes=1, streams=tuple(streams), problems=problems
    )
    with pytest.raises(NoGyroError) as caught:
        channel_table(made)
    return str(caught.value)


def test_the_streams_there_are_stand_in_the_reason() -> None:
    assert told() == "a.mcap: no gyro channels; streams: /gps, /imu"


def test_a_stream_that_could_not_be_decoded_is_explained_and_other_notes_are_not() -> None:
    undecoded = "/imu (my_msgs/Imu) is not decoded: my_msgs/Imu is not defined in the log"
    reason = told(
        Problem(what="this format has no checksums", note=True),
        Problem(what=undecoded, note=True),
        Problem(what="the file ends inside a record", bytes_lost=5),
    )
    assert reason.endswith(f"streams: /gps, /imu; {undecoded}; the file ends inside a record")
    assert "checksums" not in reason
