"""The attitude as a witness: it tells which gyro is off, is never accused, and is not trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from fdilog.analysis import Analysis, analyse, analyse_recording
from fdilog.config import Config
from fdilog.experiments.faults import Fault
from fdilog.experiments.flight import Flight
from fdilog.experiments.simulate import simulate
from fdilog.finding import Finding
from fdilog.recording import Recording, Stream
from fdilog.sources.anchors import Anchors
from fdilog.sources.assembly import assemble
from fdilog.sources.attitude import from_euler, interpolated, logged_attitude, matrices, product

Floats = NDArray[np.float64]

DEG = float(np.radians(1.0))
# The other detectors corroborate, and take their time.
CONFIG = replace(Config(), detectors=replace(Config().detectors, use=("parity",)))
START_S, END_S = 30.0, 60.0


@cache
def flown(imus: int, channel: str = "", size_deg_s: float = 3.0) -> Flight:
    faults = (
        [Fault(kind="bias", channel=channel, start_s=START_S, end_s=END_S, size=size_deg_s * DEG)]
        if channel
        else []
    )
    return simulate(90.0, 25.0, sources=imus, faults=faults, seed=3)


def analysed(recording: Recording) -> Analysis:
    return analyse_recording(recording, CONFIG)


def only(analysis: Analysis) -> Finding:
    (finding,) = analysis.findings
    return finding


def with_attitude(recording: Recording, made: Callable[[Stream], Stream]) -> Recording:
    """Return the recording with its attitude put through a function."""
    streams = [made(s) if s.origin == "derived" else s for s in recording.streams]
    return replace(recording, streams=tuple(streams))


def turned_away(
    axis: int, rate_deg_s: Callable[[NDArray[np.float64]], NDArray[np.float64]]
) -> Callable[[Stream], Stream]:
    """Make an attitude that is wrong by a rate about a body axis, as if its gyro had been."""

    def make(stream: Stream) -> Stream:
        time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
        q = from_euler(np.column_stack([stream.columns[a] for a in ("roll", "pitch", "yaw")]))
        # exp(d) R with d' = R b, step by step, is R times the product of the small body turns.
        step = np.gradient(time_s) * rate_deg_s(time_s) * DEG / 2
        followed = [q[0]]
        for k in range(1, len(q)):
            inverse = q[k - 1] * [1, -1, -1, -1]
            turn = product(inverse[None], q[k][None])
            more = np.array([[np.cos(step[k]), 0.0, 0.0, 0.0]])
            more[0, 1 + axis] = np.sin(step[k])
            followed.append(product(product(followed[-1][None], turn), more)[0])
        parts = dict(zip(("qw", "qx", "qy", "qz"), np.array(followed).T, strict=True))
        return replace(stream, columns=parts, units=dict.fromkeys(parts, "1"))

    return make


def in_fault(size: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    return lambda time_s: np.where((time_s >= START_S) & (time_s < END_S), size, 0.0)


@pytest.mark.parametrize("channel", ["imu0.x", "imu1.y"])
def test_the_attitude_tells_which_of_two_imus_is_off(channel: str) -> None:
    finding = only(analysed(flown(2, channel).recording()))
    assert finding.suspects == (channel,)
    assert finding.witness == "att"
    assert finding.size is not None
    assert finding.size.low <= 3.0 * DEG <= finding.size.high
    assert "gravity" in finding.detail
    assert finding.start_s == pytest.approx(START_S, abs=1.0)


def test_without_the_attitude_both_stay_suspects() -> None:
    finding = only(analysed(flown(2, "imu1.y").recording(attitude=False)))
    assert finding.suspects == ("imu0.y", "imu1.y")
    assert finding.witness is None


def test_yaw_that_no_anchor_shows_leaves_both_suspects() -> None:
    # The simulated log holds neither compass nor GPS, and gravity says nothing of the heading.
    finding = only(analysed(flown(2, "imu1.z").recording()))
    assert finding.suspects == ("imu0.z", "imu1.z")
    assert finding.witness is None
    assert "imu1.z unknown" in finding.detail


def with_compass(recording: Recording, reading: Callable[[Floats], Floats]) -> Recording:
    """Add a compass at 10 Hz, its field put through a function."""
    (attitude,) = [s for s in recording.streams if s.origin == "derived"]
    time_ns = np.arange(attitude.time_ns[0], attitude.time_ns[-1], 100_000_000)
    q = logged_attitude(attitude.columns)
    assert q is not None
    r = matrices(interpolated(attitude.time_ns / 1e9, q, time_ns / 1e9))
    field = reading(np.round(np.array([200.0, 20.0, 400.0]) @ r))
    columns = dict(zip(("MagX", "MagY", "MagZ"), field.T, strict=True))
    compass = Stream(name="MAG", time_ns=time_ns, columns=columns, compass=tuple(columns))
    return replace(recording, streams=(*recording.streams, compass))


def test_a_compass_tells_which_gyro_of_the_yaw_is_off() -> None:
    finding = only(analysed(with_compass(flown(2, "imu1.z").recording(), lambda field: field)))
    assert finding.suspects == ("imu1.z",)
    assert "compass" in finding.detail


@pytest.mark.parametrize(("strays", "accused"), [(True, ()), (False, ("imu0.z",))])
def test_a_field_that_strays_in_size_is_not_believed(
    strays: bool, accused: tuple[str, ...]
) -> None:
    def off(time_s: Floats) -> Floats:
        return np.clip((time_s - START_S) / (END_S - START_S), 0.0, 1.0) * np.radians(90.0)

    def followed(stream: Stream) -> Stream:
        heading = off((stream.time_ns - stream.time_ns[0]) / 1e9)
        angles = {name: stream.columns[name] for name in ("roll", "pitch", "yaw")}
        return replace(stream, columns=angles | {"yaw": angles["yaw"] - heading})

    recording = with_compass(flown(1).recording(), lambda field: field)
    (attitude,) = [s for s in recording.streams if s.origin == "derived"]
    (compass,) = [s for s in recording.streams if s.compass]
    time_s = (compass.time_ns - attitude.time_ns[0]) / 1e9
    heading = off(time_s)
    q = logged_attitude(attitude.columns)
    assert q is not None
    r = matrices(interpolated(attitude.time_ns / 1e9, q, compass.time_ns / 1e9))
    size = 1.0 + 0.3 * np.sin(time_s / 5.0) * strays
    world = [200.0 * size * np.cos(heading), 200.0 * size * np.sin(heading), 400.0 * size]
    body = np.einsum("ni,nij->nj", np.column_stack(world), r)
    led = replace(compass, columns=dict(zip(compass.columns, body.T, strict=True)))
    streams = tuple(led if s is compass else s for s in recording.streams)
    recording = with_attitude(replace(recording, streams=streams), followed)
    named = {name for finding in analysed(recording).findings for name in finding.suspects}
    assert named == set(accused)


@pytest.mark.parametrize("first_s", [0.0, 20.0])
def test_a_compass_that_repeats_one_reading_is_no_anchor(first_s: float) -> None:
    def stuck(field: Floats) -> Floats:
        first = int(10 * first_s)
        return np.where(np.arange(len(field))[:, None] < first, field, field[first])

    finding = only(analysed(with_compass(flown(2, "imu1.z").recording(), stuck)))
    assert finding.suspects == ("imu0.z", "imu1.z")
    assert "compass" not in finding.detail


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_filter_that_followed_the_failed_gyro_accuses_nobody_else(axis: int) -> None:
    channel = f"imu1.{'xyz'[axis]}"
    recording = flown(2, channel).recording()
    followed = with_attitude(recording, turned_away(axis, in_fault(3.0)))
    finding = only(analysed(followed))
    assert finding.suspects in ((channel,), (f"imu0.{'xyz'[axis]}", channel))


def test_a_filter_that_followed_and_came_back_accuses_nobody_else() -> None:
    def rate(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        tau_s = 8.0
        on = 3.0 * np.exp(-(time_s - START_S) / tau_s)
        off = -3.0 * (1 - np.exp(-(END_S - START_S) / tau_s)) * np.exp(-(time_s - END_S) / tau_s)
        return np.where(time_s < START_S, 0.0, np.where(time_s < END_S, on, off))

    recording = flown(2, "imu0.x").recording()
    finding = only(analysed(with_attitude(recording, turned_away(0, rate))))
    assert finding.suspects == ("imu0.x",)
    assert finding.witness == "att"


def test_an_attitude_that_drifts_by_itself_accuses_nobody() -> None:
    recording = flown(2).recording()
    drifting = with_attitude(recording, turned_away(1, in_fault(3.0)))
    assert analysed(drifting).findings == ()


def test_one_imu_with_an_attitude_is_a_table_of_six_channels() -> None:
    table = analysed(flown(1).recording()).table
    assert table.names == ("imu0.x", "imu0.y", "imu0.z", "att.x", "att.y", "att.z")
    assert [channel.derived for channel in table.channels] == [False] * 3 + [True] * 3


@pytest.mark.parametrize(
    ("channel", "size_deg_s"), [("imu0.x", 3.0), ("imu0.y", 3.0), ("imu0.x", 50.0)]
)
def test_the_attitude_finds_a_bias_of_a_single_imu(channel: str, size_deg_s: float) -> None:
    analysis = analysed(flown(1, channel, size_deg_s).recording())
    finding = only(analysis)
    assert finding.suspects == (channel,)
    assert finding.witness == "att"
    assert finding.size is not None
    assert finding.size.low <= size_deg_s * DEG <= finding.size.high
    assert analysis.verdict == "failed"


def test_a_single_healthy_imu_is_healthy_about_the_axes_that_gravity_shows() -> None:
    analysis = analysed(flown(1).recording())
    assert analysis.findings == ()
    assert analysis.status[:2] == ("healthy", "healthy")
    # A yaw filter that follows its only gyro would agree with it too.
    assert analysis.status[2] == "undecided"
    assert analysis.verdict == "undecided"


def test_a_single_imu_that_the_filter_followed_is_not_healthy() -> None:
    recording = flown(1, "imu0.x").recording()
    analysis = analysed(with_attitude(recording, turned_away(0, in_fault(3.0))))
    assert analysis.status[0] != "healthy"


def test_a_single_imu_is_not_accused_where_the_attitude_is_the_one_that_drifts() -> None:
    def there_and_back(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.select([time_s < 30.0, time_s < 45.0, time_s < 60.0], [0.0, 3.0, -3.0], 0.0)

    analysis = analysed(with_attitude(flown(1).recording(), turned_away(0, there_and_back)))
    assert analysis.findings == ()
    assert analysis.status[0] == "undecided"


@pytest.mark.parametrize("imus", [1, 2, 3])
def test_derived_channels_are_never_accused(imus: int) -> None:
    analysis = analysed(flown(imus, "imu0.y", 20.0).recording())
    assert not [f for f in analysis.findings if any(s.startswith("att") for s in f.suspects)]
    standing = dict(zip(analysis.table.names, analysis.status, strict=True))
    assert {standing[f"att.{axis}"] for axis in "xyz"} <= {"healthy", "undecided", "insufficient"}
    assert not any(name.startswith("att") for name in analysis.isolability.detectable)


def test_three_imus_decide_among_themselves() -> None:
    recording = flown(3, "imu2.x").recording()
    misled = with_attitude(recording, turned_away(0, in_fault(3.0)))
    for one in (recording, misled):
        finding = only(analysed(one))
        assert finding.suspects == ("imu2.x",)
        assert finding.witness is None


def test_evidence_covers_every_channel_of_the_table() -> None:
    for imus in (1, 2):
        analysis = analysed(flown(imus).recording())
        width = len(analysis.table.channels)
        assert {item.tested.shape[1] for item in analysis.evidence} == {width}


def test_the_attitude_is_listed_as_a_witness() -> None:
    infos = assemble(flown(2).recording(), CONFIG).sources
    (about,) = [info for info in infos if info.name == "att"]
    assert about.used
    assert about.derived
    assert about.reason.startswith("witness")


def test_a_lost_attitude_is_not_used_and_the_source_says_so() -> None:
    tumbling = turned_away(0, lambda time_s: np.full_like(time_s, 20.0))
    analysis = analysed(with_attitude(flown(1).recording(), tumbling))
    (about,) = [info for info in analysis.sources if info.name == "att"]
    assert not about.used
    assert "lost" in about.reason
    assert analysis.verdict == "insufficient"


def test_an_attitude_that_runs_late_is_put_right_and_reported() -> None:
    def late(stream: Stream) -> Stream:
        return replace(stream, time_ns=stream.time_ns + 80_000_000)

    assembly = assemble(with_attitude(flown(1).recording(), late), CONFIG)
    (clock,) = [clock for clock in assembly.clocks if clock.source == "att"]
    assert clock.offset_s == pytest.approx(0.08, abs=0.01)
    rate = assembly.table.rate_rad_s
    known = assembly.table.valid.all(axis=1)
    in_step = assemble(flown(1).recording(), CONFIG).table
    both = known & in_step.valid.all(axis=1)
    apart = (rate[both, 3] - rate[both, 0]).std()
    assert apart < 1.2 * (in_step.rate_rad_s[both, 3] - in_step.rate_rad_s[both, 0]).std()


def test_a_lane_switch_is_no_rate() -> None:
    def jumping(stream: Stream) -> Stream:
        yaw = np.array(stream.columns["yaw"])
        yaw[len(yaw) // 2 :] += np.radians(40.0)
        angles = {"roll": stream.columns["roll"], "pitch": stream.columns["pitch"], "yaw": yaw}
        return replace(stream, columns=angles, units=dict.fromkeys(angles, "rad"))

    analysis = analysed(with_attitude(flown(1).recording(), jumping))
    column = analysis.table.names.index("att.z")
    assert 0 < (~analysis.table.valid[:, column]).sum() < 25
    assert np.nanmax(np.abs(analysis.table.rate_rad_s[:, column])) < 100 * DEG
    assert analysis.findings == ()


def every(n: int) -> Callable[[Stream], Stream]:
    """Make an attitude of which one record in so many is left."""

    def make(stream: Stream) -> Stream:
        columns = {name: column[::n] for name, column in stream.columns.items()}
        return replace(stream, time_ns=stream.time_ns[::n], columns=columns)

    return make


def test_an_attitude_once_a_second_is_a_witness() -> None:
    finding = only(analysed(with_attitude(flown(2, "imu1.x").recording(), every(10))))
    assert finding.suspects == ("imu1.x",)


def whirling(turn_deg_s: float, hz: float) -> Recording:
    """A healthy flight that spins for ten seconds, with an attitude of so many a second."""
    recording = flown(1).recording()
    imu = next(s for s in recording.streams if s.gyro)
    time_s = np.arange(0.0, 180.0, 0.01)
    swings = ((8.0, 0.9, 1.0), (7.0, 0.7, 0.0), (10.0, 0.23, 0.0))
    rate = np.column_stack([a * np.sin(f * time_s + p) for a, f, p in swings]) * DEG
    rate[(time_s > 90.0) & (time_s < 100.0), 2] += turn_deg_s * DEG
    pose = [Rotation.identity()]
    for step in Rotation.from_rotvec(rate[:-1] * 0.01):
        pose.append(pose[-1] * step)
    poses = Rotation.concatenate(pose)
    rng = np.random.default_rng(5)
    gyro = rate + rng.normal(0.0, 0.2 * DEG, rate.shape)
    force = poses.inv().apply([0.0, 0.0, -9.8]) + rng.normal(0.0, 0.3, rate.shape)
    names = (*imu.gyro, *imu.accelerometer)
    columns = dict(zip(names, np.hstack([gyro, force]).T, strict=True))
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    n = round(100.0 / hz)
    roll, pitch, yaw = poses.as_euler("ZYX")[::n, ::-1].T
    attitude = next(s for s in recording.streams if s.origin == "derived")
    angles = {"roll": roll, "pitch": pitch, "yaw": yaw}
    return replace(
        recording,
        streams=(
            replace(imu, time_ns=time_ns, columns=columns, compass=()),
            replace(attitude, time_ns=time_ns[::n], columns=angles),
        ),
    )


@pytest.mark.parametrize("turn_deg_s", [300.0, 700.0])
@pytest.mark.parametrize("hz", [1.0, 2.0])
def test_a_spin_that_no_attitude_can_follow_accuses_no_gyro(turn_deg_s: float, hz: float) -> None:
    analysis = analysed(whirling(turn_deg_s, hz))
    assert not analysis.findings
    assert "failed" not in analysis.status


def test_attitudes_that_are_missing_are_not_valid() -> None:
    def holed(stream: Stream) -> Stream:
        time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
        kept = (time_s < 40.0) | (time_s > 45.0)
        columns = {name: column[kept] for name, column in stream.columns.items()}
        return replace(stream, time_ns=stream.time_ns[kept], columns=columns)

    table = assemble(with_attitude(flown(1).recording(), holed), CONFIG).table
    inside = (table.time_s > 40.2) & (table.time_s < 44.8)
    assert not table.valid[inside, 3:].any()
    assert table.valid[:, :3].all()


def test_a_configuration_that_names_its_sources_may_leave_the_attitude_out() -> None:
    sources = replace(CONFIG.sources, use=("imu0", "imu1"))
    assembly = assemble(flown(2).recording(), replace(CONFIG, sources=sources))
    assert assembly.witness is None
    assert len(assembly.table.channels) == 6
    named = replace(CONFIG, sources=replace(CONFIG.sources, use=("imu0", "att")))
    assert len(assemble(flown(2).recording(), named).table.channels) == 6


def test_the_sample_log_names_the_failed_gyro_alone(sample_logs: Path) -> None:
    analysis = analyse(sample_logs / "two_imus_attitude.bin")
    assert analysis.verdict == "failed"
    assert only(analysis).suspects == ("imu1.y",)


def test_a_heading_of_wheels_is_no_attitude() -> None:
    def planar(stream: Stream) -> Stream:
        level = np.zeros(len(stream.time_ns))
        angles = {"roll": level, "pitch": level, "yaw": stream.columns["yaw"]}
        return replace(stream, columns=angles, units=dict.fromkeys(angles, "rad"))

    assembly = assemble(with_attitude(flown(1).recording(), planar), CONFIG)
    assert assembly.witness is None
    assert len(assembly.table.channels) == 3


def test_the_attitude_of_another_body_is_not_used() -> None:
    def swapped(stream: Stream) -> Stream:
        q = np.column_stack([stream.columns[f"q{part}"] for part in "wxyz"])
        # Mounted a quarter of a turn about z away from the gyros.
        other = product(q, np.tile([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)], (len(q), 1)))
        return replace(stream, columns=dict(zip(("qw", "qx", "qy", "qz"), other.T, strict=True)))

    # In a robot's log it is that of another body; an autopilot has one body, and a wrong mounting.
    robot = replace(with_attitude(flown(1).recording(), swapped), format="rosbag1")
    for recording, used in ((robot, False), (replace(robot, format="dataflash"), True)):
        infos = assemble(recording, CONFIG).sources
        (about,) = [info for info in infos if info.name == "att"]
        assert about.used == used
        assert used or "contradicts" in about.reason


@pytest.mark.parametrize("size_deg_s", [20.0, 50.0, -300.0])
def test_a_gyro_that_is_off_by_more_than_it_turns_does_not_make_the_attitude_another_bodys(
    size_deg_s: float,
) -> None:
    finding = only(analysed(flown(1, "imu0.x", size_deg_s).recording()))
    assert (finding.kind, finding.suspects, finding.witness) == ("bias", ("imu0.x",), "att")
    assert finding.start_s == pytest.approx(START_S, abs=0.2)
    assert finding.end_s == pytest.approx(END_S, abs=0.2)


def test_a_fault_of_seconds_is_held_against_gravity_before_and_after() -> None:
    fault = Fault(kind="bias", channel="imu0.y", start_s=30.0, end_s=33.0, size=10.0 * DEG)
    finding = only(analysed(simulate(90.0, 25.0, sources=1, faults=[fault], seed=3).recording()))
    assert (finding.suspects, finding.witness) == (("imu0.y",), "att")
    assert (finding.start_s, finding.end_s) == pytest.approx((30.0, 33.0), abs=0.2)


@pytest.mark.parametrize("seed", range(3, 9))
def test_an_attitude_that_stands_still_from_some_moment_on_accuses_nobody(seed: int) -> None:
    def frozen(stream: Stream) -> Stream:
        rows = np.minimum(np.arange(len(stream.time_ns)), len(stream.time_ns) // 2)
        columns = {name: column[rows] for name, column in stream.columns.items()}
        return replace(stream, columns=columns)

    flight = simulate(90.0, 25.0, sources=1, seed=seed)
    assert analysed(with_attitude(flight.recording(), frozen)).findings == ()


@pytest.mark.parametrize("azimuth_deg", [20.0, 110.0, 200.0, 290.0])
def test_an_attitude_that_starts_anew_and_converges_accuses_nobody(azimuth_deg: float) -> None:
    azimuth = np.radians(azimuth_deg)
    wrong = np.radians(120.0) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])

    def anew(stream: Stream) -> Stream:
        q = logged_attitude(stream.columns)
        assert q is not None
        since_s = (stream.time_ns - stream.time_ns[0]) / 1e9 - 40.0
        off = np.where(since_s < 0.0, 0.0, np.exp(-np.abs(since_s) / 12.0))[:, None] * wrong
        half = np.linalg.norm(off, axis=1, keepdims=True) / 2.0
        turn = np.hstack([np.cos(half), off / 2.0 * np.sinc(half / np.pi)])
        parts = dict(zip(("qw", "qx", "qy", "qz"), product(turn, q).T, strict=True))
        return replace(stream, columns=parts, units=dict.fromkeys(parts, "1"))

    recording = simulate(90.0, 25.0, sources=1, seed=1).recording()
    assert analysed(with_attitude(recording, anew)).findings == ()


def test_what_gravity_does_not_show_leaves_the_axis_in_question_known() -> None:
    # At rest, nose up by 30 degrees: half a turn about x is a turn of the heading.
    r = matrices(from_euler(np.array([[0.0, np.radians(30.0), 0.0]])))[0]
    time_s = np.arange(0.25, 60.0, 0.5)
    down = np.tile([0.0, 0.0, -1.0], (len(time_s), 1))
    anchors = Anchors(
        time_s=time_s,
        segment=np.zeros(len(time_s), np.int64),
        turned=time_s[:, None, None] * r,
        force=down + np.random.default_rng(1).normal(0.0, 0.01, down.shape),
        expected=down,
        compass=np.full_like(down, np.nan),
        by_gps=False,
        unseen=np.zeros(len(time_s)),
        healthy_rad_s=DEG / 3.0,
    )
    x = np.array([1.0, 0.0, 0.0])
    of_any = anchors.drift(15.0, 45.0, 0.99)
    of_x = anchors.drift(15.0, 45.0, 0.99, axis=(x, DEG / 3.0))
    assert of_any is not None
    assert of_x is not None
    assert of_any.half_width(x) > 5.0 * DEG
    assert of_x.half_width(x) < 1.0 * DEG
    assert abs(float(x @ of_x.error_rad_s)) < of_x.half_width(x)


def test_acceleration_that_the_attitude_does_not_show_leaves_the_tilt_open() -> None:
    time_s = np.arange(0.25, 60.0, 0.5)
    down = np.tile([0.0, 0.0, -1.0], (len(time_s), 1))
    half_width = []
    for unseen in (0.0, 0.3):
        anchors = Anchors(
            time_s=time_s,
            segment=np.zeros(len(time_s), np.int64),
            turned=time_s[:, None, None] * np.eye(3),
            force=down + np.random.default_rng(1).normal(0.0, 0.01, down.shape),
            expected=down,
            compass=np.full_like(down, np.nan),
            by_gps=False,
            unseen=np.full(len(time_s), unseen),
            healthy_rad_s=DEG / 3.0,
        )
        drift = anchors.drift(15.0, 45.0, 0.99)
        assert drift is not None
        half_width.append(drift.half_width(np.array([1.0, 0.0, 0.0])))
    # A constant 0.3 g leans the vertical by 17 degrees.
    assert half_width[0] < 0.1 * DEG
    assert half_width[1] > 17.0 * DEG / 30.0


@pytest.mark.parametrize("readings", [0, 600])
def test_a_compass_without_readings_is_none(readings: int) -> None:
    recording = flown(2, "imu1.y").recording()
    names = ("mx", "my", "mz")
    silent = Stream(
        name="MAG",
        time_ns=recording.streams[0].time_ns[:readings],
        columns={name: np.full(readings, np.nan) for name in names},
        compass=names,
    )
    streams = [
        replace(stream, compass=()) if stream.compass else stream for stream in recording.streams
    ]
    finding = only(analysed(replace(recording, streams=(*streams, silent))))
    assert "imu1.y" in finding.suspects


def test_an_attitude_in_short_pieces_tells_nothing_and_breaks_nothing() -> None:
    def pausing(stream: Stream) -> Stream:
        time_s = (stream.time_ns - stream.time_ns[0]) / 1e9
        kept = time_s % 3.0 > 0.5
        columns = {name: np.asarray(column)[kept] for name, column in stream.columns.items()}
        return replace(stream, time_ns=stream.time_ns[kept], columns=columns)

    finding = only(analysed(with_attitude(flown(2, "imu1.y").recording(), pausing)))
    assert set(finding.suspects) == {"imu0.y", "imu1.y"}
