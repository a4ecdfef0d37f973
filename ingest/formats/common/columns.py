"""Records of one kind -> Arrow columns, vectorised.

The records of one message are gathered into an (n, size) byte matrix, viewed as a packed little-endian
dtype, and each field is copied once into a contiguous buffer that Arrow takes over as it is. Nothing
here calls `pa.array` on a NumPy array: its first call imports pandas (0.2 to 0.3 s).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.flight import BOOT, RECEIVED, TIME, field_metadata

ByteMatrix = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]

_ARROW_TYPES = {
    "i1": pa.int8(),
    "i2": pa.int16(),
    "i4": pa.int32(),
    "i8": pa.int64(),
    "u1": pa.uint8(),
    "u2": pa.uint16(),
    "u4": pa.uint32(),
    "u8": pa.uint64(),
    "f2": pa.float16(),
    "f4": pa.float32(),
    "f8": pa.float64(),
}


@dataclass(frozen=True)
class Field:
    """One field of a message. `is_text` marks bytes that end at the first NUL and become a string."""

    name: str
    is_text: bool = False
    unit: str = ""
    scale: float = 1.0
    enum: Mapping[int, str] = field(default_factory=dict)
    description: str = ""


@dataclass(frozen=True)
class Layout:
    """The packed layout of a message on the wire, and its fields in the order of the columns."""

    name: str
    dtype: np.dtype[np.void]
    fields: tuple[Field, ...]

    @property
    def size(self) -> int:
        return int(self.dtype.itemsize)


def as_array(content: memoryview | bytes) -> npt.NDArray[np.uint8]:
    """Bytes as an array, not copied."""
    return np.frombuffer(content, dtype=np.uint8)


def numbers(values: npt.NDArray[np.generic]) -> pa.Array:
    """A 1-D numeric array as an Arrow array; (n, k) becomes a list of fixed size k."""
    if values.ndim == 2:
        return pa.FixedSizeListArray.from_arrays(numbers(values.reshape(-1)), values.shape[1])
    native = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("="))
    kind = _ARROW_TYPES[native.dtype.str[1:]]
    return pa.Array.from_buffers(kind, len(native), [None, pa.py_buffer(native)])


def constant(value: int, count: int, dtype: type[np.integer]) -> pa.Array:
    """`count` times the same integer."""
    return numbers(np.full(count, value, dtype=dtype))


def texts(matrix: ByteMatrix) -> pa.Array:
    """(n, k) bytes as strings: each ends at its first NUL; bytes that are not UTF-8 become U+FFFD."""
    count, width = matrix.shape
    if width == 0 or count == 0:
        return strings([""] * count)
    ends = np.where((matrix == 0).any(axis=1), (matrix == 0).argmax(axis=1), width)
    kept = np.arange(width) < ends[:, None]
    if ((matrix & 0x80).astype(bool) & kept).any():
        rows = [bytes(row[:end]) for row, end in zip(matrix, ends.tolist(), strict=True)]
        return strings([row.decode("utf-8", "replace") for row in rows])
    offsets = np.zeros(count + 1, dtype=np.int32)
    np.cumsum(ends, out=offsets[1:])
    data = np.ascontiguousarray(matrix[kept])
    return pa.Array.from_buffers(pa.string(), count, [None, pa.py_buffer(offsets), pa.py_buffer(data)])


def strings(values: Sequence[str]) -> pa.Array:
    """Python strings as an Arrow array; lone surrogates become U+FFFD."""
    return pa.array([v.encode("utf-8", "replace").decode() for v in values], pa.string())


def schema_field(spec: Field, kind: pa.DataType) -> pa.Field:
    """The column's Arrow field with unit, scale and enumeration."""
    return pa.field(
        spec.name, kind, metadata=field_metadata(spec.unit, spec.scale, spec.enum, spec.description)
    )


def decode(matrix: ByteMatrix, layout: Layout) -> list[pa.Array]:
    """The columns of a message, in the order of `layout.fields`.

    Parameters
    ----------
    matrix : (n, layout.size) C-contiguous bytes, one record per row.
    """
    records = matrix.view(layout.dtype).reshape(len(matrix))
    columns = []
    for spec in layout.fields:
        if spec.is_text:
            start = layout.dtype.fields[spec.name][1]  # type: ignore[index]
            width = layout.dtype[spec.name].itemsize
            columns.append(texts(matrix[:, start : start + width]))
        else:
            columns.append(numbers(records[spec.name]))
    return columns


def message_schema(
    layout: Layout, columns: Sequence[pa.Array], metadata: Mapping[str, str], *, received: bool
) -> pa.Schema:
    """time_ns, boot, maybe recv_ns, then the message's fields; `metadata` goes to the schema."""
    heads = [pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32())]
    if received:
        heads.append(pa.field(RECEIVED, pa.int64()))
    taken = {TIME, BOOT, RECEIVED}
    fields = []
    for spec, column in zip(layout.fields, columns, strict=True):
        item = schema_field(spec, column.type)
        fields.append(item.with_name(item.name + "_") if item.name in taken else item)
    return pa.schema(heads + fields, metadata=dict(metadata))


def gather(buffer: npt.NDArray[np.uint8], starts: IntArray, lengths: IntArray, size: int) -> ByteMatrix:
    """(n, size) bytes: row i is buffer[starts[i]:][:lengths[i]], zero-padded or cut to `size`."""
    if size == 0 or not len(starts):
        return np.zeros((len(starts), size), dtype=np.uint8)
    beyond = np.flatnonzero(starts > len(buffer) - size)
    if len(beyond):
        return _gather_tail(buffer, starts, lengths, size, beyond)
    # one copy a row: a window of single bytes would be copied byte by byte
    windows = np.ndarray((len(buffer) - size + 1,), dtype=f"V{size}", buffer=buffer, strides=(1,))
    rows: ByteMatrix = windows[starts].view(np.uint8).reshape(len(starts), size)
    shortest = int(lengths.min())
    if shortest < size:
        rows[:, shortest:] *= np.arange(shortest, size) < lengths[:, None]
    return rows


def _gather_tail(
    buffer: npt.NDArray[np.uint8], starts: IntArray, lengths: IntArray, size: int, beyond: IntArray
) -> ByteMatrix:
    """`gather` where the windows of the rows `beyond` reach over the buffer's end."""
    rows = np.zeros((len(starts), size), dtype=np.uint8)
    within = np.setdiff1d(np.arange(len(starts)), beyond)
    rows[within] = gather(buffer, starts[within], lengths[within], size)
    for i in beyond.tolist():
        piece = buffer[starts[i] : starts[i] + min(int(lengths[i]), size)]
        rows[i, : len(piece)] = piece
    return rows
