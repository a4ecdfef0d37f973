"""Protobuf messages of one type, decoded together from the wire: one step per field, not per message.

A message is a sequence of keys (varint: field number << 3 | wire type) and values: 0 varint, 1 eight bytes,
2 length and bytes, 5 four bytes. All messages advance by one field at a time; those with the same key are
read with one gather. Unknown fields are stepped over, absent ones read their default, repeated scalars may
be packed or not. Source: the protobuf encoding guide. What it leaves to the protobuf library
(`LeftToLibrary`): groups, nested messages that occur twice and must be merged, and messages of a great many
fields.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.gather import Bytes, Index, Values, numbers, runs, spread
from flysid.ingest.formats.messages.protobuf import ProtoField

MAX_STEPS = 20_000
VARINT, EIGHT, LENGTH, FOUR = 0, 1, 2, 5
ZIGZAG = (17, 18)
FIXED = {1: "<f8", 2: "<f4", 6: "<u8", 7: "<u4", 15: "<i4", 16: "<i8"}  # descriptor type -> NumPy
ZERO_BYTES = 16  # that must follow the data


class LeftToLibrary(ValueError):
    """Something in these messages is not read here."""


@dataclass
class _Occurrences:
    """Values of one field: the message each belongs to, and numbers, or places and sizes of bytes."""

    rows: list[Index] = field(default_factory=list)
    values: list[Values] = field(default_factory=list)
    starts: list[Index] = field(default_factory=list)
    sizes: list[Index] = field(default_factory=list)

    def sorted(self, parts: Sequence[Values], order: Index) -> Values:
        joined: Values = np.concatenate(parts)[order]
        return joined


@dataclass
class _Walk:
    """Messages data[at : end] of one type on their way through their fields."""

    data: Bytes
    at: Index
    end: Index
    bad: NDArray[np.bool_]
    budget: list[int]


def decode_wire(
    data: Bytes, at: Index, size: Index, fields: Sequence[ProtoField]
) -> tuple[list[pa.Array], Index]:
    """One array per column, and the numbers of the messages that are well formed.

    `data` must end with `ZERO_BYTES` zeros. Columns have one row per message, malformed ones included.

    Raises
    ------
    LeftToLibrary : see the module.
    """
    bad = np.zeros(len(at), dtype=np.bool_)
    walk = _Walk(data, at.copy(), at + size, bad, [MAX_STEPS])
    columns = _columns(walk, fields)
    return columns, np.flatnonzero(~walk.bad)


def _columns(walk: _Walk, fields: Sequence[ProtoField]) -> list[pa.Array]:
    found = {f.number: _Occurrences() for f in fields}
    known = {f.number: f for f in fields}
    active = np.flatnonzero((walk.at < walk.end) & ~walk.bad)
    while len(active):
        walk.budget[0] -= 1
        if walk.budget[0] < 0:
            raise LeftToLibrary("too many fields")
        keys = _take_varints(walk, active)
        first = keys[0]
        groups = [(int(first), active)]
        if not (keys == first).all():
            groups = [(int(k), active[keys == k]) for k in np.unique(keys)]
        for key, rows in groups:
            spec = known.get(key >> 3)
            _take(walk, rows, key & 7, (spec, found[spec.number]) if spec else None)
        active = active[(walk.at[active] < walk.end[active]) & ~walk.bad[active]]
    arrays: list[pa.Array] = []
    for spec in fields:
        arrays += _arrays(walk, spec, found[spec.number])
    return arrays


def _take_varints(walk: _Walk, rows: Index) -> NDArray[np.uint64]:
    value, width = varints(walk.data, walk.at[rows])
    walk.at[rows] += width
    walk.bad[rows] |= (walk.at[rows] > walk.end[rows]) | (width > 10)
    return value


def varints(data: Bytes, at: Index) -> tuple[NDArray[np.uint64], Index]:
    """Values and widths of the varints at `at`; a width of 11 marks one that does not end."""
    byte = data[at]
    value = (byte & 0x7F).astype(np.uint64)
    width = np.ones(len(at), dtype=np.int64)
    more = np.flatnonzero(byte >= 0x80)
    for place in range(1, 11):
        if not len(more):
            break
        width[more] += 1
        if place == 10:
            break
        byte = data[at[more] + place]
        value[more] |= (byte & 0x7F).astype(np.uint64) << np.uint64(7 * place)
        more = more[byte >= 0x80]
    return value, width


def _take(walk: _Walk, rows: Index, wire: int, target: tuple[ProtoField, _Occurrences] | None) -> None:
    """Read one value of wire type `wire` in each of `rows`, and pass it."""
    rows = rows[~walk.bad[rows]]
    if wire == VARINT:
        value = _take_varints(walk, rows)
        if target is not None and target[0].wire not in FIXED and target[0].dtype not in _BYTES:
            target[1].rows.append(rows)
            target[1].values.append(_converted(value, target[0]))
    elif wire in (EIGHT, FOUR):
        _take_fixed(walk, rows, 8 if wire == EIGHT else 4, target)
    elif wire == LENGTH:
        _take_bytes(walk, rows, target)
    else:
        raise LeftToLibrary("groups")


def _take_fixed(walk: _Walk, rows: Index, size: int, target: tuple[ProtoField, _Occurrences] | None) -> None:
    start = walk.at[rows]
    walk.at[rows] += size
    walk.bad[rows] |= walk.at[rows] > walk.end[rows]
    if target is None or np.dtype(FIXED.get(target[0].wire, "u1")).itemsize != size:
        return
    good = ~walk.bad[rows]
    target[1].rows.append(rows[good])
    target[1].values.append(numbers(walk.data, start[good], FIXED[target[0].wire]))


def _take_bytes(walk: _Walk, rows: Index, target: tuple[ProtoField, _Occurrences] | None) -> None:
    length = _take_varints(walk, rows)
    room = np.maximum(walk.end[rows] - walk.at[rows], 0)
    walk.bad[rows] |= length > room.astype(np.uint64)
    size = np.where(walk.bad[rows], 0, np.minimum(length, np.uint64(1 << 62)).astype(np.int64))
    start = walk.at[rows]
    walk.at[rows] += size
    if target is None:
        return
    good = ~walk.bad[rows]
    rows, start, size = rows[good], start[good], size[good]
    spec, found = target
    if spec.dtype in _BYTES:
        found.rows.append(rows)
        found.starts.append(start)
        found.sizes.append(size)
    elif spec.shape == "many":
        _unpack(walk, (rows, start, size), spec, found)


def _unpack(walk: _Walk, packed: tuple[Index, Index, Index], spec: ProtoField, found: _Occurrences) -> None:
    """The elements of packed repeated fields."""
    rows, start, size = packed
    if spec.wire in FIXED:
        width = np.dtype(FIXED[spec.wire]).itemsize
        walk.bad[rows] |= size % width != 0
        count = size // width
        places = np.repeat(start, count) + spread(np.zeros_like(count), count) * width
        values = numbers(walk.data, places, FIXED[spec.wire])
    else:
        inside = runs(walk.data, start, size)
        last = np.flatnonzero(inside < 0x80)
        owner = np.repeat(np.arange(len(rows)), size)
        count = np.bincount(owner[last], minlength=len(rows))
        joined = np.concatenate([inside, np.zeros(ZERO_BYTES, dtype=np.uint8)])
        ends = np.cumsum(size)
        unfinished = (size > 0) & (joined[ends - 1] >= 0x80)
        if unfinished.any():
            raise LeftToLibrary("a packed field that ends inside a number")
        value, width_each = varints(joined, np.append(0, last[:-1] + 1) if len(last) else last)
        if (width_each > 10).any():
            raise LeftToLibrary("a number of more than ten bytes")
        values = _converted(value, spec)
    found.rows.append(np.repeat(rows, count))
    found.values.append(values)


def _converted(value: NDArray[np.uint64], spec: ProtoField) -> Values:
    """Varints as the field's own type."""
    if spec.wire in ZIGZAG:
        value = (value >> np.uint64(1)) ^ (np.uint64(0) - (value & np.uint64(1)))
    if spec.dtype == "b1":
        true: Values = value != 0
        return true
    if spec.dtype in ("i4", "u4"):
        low: Values = value.astype(np.uint32).view(spec.dtype)
        return low
    whole: Values = value.view(spec.dtype)
    return whole


_BYTES = ("str", "bytes", "serial", "message")


def _arrays(walk: _Walk, spec: ProtoField, found: _Occurrences) -> list[pa.Array]:
    """The column (or columns, of a nested message) of one field."""
    count = len(walk.at)
    rows = np.concatenate(found.rows) if found.rows else np.empty(0, dtype=np.int64)
    if spec.shape != "one":
        return [_repeated(walk, spec, found, rows)]
    if spec.dtype not in _BYTES:
        values = np.full(count, spec.default, dtype=spec.dtype)
        for own, part in zip(found.rows, found.values, strict=True):
            values[own] = part
        return [arrow_arrays.numeric(values)]
    start, size = np.zeros(count, dtype=np.int64), np.zeros(count, dtype=np.int64)
    for own, s, n in zip(found.rows, found.starts, found.sizes, strict=True):
        start[own], size[own] = s, n
    if spec.dtype != "message":
        return [_bytes_array(walk.data, start, size, spec.dtype)]
    if len(found.rows) > 1 and len(np.unique(rows)) != len(rows):
        raise LeftToLibrary("a nested message in pieces")
    inner = _Walk(walk.data, start, start + size, np.zeros(count, dtype=np.bool_), walk.budget)
    columns = _columns(inner, spec.inner)
    walk.bad |= inner.bad
    return columns


def _repeated(walk: _Walk, spec: ProtoField, found: _Occurrences, rows: Index) -> pa.Array:
    order = np.argsort(rows, kind="stable")
    counts = np.bincount(rows, minlength=len(walk.at))
    if spec.dtype not in _BYTES:
        values = found.sorted(found.values, order) if found.values else np.empty(0, dtype=spec.dtype)
        return arrow_arrays.lists(arrow_arrays.numeric(values), counts)
    none = np.empty(0, dtype=np.int64)
    start = found.sorted(found.starts, order) if found.starts else none
    size = found.sorted(found.sizes, order) if found.sizes else none
    if spec.dtype != "message":
        return arrow_arrays.lists(_bytes_array(walk.data, start, size, spec.dtype), counts)
    inner = _Walk(walk.data, start.copy(), start + size, np.zeros(len(start), dtype=np.bool_), walk.budget)
    columns = _columns(inner, spec.inner)
    walk.bad[rows[order][inner.bad]] = True
    return arrow_arrays.lists(arrow_arrays.structs(spec.inner_names(), columns), counts)


def _bytes_array(data: Bytes, start: Index, size: Index, dtype: str) -> pa.Array:
    joined = runs(data, start, size)
    if dtype == "str":
        return arrow_arrays.text(joined, size)
    return arrow_arrays.text(joined, size, pa.binary())
