"""Bytes to Arrow columns."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from random import Random
from types import ModuleType

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from flysid.ingest.formats.common.arrow_arrays import fixed_text, numeric_or_null, strings
from flysid.ingest.formats.common.columns import (
    Field,
    RecordLayout,
    gather,
    message_schema,
)
from flysid.ingest.formats.common.table_numbers import PLAIN, are_plain, floats
from tests.samplelogs import blackbox, dataflash, dataflash_text, mcap, tlog, ulog


def matrix_of(rows: list[bytes], width: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    padded = b"".join(row[:width].ljust(width, b"\0") for row in rows)
    return np.frombuffer(padded, dtype=np.uint8).reshape(len(rows), width)


@given(st.lists(st.binary(max_size=9), min_size=1, max_size=8))
@settings(deadline=None)
def test_texts_end_at_the_first_nul_and_are_always_utf8(rows: list[bytes]) -> None:
    column = fixed_text(matrix_of(rows, 7))
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


KINDS = ("<i1", "<i2", "<i4", "<i8", "<u1", "<u2", "<u4", "<u8", "<f4", "<f8", "<f2", "?", "S3")


@given(
    st.lists(st.tuples(st.sampled_from(KINDS), st.sampled_from([0, 0, 1, 3])), min_size=1, max_size=12),
    st.sampled_from([0, 1, 7, 8, 9, 50]),
    st.randoms(use_true_random=False),
)
@settings(deadline=None)
def test_every_kind_of_field_keeps_its_bits(kinds: list[tuple[str, int]], rows: int, random: Random) -> None:
    shapes = [(k, (n,)) if n and k != "S3" else (k, ()) for k, n in kinds]
    dtype = np.dtype([(f"f{i}", *shape) for i, shape in enumerate(shapes)])
    raw = np.frombuffer(random.randbytes(rows * dtype.itemsize), np.uint8).reshape(rows, dtype.itemsize)
    names = random.sample(dtype.names or (), len(kinds))
    layout = RecordLayout("M", dtype, tuple(Field(n) for n in names))
    time_ns = np.arange(rows)
    schema = message_schema(layout.columns, {}, received=False)
    table = layout.table(schema, (time_ns, time_ns + 1), raw)
    table.validate(full=True)
    assert table.schema == schema
    assert table["boot"].to_pylist() == (time_ns + 1).tolist()
    for name in names:
        kind, offset = dtype.fields[name][:2]  # type: ignore[index]
        fields = [row[offset : offset + kind.itemsize].tobytes() for row in raw]
        column = table[name].combine_chunks()
        if kind.kind == "S":
            expected = [f.split(b"\0", 1)[0].decode("utf-8", "replace") for f in fields]
            assert column.to_pylist() == expected
            continue
        flat = column.flatten() if kind.shape else column
        values = np.frombuffer(b"".join(fields), kind.base)
        if kind.base == np.bool_:
            assert flat.to_pylist() == (values.view(np.uint8) != 0).tolist()
        else:
            start = flat.offset * kind.base.itemsize
            assert bytes(flat.buffers()[1])[start:][: values.nbytes] == values.tobytes()


def test_schema_states_units_and_avoids_reserved_names() -> None:
    layout = RecordLayout(
        "M", np.dtype([("boot", "<i4"), ("v", "<i2")]), (Field("boot"), Field("v", unit="m/s", scale=0.01))
    )
    schema = message_schema(layout.columns, {"time_source": "x"}, received=True)
    assert schema.names == ["time_ns", "boot", "recv_ns", "boot_", "v"]
    assert schema.field("v").metadata == {b"unit": b"m/s", b"scale": b"0.01"}


def test_lone_surrogates_do_not_break_strings() -> None:
    assert strings(["a\ud800"]).to_pylist() == ["a?"]
    assert strings([]).type == pa.string()


def test_none_among_numbers_is_null() -> None:
    for values in ([], [2.0], [None], [1.0, None, 3, None, *[4.0] * 7, None]):
        made = numeric_or_null(iter(values))
        made.validate(full=True)
        assert made.to_pylist() == values
        assert made.type == pa.float64()


@pytest.mark.parametrize("log", [ulog, tlog, dataflash, dataflash_text, mcap, blackbox])
def test_logs_are_read_without_importing_pandas(log: ModuleType, tmp_path: Path) -> None:
    """It takes 0.3 s of CPU, as much as all else of a small log."""
    path = tmp_path / "one.log"
    path.write_bytes(log.build())
    script = f"import sys, flysid; flysid.read({str(path)!r}); print('pandas' in sys.modules)"
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["False"]


@pytest.mark.parametrize("cell", ["1", "-.5", "2.", "+2e-3"])
def test_plain_numbers_are_seen_without_arrow(cell: str) -> None:
    assert are_plain([cell, "1"])
    assert not floats(strings([cell]), PLAIN)[1].any()


@pytest.mark.parametrize(
    "cell", ["1e400", "1_0", "\u0663", "++5", "+-5", ".", "e5", "nan", "inf", "", "1.2.3"]
)
def test_what_python_alone_takes_for_a_number_is_not_plain(cell: str) -> None:
    assert not are_plain(["1", cell])
