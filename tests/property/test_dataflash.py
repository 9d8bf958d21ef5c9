"""However a DataFlash log is damaged: what was not touched is read, every other byte is told."""

from __future__ import annotations

from itertools import accumulate
from pathlib import Path

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from fdilog.errors import UnreadableLogError
from fdilog.recording import Recording
from fdilog_readers import dataflash
from fdilog_readers.dataflash_layout import parse_fmt
from tests.dataflash_bytes import (
    HEAD,
    LENGTHS,
    accounted,
    bat,
    flight,
    fmt,
    imu,
    official,
    record,
    rows,
    sample,
    samples,
)

RECORDS = flight(60)
STARTS = [len(HEAD), *(len(HEAD) + end for end in accumulate(map(len, RECORDS)))]
WHOLE = HEAD + b"".join(RECORDS)
IMU_AT = {
    start: sample(k)
    for k, start in enumerate(
        (s for s, r in zip(STARTS, RECORDS, strict=False) if r[2] == 131), start=1
    )
}
# Bytes that cannot be taken for a header or for padding.
NOISE = st.binary(min_size=1, max_size=200).map(
    lambda raw: bytes(b if b not in (0xA3, 0x95, 0x00, 0xFF) else 0x11 for b in raw)
)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("dataflash") / "log.bin"


def read(path: Path, data: bytes) -> Recording:
    path.write_bytes(data)
    return dataflash.read(path)


def read_or_refuse(path: Path, data: bytes) -> Recording | None:
    path.write_bytes(data)
    try:
        return dataflash.read(path)
    except UnreadableLogError as error:
        line = str(error)
    assert line.startswith(f"{path}: no FMT record")
    assert len(line.splitlines()) == 1
    return None


def bits(recording: Recording) -> list[tuple[str, bytes]]:
    """Every value read, to the last bit of a not-a-number."""
    return [(f, c.tobytes()) for stream in recording.streams for f, c in stream.columns.items()]


def losses(recording: Recording) -> list[tuple[int | None, int | None]]:
    return [(p.offset, p.bytes_lost) for p in recording.problems if not p.note]


@given(st.integers(len(HEAD), len(WHOLE)))
def test_a_log_cut_anywhere_gives_every_whole_record_and_is_still_whole(
    path: Path, cut: int
) -> None:
    recording = read(path, WHOLE[:cut])
    whole = {s for start, s in IMU_AT.items() if start + LENGTHS["IMU"] <= cut}
    assert samples(recording) == whole == official(path)
    assert losses(recording) == []
    assert accounted(recording, LENGTHS) == cut


@given(st.integers(0, len(HEAD) - 1))
def test_a_log_cut_within_its_formats_is_read_or_refused_in_one_line(path: Path, cut: int) -> None:
    recording = read_or_refuse(path, WHOLE[:cut])
    assert (recording is None) == (cut < 89)
    if recording is not None:
        assert accounted(recording, LENGTHS) == cut
        assert losses(recording) == []


@given(st.integers(len(HEAD), len(WHOLE) - 1), st.integers(1, 255))
def test_a_spoiled_byte_costs_no_record_but_its_own(path: Path, at: int, flip: int) -> None:
    data = bytearray(WHOLE)
    data[at] ^= flip
    recording = read(path, bytes(data))
    own = max(start for start in STARTS if start <= at)
    others = {s for start, s in IMU_AT.items() if start != own}
    got = samples(recording)
    assert others <= got
    assert official(path) & set(IMU_AT.values()) <= got
    assert accounted(recording, LENGTHS) == len(data)
    if at - own < 2:  # its header is gone
        assert losses(recording) in (
            [(own, STARTS[STARTS.index(own) + 1] - own)],
            [],  # the last record: nothing tells it from padding or a cut
        )
        assert got == others


@given(st.sampled_from(STARTS), NOISE)
def test_bytes_pushed_in_between_records_cost_at_most_the_record_before_them(
    path: Path, at: int, noise: bytes
) -> None:
    recording = read(path, WHOLE[:at] + noise + WHOLE[at:])
    # Whether the record before the noise reached its end cannot be known: it is not believed.
    before = max((start for start in STARTS if start < at), default=None)
    certain = {s for start, s in IMU_AT.items() if start != before}
    assert certain <= samples(recording) <= set(IMU_AT.values())
    assert official(path) & certain <= samples(recording)
    assert sum(lost or 0 for _, lost in losses(recording)) - len(noise) in (0, *LENGTHS.values())
    assert accounted(recording, LENGTHS) == len(WHOLE) + len(noise)


@given(
    st.integers(len(HEAD), len(WHOLE) - 60),
    st.integers(60, 400),
    st.sampled_from([0x00, 0xFF, 0x11]),
)
def test_a_hole_gives_no_false_sample_and_costs_only_what_it_touched(
    path: Path, start: int, length: int, value: int
) -> None:
    data = bytearray(WHOLE)
    end = min(start + length, len(data))
    data[start:end] = bytes([value]) * (end - start)
    # What the hole only happens to leave as it was is not touched.
    same = [k for k in range(start, end) if WHOLE[k] == value]
    assume(start not in same)
    recording = read(path, bytes(data))
    untouched = {s for at, s in IMU_AT.items() if at + LENGTHS["IMU"] <= start or at >= end}
    ends_there = {s for at, s in IMU_AT.items() if at + LENGTHS["IMU"] == start}
    assert untouched - ends_there <= samples(recording) <= untouched
    assert accounted(recording, LENGTHS) == len(data)


@given(st.binary(max_size=600))
def test_bytes_of_any_kind_are_read_or_refused_in_one_line(path: Path, data: bytes) -> None:
    recording = read_or_refuse(path, data)
    assert recording is None or recording.bytes == len(data)
    assert not dataflash.sniff(data) or b"\xa3\x95\x80" in data


@given(st.lists(st.sampled_from([imu(1), bat(2), b"\xa3\x95", b"\xa3\x95\x80", b"\0", b"\xa3"])))
def test_every_byte_behind_the_formats_is_in_a_record_or_in_a_problem(
    path: Path, pieces: list[bytes]
) -> None:
    data = HEAD + b"".join(pieces)
    recording = read(path, data)
    bad = sum(89 for problem in recording.problems if "FMT record is bad" in problem.what)
    assert accounted(recording, LENGTHS) - bad == len(data)


@given(st.data())
def test_the_size_of_the_blocks_changes_nothing(path: Path, data: st.DataObject) -> None:
    raw = bytearray(WHOLE)
    for at in data.draw(st.lists(st.integers(len(HEAD), len(WHOLE) - 1), max_size=6)):
        raw[at] = data.draw(st.sampled_from([0x00, 0xFF, 0xA3, 0x95, 0x83]))
    whole = read(path, bytes(raw))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataflash, "BLOCK_BYTES", data.draw(st.integers(700, 2000)))
        parts = dataflash.read(path)
    assert parts.problems == whole.problems
    assert [s.count for s in parts.streams] == [s.count for s in whole.streams]
    assert bits(parts) == bits(whole)


@given(
    st.text(max_size=4).map(lambda t: t.encode("utf-8", "surrogateescape")[:4]),
    st.binary(max_size=64),
    st.sampled_from(["QB", "QZ", "Qn", "Qa", "QgfcCeELMqQdhHiIbB"]),
)
def test_names_may_be_anything(path: Path, name: bytes, fields: bytes, form: str) -> None:
    values = [b"\xffx" if c in "aZn" else 1 for c in form]
    data = HEAD + fmt(140, name, form, fields) + record(140, form, *values) + imu(1)
    recording = read(path, data)
    everything = dataflash.read(path, also={stream.name for stream in recording.streams})
    assert all(stream.name.isprintable() and stream.name for stream in recording.streams)
    assert all(f.isprintable() for stream in everything.streams for f in stream.columns)
    assert samples(recording) | samples(everything) >= {sample(1)}


@given(st.lists(st.sampled_from(["Qffffff", "Qfff", "QdddB"]), min_size=1, max_size=5))
def test_a_type_may_be_defined_anew_at_any_time(path: Path, forms: list[str]) -> None:
    data = HEAD
    for number, form in enumerate(forms):
        names = ["TimeUS", "GyrX", "GyrY", "GyrZ", "A", "B", "C"][: len(form)]
        data += fmt(131, "IMU", form, ",".join(names))
        data += record(131, form, 1000 * number, *range(len(form) - 1))
    stream = next(s for s in read(path, data).streams if s.name == "IMU")
    assert rows(stream) == [(10**6 * k, 0.0, 1.0, 2.0) for k in range(len(forms))]


FORMS = st.lists(st.sampled_from("bBghHiIfdnNcCeELMqQ"), min_size=8, max_size=8)
LONG = st.sampled_from([["a"], ["Z"], ["Q"], ["f"]])  # no record is longer than 255 bytes
KNOWN = {
    "IMU": "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T",
    "GYR": "TimeUS,I,SampleUS,GyrX,GyrY,GyrZ",
    "GPS": "Status,TimeMS,Week,T",
    "GPS2": "TimeUS,Status,GMS,GWk",
    "EV": "Id,TimeMS",
    "ARM": "TimeUS,ArmState",
    "ATT": "TimeUS,Roll,Pitch,Yaw",
    "PARM": "TimeUS,Name,Value",
    "MSG": "Message",
    "VER": "FWS",
    "FMTU": "FmtType,UnitIds,MultIds",
    "UNIT": "Id,Label",
    "MULT": "Id,Mult",
}


@given(st.data())
def test_known_messages_may_hold_anything(path: Path, data: st.DataObject) -> None:
    parts = [HEAD]
    for kind, (name, fields) in enumerate(KNOWN.items(), start=140):
        size = fields.count(",")
        form = "".join(data.draw(st.permutations(data.draw(FORMS)[:size] + data.draw(LONG))))
        parts.append(fmt(kind, name.replace("GPS2", "GPS"), form, fields))
        length = parse_fmt(parts[-1]).length
        body = data.draw(st.binary(min_size=length - 3, max_size=length - 3))
        parts.append(b"\xa3\x95" + bytes([kind]) + body)
    parts.append(imu(1))
    recording = read(path, b"".join(parts))
    assert all(isinstance(text, str) for pair in (recording.vehicle or {}).items() for text in pair)
    for stream in recording.streams:
        assert all(stream.columns[f].dtype.kind in "fiu" for f in stream.gyro)
        assert len(stream.time_ns) in (stream.count, 0)
