"""High-rate batches of DataFlash logs: ISBH announces one, ISBD records hold its samples.

The autopilot's batch sampler keeps some thousand samples of one sensor at the sensor's own rate,
writes them to the log bit by bit, and goes on with the next sensor. So a batch is short, and what
lies between two of them was never recorded. ISBH tells the kind of sensor and its number, what the
raw numbers are to be divided by, how many samples there are, when the first was taken, and their
rate; each ISBD has 32 of them (ArduPilot, AP_InertialSensor/BatchSampler).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from fdilog.recording import Problem, Stream
from fdilog_readers.columns import Offsets

HEADER, BLOCK = "ISBH", "ISBD"
HEADER_FIELDS = ("N", "type", "instance", "mul", "smp_cnt", "SampleUS", "smp_rate")
BLOCK_FIELDS = ("N", "seqno")
AXES = ("x", "y", "z")
SAMPLES = 32
ACCELEROMETER, GYRO = 0, 1
# Batch numbers have 16 bits; above so many bits of offset they make one key that sorts by both.
OFFSET_BITS = 46
LATEST_US = 2**52


class Records(Protocol):
    """Records of one name: their offsets in the file, and their columns."""

    offsets: Offsets
    columns: dict[str, NDArray[Any]]


def batch_streams(tables: Mapping[str, Records]) -> tuple[list[Stream], list[Problem]]:
    """Make a stream of every sensor that was sampled in batches, and say what is incomplete."""
    headers, blocks = tables.get(HEADER), tables.get(BLOCK)
    if headers is None or blocks is None or not (_is_known(headers, HEADER_FIELDS)):
        return [], []
    if not _is_known(blocks, BLOCK_FIELDS) or not _has_samples(blocks):
        return [], []
    head, owner = headers.columns, _owners(headers, blocks)
    problems = []
    if orphans := int((owner < 0).sum()):
        what = f"{orphans} {BLOCK} records belong to no batch that was announced"
        problems.append(Problem(what=what, note=True))
    wanted = -(-head["smp_cnt"].astype(np.int64) // SAMPLES)
    missing = np.maximum(wanted - np.bincount(owner[owner >= 0], minlength=len(wanted)), 0)
    if len(missing) and missing[:-1].any():  # the log may end within the last one
        what = f"{int((missing[:-1] > 0).sum())} batches of samples are incomplete"
        problems.append(Problem(what=f"{what}: {missing[:-1].sum()} {BLOCK} missing", note=True))
    usable = np.isfinite(head["mul"]) & (head["mul"] > 0) & np.isfinite(head["smp_rate"])
    usable &= (head["smp_rate"] > 0) & (head["SampleUS"] < LATEST_US)
    streams = []
    sensors = zip(head["type"].tolist(), head["instance"].tolist(), strict=True)
    for kind, instance in sorted(set(sensors)):
        if kind in {ACCELEROMETER, GYRO}:
            mine = usable & (head["type"] == kind) & (head["instance"] == instance)
            here = np.flatnonzero((owner >= 0) & mine[owner])
            samples = _samples(head, blocks, owner[here], here)
            streams.append(replace(samples, sensor=int(instance), **_meaning(kind, instance)))
    return streams, problems


def _is_known(table: Records, fields: tuple[str, ...]) -> bool:
    return all(
        name in table.columns
        and table.columns[name].ndim == 1
        and table.columns[name].dtype.kind in "iuf"
        for name in fields
    )


def _has_samples(blocks: Records) -> bool:
    shape = (len(blocks.offsets), SAMPLES)
    return all(axis in blocks.columns and blocks.columns[axis].shape == shape for axis in AXES)


def _owners(headers: Records, blocks: Records) -> NDArray[np.int64]:
    """Return the index of each block's header, the last one before it of its number, or -1."""
    numbers = headers.columns["N"].astype(np.int64)
    keys = (numbers << OFFSET_BITS) + headers.offsets
    order = np.argsort(keys)
    wanted = blocks.columns["N"].astype(np.int64)
    after = np.searchsorted(keys[order], (wanted << OFFSET_BITS) + blocks.offsets)
    found = order[np.maximum(after - 1, 0)] if len(order) else np.zeros(len(wanted), np.int64)
    known = (after > 0) & (numbers[found] == wanted) if len(order) else np.zeros(len(wanted), bool)
    return np.where(known, found, -1)


def _meaning(kind: int, instance: int) -> dict[str, Any]:
    if kind == GYRO:
        units = dict.fromkeys(AXES, "rad/s")
        return {"name": f"{BLOCK}[{instance}]", "units": units, "gyro": AXES}
    units = dict.fromkeys(AXES, "m/s^2")
    return {"name": f"{BLOCK}[{instance}] accelerometer", "units": units, "accelerometer": AXES}


def _samples(
    head: dict[str, NDArray[Any]],
    blocks: Records,
    owner: NDArray[np.int64],
    here: NDArray[np.intp],
) -> Stream:
    """Spread blocks out to samples, each with its time."""
    first = blocks.columns["seqno"][here].astype(np.int64) * SAMPLES
    number = first[:, None] + np.arange(SAMPLES)
    kept = number < head["smp_cnt"].astype(np.int64)[owner, None]
    rate_hz = head["smp_rate"].astype(np.float64)[owner, None]
    start_ns = head["SampleUS"].astype(np.int64)[owner, None] * 1000
    time_ns = start_ns + np.round(number / rate_hz * 1e9).astype(np.int64)
    divisor = head["mul"].astype(np.float64)[owner, None]
    columns = {axis: (blocks.columns[axis][here] / divisor)[kept] for axis in AXES}
    return Stream(
        name=BLOCK,
        time_ns=time_ns[kept],
        columns=columns,
        clock="SampleUS and smp_rate",
        batched=True,
        offsets=np.repeat(blocks.offsets[here], SAMPLES)[kept.ravel()],
    )
