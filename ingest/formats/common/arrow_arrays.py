"""NumPy values as Arrow arrays, built from their buffers.

`pyarrow.array(ndarray)` imports pandas on its first call (0.2 to 0.3 s); a buffer costs nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.flight import BOOT, RECEIVED, TIME
from flysid.ingest.formats.common.gather import Bytes, Index, Values, as_bytes

ARROW_TYPES: Mapping[str, pa.DataType] = {
    "b1": pa.bool_(),
    "i1": pa.int8(),
    "u1": pa.uint8(),
    "i2": pa.int16(),
    "u2": pa.uint16(),
    "i4": pa.int32(),
    "u4": pa.uint32(),
    "i8": pa.int64(),
    "u8": pa.uint64(),
    "f2": pa.float16(),
    "f4": pa.float32(),
    "f8": pa.float64(),
}

RESERVED = (TIME, BOOT, RECEIVED)


def numeric(values: Values) -> pa.Array:
    """A 1-D array of numbers (any byte order, any stride) or booleans."""
    kind = values.dtype
    if kind.kind == "b":
        packed = np.packbits(values, bitorder="little")
        return pa.Array.from_buffers(pa.bool_(), len(values), [None, pa.py_buffer(packed)])
    native, arrow = _types(kind)
    return pa.Array.from_buffers(
        arrow, len(values), [None, pa.py_buffer(np.ascontiguousarray(values, dtype=native))]
    )


def numeric_or_null(values: Iterable[float | None]) -> pa.Array:
    """Python numbers as float64, null for None."""
    every = list(values)
    numbers = np.array([np.nan if v is None else v for v in every], dtype=np.float64)
    is_there = np.packbits(np.array([v is not None for v in every], dtype=bool), bitorder="little")
    buffers = [pa.py_buffer(is_there), pa.py_buffer(numbers)]
    return pa.Array.from_buffers(pa.float64(), len(every), buffers)


def number_type(kind: np.dtype[Any]) -> pa.DataType:
    """Arrow's type of a number."""
    return _types(kind)[1]


@cache
def _types(kind: np.dtype[Any]) -> tuple[np.dtype[Any], pa.DataType]:
    """The type of numbers in this machine's byte order, and Arrow's."""
    return kind.newbyteorder("="), ARROW_TYPES[f"{kind.kind}{kind.itemsize}"]


def whole_numbers(array: pa.Array) -> Index:
    """An array of integers without nulls, as int64; `to_numpy` would import pandas."""
    kind = np.dtype(f"{'i' if pa.types.is_signed_integer(array.type) else 'u'}{array.type.bit_width // 8}")
    values = np.frombuffer(array.buffers()[1], dtype=kind, count=array.offset + len(array))
    return values[array.offset :].astype(np.int64)


def matrix(values: Values) -> pa.Array:
    """An (n, k) array as n lists of the fixed length k; k > 0."""
    return pa.FixedSizeListArray.from_arrays(numeric(values.reshape(-1)), values.shape[1])


def lists(child: pa.Array, counts: Index) -> pa.Array:
    """`child` cut into lists of the given lengths."""
    kind = pa.list_(child.type)
    return pa.Array.from_buffers(kind, len(counts), [None, pa.py_buffer(_offsets(counts))], children=[child])


def text(joined: Bytes, sizes: Index, kind: pa.DataType | None = None) -> pa.Array:
    """Strings (or `kind` binary) from their bytes one after the other; what is not UTF-8 becomes U+FFFD."""
    buffers = [None, pa.py_buffer(_offsets(sizes)), pa.py_buffer(np.ascontiguousarray(joined))]
    array = pa.Array.from_buffers(kind or pa.string(), len(sizes), buffers)
    if kind is None and len(joined) and int(joined.max()) >= 0x80:
        try:
            array.validate(full=True)
        except pa.ArrowInvalid:
            return pa.array([b.decode("utf-8", "replace") for b in _split(joined, sizes)], pa.string())
    return array


def fixed_text(values: Values) -> pa.Array:
    """Strings from an (n, k) array of characters, each cut at its first NUL."""
    width = values.shape[1]
    ends = np.where((values == 0).any(axis=1), (values == 0).argmax(axis=1), width).astype(np.int64)
    keep = np.arange(width) < ends[:, None]
    return text(values[keep].view(np.uint8), ends)


def strings(values: Iterable[str]) -> pa.Array:
    """Python strings; lone surrogates become "?"."""
    every: list[str] = list(values)
    joined = "".join(every)
    if joined.isascii():
        sizes = np.fromiter(map(len, every), np.int64, len(every))
        return text(as_bytes(joined.encode()), sizes)
    encoded = [v.encode("utf-8", "replace") for v in every]
    sizes = np.array([len(v) for v in encoded], dtype=np.int64)
    return text(as_bytes(b"".join(encoded)), sizes)


def blobs(values: Sequence[bytes]) -> pa.Array:
    """Byte strings."""
    sizes = np.array([len(v) for v in values], dtype=np.int64)
    buffers = [None, pa.py_buffer(_offsets(sizes)), pa.py_buffer(b"".join(values))]
    return pa.Array.from_buffers(pa.binary(), len(values), buffers)


def structs(names: Sequence[str], children: Sequence[pa.Array]) -> pa.Array:
    """One struct per element from equally long children; there must be at least one."""
    return pa.StructArray.from_arrays(list(children), names=list(names))


def free_name(name: str, taken: Mapping[str, object] | set[str]) -> str:
    """`name`, with underscores after it until it is neither reserved nor taken."""
    while name in RESERVED or name in taken:
        name += "_"
    return name


def _offsets(counts: Index) -> Values:
    ends = np.zeros(len(counts) + 1, dtype=np.int64)
    np.cumsum(counts, out=ends[1:])
    if ends[-1] > np.iinfo(np.int32).max:
        raise OverflowError("more than 2^31 elements in one column part")
    return ends.astype(np.int32)


def _split(joined: Bytes, sizes: Index) -> list[bytes]:
    whole = joined.tobytes()
    ends = np.cumsum(sizes).tolist()
    return [whole[end - size : end] for end, size in zip(ends, sizes.tolist(), strict=True)]
