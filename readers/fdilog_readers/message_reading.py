"""How to read a topic's messages, from what the log says about their type."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial

import numpy as np

from fdilog.recording import Problem
from fdilog_readers.gyro_search import (
    MAX_UNROLLED,
    find_gyros,
    lists_of_gyros,
    number_leaves,
    stamps_at,
    with_lengths,
)
from fdilog_readers.json_layout import JsonLayout, json_schema, schema_of
from fdilog_readers.message_batch import Batch, Layout
from fdilog_readers.message_schema import Schema, UnknownTypeError, ros_schema, short_name
from fdilog_readers.protobuf_layout import ProtobufLayout, protobuf_schema
from fdilog_readers.ros_layout import RosLayout
from fdilog_readers.topics import Reading, Topic, Topics

# A twist or an attitude under such a name is what was commanded, not what happened.
COMMAND = re.compile(
    r"(^|[/_])cmd(_|$)|command|setpoint|goal|target|desired|reference", re.IGNORECASE
)


def open_topic(
    topics: Topics,
    name: str,
    type_name: str,
    *,
    message_encoding: str,
    schema_encoding: str,
    definition: bytes,
) -> Topic:
    """Return the topic, with how to read it if it holds a gyro or was asked for.

    A type that cannot be read leaves a note in ``topics.problems`` and a topic that is only listed.
    """
    topic = topics.topic(name, type_name)
    if topic.reading is None and not topic.tried:
        topic.tried = True
        try:
            topic.reading = _reading(
                topic, topic.name in topics.also, message_encoding, schema_encoding, definition
            )
        except UnknownTypeError as error:
            what = f"{topic.name} ({topic.type}) is not decoded: {error}"
            topics.problems.append(Problem(what=what, note=True))
    return topic


def _reading(
    topic: Topic, also: bool, message_encoding: str, schema_encoding: str, definition: bytes
) -> Reading | None:
    root = topic.type
    layout: Callable[[Schema, str, set[str]], Layout]
    if message_encoding in {"cdr", "ros1"}:
        ros = 1 if message_encoding == "ros1" else 2
        text = definition.decode(errors="replace")
        schema, root = ros_schema(root, schema_encoding, text, ros), short_name(root)
        layout = partial(RosLayout, packed=ros == 1)
        if lists := lists_of_gyros(schema, root):
            # Nothing but a message tells how many sensors there are in a list of them.
            counter = layout(schema, root, {f"#{path}" for path, _, _ in lists})
            topic.probe = lambda raw: _plan(
                topic, also, with_lengths(schema, _lengths(raw, counter, lists)), root, layout
            )
            return None
    elif message_encoding == "protobuf":
        schema, layout = protobuf_schema(definition), ProtobufLayout
    elif message_encoding == "json":
        schema, layout = json_schema(root, definition), _json_layout
        if not schema.get(root):
            # Nothing but a message tells what is in it.
            topic.probe = lambda raw: _plan(topic, also, schema_of(root, raw), root, _json_layout)
            return None
    else:
        raise UnknownTypeError(f"the message encoding {message_encoding!r} is not known")
    return _plan(topic, also, schema, root, layout)


def _plan(
    topic: Topic,
    also: bool,
    schema: Schema,
    root: str,
    layout: Callable[[Schema, str, set[str]], Layout],
) -> Reading | None:
    if root not in schema:
        return None
    gyros = find_gyros(schema, root)
    if COMMAND.search(topic.name):
        gyros = tuple(gyro for gyro in gyros if gyro.origin != "derived")
    others = number_leaves(schema, root) if also else ()
    if not gyros and not others:
        return None
    stamps = stamps_at(schema, root) if others else ()
    leaves = {leaf for gyro in gyros for leaf in gyro.leaves} | set(others)
    leaves |= {leaf for stamp in stamps for leaf in (stamp.seconds, stamp.nanoseconds)}
    return Reading(layout(schema, root, leaves), gyros, others, stamps)


def _lengths(
    raw: bytes, counter: Layout, lists: tuple[tuple[str, str, str], ...]
) -> dict[tuple[str, str], int]:
    """Return how long the lists are in one message, up to what is worth unrolling."""
    rows = np.frombuffer(raw, np.uint8).reshape(1, -1)
    columns, _ = counter.columns(Batch(rows, 0, np.array([len(raw)])))
    counts = {(kind, field): columns.get(f"#{path}") for path, kind, field in lists}
    return {
        place: int(count[0])
        for place, count in counts.items()
        if count is not None and 0 < count[0] <= MAX_UNROLLED
    }


def _json_layout(_schema: Schema, _root: str, leaves: set[str]) -> Layout:
    return JsonLayout(leaves)
