"""A table as pandas writes it to parquet: the time as the index, units in the fields' metadata, checksums."""

from __future__ import annotations

import io
import itertools
import json
import math

import pyarrow as pa
import pyarrow.parquet as pq

from tests.samplelogs import Record

SUFFIX = ".parquet"
ROWS = 400
PER_GROUP = 100
ADDRESSED = True  # the footer knows every page by its place


def build() -> bytes:
    """20 s at 20 Hz: a command, two outputs, a mode in words, a column with gaps; four row groups."""
    times = [100 + 0.05 * i for i in range(ROWS)]
    columns = {
        "pitch_cmd": ([5 * math.sin(0.1 * i) for i in range(ROWS)], "deg"),
        "v_x": ([0.3 * math.cos(0.07 * i) for i in range(ROWS)], "m/s"),
        "alt_m": ([-0.01 * i for i in range(ROWS)], ""),
        "mode": (["HOVER" if i % 50 else "LAND" for i in range(ROWS)], ""),
        "rssi": ([200 - i % 7 if i % 10 == 0 else None for i in range(ROWS)], ""),
        "t_s": (times, ""),
    }
    fields = [
        pa.field(name, pa.array(values).type, metadata={"unit": unit} if unit else None)
        for name, (values, unit) in columns.items()
    ]
    schema = pa.schema(fields, metadata={"pandas": json.dumps({"index_columns": ["t_s"]})})
    table = pa.table([pa.array(values) for values, _ in columns.values()], schema=schema)
    out = io.BytesIO()
    pq.write_table(table, out, row_group_size=PER_GROUP, compression="zstd", write_page_checksum=True)
    return out.getvalue()


def records(blob: bytes) -> list[Record]:
    """The row groups, and the footer, without which none of them can be read."""
    borders = [0, *_ends(blob)]
    groups = [Record(a, b, 0) for a, b in itertools.pairwise(borders)]
    return [*groups, Record(borders[-1], len(blob), ROWS)]


def at_risk(blob: bytes, byte: int) -> int:
    """A byte of a row group decides over its rows; one of the footer, or of the mark in front, over all."""
    return PER_GROUP if 4 <= byte < _ends(blob)[-1] else ROWS


def _ends(blob: bytes) -> list[int]:
    footer = pq.ParquetFile(io.BytesIO(blob)).metadata
    groups = [footer.row_group(k) for k in range(footer.num_row_groups)]
    chunks = [[g.column(k) for k in range(g.num_columns)] for g in groups]
    return [max(_start(c) + c.total_compressed_size for c in columns) for columns in chunks]


def _start(chunk: pq.ColumnChunkMetaData) -> int:
    return int(chunk.dictionary_page_offset or chunk.data_page_offset)
