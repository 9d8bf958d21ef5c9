"""What the autopilot said of its gyros is quoted with its time, and nothing follows from it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fdilog.decision.autopilot import AutopilotNote, autopilot_notes, with_quotes
from fdilog.finding import Finding
from fdilog.recording import Recording, Stream

SPAN = (0.0, 100.0)
TIME_NS = np.arange(0, 101, dtype=np.int64) * 1_000_000_000


def stream(name: str, *, sensor: Any = None, **columns: Any) -> Stream:
    filled = {key: np.asarray(values) for key, values in columns.items()}
    return Stream(
        name=name,
        time_ns=TIME_NS[: len(next(iter(filled.values())))],
        columns=filled,
        sensor=sensor,
    )


def recording(*streams: Stream) -> Recording:
    return Recording(path="", format="test", bytes=0, streams=streams)


def notes(*streams: Stream, gyros: tuple[str, ...] = ("imu0", "imu1")) -> list[AutopilotNote]:
    return list(autopilot_notes(recording(*streams), 0, SPAN, gyros))


def brief(*streams: Stream) -> list[tuple[str | None, str, float, float]]:
    return [(note.gyro, note.what, note.start_s, note.end_s) for note in notes(*streams)]


def down(start: int, stop: int) -> np.ndarray[Any, Any]:
    flag = np.ones(101, np.uint8)
    flag[start:stop] = 0
    return flag


def test_a_health_flag_that_went_down_is_quoted_with_its_span() -> None:
    assert brief(stream("IMU[1]", sensor=1, GH=down(20, 31))) == [
        ("imu1", "flagged unhealthy", 20.0, 30.0)
    ]


def test_a_healthy_flag_is_no_note() -> None:
    assert brief(stream("IMU", sensor=0, GH=down(0, 0), EG=np.zeros(101, np.uint32))) == []


@pytest.mark.parametrize("field", ["EG", "ErrG", "error_count"])
def test_a_counter_of_errors_that_rises_is_quoted(field: str) -> None:
    count = np.zeros(101, np.uint32)
    count[40:] = 3
    count[41:] = 7
    assert brief(stream("IMU", sensor=0, **{field: count})) == [
        ("imu0", f"{field} rose from 0 to 7", 40.0, 41.0)
    ]


def test_of_a_device_that_is_not_used_nothing_is_quoted() -> None:
    assert notes(stream("IMU3", sensor=2, GH=down(0, 101))) == []


def test_a_change_of_the_leading_lane_is_quoted_once_however_many_lanes_report_it() -> None:
    lead = np.repeat([0] * 30 + [1] * 20, 2)
    lanes = np.tile([0, 1], 50)
    fault = np.where((lanes == 0) & (np.arange(100) >= 60), 4, 0)
    assert brief(stream("XKF4", C=lanes, PI=lead, FS=fault)) == [
        (None, "EKF3 primary changed from lane 0 to 1", 60.0, 60.0),
        (None, "EKF3 lane 0 reports faults", 60.0, 98.0),
    ]


def test_logged_errors_of_the_filter_are_quoted_and_others_are_not() -> None:
    assert brief(stream("ERR", Subsys=[16, 3, 24], ECode=[2, 1, 1])) == [
        (None, "EKF check: the variances are too large", 0.0, 0.0),
        (None, "EKF primary changed to lane 1", 2.0, 2.0),
    ]


def test_a_bit_of_the_system_status_is_quoted_where_the_sensor_is_enabled() -> None:
    both = 0x1 | 0x20000
    health = np.full(101, both, np.uint32)
    health[10:13] = 0x1
    on = np.full(101, both, np.uint32)
    fields = {f"onboard_control_sensors_{name}": on for name in ("present", "enabled")}
    status = stream("SYS_STATUS", onboard_control_sensors_health=health, **fields)
    assert brief(status) == [("imu1", "second gyro flagged unhealthy", 10.0, 12.0)]


def test_px4_votes_by_number_of_device_and_changes_its_choice() -> None:
    gyros = [
        stream("sensor_gyro[0]", sensor=0, device_id=np.full(3, 77)),
        stream("sensor_gyro[1]", sensor=1, device_id=np.full(3, 88)),
    ]
    vote = stream(
        "sensors_status_imu",
        **{"gyro_device_ids[0]": np.full(5, 88), "gyro_healthy[0]": np.array([1, 0, 0, 1, 1])},
    )
    choice = stream("sensor_selection", gyro_device_id=[77, 88])
    assert brief(*gyros, vote, choice) == [
        (None, "selected gyro changed from imu0 to imu1", 1.0, 1.0),
        ("imu1", "flagged unhealthy", 1.0, 2.0),
    ]


def test_messages_that_complain_of_gyros_are_quoted_word_for_word() -> None:
    texts = [
        "EKF3 IMU1 initialised",
        "Gyros inconsistent",
        "Arming motors",
        "EKF primary changed:1",
    ]
    quoted = [what for _, what, _, _ in brief(stream("MSG", Message=texts))]
    assert quoted == ["Gyros inconsistent", "EKF primary changed:1"]


@pytest.mark.parametrize(
    "broken",
    [
        stream("ERR", Other=[1]),
        stream("XKF4", Other=[1]),
        stream("SYS_STATUS", Other=[1]),
        stream("EKF_STATUS_REPORT", Other=[1]),
        stream("sensors_status_imu", **{"gyro_healthy[0]": [0]}),
        stream("ERR", Subsys=["?"], ECode=["?"]),
        stream("IMU", sensor=0, GH=[1.0], EG=[np.nan]),
    ],
)
def test_a_stream_without_its_usual_fields_says_nothing(broken: Stream) -> None:
    assert notes(broken) == []


def test_a_finding_quotes_what_was_said_of_its_device_meanwhile() -> None:
    log = recording(
        stream("IMU[0]", sensor=0, GH=down(0, 0)), stream("IMU[1]", sensor=1, GH=down(20, 31))
    )
    said = autopilot_notes(log, 0, SPAN, ("imu0", "imu1"))

    def quoted(device: str, start_s: float) -> str:
        finding = Finding(
            kind="bias", suspects=(f"{device}.x",), start_s=start_s, end_s=start_s + 5, detail="off"
        )
        return with_quotes([finding], said, log)[0].detail

    assert "IMU[1]: flagged unhealthy" in quoted("imu1", 25.0)
    assert quoted("imu1", 60.0) == "off"
    assert "IMU[0].GH called it healthy all along" in quoted("imu0", 25.0)


def test_a_flag_that_went_down_after_many_other_words_is_not_denied() -> None:
    # An error every fourth record.
    count = np.repeat(np.arange(26, dtype=np.uint32), 4)[:101]
    many = [stream(f"vehicle_imu_status[{k}]", error_count=count) for k in range(5)]
    log = recording(*many, stream("IMU[0]", sensor=0, GH=down(90, 95)))
    said = autopilot_notes(log, 0, SPAN, tuple(f"imu{k}" for k in range(5)))
    assert len(said) > 100
    finding = Finding(kind="bias", suspects=("imu0.x",), start_s=90.0, end_s=95.0)
    detail = with_quotes([finding], said, log)[0].detail
    assert "IMU[0]: flagged unhealthy" in detail
    assert "healthy all along" not in detail
