"""Records of one kind as an Arrow table whose columns lie in one buffer.

An Arrow array of its own costs 4 us to make, and a log of 1 MB has a thousand columns. So all columns of
a table are laid behind one another as a record batch lies in an Arrow stream, and pyarrow takes the whole in
one call. Fields of one width that are neighbours in the record are copied together. Machines are
little-endian, as all are that pyarrow has wheels for.

The head of such a batch is a flatbuffer (Message.fbs in Arrow's format), in which only these numbers change:

    body length, rows
    nodes    (rows, nulls)       of every column, and of the numbers inside one of fixed-size lists
    buffers  (offset, length)    validity, always empty, then values; of text validity, ends, characters
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa

from flysid.ingest.formats.common.arrow_arrays import fixed_text, number_type
from flysid.ingest.formats.common.gather import Bytes, Values

HEADS = (np.dtype("<i8"), np.dtype("<i4"), np.dtype("<i8"))  # time_ns, boot, recv_ns
_PREFIX = "<iI"  # a message begins: -1, bytes of its head
_HEAD = struct.Struct("<I8x 6HiIqhB5x 5H2xiqII4xI")
_BODY_LENGTH, _ROWS, _NODES = 4, 8, 11  # places in the head, in words of 8 bytes
_V5, _RECORD_BATCH = 4, 3
_NUMBERS = {size: np.dtype(f"u{size}") for size in (1, 2, 4, 8)}


@dataclass(frozen=True)
class RecordCell:
    """Where a column lies in a record.

    Attributes
    ----------
    kind : of one number, little-endian; of text how many bytes.
    count : numbers in a list of fixed size; 0 where it is none.
    """

    offset: int
    kind: np.dtype[Any]
    count: int = 0

    @property
    def width(self) -> int:
        """Bytes in a record."""
        return int(self.kind.itemsize) * max(self.count, 1)

    @property
    def is_text(self) -> bool:
        """Whether it is characters that end at the first NUL."""
        return self.kind.kind == "S"

    @property
    def is_flag(self) -> bool:
        """Whether it is true or false: a byte in a record, a bit in a column."""
        return self.kind.kind == "b"

    @property
    def type(self) -> pa.DataType:
        """Of the column."""
        if self.is_text:
            return pa.string()
        number = number_type(self.kind)
        return pa.list_(number, self.count) if self.count else number


class _Block:
    """Cells that are alike, and neighbours in the record: what the first one is, its piece, and how many."""

    def __init__(self, cell: RecordCell, piece: int) -> None:
        self.piece = piece
        self.columns = 1
        self._cell = cell
        self._width = cell.width
        self._kind = _NUMBERS.get(cell.width) or np.dtype(f"V{cell.width}")
        self._is_flag = cell.is_flag

    def takes(self, cell: RecordCell) -> bool:
        """Whether a cell goes on where the block ends, and is copied as its cells are."""
        alike = cell.is_flag == self._is_flag and cell.width == self._width
        return alike and cell.offset == self._cell.offset + self.columns * self._width

    def values(self, records: Bytes, rows: int, size: int) -> Values:
        """(columns, rows) values; flags as (columns, bytes of bits)."""
        shape = (self.columns, rows)
        strides = (self._width, size)
        if not self._is_flag:
            return np.ndarray(shape, self._kind, records, self._cell.offset, strides)
        flags = np.ndarray((*shape, self._width), np.uint8, records, self._cell.offset, (*strides, 1))
        return np.packbits(flags.reshape(self.columns, -1) != 0, axis=1, bitorder="little")


class RecordForm:
    """How records of `size` bytes become columns: `heads`, which are computed, then one for every cell."""

    def __init__(self, size: int, heads: Sequence[np.dtype[Any]], cells: Sequence[RecordCell]) -> None:
        self.size = size
        self.types = [*map(number_type, heads), *(cell.type for cell in cells)]
        numbers = sorted((c for c in cells if not c.is_text), key=lambda c: c.offset)
        self._heads = heads
        self._blocks = list(_blocks(numbers, len(heads)))
        self._texts = [cell for cell in cells if cell.is_text]
        # pieces of the buffer: heads, numbers as they lie in the record, ends and characters of every text
        laid = [*(RecordCell(0, kind) for kind in heads), *numbers]
        self._bits = [c.width * (1 if c.is_flag else 8) for c in laid]
        self._make_head(cells)

    def _make_head(self, cells: Sequence[RecordCell]) -> None:
        """The words of the head, and which of them tell of rows and of pieces."""
        counts = [1] * len(self._heads)
        buffers = 2 * len(self._heads)
        of_cell: dict[int, list[int]] = {}  # where a cell's pieces stand among the buffers
        for k, cell in enumerate(cells):
            buffers += 3 if cell.is_text or cell.count else 2
            counts += [1, cell.count] if cell.count else [1]
            of_cell[k] = [buffers - 2, buffers - 1] if cell.is_text else [buffers - 1]
        order = sorted(of_cell, key=lambda k: (cells[k].is_text, 0 if cells[k].is_text else cells[k].offset))
        places = [2 * k + 1 for k in range(len(self._heads))]
        places += [place for k in order for place in of_cell[k]]
        nodes = len(counts)
        message = (24, 12, 24, 16, 18, 4, 8, 12, 32, 0, _V5, _RECORD_BATCH)
        batch = (10, 20, 4, 12, 16, 12, 0, 12, 16 * nodes + 16, nodes)
        head = struct.unpack(f"<{_NODES}q", _HEAD.pack(*message, *batch))
        self._words = [*head, *[0] * (2 * nodes), buffers << 32, *[0] * (2 * buffers)]
        self._packing = struct.Struct(f"{_PREFIX}{len(self._words)}q")
        self._counts = counts
        self._rows = slice(_NODES, _NODES + 2 * nodes, 2)
        self._places = [_NODES + 2 * nodes + 1 + 2 * place for place in places]

    def table(self, schema: pa.Schema, heads: Sequence[Values | int], records: Bytes, rows: int) -> pa.Table:
        """(rows * size,) bytes as a table; `heads` are its first columns: (rows,) numbers, or one for all."""
        if not rows:
            return pa.Table.from_batches([], schema)  # Schema.empty_table() imports pandas
        texts = [piece for cell in self._texts for piece in self._text(cell, records, rows)]
        lengths = [(bits * rows + 7) >> 3 for bits in self._bits]
        lengths += map(len, texts)
        words = self._words.copy()
        end = 0
        at = []
        for place, length in zip(self._places, lengths, strict=True):
            words[place] = end
            words[place + 1] = length
            at.append(end + self._packing.size)
            end += (length + 7) & -8
        words[_BODY_LENGTH] = end
        words[_ROWS] = rows
        words[self._rows] = [count * rows for count in self._counts]
        whole = np.empty(self._packing.size + end, dtype=np.uint8)
        self._packing.pack_into(whole.data, 0, -1, 8 * len(words), *words)
        for place, kind, head in zip(at, self._heads, heads, strict=False):
            np.ndarray((rows,), kind, whole, place)[:] = head
        for block in self._blocks:
            values = block.values(records, rows, self.size)
            strides = ((lengths[block.piece] + 7) & -8, values.itemsize)
            np.ndarray(values.shape, values.dtype, whole, at[block.piece], strides)[:] = values
        for place, piece in zip(at[len(self._bits) :], texts, strict=True):
            whole[place : place + len(piece)] = piece
        return pa.Table.from_batches([pa.ipc.read_record_batch(pa.py_buffer(whole), schema)])

    def _text(self, cell: RecordCell, records: Bytes, rows: int) -> tuple[Bytes, Bytes]:
        """Ends and characters of a column of text."""
        array = fixed_text(np.ndarray((rows, cell.width), np.uint8, records, cell.offset, (self.size, 1)))
        _, ends, characters = (np.frombuffer(b or b"", dtype=np.uint8) for b in array.buffers())
        last = int(ends.view(np.int32)[rows])
        return ends[: 4 * (rows + 1)], characters[:last]


def _blocks(cells: Sequence[RecordCell], piece: int) -> Iterator[_Block]:
    """Cells in the order of the record, neighbours together; the first one's piece is `piece`."""
    block: _Block | None = None
    for k, cell in enumerate(cells):
        if block is not None and block.takes(cell):
            block.columns += 1
            continue
        if block is not None:
            yield block
        block = _Block(cell, piece + k)
    if block is not None:
        yield block
