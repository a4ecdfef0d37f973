"""The columns of a parquet file as a log's: plain types, units, and which of them tells the time."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.flight import BOOT, TIME
from flysid.ingest.formats.common.arrow_arrays import free_name
from flysid.ingest.formats.common.table_columns import fraction_beside, named_and_measured, time_name, unit_in
from flysid.ingest.formats.common.table_kinds import Column as TextColumn
from flysid.ingest.formats.common.table_kinds import columns_of as text_columns
from flysid.ingest.formats.common.table_numbers import MISSING, Style
from flysid.ingest.formats.common.table_times import MOSTLY, MOVING, NO_TURN, Turn
from flysid.ingest.formats.common.time_columns import TimeColumn as TextTime
from flysid.ingest.formats.common.time_columns import turn_of
from flysid.ingest.formats.common.time_units import TIME_UNITS_NS, TimeUnit
from flysid.ingest.formats.parquet.stretches import DAMAGE
from flysid.stretch import FloatArray

UNNAMED = "__index_level_"  # what pandas calls an index without a name
UNIT_KEYS = (b"unit", b"units", b"Unit", b"Units")
KEPT_KEYS = (b"scale", b"enum", b"description")  # of flysid's own tables
DATES = "date and time"
DEEPEST = 8  # structs in structs
_NUMBERS = (pa.types.is_integer, pa.types.is_floating, pa.types.is_decimal)


@dataclass(frozen=True)
class Column:
    """A column of the file.

    Attributes
    ----------
    top : name of the file's column that holds its values.
    place : which of the columns of that name, counted from 0; then the fields of its structs by number.
    field : name, plain type and metadata in the table that is made of it.
    style : of text that holds numbers: how they are spelled; None where the file's values are taken.
    """

    top: str
    place: tuple[int, ...]
    field: pa.Field
    style: Style | None = None


@dataclass(frozen=True)
class TimeColumn:
    """Which column of the file tells the time.

    Attributes
    ----------
    unit : of its numbers; "" where nothing states it, DATES for stamps.
    ticks : (first, step) of an index that pandas stored as a rule instead of a column.
    moving : the share of its steps that must go forwards for it to be the rows' time.
    counted : how numbers count the time, once that is known.
    text : of times in text, maybe in several columns: how they are read.
    """

    name: str
    unit: str
    why: str = "stated"
    ticks: tuple[int, int] | None = None
    moving: float = MOVING
    counted: TimeUnit | None = None
    text: TextTime | None = None

    @property
    def shown(self) -> str:
        """As a person calls it."""
        return "the index" if self.name.startswith(UNNAMED) else self.name

    @property
    def source(self) -> str:
        """In words, for the stream's `time_source`."""
        if self.text is not None:
            return self.text.source
        if self.counted is None:
            return f"{self.shown}: {DATES}"
        return f"{self.shown} in {self.counted.unit}, {self.counted.why}"

    @property
    def turn(self) -> Turn:
        """When its times begin anew."""
        if self.text is not None:
            return self.text.turn
        return NO_TURN if self.counted is None else turn_of(self.counted)


@dataclass(frozen=True)
class Sample:
    """The first rows as text: the columns that can be printed, with their kinds, and their cells.

    `places` are those columns in the file: a name, and which of the columns of that name, counted from 0.
    """

    places: tuple[tuple[str, int], ...] = ()
    columns: tuple[TextColumn, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()

    def style(self, top: str, nth: int) -> Style | None:
        """How the numbers in a column of text are spelled; None where it holds no numbers."""
        index = self.places.index((top, nth)) if (top, nth) in self.places else -1
        told = index >= 0 and any(row[index] not in MISSING for row in self.rows)
        return self.columns[index].style if told and not self.columns[index].is_text else None


def sample_of(table: pa.Table) -> Sample:
    """The first rows of a file as text."""
    seen: Counter[str] = Counter()
    places = []
    texts = []
    for field, column in zip(table.schema, table.columns, strict=True):
        nth = seen[field.name]
        seen[field.name] += 1
        if not is_cell(field.type):
            continue
        try:
            values = (as_text(column) if _is_text(field.type) else column).to_pylist()
        except DAMAGE:  # a date that no calendar has
            continue
        places.append((field.name, nth))
        texts.append([_cell(value) for value in values])
    rows = tuple(zip(*texts, strict=True))
    named = named_and_measured([name for name, _ in places])
    return Sample(tuple(places), tuple(text_columns(named, rows)), rows)


def is_cell(kind: pa.DataType) -> bool:
    """Whether values of a type may tell a time when they are printed."""
    types = pa.types
    tests = (types.is_integer, types.is_floating, types.is_date, types.is_time, _is_text)
    return any(test(kind) for test in tests)


def _is_text(kind: pa.DataType) -> bool:
    kind = kind.value_type if pa.types.is_dictionary(kind) else kind
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind))


def _cell(value: Any) -> str:
    return "" if value is None else str(value).strip()


def as_text(column: pa.Array) -> pa.Array:
    """Values as the cells of a table in text."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    column = column.cast(pa.string())
    try:
        return pc.fill_null(pc.utf8_trim_whitespace(column), "")
    except pa.ArrowInvalid:  # bytes that are no UTF-8
        values = column.cast(pa.binary()).to_pylist()
        return pa.array([(value or b"").decode("utf-8", "replace").strip() for value in values], pa.string())


def columns_of(schema: pa.Schema, sample: Sample) -> tuple[list[Column], dict[str, str]]:
    """The columns that can be kept, structs taken apart; and the types of those that cannot.

    Text whose first cells are mostly numbers is a column of numbers.
    """
    leaves = _leaves(schema)
    labels = [".".join(path) for path, _, _ in leaves]
    named = named_and_measured(["index" if label.startswith(UNNAMED) else label for label in labels])
    found: list[Column] = []
    refused: dict[str, str] = {}
    taken: set[str] = {TIME, BOOT}
    for (path, place, field), label, (wanted, unit) in zip(leaves, labels, named, strict=True):
        kind = plain_type(field.type)
        if kind is None:
            refused[label] = str(field.type)
            continue
        style = sample.style(path[0], place[0]) if len(path) == 1 and _is_text(field.type) else None
        name = free_name(wanted, taken)
        taken.add(name)
        metadata = _metadata(field, unit or ((unit_in(style.unit) or "") if style else ""))
        kept = pa.field(name, kind if style is None else pa.float64(), metadata=metadata)
        found.append(Column(path[0], place, kept, style))
    return found, refused


Leaf = tuple[tuple[str, ...], tuple[int, ...], pa.Field]
"""Names from the file's column down, the same as places (see `Column`), and the field."""


def _leaves(schema: pa.Schema) -> list[Leaf]:
    seen: Counter[str] = Counter()
    found: list[Leaf] = []
    for field in schema:
        found += _below(field, (field.name,), (seen[field.name],))
        seen[field.name] += 1
    return found


def _below(field: pa.Field, path: tuple[str, ...], place: tuple[int, ...]) -> list[Leaf]:
    if not pa.types.is_struct(field.type) or len(path) > DEEPEST:
        return [(path, place, field)]
    inner = enumerate(field.type)
    return [leaf for k, child in inner for leaf in _below(child, (*path, child.name), (*place, k))]


def _metadata(field: pa.Field, named: str) -> dict[bytes, bytes] | None:
    """What the file says of a column; its name tells the unit where nothing else does."""
    told = field.metadata or {}
    kept = {key: told[key] for key in KEPT_KEYS if key in told and _is_ours(key, told[key])}
    unit = next((told[key] for key in UNIT_KEYS if told.get(key)), named.encode())
    if pa.types.is_timestamp(field.type) or pa.types.is_duration(field.type):
        unit = b"ns"
    return {**({b"unit": unit} if unit else {}), **kept} or None


def _is_ours(key: bytes, value: bytes) -> bool:
    """Whether a column's fact stands in flysid's form; other programs use the same words for theirs."""
    try:
        if key == b"scale":
            return math.isfinite(float(value)) and float(value) != 0.0
        if key == b"enum":
            names = json.loads(value)
            return all(isinstance(name, str) and str(int(number)) == number for number, name in names.items())
    except (ValueError, AttributeError, RecursionError):
        return False
    return True


def plain_type(kind: pa.DataType) -> pa.DataType | None:
    """The type that a column of this type is kept in; None where it cannot be kept."""
    types = pa.types
    tests: list[tuple[Callable[[pa.DataType], bool], pa.DataType]] = [
        (types.is_boolean, kind),
        (types.is_integer, kind),
        (types.is_floating, kind),
        (types.is_timestamp, pa.int64()),
        (types.is_duration, pa.int64()),
        (types.is_decimal, pa.float64()),
        (types.is_null, pa.float64()),
        (types.is_date, pa.string()),
        (types.is_time, pa.string()),
        (lambda k: types.is_string(k) or types.is_large_string(k), pa.string()),
        (lambda k: types.is_binary(k) or types.is_large_binary(k), pa.binary()),
    ]
    if types.is_dictionary(kind):
        return plain_type(kind.value_type)
    if types.is_fixed_size_list(kind) or types.is_list(kind) or types.is_large_list(kind):
        inner = kind.value_type
        if not (types.is_integer(inner) or types.is_floating(inner)):
            return None
        return kind if types.is_fixed_size_list(kind) else pa.list_(inner)
    return next((plain for test, plain in tests if test(kind)), None)


def plain(column: pa.Array, wanted: pa.DataType) -> pa.Array:
    """A column in its plain type. Raises pa.ArrowInvalid where a value does not fit it."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    if pa.types.is_timestamp(column.type):
        column = column.cast(pa.timestamp("ns", column.type.tz))
    elif pa.types.is_duration(column.type):
        column = column.cast(pa.duration("ns"))
    return column if column.type.equals(wanted) else column.cast(wanted)


def time_candidates(schema: pa.Schema) -> list[TimeColumn]:
    """The columns that may tell the time, the likeliest first: the index, then names, then other stamps.

    Seconds whose fractions stand in another column are none.
    """
    told = _index_of_pandas(schema)
    index = [name for name in told if isinstance(name, str) and name in schema.names]
    others = [name for name in schema.names if name not in index]
    found = [time for rule in told if isinstance(rule, dict) and (time := _time_by_rule(rule))]
    late: list[TimeColumn] = []
    bares = dict(zip(schema.names, named_and_measured(schema.names), strict=True))
    for name in [*index, *others]:
        if schema.names.count(name) != 1 or fraction_beside(name, schema.names):
            continue
        field = schema.field(name)
        kind = field.type
        bare, unit = bares[name]
        says = time_name(bare)
        is_plain = name in index or (says is not None and says.is_plain)
        if pa.types.is_timestamp(kind) or pa.types.is_duration(kind) or pa.types.is_time64(kind):
            (found if is_plain else late).append(TimeColumn(name, DATES))
        elif not any(is_kind(kind) for is_kind in _NUMBERS):
            continue
        elif says is not None or (name.startswith(UNNAMED) and pa.types.is_floating(kind)):
            stated = (_metadata(field, unit) or {}).get(b"unit", b"").decode("utf-8", "replace")
            own = stated if stated in TIME_UNITS_NS else says.unit if says else ""
            time = TimeColumn(name, own, moving=MOVING if is_plain else MOSTLY)
            (found if is_plain or says is None else late).append(time)
    return found + late


def _index_of_pandas(schema: pa.Schema) -> list[Any]:
    """What pandas says of its index: names of columns, and rules for those that stand in none."""
    try:
        told = json.loads((schema.metadata or {}).get(b"pandas", b"{}"))
        return list(told.get("index_columns", []))
    except (ValueError, AttributeError, TypeError):
        return []


def _time_by_rule(rule: dict[str, Any]) -> TimeColumn | None:
    """The time that a rule for an evenly spaced index tells; None where its name is that of no time."""
    name = rule.get("name")
    first = rule.get("start")
    step = rule.get("step")
    says = time_name(name) if isinstance(name, str) else None
    if says is None or not isinstance(first, int) or not isinstance(step, int) or step <= 0:
        return None
    return TimeColumn(str(name), says.unit, ticks=(first, step))


def as_floats(column: pa.Array) -> FloatArray:
    """(n,) values of a column of numbers, without its gaps."""
    return np.asarray(pc.drop_null(column).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False))
