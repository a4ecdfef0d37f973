"""Records of one kind -> Arrow columns, vectorised.

The records of one message are gathered into an (n, size) byte matrix, viewed as a packed little-endian
dtype, and each field is copied once into a contiguous buffer that Arrow takes over as it is. Nothing
here calls `pa.array` on a NumPy array: its first call imports pandas (0.2 to 0.3 s).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.flight import BOOT, RECEIVED, TIME, field_metadata
from flysid.ingest.formats.common import arrow_arrays

ByteMatrix = npt.NDArray[np.uint8]
IntArray = npt.NDArray[np.int64]

_HEADS = (pa.field(TIME, pa.int64()), pa.field(BOOT, pa.int32()), pa.field(RECEIVED, pa.int64()))


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

    @cached_property
    def columns(self) -> tuple[pa.Field, ...]:
        """The Arrow fields of `fields`. Logs of one process share them: a small log has as many as rows."""
        return tuple(schema_field(spec, self._kind(spec)) for spec in self.fields)

    def _kind(self, spec: Field) -> pa.DataType:
        if spec.is_text:
            return pa.string()
        kind = self.dtype[spec.name]
        number = arrow_arrays.number_type(kind.base)
        return pa.list_(number, kind.shape[0]) if kind.shape else number


def as_array(content: memoryview | bytes) -> npt.NDArray[np.uint8]:
    """Bytes as an array, not copied."""
    return np.frombuffer(content, dtype=np.uint8)


def numbers(values: npt.NDArray[np.generic]) -> pa.Array:
    """A 1-D numeric array as an Arrow array; (n, k) becomes a list of fixed size k."""
    return arrow_arrays.matrix(values) if values.ndim == 2 else arrow_arrays.numeric(values)


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


def message_schema(fields: Iterable[pa.Field], metadata: Mapping[str, str], *, received: bool) -> pa.Schema:
    """time_ns, boot, maybe recv_ns, then the message's fields; `metadata` goes to the schema."""
    heads = _HEADS if received else _HEADS[:2]
    own = [f.with_name(f.name + "_") if f.name in arrow_arrays.RESERVED else f for f in fields]
    return pa.schema([*heads, *own], metadata=dict(metadata))


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
