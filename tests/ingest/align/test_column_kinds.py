"""Columns of every kind as signals, times, conditions and in `where`: values, or an error in words."""

from __future__ import annotations

import math
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import flysid
from flysid.errors import FlysidError, RecipeError
from flysid.flight import Flight
from flysid.ingest.align.align import align
from flysid.ingest.align.recipe import parse_recipe
from flysid.ingest.align.values import column_values

ROWS = 200
COUNT = list(range(ROWS))
COLUMNS: dict[str, tuple[pa.Array, dict[str, str] | None]] = {
    "words": (pa.array(["A" if i % 2 else "B" for i in COUNT]), None),
    "flags": (pa.array([i % 2 == 1 for i in COUNT]), None),
    "some flags": (pa.array([None if i % 5 == 0 else True for i in COUNT]), None),
    "pairs": (pa.array([[i % 3, 1.0] for i in COUNT], pa.list_(pa.float64(), 2)), None),
    "some pairs": (
        pa.array([None if i % 4 == 0 else [i % 3, 1.0] for i in COUNT], pa.list_(pa.float64(), 2)),
        None,
    ),
    "lists": (pa.array([[i % 3] * (i % 3) for i in COUNT]), None),
    "nothing": (pa.nulls(ROWS), None),
    "others' scale": (pa.array(COUNT), {"scale": "0.1 V"}),
    "no scale": (pa.array(COUNT), {"scale": "nan"}),
    "others' enum": (pa.array([i % 3 for i in COUNT]), {"enum": "off, on"}),
    "enum of words": (pa.array([i % 3 for i in COUNT]), {"enum": '{"on": "1"}'}),
    "enum of numbers": (pa.array([i % 3 for i in COUNT]), {"enum": '{"1": 7}'}),
    "enum in a list": (pa.array([i % 3 for i in COUNT]), {"enum": "[1, 2]"}),
}


def table(folder: Path, name: str) -> Flight:
    """A log with a time, an input, an output, and one column of a kind."""
    column, metadata = COLUMNS[name]
    columns = {
        "t_s": pa.array([0.02 * i for i in COUNT]),
        "u": pa.array([math.sin(0.1 * i) for i in COUNT]),
        "y": pa.array([math.sin(0.1 * i - 0.3) for i in COUNT]),
    }
    fields = [pa.field(key, pa.float64()) for key in columns]
    fields.append(pa.field("c", column.type, metadata=metadata))
    pq.write_table(pa.table([*columns.values(), column], schema=pa.schema(fields)), folder / "log.parquet")
    return flysid.read(folder / "log.parquet")


def rows(flight: Flight, **facts: Any) -> int:
    """Samples of a channel whose input is found as `facts` say."""
    conditions = facts.pop("conditions", [])
    source = {"stream": "table", "field": "u", **facts}
    recipe = parse_recipe(
        {
            "name": "r",
            "signals": {
                "u": {"unit": "", "sources": [source]},
                "y": {"unit": "", "sources": [{"stream": "table", "field": "y"}]},
            },
            "channels": {"c": {"inputs": ["u"], "outputs": ["y"]}},
            "conditions": conditions,
        }
    )
    return sum(len(s) for s in align([flight], recipe, "c").dataset.segments)


@pytest.mark.parametrize("name", COLUMNS)
@pytest.mark.parametrize("column", ["c", "c[0]", "c[5]"])
def test_every_kind_of_column_serves_or_says_why_not(name: str, column: str, tmp_path: Path) -> None:
    flight = table(tmp_path, name)
    asked: list[dict[str, Any]] = [{"field": column}, {"time": column}]
    for value in ("A", "1", "", 1, 2**70, -1e300):
        asked.append({"where": {column: value}})
        there = [{"stream": "table", "field": column}]
        asked.append({"conditions": [{"name": "k", "sources": there, "any_of": [value]}]})
    for facts in asked:
        with suppress(FlysidError):  # anything else would be a traceback
            assert rows(flight, **facts) > 0


def test_rows_without_a_flag_or_a_list_are_left_out_and_no_others(tmp_path: Path) -> None:
    kept = rows(table(tmp_path, "some flags"), where={"c": 1})
    assert kept == rows(table(tmp_path, "some pairs"), where={"c[1]": 1}) == ROWS - 1  # no first one
    values = table(tmp_path, "others' scale")["table"]["c"].to_pylist()
    assert values == COUNT


def test_an_element_of_a_column_without_lists_is_none(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"'c' holds no lists"):
        rows(table(tmp_path, "flags"), field="c[3]")


def test_a_where_column_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecipeError, match=r"table\.u/core"):
        rows(table(tmp_path, "flags"), where={"core": 0})


@pytest.mark.parametrize("kind", ["i1", "u2", "i4", "u8", "f2", "f4", "f8"])
def test_numbers_are_those_of_the_column(kind: str) -> None:
    """Of a slice, too, and of lists; without nulls and with them."""
    numbers = np.arange(40).astype(kind)
    column = pa.array(numbers).slice(7, 20)
    table = pa.table({"a": column, "b": pa.FixedSizeListArray.from_arrays(pa.array(numbers), 2).slice(0, 20)})
    assert column_values(table, "a").dtype == numbers.dtype
    assert np.array_equal(column_values(table, "a"), numbers[7:27])
    assert np.array_equal(column_values(table.slice(3, 5), "b"), numbers.reshape(-1, 2)[3:8])
    lacking = pa.table({"a": pa.array([1.0, None, 3.0])})
    assert np.array_equal(column_values(lacking, "a"), [1.0, np.nan, 3.0], equal_nan=True)


def test_numbers_are_read_without_importing_pandas() -> None:
    """It takes 0.3 s of CPU, which the first curve of a dropped log would wait for."""
    script = (
        "import sys, pyarrow as pa; from flysid.ingest.align.values import column_values;"
        "column = pa.Array.from_buffers(pa.float64(), 2, [None, pa.py_buffer(bytes(16))]);"
        "table = pa.Table.from_arrays([column], names=['a']);"
        "print(len(column_values(table, 'a')), 'pandas' in sys.modules)"
    )
    ended = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert ended.stdout.split() == ["2", "False"]
