"""Bytes to Arrow columns."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.formats.common.columns import (
    Field,
    Layout,
    decode,
    gather,
    message_schema,
    strings,
    texts,
)


def matrix_of(rows: list[bytes], width: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    padded = b"".join(row[:width].ljust(width, b"\0") for row in rows)
    return np.frombuffer(padded, dtype=np.uint8).reshape(len(rows), width)


@given(st.lists(st.binary(max_size=9), min_size=1, max_size=8))
@settings(deadline=None)
def test_texts_end_at_the_first_nul_and_are_always_utf8(rows: list[bytes]) -> None:
    column = texts(matrix_of(rows, 7))
    column.validate(full=True)
    assert column.to_pylist() == [row[:7].split(b"\0", 1)[0].decode("utf-8", "replace") for row in rows]


@given(st.lists(st.binary(max_size=12), min_size=1, max_size=10), st.integers(1, 12))
@settings(deadline=None)
def test_gather_pads_and_cuts(rows: list[bytes], size: int) -> None:
    buffer = np.frombuffer(b"".join(rows) + b"\xaa" * 12, dtype=np.uint8)
    lengths = np.array([len(r) for r in rows])
    starts = np.cumsum(lengths) - lengths
    got = gather(buffer, starts, lengths, size)
    assert [bytes(row) for row in got] == [row[:size].ljust(size, b"\0") for row in rows]


def test_every_kind_of_field_keeps_its_bits() -> None:
    kinds = ["<i1", "<i2", "<i4", "<i8", "<u1", "<u2", "<u4", "<u8", "<f4", "<f8", "<f2"]
    dtype = np.dtype([("s", "S3"), *((f"f{i}", k) for i, k in enumerate(kinds)), ("a", "<f4", (3,))])
    raw = np.random.default_rng(1).integers(0, 256, (50, dtype.itemsize), dtype=np.uint8)
    layout = Layout("M", dtype, tuple(Field(n, is_text=n == "s") for n in dtype.names or ()))
    columns = decode(raw, layout)
    records = raw.view(dtype).reshape(50)
    for spec, column in zip(layout.fields, columns, strict=True):
        column.validate(full=True)
        assert layout.columns[layout.fields.index(spec)].type == column.type
        if not spec.is_text:
            values = column.flatten() if spec.name == "a" else column
            assert bytes(values.buffers()[1])[: values.nbytes] == records[spec.name].tobytes()


def test_schema_states_units_and_avoids_reserved_names() -> None:
    layout = Layout(
        "M", np.dtype([("boot", "<i4"), ("v", "<i2")]), (Field("boot"), Field("v", unit="m/s", scale=0.01))
    )
    schema = message_schema(layout.columns, {"time_source": "x"}, received=True)
    assert schema.names == ["time_ns", "boot", "recv_ns", "boot_", "v"]
    assert schema.field("v").metadata == {b"unit": b"m/s", b"scale": b"0.01"}


def test_lone_surrogates_do_not_break_strings() -> None:
    assert strings(["a\ud800"]).to_pylist() == ["a?"]
    assert strings([]).type == pa.string()
