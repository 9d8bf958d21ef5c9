"""Columns of JSON messages are what Python's own decoder finds in them, whatever they hold."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fdilog_readers.json_layout import JsonLayout
from fdilog_readers.message_batch import Batch

WANTED = ["header.stamp.sec", "rate.x", "rate.y", "rate.long key of a unit: °/s", "status"]

numbers = st.one_of(
    st.floats(),
    st.integers(-(2**70), 2**70),
    st.sampled_from([0, -0.0, 2**53 + 1, 2**63, 2**64 - 1, 5e-324, 1.7976931348623157e308]),
)
odd: st.SearchStrategy[Any] = st.one_of(
    st.none(), st.booleans(), st.text(max_size=3), st.just({}), st.just({"x": 1})
)


def an_object(values: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    rate = st.fixed_dictionaries(
        {}, optional={key.partition(".")[2]: values for key in WANTED if key.startswith("rate")}
    )
    stamp = st.fixed_dictionaries({}, optional={"sec": values, "unwanted": values})
    header = st.fixed_dictionaries({}, optional={"stamp": stamp, "frame_id": st.text(max_size=5)})
    return st.fixed_dictionaries(
        {}, optional={"header": header, "rate": rate, "status": values, "other": st.lists(numbers)}
    )


def expected(message: Any) -> list[float] | None:
    """Return the wanted numbers; None if the message cannot hold them."""
    row = []
    for path in WANTED:
        value = message
        for key in path.split("."):
            if not isinstance(value, dict):
                return None
            value = value.get(key, {} if key != path.split(".")[-1] else None)
        if not isinstance(value, int | float | None):
            return None
        row.append(math.nan if value is None else float(value))
    return row


def check(texts: list[bytes], rows: list[list[float] | None]) -> None:
    width = max(map(len, texts)) + 3
    side_by_side = np.full((len(texts), width), ord('"'), np.uint8)
    for row, text in zip(side_by_side, texts, strict=True):
        row[1 : 1 + len(text)] = np.frombuffer(text, np.uint8)
    columns, fits = JsonLayout(WANTED).columns(
        Batch(side_by_side, 1, np.array([len(text) for text in texts]))
    )
    assert fits.tolist() == [row is not None for row in rows]
    for number, path in enumerate(WANTED):
        found = columns[path][fits]
        wanted = np.array([row[number] for row in rows if row is not None], np.float64)
        assert found.dtype == np.float64
        assert np.array_equal(found, wanted, equal_nan=True)
        assert np.array_equal(np.signbit(found[found == 0]), np.signbit(wanted[wanted == 0]))


@given(st.lists(an_object(numbers), min_size=1, max_size=6))
def test_numbers_are_those_of_pythons_decoder(messages: list[Any]) -> None:
    check([json.dumps(each).encode() for each in messages], [expected(each) for each in messages])


@given(st.lists(an_object(st.one_of(numbers, odd)) | odd | numbers, min_size=1, max_size=6))
def test_what_is_no_number_costs_its_message_alone(messages: list[Any]) -> None:
    check([json.dumps(each).encode() for each in messages], [expected(each) for each in messages])


@given(st.lists(an_object(numbers), min_size=2, max_size=5), st.data())
def test_a_cut_message_costs_itself_alone(messages: list[Any], data: st.DataObject) -> None:
    texts = [json.dumps(each).encode() for each in messages]
    cut = data.draw(st.integers(0, len(texts) - 1))
    texts[cut] = texts[cut][: data.draw(st.integers(0, len(texts[cut]) - 1))]
    rows = [None if k == cut else expected(each) for k, each in enumerate(messages)]
    check(texts, rows)


def test_there_are_as_many_rows_as_messages() -> None:
    for count in (1, 15, 16, 65_535, 65_536):
        texts = [b'{"rate":{"x":%d,"y":%.1f}}' % (k, k / 4) for k in range(count)]
        check(texts, [expected(json.loads(text)) for text in texts])
