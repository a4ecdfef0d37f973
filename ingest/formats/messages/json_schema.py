"""JSON messages of one topic as columns, with types from the topic's JSON schema where it has one.

The fast way: all messages of a batch, one a line, through Arrow's JSON reader with the schema's types. What
that refuses (NaN literals, numbers of another type than declared, duplicate keys) goes message by message
through the json module, with types inferred: a field whose values are mostly numbers is one of numbers.
Objects flatten to dotted names; arrays become lists.
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.flight import field_metadata
from flysid.ingest.formats.common.arrow_arrays import strings
from flysid.ingest.formats.common.gather import Bytes, Index
from flysid.ingest.formats.common.odd_cells import OddCells
from flysid.ingest.formats.common.table_numbers import PLAIN, floats
from flysid.ingest.formats.messages.definitions import DefinitionError

MAX_DEPTH = 32
MAX_PROPERTIES = 20_000
MOST_CELLS = 1 << 24
"""Of a batch: six times as many as its bytes can state, so that most of a wide table may be empty."""
_NAME = re.compile(rb'"((?:[^"\\]|\\.)*)"\s*:')

JSON_TYPES: Mapping[str, pa.DataType] = {
    "number": pa.float64(),
    "integer": pa.int64(),
    "boolean": pa.bool_(),
    "string": pa.string(),
}


@dataclass(frozen=True)
class JsonLayout:
    """Arrow types of a topic's messages (None: infer), units and descriptions by dotted path."""

    schema: pa.Schema | None = None
    notes: Mapping[str, dict[bytes, bytes]] = field(default_factory=dict)


def parse_json_schema(raw: bytes) -> JsonLayout:
    """Types and units from a JSON schema of an object; anything it does not pin down is inferred later.

    A property may carry "unit" (or "units"), "scale", "description", and "enum" names are left to the reader.
    """
    try:
        document = json.loads(raw) if raw.strip() else {}
    except (ValueError, RecursionError):
        return JsonLayout()
    if not isinstance(document, dict) or not isinstance(document.get("properties"), dict):
        return JsonLayout()
    notes: dict[str, dict[bytes, bytes]] = {}
    fields = list(_fields(document, "", notes, 0))
    if len(fields) != len(document["properties"]):
        return JsonLayout(None, notes)
    return JsonLayout(pa.schema(fields), notes)


def _fields(
    node: Mapping[str, Any], path: str, notes: dict[str, dict[bytes, bytes]], depth: int
) -> Iterator[pa.Field]:
    """One field for every property whose type is certain."""
    if depth > MAX_DEPTH or len(notes) > MAX_PROPERTIES:
        return
    properties = node.get("properties")
    for name, inner in properties.items() if isinstance(properties, dict) else ():
        if not isinstance(inner, dict):
            continue
        here = f"{path}.{name}" if path else str(name)
        note = _note(inner)
        if note:
            notes[here] = note
        kind = _type(inner, here, notes, depth)
        if kind is not None:
            yield pa.field(str(name), kind)


def _note(node: Mapping[str, Any]) -> dict[bytes, bytes] | None:
    unit = node.get("unit", node.get("units", ""))
    scale = node.get("scale", 1.0)
    description = node.get("description", "")
    return field_metadata(
        unit if isinstance(unit, str) else "",
        float(scale) if isinstance(scale, int | float) and not isinstance(scale, bool) else 1.0,
        None,
        description if isinstance(description, str) else "",
    )


def _type(
    node: Mapping[str, Any], path: str, notes: dict[str, dict[bytes, bytes]], depth: int
) -> pa.DataType | None:
    """The Arrow type of a schema node; None where the schema leaves it open."""
    kind = node.get("type")
    if isinstance(kind, list):  # ["number", "null"]
        known = [k for k in kind if k != "null"]
        kind = known[0] if len(known) == 1 else None
    if isinstance(kind, str) and kind in JSON_TYPES:
        return JSON_TYPES[kind]
    if kind == "array" and isinstance(node.get("items"), dict):
        inner = _type(node["items"], path, notes, depth + 1) if depth < MAX_DEPTH else None
        return None if inner is None else pa.list_(inner)
    if kind == "object" and isinstance(node.get("properties"), dict):
        fields = list(_fields(node, path, notes, depth + 1))
        if fields and len(fields) == len(node["properties"]):
            return pa.struct(fields)
    return None


def decode_json(
    data: Bytes, at: Index, size: Index, layout: JsonLayout, odd: OddCells
) -> tuple[pa.Table, Index]:
    """Columns of the messages data[at : at + size] and the numbers of those that are JSON objects.

    Values that are no numbers, in fields that mostly are, are null and noted in `odd` with their messages,
    1 for the first.
    """
    table = _read_lines(data, at, size, layout)
    if table is not None:
        return _flatten(table), np.arange(len(at))
    objects = []
    kept = []
    for number, (start, length) in enumerate(zip(at.tolist(), size.tolist(), strict=True)):
        try:
            value = json.loads(data[start : start + length].tobytes())
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict):
            objects.append(value)
            kept.append(number)
    numbers = np.array(kept, dtype=np.int64)
    return _from_objects(objects, layout, odd, numbers + 1), numbers


def _read_lines(data: Bytes, at: Index, size: Index, layout: JsonLayout) -> pa.Table | None:
    """The messages through Arrow's reader; None where it does not take them all as they are.

    Arrow counts two objects in a line as two rows, and none for a blank line: with an object at the start of
    every message, as many rows as messages are one row each.
    """
    import pyarrow.json as arrow_json

    if (size == 0).any() or (data[at] != ord("{")).any():
        return None
    window = data.data
    lines = b"\n".join(
        [
            bytes(window[p : p + s]).replace(b"\n", b" ")
            for p, s in zip(at.tolist(), size.tolist(), strict=True)
        ]
    )
    _check_size(len(at), _count_names(lines, len(at), layout))
    options = arrow_json.ParseOptions(
        explicit_schema=layout.schema, unexpected_field_behavior="infer" if layout.schema is None else "error"
    )
    block = arrow_json.ReadOptions(use_threads=False, block_size=min(len(lines) + 64, (1 << 31) - 1))
    try:
        table = arrow_json.read_json(io.BytesIO(lines), read_options=block, parse_options=options)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowKeyError):
        return None
    if table.num_rows != len(at) or any(_has_times(f.type) for f in table.schema):
        return None
    return table


def _count_names(lines: bytes, messages: int, layout: JsonLayout) -> int:
    """How many columns the messages may become; they are counted where there could be too many."""
    if layout.schema is not None:
        return len(layout.schema)
    stated = lines.count(b":")
    return stated if messages * stated <= MOST_CELLS else len(set(_NAME.findall(lines)))


def _check_size(messages: int, names: int) -> None:
    """Raise DefinitionError where fields that change from message to message make too wide a table."""
    if messages * names > MOST_CELLS:
        raise DefinitionError(f"{names:,} fields in {messages:,} messages, most of them in few")


def _has_times(kind: pa.DataType) -> bool:
    """Whether inference turned strings into timestamps: they stay strings."""
    if pa.types.is_timestamp(kind):
        return True
    return any(_has_times(kind.field(i).type) for i in range(kind.num_fields))


def _flatten(table: pa.Table) -> pa.Table:
    """Struct columns, however deep, as dotted columns."""
    for _ in range(MAX_DEPTH + 2):
        if not any(pa.types.is_struct(f.type) and f.type.num_fields for f in table.schema):
            break
        table = table.flatten()
    return table.combine_chunks()


def _from_objects(
    objects: list[dict[str, Any]], layout: JsonLayout, odd: OddCells, numbers: Index
) -> pa.Table:
    """Dotted columns of decoded objects, which are those messages."""
    columns: dict[str, list[Any]] = {}
    for number, item in enumerate(objects):
        for path, value in _leaves(item, "", 0):
            if path not in columns:
                _check_size(len(objects), len(columns) + 1)
                columns[path] = [None] * len(objects)
            columns[path][number] = value
    declared = {} if layout.schema is None else _dotted(layout.schema)
    arrays = {}
    for path, values in columns.items():
        arrays[path], wrong = _array(values, declared.get(path))
        if wrong:
            odd.note(path, numbers[wrong].tolist(), str(values[wrong[0]]))
    missing = {path: pa.nulls(len(objects), kind) for path, kind in declared.items() if path not in arrays}
    arrays.update(missing)
    order = [*(p for p in declared if p in arrays), *(p for p in arrays if p not in declared)]
    return pa.table([arrays[p] for p in order], names=order)


def _leaves(item: Mapping[str, Any], path: str, depth: int) -> Iterator[tuple[str, Any]]:
    for name, value in item.items():
        here = f"{path}.{name}" if path else name
        if isinstance(value, dict) and value and depth < MAX_DEPTH:
            yield from _leaves(value, here, depth + 1)
        else:
            yield here, value


def _dotted(schema: pa.Schema) -> dict[str, pa.DataType]:
    flat = _flatten(schema.empty_table())
    return dict(zip(flat.schema.names, flat.schema.types, strict=True))


def _array(values: list[Any], declared: pa.DataType | None) -> tuple[pa.Array, list[int]]:
    """Values under the declared type, else under one that fits them all, else as numbers or as JSON text.

    They are numbers where at least half of them are, or where those are declared; second, the places of those
    that are none. Numbers in quotes are numbers.
    """
    for kind in (declared, None):
        try:
            return (pa.array(values, kind) if kind is not None else _infer(values)), []
        except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError, pa.ArrowNotImplementedError):
            continue
    told = [value for value in values if value is not None]
    is_declared = declared in (pa.float64(), pa.int64())
    if is_declared or 2 * sum(isinstance(v, int | float) for v in told) >= len(told):
        return as_numbers(values)
    return pa.array([None if v is None else json.dumps(v) for v in values], pa.string()), []


def as_numbers(values: Sequence[object]) -> tuple[pa.Array, list[int]]:
    """Values of JSON as numbers, numbers in quotes among them; null, and named by their places, where not.

    Examples
    --------
    >>> as_numbers([1, "2.5", None, "x"])[1]
    [3]
    """
    is_text = [isinstance(value, str) for value in values]
    told, wrong = floats(strings([v.strip() if isinstance(v, str) else "" for v in values]), PLAIN)
    found = [
        text if quoted else float(value) if isinstance(value, int | float) else None
        for value, quoted, text in zip(values, is_text, told.to_pylist(), strict=True)
    ]
    lost = [
        place
        for place, value in enumerate(values)
        if (wrong[place] if is_text[place] else not isinstance(value, int | float | None))
    ]
    return pa.array(found, pa.float64()), lost


def _infer(values: list[Any]) -> pa.Array:
    kinds = {type(v) for v in values if v is not None}
    if kinds == {int, float}:
        return pa.array([None if v is None else float(v) for v in values], pa.float64())
    return pa.array(values)
