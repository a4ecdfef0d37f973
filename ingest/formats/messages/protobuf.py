"""Protobuf messages of one topic as columns, decoded with the descriptors that the log carries.

Fields of nested messages become dotted columns, repeated fields lists, maps lists of (key, value), enums
their numbers with names in the metadata. An absent field reads its default, as in protobuf itself. A message
that contains itself is kept as its bytes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.flight import field_metadata
from flysid.ingest.formats.common import arrow_arrays
from flysid.ingest.formats.common.gather import Bytes, Index
from flysid.ingest.formats.messages.definitions import DefinitionError

MAX_LEAVES = 20_000
MAX_DEPTH = 16
MAX_FILES = 2000

# google.protobuf.descriptor.FieldDescriptor.CPPTYPE_* -> type
_TYPES: Mapping[int, str] = {
    1: "i4",
    2: "i8",
    3: "u4",
    4: "u8",
    5: "f8",
    6: "f4",
    7: "b1",
    8: "i4",
    9: "str",
    10: "message",
}
_ENUM = 8
_BYTES_TYPE = 12


@dataclass(frozen=True)
class ProtoField:
    """A field of a message: its own name and dotted path, and what its values are.

    `shape` is "one", "many" (repeated) or "map"; `dtype` a NumPy type, or "str", "bytes" or "message", whose
    own columns are `inner`. `metadata` is that of the column.
    """

    name: str
    path: str
    shape: str
    dtype: str
    metadata: dict[bytes, bytes] | None = None
    inner: tuple[ProtoField, ...] = ()

    def inner_names(self) -> list[str]:
        """Names of the columns of the nested message."""
        return [name for name, _ in _columns_of(self.inner)]


@dataclass(frozen=True)
class ProtoLayout:
    """A message class and its fields; those of nested messages are inside theirs."""

    message: Any
    fields: tuple[ProtoField, ...]

    def columns(self) -> Iterator[tuple[str, dict[bytes, bytes] | None]]:
        """Dotted name and metadata of every column, in order."""
        return _columns_of(self.fields)


def _columns_of(fields: Sequence[ProtoField]) -> Iterator[tuple[str, dict[bytes, bytes] | None]]:
    for field in fields:
        if field.shape == "one" and field.dtype == "message":
            yield from _columns_of(field.inner)
        else:
            yield field.path, field.metadata


def parse_descriptors(name: str, raw: bytes) -> ProtoLayout:
    """The layout of message `name` from a serialised FileDescriptorSet.

    Raises
    ------
    DefinitionError : protobuf is not installed, or the set does not define the message.
    """
    try:
        from google.protobuf.message import DecodeError
        from google.protobuf.message_factory import GetMessageClass
    except ImportError as error:
        raise DefinitionError("protobuf topics need the package protobuf: pip install protobuf") from error
    try:
        descriptor = _pool(raw).FindMessageTypeByName(name)
    except (DecodeError, KeyError, TypeError, ValueError) as error:
        raise DefinitionError(f"descriptors do not define {name}: {error}") from error
    fields = tuple(_fields(descriptor, "", (descriptor.full_name,), [0]))
    return ProtoLayout(GetMessageClass(descriptor), fields)


def _pool(raw: bytes) -> Any:
    """A pool of the files in a descriptor set, each after those it imports."""
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from google.protobuf.descriptor_pool import DescriptorPool

    files = {file.name: file for file in FileDescriptorSet.FromString(raw).file}
    if len(files) > MAX_FILES:
        raise ValueError(f"{len(files)} descriptor files")
    pool = DescriptorPool()
    added: set[str] = set()
    stack = list(files)
    while stack:
        file = files[stack[-1]]
        needed = [d for d in file.dependency if d in files and d not in added]
        if needed and len(stack) <= 2 * len(files):
            stack += needed
            continue
        stack.pop()
        if file.name not in added:
            added.add(file.name)
            pool.Add(file)
    return pool


def _fields(descriptor: Any, path: str, above: tuple[str, ...], leaves: list[int]) -> Iterator[ProtoField]:
    """Columns of a message type; `leaves` counts them all."""
    for field in descriptor.fields:
        leaves[0] += 1
        if leaves[0] > MAX_LEAVES:
            raise DefinitionError(f"more than {MAX_LEAVES} fields")
        here = f"{path}.{field.name}" if path else field.name
        dtype = "bytes" if field.type == _BYTES_TYPE else _TYPES[field.cpp_type]
        if dtype != "message":
            yield ProtoField(
                field.name, here, "many" if _repeated(field) else "one", dtype, _enum_names(field)
            )
            continue
        kind = field.message_type
        if kind.full_name in above or len(above) >= MAX_DEPTH:
            yield ProtoField(field.name, here, "many" if _repeated(field) else "one", "serial")
        elif not _repeated(field):
            inner = tuple(_fields(kind, here, (*above, kind.full_name), leaves))
            yield ProtoField(field.name, here, "one", "message", None, inner)
        else:
            inner = tuple(_fields(kind, "", (*above, kind.full_name), leaves))
            shape = "map" if kind.GetOptions().map_entry else "many"
            yield ProtoField(field.name, here, shape, "message", None, inner)


def _repeated(field: Any) -> bool:
    if hasattr(field, "is_repeated"):
        return bool(field.is_repeated)
    return bool(field.label == 3)


def _enum_names(field: Any) -> dict[bytes, bytes] | None:
    if field.cpp_type != _ENUM:
        return None
    return field_metadata(enum={v.number: v.name for v in field.enum_type.values})


def decode_protobuf(data: Bytes, at: Index, size: Index, layout: ProtoLayout) -> tuple[list[pa.Array], Index]:
    """One array per column of the layout, and the numbers of the messages that parse."""
    from google.protobuf.message import DecodeError

    window = data.data
    parse = layout.message.FromString
    messages = []
    kept = []
    for number, (start, length) in enumerate(zip(at.tolist(), size.tolist(), strict=True)):
        try:
            messages.append(parse(bytes(window[start : start + length])))
        except DecodeError:
            continue
        kept.append(number)
    return list(_arrays(messages, layout.fields)), np.array(kept, dtype=np.int64)


def _arrays(messages: Sequence[Any], fields: Sequence[ProtoField]) -> Iterator[pa.Array]:
    """Arrays of all columns; each nested message is taken from its owner once, not once a field."""
    for field in fields:
        if field.shape == "one" and field.dtype == "message":
            yield from _arrays(list(map(attrgetter(field.name), messages)), field.inner)
        else:
            yield _column(messages, field)


def _column(messages: Sequence[Any], field: ProtoField) -> pa.Array:
    values = map(attrgetter(field.name), messages)
    if field.shape == "one":
        return _values(values, len(messages), field.dtype)
    containers = list(values)
    counts = np.fromiter(map(len, containers), dtype=np.int64, count=len(containers))
    total = int(counts.sum())
    if field.shape == "map":
        return arrow_arrays.lists(_entries(containers, total, field), counts)
    flat = chain.from_iterable(containers)
    if field.dtype != "message":
        return arrow_arrays.lists(_values(flat, total, field.dtype), counts)
    return arrow_arrays.lists(_records(list(flat), field.inner), counts)


def _values(values: Iterable[Any], count: int, dtype: str) -> pa.Array:
    if dtype == "str":
        return arrow_arrays.strings(values)
    if dtype == "bytes":
        return arrow_arrays.blobs(list(values))
    if dtype == "serial":
        return arrow_arrays.blobs([v.SerializeToString() for v in values])
    return arrow_arrays.numeric(np.fromiter(values, dtype=dtype, count=count))


def _records(messages: Sequence[Any], fields: Sequence[ProtoField]) -> pa.Array:
    if not fields:
        return pa.nulls(len(messages))
    return arrow_arrays.structs([n for n, _ in _columns_of(fields)], list(_arrays(messages, fields)))


def _entries(containers: Sequence[Mapping[Any, Any]], total: int, field: ProtoField) -> pa.Array:
    """The (key, value) pairs of maps; `field.inner` begins with the key."""
    items = list(chain.from_iterable(c.items() for c in containers))
    key, *rest = field.inner
    keys = _values((k for k, _ in items), total, key.dtype)
    value = rest[0]
    if value.dtype == "message":
        values = list(_arrays([v for _, v in items], value.inner))
    else:
        values = [_values((v for _, v in items), total, value.dtype)]
    return arrow_arrays.structs(field.inner_names(), [keys, *values])
