"""Raw values of columns: single elements of lists, and the names that enumerations give to numbers."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Mapping, Sequence

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from flysid.errors import RecipeError
from flysid.facts.modes import mode_names

BoolArray = npt.NDArray[np.bool_]
Value = int | float | str
MOST_VALUES = 6  # shown of those that a column has
ELEMENT = re.compile(r"^(.+)\[(\d+)\]$")


def base_column(name: str, columns: Collection[str]) -> str:
    """The column that holds `name`: itself, or the list that `name[i]` is an element of; "" for neither."""
    if name in columns:
        return name
    match = ELEMENT.match(name)
    return match[1] if match and match[1] in columns else ""


def column_values(table: pa.Table, name: str) -> npt.NDArray[np.generic]:
    """(N,) or (N, k) raw values of a column, or of one element of a list column."""
    element = None
    if name not in table.column_names:
        match = ELEMENT.match(name)
        assert match is not None  # _has_fields saw to it
        name = match[1]
        element = int(match[2])
    column = table[name].combine_chunks()
    if isinstance(column, pa.ChunkedArray):
        column = pa.concat_arrays(column.chunks) if column.num_chunks else pa.array([], column.type)
    if pa.types.is_fixed_size_list(column.type):
        matrix = _matrix(column)
        if element is not None and element >= matrix.shape[1]:
            raise RecipeError(f"{name!r} has {matrix.shape[1]} elements, no [{element}]")
        return np.asarray(matrix if element is None else matrix[:, element])
    if pa.types.is_list(column.type):
        return _take_ragged(column, name, element)
    if element is not None:
        raise RecipeError(f"{name!r} holds no lists: it has no [{element}]", hint=f"name the column: {name}")
    if pa.types.is_boolean(column.type):  # numbers, so that rows without a value are NaN
        column = column.cast(pa.int8())
    return _values(column)


def single_values(table: pa.Table, name: str, use: str) -> npt.NDArray[np.generic]:
    """(N,) raw values of a column with one value a row. Raises RecipeError where it holds lists."""
    values = column_values(table, name)
    if values.ndim > 1:
        raise RecipeError(f"{use} cannot use the list {name!r}", hint=f"name one element: {name}[0]")
    return values


def _values(column: pa.Array) -> npt.NDArray[np.generic]:
    """(N,) values; those of numbers without nulls as they lie in memory, for `to_numpy` imports pandas."""
    kind = column.type
    is_whole = pa.types.is_integer(kind)
    if not (is_whole or pa.types.is_floating(kind)) or column.null_count or not len(column):
        return np.asarray(column.to_numpy(zero_copy_only=False))
    letter = "f" if not is_whole else "u" if pa.types.is_unsigned_integer(kind) else "i"
    size = kind.bit_width // 8
    return np.frombuffer(column.buffers()[1], f"{letter}{size}", len(column), column.offset * size)


def _matrix(column: pa.Array) -> npt.NDArray[np.generic]:
    """(N, k) the elements of lists of one length; NaN in rows without a list."""
    flat = _values(column.flatten()).reshape(-1, column.type.list_size)
    if not column.null_count:
        return np.asarray(flat)
    matrix = np.full((len(column), column.type.list_size), np.nan)
    matrix[np.asarray(column.is_valid())] = flat
    return matrix


def _take_ragged(column: pa.Array, name: str, element: int | None) -> npt.NDArray[np.generic]:
    """Lists of varying length: one element of each (NaN where it is too short), or all where equal."""
    lengths = np.diff(column.offsets.to_numpy())
    flat = column.values.to_numpy(zero_copy_only=False)
    starts = column.offsets.to_numpy()[:-1]
    if element is not None:
        values = np.full(len(lengths), np.nan)
        has = lengths > element
        values[has] = flat[starts[has] + element]
        return values
    if len(lengths) and (lengths != lengths[0]).any():
        raise RecipeError(f"{name!r} holds lists of different lengths", hint=f"name one element: {name}[0]")
    if not len(lengths):
        return np.empty((0, 1))
    return np.asarray(flat[starts[0] : starts[0] + lengths.sum()].reshape(len(lengths), -1))


def names_of(table: pa.Table, stream: str, column: str, info: Mapping[str, str]) -> Mapping[str, str]:
    """Number (as text) -> name of a column's values: the log's enumeration, else the known flight modes."""
    metadata = table.schema.field(base_column(column, table.column_names)).metadata or {}
    logged: Mapping[str, str] = json.loads(metadata.get(b"enum", b"{}"))
    return logged or {str(k): v for k, v in mode_names(stream, column, info).items()}


def texts_of(values: npt.NDArray[np.generic], names: Mapping[str, str]) -> list[str]:
    """Values as words, numbers where there is no word."""
    return [names.get(str(v), str(v)) for v in values.tolist()]


def is_one_of(
    values: npt.NDArray[np.generic], wanted: Sequence[Value], names: Mapping[str, str]
) -> BoolArray:
    """(N,) whether each value is one of those wanted, which may be given by their names."""
    if values.dtype.kind in "OUS":
        texts = {str(w) for w in wanted}
        return np.array([str(v) in texts for v in values], dtype=bool)
    numbers = {name: float(number) for number, name in names.items()}
    known = [numbers.get(w, np.nan) if isinstance(w, str) else float(w) for w in wanted]
    return np.isin(values.astype(np.float64), [k for k in known if not np.isnan(k)])
