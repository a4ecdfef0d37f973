"""The range of every column of a stream, in physical values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from flysid.flight import field_scale
from flysid.flightwriter import float_values


@dataclass(frozen=True)
class Range:
    """Lowest, mean and highest value in the column's unit; None where it holds no number.

    `missing` counts rows without a value: empty, or not finite.
    """

    low: float | None
    mean: float | None
    high: float | None
    missing: int


def is_number(kind: pa.DataType) -> bool:
    """Whether a column of this type can be drawn, measured or put on a grid."""
    return bool(pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind))


def column_ranges(table: pa.Table) -> dict[str, Range]:
    """The range of every column, over all elements where it holds arrays."""
    return {
        field.name: _range(table[field.name].combine_chunks(), field_scale(field)) for field in table.schema
    }


def _range(column: pa.Array, scale: float) -> Range:
    if pa.types.is_fixed_size_list(column.type):
        column = column.flatten()
    kind = column.type
    if not is_number(kind):
        return Range(None, None, None, column.null_count)
    values = float_values(column)
    finite = values[np.isfinite(values)]
    missing = len(values) - len(finite)
    if not len(finite):
        return Range(None, None, None, missing)
    return Range(finite.min() * scale, finite.mean() * scale, finite.max() * scale, missing)
