"""Rows of a parquet file a stretch at a time, so that no file takes more memory than a few stretches.

Few bytes can stand for many: a run of one number, a list that repeats, a text that thousands of rows share.
Rows are decoded in stretches of about as many bytes as the caller wants, text as a dictionary and the numbers
of its entries: what it takes once it is spelt out is known before.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from flysid.ingest.formats.base import Limits

FREE_BYTES = 64 << 20  # below this, the ratio is not held against a file
CELL_BYTES = 8
DAMAGE = (pa.ArrowException, OSError, ValueError, OverflowError, KeyError, IndexError)
TEXT = "BYTE_ARRAY"
FIXED = "FIXED_LEN_BYTE_ARRAY"


def open_file(view: memoryview) -> pq.ParquetFile:
    """A parquet file whose text is read as dictionaries. Raises what `DAMAGE` names."""
    source = pa.py_buffer(view)
    schema = pq.ParquetFile(pa.BufferReader(source)).metadata.schema
    leaves = [schema.column(k) for k in range(len(schema))]
    texts = [c.path for c in leaves if c.physical_type == TEXT and c.logical_type.type in ("STRING", "NONE")]
    return pq.ParquetFile(pa.BufferReader(source), page_checksum_verification=True, read_dictionary=texts)


def too_large(file: pq.ParquetFile, groups: Sequence[int], limits: Limits) -> dict[str, str]:
    """Columns that expand far beyond what they take in the file, by their name, with the reason.

    Lists and fixed sizes alone: a cell of any other kind takes no more than a number, or is text.

    `groups`: those whose metadata are sound; asking Arrow for others ends the process.
    """
    schema = file.metadata.schema
    leaves = [schema.column(k) for k in range(len(schema))]
    expanded: dict[str, int] = {}
    packed: dict[str, int] = {}
    for number in groups:
        group = file.metadata.row_group(number)
        for k, leaf in enumerate(leaves):
            if leaf.max_repetition_level or leaf.physical_type == FIXED:
                top = leaf.path.partition(".")[0]
                chunk = group.column(k)
                expanded[top] = expanded.get(top, 0) + chunk.num_values * _width(leaf)
                packed[top] = packed.get(top, 0) + chunk.total_compressed_size
    return {
        top: f"it expands to more than {limits.max_ratio:g} times its size"
        for top, size in expanded.items()
        if size > max(FREE_BYTES, limits.max_ratio * packed[top])
    }


def _width(leaf: pq.ColumnSchema) -> int:
    """Bytes of a cell of a column, as far as they are known before it is read."""
    return max(CELL_BYTES, leaf.length or 0) if leaf.physical_type == FIXED else CELL_BYTES


@dataclass(frozen=True)
class RowGroup:
    """A row group: its number, rows, and bytes [start, end) in the file; 0, 0 where these are not known.

    Attributes
    ----------
    fault : why it is not read.
    is_sound : whether its metadata may be asked for.
    """

    number: int
    rows: int
    start: int
    end: int
    fault: str = ""
    is_sound: bool = True


@dataclass(frozen=True)
class Stretches:
    """The rows of a group, by the columns that are wanted.

    Attributes
    ----------
    rows : that the group states.
    names : of columns of the file; those of one name are read together.
    size : rows of a stretch.
    """

    file: pq.ParquetFile
    group: int
    rows: int
    names: Sequence[str]
    size: int

    @classmethod
    def of(cls, file: pq.ParquetFile, group: RowGroup, names: Sequence[str], stretch_bytes: int) -> Stretches:
        """Stretches of about this many bytes."""
        facts = file.metadata.row_group(group.number)
        leaves = [file.metadata.schema.column(k) for k in range(facts.num_columns)]
        counts = [facts.column(k).num_values if group.is_sound else group.rows for k in range(len(leaves))]
        cells = sum(count * _width(leaf) for count, leaf in zip(counts, leaves, strict=True))
        size = max(1, min(group.rows, stretch_bytes * group.rows // max(cells, 1)))
        return cls(file, group.number, group.rows, names, size)

    def together(self) -> Iterator[pa.Table]:
        """Stretches of all columns, up to the first that cannot be read."""
        left = self.rows
        try:
            for batch in self._batches(self.names):
                if batch.num_rows > left:
                    return
                left -= batch.num_rows
                yield pa.Table.from_batches([batch])
        except DAMAGE:
            return

    def faults(self) -> dict[str, str]:
        """Columns that cannot be read to their end, and why."""
        found = {}
        for name in self.names:
            try:
                rows = sum(batch.num_rows for batch in self._batches([name]))
                if rows != self.rows:
                    found[name] = f"{rows} rows of {self.rows}"
            except DAMAGE as error:
                found[name] = first_line(error)
        return found

    def without(self, lost: Mapping[str, str], done: int) -> Iterator[pa.Table]:
        """Stretches behind `done` rows; the columns that are lost are null."""
        sound = [name for name in self.names if name not in lost]
        schema = self.file.schema_arrow
        for table in islice(
            Stretches(self.file, self.group, self.rows, sound, self.size).together(), done // self.size, None
        ):
            columns = []
            fields = []
            at = 0
            for name in self.names:
                for place in schema.get_all_field_indices(name):
                    field = schema.field(place)
                    if name in lost:
                        columns.append(pa.nulls(len(table), field.type))
                    else:
                        columns.append(table.column(at))
                        field = table.schema.field(at)
                        at += 1
                    fields.append(field)
            yield pa.Table.from_arrays(columns, schema=pa.schema(fields))

    def _batches(self, names: Sequence[str]) -> Iterator[pa.RecordBatch]:
        chosen = {"row_groups": [self.group], "columns": list(names), "use_threads": False}
        yield from self.file.iter_batches(self.size, **chosen)


def cells(table: pa.Table, top: str, nth: int = 0) -> pa.Array:
    """The cells of the column of this name, or of the `nth` of several, as one array."""
    values = table.column(table.schema.get_all_field_indices(top)[nth]).combine_chunks()
    if not isinstance(values, pa.ChunkedArray):
        return values
    return pa.concat_arrays(values.chunks) if values.num_chunks else pa.array([], values.type)


def first_line(error: BaseException) -> str:
    """What an error says, in a line."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


# ------------------------------------------------------------------------------------------------- text


def spelt_bytes(column: pa.Array) -> int:
    """Bytes that the text in a dictionary column takes once it is spelt out; 0 of any other column."""
    if not pa.types.is_dictionary(column.type) or not is_text(column.type.value_type):
        return 0
    sizes = pc.binary_length(column.dictionary).cast(pa.int64())
    return pc.sum(sizes.take(column.indices)).as_py() or 0


def is_text(kind: pa.DataType) -> bool:
    """Whether cells of this type are of any size."""
    types = pa.types
    tests = (types.is_string, types.is_large_string, types.is_binary, types.is_large_binary)
    return any(test(kind) for test in tests)
