"""Records of one kind -> Arrow tables, vectorised.

The records of one message are gathered into an (n, size) byte matrix, and each field is copied once into the
buffer of the table (`record_tables`). Nothing here calls `pa.array` on a NumPy array: its first call imports
pandas (0.2 to 0.3 s).
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
from flysid.ingest.formats.common.record_tables import HEADS, RecordCell, RecordForm

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
class RecordLayout:
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
        types = (self._cell(spec).type for spec in self.fields)
        return tuple(schema_field(spec, kind) for spec, kind in zip(self.fields, types, strict=True))

    @cached_property
    def _forms(self) -> dict[int, RecordForm]:
        return {}

    def table(self, schema: pa.Schema, heads: Sequence[IntArray | int], matrix: ByteMatrix) -> pa.Table:
        """Records as a table: time_ns, boot, maybe recv_ns, (n,) each or one number for all, then `fields`.

        Parameters
        ----------
        matrix : (n, size) C-contiguous bytes, one record per row.
        """
        form = self._forms.get(len(heads))
        if form is None:
            form = RecordForm(self.size, HEADS[: len(heads)], [self._cell(spec) for spec in self.fields])
            self._forms[len(heads)] = form
        return form.table(schema, heads, matrix.reshape(-1), len(matrix))

    def _cell(self, spec: Field) -> RecordCell:
        kind, offset = self.dtype.fields[spec.name][:2]  # type: ignore[index]
        return RecordCell(offset, kind.base, kind.shape[0] if kind.shape else 0)


def as_array(content: memoryview | bytes) -> npt.NDArray[np.uint8]:
    """Bytes as an array, not copied."""
    return np.frombuffer(content, dtype=np.uint8)


def numbers(values: npt.NDArray[np.generic]) -> pa.Array:
    """A 1-D numeric array as an Arrow array; (n, k) becomes a list of fixed size k."""
    return arrow_arrays.matrix(values) if values.ndim == 2 else arrow_arrays.numeric(values)


def schema_field(spec: Field, kind: pa.DataType) -> pa.Field:
    """The column's Arrow field with unit, scale and enumeration."""
    return pa.field(
        spec.name, kind, metadata=field_metadata(spec.unit, spec.scale, spec.enum, spec.description)
    )


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
