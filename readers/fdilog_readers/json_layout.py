"""Numbers in JSON messages: decoded by msgspec straight into the few fields that are wanted."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Collection, Iterator, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdilog_readers.columns import Bytes
from fdilog_readers.message_batch import Batch, Columns, Mask
from fdilog_readers.message_schema import SEQUENCE, Field, Schema, UnknownTypeError

_NUMBERS = {"number": "float64", "integer": "int64", "boolean": "bool"}
MAX_DEPTH = 16
MAX_LIST_COLUMNS = 64
MSGPACK_FLOAT = 0xCB

Tree = dict[str, Any]


def json_schema(name: str, text: bytes) -> Schema:
    """Read a JSON Schema as far as it names properties; empty where it names none.

    Raises
    ------
    UnknownTypeError
        If it is no JSON.
    """
    if not text.strip():
        return {}
    try:
        root = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise UnknownTypeError(f"its JSON schema cannot be read ({error})") from error
    types: dict[str, tuple[Field, ...]] = {}
    if isinstance(root, dict):
        _object(types, name, root, root, 0)
    return types


def schema_of(name: str, message: bytes) -> Schema:
    """Infer the schema from a message, for topics whose log has none."""
    try:
        value = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    types: dict[str, tuple[Field, ...]] = {}
    if isinstance(value, dict):
        _like(types, name, value, 0)
    return types


def _object(
    types: dict[str, tuple[Field, ...]],
    name: str,
    node: Mapping[str, Any],
    root: Mapping[str, Any],
    depth: int,
) -> None:
    properties = node.get("properties")
    if not isinstance(properties, dict) or depth > MAX_DEPTH:
        return
    fields = []
    for key, described in properties.items():
        item = _resolved(described, root)
        kind = item.get("type")
        if isinstance(kind, list):  # "number or null"
            kind = next((k for k in kind if k != "null"), None)
        if kind in _NUMBERS:
            fields.append(Field(key, _NUMBERS[kind]))
        elif kind == "array":
            inner = _resolved(item.get("items"), root).get("type")
            if inner in _NUMBERS:
                fields.append(Field(key, _NUMBERS[inner], SEQUENCE))
        elif kind == "object" or "properties" in item:
            below = f"{name}.{key}"
            _object(types, below, item, root, depth + 1)
            if below in types:
                fields.append(Field(key, below))
    types[name] = tuple(fields)


def _resolved(node: Any, root: Mapping[str, Any]) -> Mapping[str, Any]:
    """Follow references within the schema."""
    for _ in range(MAX_DEPTH):
        if not isinstance(node, dict):
            return {}
        reference = node.get("$ref")
        if not isinstance(reference, str):
            return node
        node = root
        for part in reference.removeprefix("#").strip("/").split("/"):
            node = node.get(part) if isinstance(node, dict) else None
    return {}


def _like(
    types: dict[str, tuple[Field, ...]], name: str, value: Mapping[str, Any], depth: int
) -> None:
    fields = []
    for key, item in value.items():
        if isinstance(item, bool):
            fields.append(Field(key, "bool"))
        elif isinstance(item, int | float):
            fields.append(Field(key, "float64"))
        elif isinstance(item, dict) and depth < MAX_DEPTH:
            below = f"{name}.{key}"
            _like(types, below, item, depth + 1)
            fields.append(Field(key, below))
        elif isinstance(item, list) and item and all(type(v) in {int, float} for v in item):
            fields.append(Field(key, "float64", SEQUENCE))
    types[name] = tuple(fields)


class JsonLayout:
    """Reads some leaves of JSON messages, all as float64; what a message lacks is not-a-number.

    Messages of nothing but numbers, as nearly all are, are decoded to objects with a float in each
    leaf and encoded again as MessagePack, in which every such object has the same bytes but for its
    floats: the columns are then views of it, and no float is ever touched from Python.

    Parameters
    ----------
    wanted
        Dotted paths: ``header.stamp.sec``, ``angular_velocity[0]``, or a list of numbers.
    """

    batch_bytes = 1 << 18  # a chunk as it comes, and its objects in the cache still

    def __init__(self, wanted: Collection[str]) -> None:
        import msgspec

        self._msgspec = msgspec
        tree: Tree = {}
        for leaf in wanted:
            node = tree
            path = leaf.rpartition("[")[0] if leaf.endswith("]") else leaf
            *parts, last = path.split(".")
            for part in parts:
                node = node.setdefault(part, {})
            node[last] = None
        leaves = dict(_leaves(tree, "", ()))
        self._getters = {leaf: attrgetter(fields) for leaf, fields in leaves.items()}
        floats = self._structure(tree, float, math.nan)
        self._floats: Any = msgspec.json.Decoder(list[floats])  # type: ignore[valid-type]
        self._encoder = msgspec.msgpack.Encoder()
        self._raw = bytearray()  # used again and again: fresh memory costs more than the encoding
        self._layout = self._encoded(floats, leaves)
        number = float | bool | None
        self._message = self._structure(tree, number | list[number], None)
        self._one: Any = msgspec.json.Decoder(self._message)
        self._many: Any = msgspec.json.Decoder(list[self._message])  # type: ignore[name-defined]

    def _structure(self, tree: Tree, leaf: Any, missing: Any) -> type:
        """Make the type of one object: keys may be any text, so its fields are numbered."""
        field = self._msgspec.field
        defined: list[tuple[str, Any, Any]] = []
        names = {}
        for number, (key, below) in enumerate(tree.items()):
            names[f"f{number}"] = key
            if below is None:
                defined.append((f"f{number}", leaf, missing))
            else:
                inner = self._structure(below, leaf, missing)
                defined.append((f"f{number}", inner, field(default_factory=inner)))
        made: type = self._msgspec.defstruct("Message", defined, rename=names, gc=False)
        return made

    def _encoded(self, floats: Any, leaves: Mapping[str, str]) -> np.dtype[np.void]:
        """Find out where the floats of an encoded message are, by marks put into one."""
        marked = floats()
        marks = {leaf: number + 0.5 for number, leaf in enumerate(leaves)}
        for leaf, fields in leaves.items():
            owner, _, name = fields.rpartition(".")
            setattr(attrgetter(owner)(marked) if owner else marked, name, marks[leaf])
        raw = self._encoder.encode(marked)
        # The byte before each float is no text that goes on like this: a key cannot hold a mark.
        places = [raw.index(struct.pack(">Bd", MSGPACK_FLOAT, mark)) + 1 for mark in marks.values()]
        described = {"names": list(leaves), "formats": [">f8"] * len(leaves), "offsets": places}
        return np.dtype({**described, "itemsize": len(raw)})  # type: ignore[no-any-return, call-overload]

    def columns(self, batch: Batch) -> tuple[Columns, Mask]:
        """Read the wanted leaves of all messages; see ``Layout``."""
        text = _as_list(batch)
        try:
            messages = self._floats.decode(text)
        except (self._msgspec.MsgspecError, RecursionError):
            return self._of_any_kind(batch, text)
        if len(messages) != len(batch):
            return self._of_any_kind(batch, text)
        self._encoder.encode_into(messages, self._raw)
        head = len(self._raw) - len(messages) * self._layout.itemsize
        rows = np.frombuffer(self._raw, self._layout, offset=head)
        return {leaf: rows[leaf].astype(np.float64) for leaf in self._getters}, _all(batch)

    def _of_any_kind(self, batch: Batch, text: bytes | memoryview) -> tuple[Columns, Mask]:
        """Read messages of which some lack a number, have a list, or cannot be read at all."""
        fits = _all(batch)
        try:
            messages = self._many.decode(text)
        except (self._msgspec.MsgspecError, RecursionError):
            messages = []
        if len(messages) != len(batch):
            messages = [self._alone(batch, k) for k in range(len(batch))]
            fits = np.array([message is not None for message in messages], np.bool_)
            empty = self._message()
            messages = [empty if message is None else message for message in messages]
        columns: Columns = {}
        for leaf, getter in self._getters.items():
            try:
                columns[leaf] = np.fromiter(map(getter, messages), np.float64, len(batch))
            except (TypeError, ValueError):  # something is missing, or is a list
                columns |= _uneven(leaf, list(map(getter, messages)))
        return columns, fits

    def _alone(self, batch: Batch, row: int) -> Any:
        """Decode one message; Python's own decoder also takes NaN and Infinity."""
        end = batch.lead + int(batch.lengths[row])
        raw = batch.rows[row, batch.lead : end].tobytes()
        try:
            return self._one.decode(raw)
        except (self._msgspec.MsgspecError, RecursionError):
            pass
        try:
            return self._msgspec.convert(json.loads(raw), self._message)
        except (self._msgspec.MsgspecError, ValueError, RecursionError):
            return None


def _leaves(tree: Tree, path: str, fields: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Yield the path of each leaf in the messages, and in the objects that they are decoded to."""
    for number, (key, below) in enumerate(tree.items()):
        here = (*fields, f"f{number}")
        if below is None:
            yield f"{path}{key}", ".".join(here)
        else:
            yield from _leaves(below, f"{path}{key}.", here)


def _all(batch: Batch) -> Mask:
    return np.ones(len(batch), np.bool_)


def _as_list(batch: Batch) -> bytes | memoryview:
    """Make one JSON list of all messages, in place: blanks where a row has none of its message."""
    width = batch.rows.shape[1]
    rows = batch.rows if batch.rows.flags.writeable and batch.lead else _with_room(batch)
    lead = rows.shape[1] - width + batch.lead
    ends = lead + batch.lengths
    rows[:, :lead] = ord(" ")
    rows[1:, 0] = ord(",")
    rows[0, 0] = ord("[")
    shortest = int(ends.min())
    tail = np.arange(shortest, rows.shape[1]) >= ends[:, np.newaxis]
    np.copyto(rows[:, shortest:], np.uint8(ord(" ")), where=tail)
    if ends[-1] == rows.shape[1]:
        return rows.tobytes() + b"]"
    rows[-1, -1] = ord("]")
    return rows.reshape(-1).data


def _with_room(batch: Batch) -> Bytes:
    """Copy rows to others with a byte more before the message."""
    count, width = batch.rows.shape
    rows = np.empty((count, width + 1), np.uint8)
    rows[:, 1:] = batch.rows
    return rows


def _uneven(leaf: str, values: list[Any]) -> dict[str, NDArray[np.float64]]:
    """Make a column of numbers of which some are missing, and one of each place in lists."""
    lists = [value for value in values if isinstance(value, list)]
    if not lists:
        return {leaf: np.array(values, np.float64)}
    longest = min(max(map(len, lists)), MAX_LIST_COLUMNS)
    padded = [value if isinstance(value, list) else [] for value in values]
    return {
        f"{leaf}[{k}]": np.array([v[k] if len(v) > k else None for v in padded], np.float64)
        for k in range(longest)
    }
