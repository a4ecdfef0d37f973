"""ULog formats ("F" records) as NumPy layouts.

A format is `name:type field;type[3] field;other_format field;...`. Nested formats flatten to dotted names,
arrays of them to `field[0].x`; arrays of numbers stay arrays, `char[n]` becomes text. Padding fields
(_padding0) at the very end may be missing from the records.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from flysid.ingest.formats.common.record_tables import HEADS, RecordCell, RecordForm

MAX_RECORD_BYTES = 0xFFFF
MAX_FIELDS = 4000
MAX_DEPTH = 16

NUMBERS: Mapping[str, str] = {
    "int8_t": "i1",
    "uint8_t": "u1",
    "int16_t": "<i2",
    "uint16_t": "<u2",
    "int32_t": "<i4",
    "uint32_t": "<u4",
    "int64_t": "<i8",
    "uint64_t": "<u8",
    "float": "<f4",
    "double": "<f8",
    "bool": "u1",
    "char": "i1",
}
_KINDS = {**{kind: np.dtype(code) for kind, code in NUMBERS.items()}, "bool": np.dtype(np.bool_)}
MAX_FIELD_TEXTS = 1 << 12
MAX_FIELD_CHARS = 1 << 10
MAX_SHARED_CHARS = 1 << 12  # of a layout that is kept for the next log
_FIELD = re.compile(r"^\s*(?P<type>[^\s\[\]]+)(?:\[(?P<size>\d{1,5})\])?\s+(?P<name>\S.*?)\s*$")


class LayoutError(ValueError):
    """A format that gives no layout; the message says why."""


@dataclass(frozen=True, slots=True)
class UlogField:
    """A column: dotted name, byte offset, element type as in the format, number of elements (0: a scalar).

    `size` is the bytes of all elements.
    """

    name: str
    offset: int
    kind: str
    count: int
    size: int


@dataclass(frozen=True)
class UlogLayout:
    """A flattened format. `size` is without the padding at the end, `full_size` with it."""

    fields: tuple[UlogField, ...]
    full_size: int

    def __hash__(self) -> int:
        return hash((self.full_size, len(self.fields)))  # cheap: layouts are keys of caches

    @cached_property
    def size(self) -> int:
        """Bytes of a record without the padding at its end."""
        return max((f.offset + f.size for f in self.fields), default=0)

    @cached_property
    def time(self) -> UlogField | None:
        """The field `timestamp`, in microseconds, where it is a whole number."""
        for field in self.fields:
            if field.name == "timestamp" and not field.count and NUMBERS[field.kind].strip("<")[0] in "iu":
                return field
        return None

    @cached_property
    def utc(self) -> UlogField | None:
        """The field that carries UTC in microseconds."""
        return next((f for f in self.fields if f.name == "time_utc_usec" and not f.count), None)

    @cached_property
    def form(self) -> RecordForm:
        """How records become a table: time_ns, boot, then the fields."""
        return RecordForm(self.size, HEADS[:2], [_cell(field) for field in self.fields])

    def dtype(self) -> np.dtype[np.void]:
        """Structured type of one record; columns are numbered."""
        return np.dtype(
            {
                "names": [str(k) for k in range(len(self.fields))],
                "formats": [(NUMBERS[f.kind], f.count) if f.count else NUMBERS[f.kind] for f in self.fields],
                "offsets": [f.offset for f in self.fields],
                "itemsize": self.size,
            }
        )


def _cell(field: UlogField) -> RecordCell:
    """A field as a column."""
    if field.kind == "char" and field.count:
        return RecordCell(field.offset, np.dtype(f"S{field.count}"))
    return RecordCell(field.offset, _KINDS[field.kind], field.count)


def parse_format(text: str) -> tuple[str, str]:
    """Name and fields of a format record. Raises LayoutError where there is no name."""
    name, colon, fields = text.partition(":")
    if not colon or not name:
        raise LayoutError("a format without a name")
    return name, fields


def flatten(name: str, formats: Mapping[str, str]) -> UlogLayout:
    """The layout of format `name`. Raises LayoutError: unknown, recursive, malformed, or too large.

    Logs of one kind share their layouts: a small log has nearly as many formats as rows.
    """
    if name in formats and (known := _plain(formats[name])) is not None:
        return known
    return _share(_flatten(name, formats))


@lru_cache(maxsize=1024)
def _share(layout: UlogLayout) -> UlogLayout:
    """The first layout that is equal: what it has made of itself is not made again."""
    return layout


@lru_cache(maxsize=1024)
def _plain(text: str) -> UlogLayout | None:
    """The layout of a format that holds no other one; None where it does, or cannot be read."""
    if len(text) > MAX_SHARED_CHARS:
        return None
    try:
        return _flatten("", {"": text})
    except LayoutError:
        return None


def _flatten(name: str, formats: Mapping[str, str]) -> UlogLayout:
    fields: list[UlogField] = []
    end = _flatten_into(name, "", 0, (formats, fields, ()))
    while fields and fields[-1].name.startswith("_padding"):
        fields.pop()
    if not fields:
        raise LayoutError(f"format {name} has no fields")
    return UlogLayout(tuple(fields), end)


_State = tuple[Mapping[str, str], list[UlogField], tuple[str, ...]]


def _flatten_into(name: str, prefix: str, at: int, state: _State) -> int:
    formats, fields, above = state
    if name not in formats:
        raise LayoutError(f"format {name} is not defined")
    if name in above or len(above) >= MAX_DEPTH:
        raise LayoutError(f"format {name} contains itself")
    inner = (formats, fields, (*above, name))
    for raw in formats[name].split(";"):
        if not raw.strip():
            continue
        found = parse_field(raw) if len(raw) <= MAX_FIELD_CHARS else None
        if found is None:
            raise LayoutError(f"cannot read field {raw[:60]!r} of format {name}")
        at = _place(found, prefix, at, inner)
        if at > MAX_RECORD_BYTES or len(fields) > MAX_FIELDS:
            raise LayoutError(f"format {name} is larger than a record")
    return at


@lru_cache(maxsize=MAX_FIELD_TEXTS)
def parse_field(text: str) -> tuple[str, int | None, str] | None:
    """Type, number of elements (None: no array) and name of a field; None where it is malformed."""
    found = _FIELD.match(text)
    if found is None:
        return None
    return found["type"], None if found["size"] is None else int(found["size"]), found["name"]


def _place(found: tuple[str, int | None, str], prefix: str, at: int, state: _State) -> int:
    """Add one field at `at`; returns where the next one begins."""
    kind, size, name = found
    count = size or 0
    path = prefix + name
    if kind in NUMBERS:
        if size == 0:
            return at
        bytes_taken = _KINDS[kind].itemsize * max(count, 1)
        state[1].append(UlogField(path, at, kind, count, bytes_taken))
        return at + bytes_taken
    if size is None:
        return _flatten_into(kind, f"{path}.", at, state)
    for k in range(count):
        at = _flatten_into(kind, f"{path}[{k}].", at, state)
        if at > MAX_RECORD_BYTES or len(state[1]) > MAX_FIELDS:
            break
    return at
