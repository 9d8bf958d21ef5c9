"""Numbers in JSON messages: decoded by msgspec straight into the few fields that are wanted."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from itertools import chain
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

    Parameters
    ----------
    wanted
        Dotted paths: ``header.stamp.sec``, ``angular_velocity[0]``, or a list of numbers.
    """

    batch_bytes = 1 << 20

    def __init__(self, wanted: Collection[str]) -> None:
        import msgspec

        self._msgspec = msgspec
        self._getters: dict[str, attrgetter[Any]] = {}
        # Objects of nothing but numbers are taken apart at once, which is twice as fast.
        self._vectors: list[tuple[attrgetter[Any], list[str]]] = []
        tree: Tree = {}
        for leaf in wanted:
            node = tree
            path = leaf.rpartition("[")[0] if leaf.endswith("]") else leaf
            *parts, last = path.split(".")
            for part in parts:
                node = node.setdefault(part, {})
            node[last] = None
        self._message = self._structure(tree, (), "")
        self._one: Any = msgspec.json.Decoder(self._message)
        self._many: Any = msgspec.json.Decoder(list[self._message])  # type: ignore[name-defined]

    def _structure(self, tree: Tree, fields: tuple[str, ...], path: str) -> type:
        """Make the type of one object: keys may be any text, so its fields are numbered."""
        msgspec = self._msgspec
        defined: list[tuple[str, Any, Any]] = []
        names = {}
        for number, (key, below) in enumerate(tree.items()):
            name = f"f{number}"
            names[name] = key
            if below is None:
                leaf = f"{path}{key}"
                number_type = float | bool | None
                defined.append((name, number_type | list[number_type], None))
                self._getters[leaf] = attrgetter(".".join((*fields, name)))
            else:
                inner = self._structure(below, (*fields, name), f"{path}{key}.")
                defined.append((name, inner, msgspec.field(default_factory=inner)))
        if fields and all(below is None for below in tree.values()):
            leaves = [f"{path}{key}" for key in tree]
            self._vectors.append((attrgetter(".".join(fields)), leaves))
        made: type = msgspec.defstruct("Message", defined, rename=names, gc=False)
        return made

    def columns(self, batch: Batch) -> tuple[Columns, Mask]:
        """Read the wanted leaves of all messages; see ``Layout``."""
        fits = np.ones(len(batch), np.bool_)
        try:
            messages = self._many.decode(_as_list(batch))
        except (self._msgspec.MsgspecError, RecursionError):
            messages = []
        if len(messages) != len(batch):
            messages = [self._alone(batch, k) for k in range(len(batch))]
            fits = np.array([message is not None for message in messages], np.bool_)
            empty = self._message()
            messages = [empty if message is None else message for message in messages]
        columns: Columns = {}
        for parent, leaves in self._vectors:
            parts = map(self._msgspec.structs.astuple, map(parent, messages))
            try:
                values = np.fromiter(chain.from_iterable(parts), np.float64)
            except (TypeError, ValueError):  # something is missing, or is a list
                continue
            for k, leaf in enumerate(leaves):
                columns[leaf] = values[k :: len(leaves)].copy()
        for leaf, getter in self._getters.items():
            if leaf in columns:
                continue
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
    rows[:, shortest:][tail] = ord(" ")
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
