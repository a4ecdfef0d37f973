"""A flight for other programs: CSV, parquet, MATLAB, Excel, MCAP; in physical values, with units.

Streams keep their own times, one table each, or are brought onto one grid of time in a single table.
"""

from __future__ import annotations

import importlib.util
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from flysid.dataset import FloatArray
from flysid.errors import UsageError
from flysid.escaping import inert_cell, one_line
from flysid.facts.clock import LogClock, log_clock
from flysid.files import new_file, replacing_folder, slug, writing_to
from flysid.flight import BOOT, RECEIVED, TIME, field_metadata, field_scale, field_unit, resolve_stream
from flysid.flightwriter import float_values, int_values
from flysid.ingest.align.resample import GAP_PERIODS, grid_in, linear, period_ns, spans_between_gaps, tidy
from flysid.ingest.align.resample import hold as hold_last
from flysid.ingest.align.signals import Log
from flysid.ingest.formats.common.arrow_arrays import numeric
from flysid.ingest.formats.common.table_columns import once_each
from flysid.ingest.lake.ranges import is_number

SECONDS = "time_s"
GRID = "flight"
EXCEL_ROWS = 1_048_576
MATLAB_NAME = 63


@dataclass(frozen=True)
class FileKind:
    """A kind of file: what writes it, and whether one file holds several tables."""

    write: Callable[[Path, Mapping[str, pa.Table]], None]
    holds_many: bool


def physical_tables(log: Log, streams: Sequence[str] = ()) -> dict[str, pa.Table]:
    """Streams as tables of physical values: `time_s`, `boot` where there are several, then the fields.

    `time_s` is that of every verb, seconds since the log began (`facts.clock`).

    Arrays of fixed size become a column per element, `q[0]`. The unit is in each column's metadata.

    `streams`: keys or message names; all where none is named.
    Raises UsageError: no such stream.
    """
    keys = [resolve_stream(name, log.rows, log.name) for name in streams] or list(log.rows)
    clock = log_clock(log.clocks)
    return {key: _physical(log.table(key, log.columns(key)), clock) for key in keys if log.rows[key]}


def seconds_of(table: pa.Table, clock: LogClock) -> FloatArray:
    """(N,) the rows of a stream on the log's axis of time."""
    boots = int_values(table[BOOT])
    time_s = int_values(table[TIME]) / 1e9
    for boot, offset_s in clock.offsets_s.items():
        time_s[boots == boot] += offset_s
    return np.round(time_s, 9)


def gridded_table(tables: Mapping[str, pa.Table], rate_hz: float) -> pa.Table:
    """All numbers of some tables on one grid of time; a column is named `STREAM.FIELD`.

    Measurements are interpolated linearly, whole numbers and switches keep their last value. Where a stream
    pauses, its cells are empty. Boots follow one another in the rows; their clocks do not compare.

    `rate_hz`: rows a second.
    Raises UsageError: the rate is not positive, or no table holds a number.
    """
    if not rate_hz > 0.0:
        raise UsageError(f"a rate of {rate_hz:g} Hz", hint="--rate takes a positive number")
    numbers = [
        (stream, table, name)
        for stream, table in tables.items()
        for name in table.column_names
        if name not in (SECONDS, BOOT) and is_number(table.schema.field(name).type)
    ]
    if not numbers:
        raise UsageError("no stream has a number to resample", hint="name other streams")
    dt_ns = round(1e9 / rate_hz)
    boots = sorted({int(boot) for table in tables.values() for boot in np.unique(_boots(table))})
    parts = [_gridded_boot(numbers, boot, dt_ns) for boot in boots]
    joined = pa.concat_tables([part for part in parts if part.num_rows])
    return joined if len(boots) > 1 else joined.drop_columns([BOOT])


def export_tables(tables: Mapping[str, pa.Table], kind: str, target: Path) -> Path:
    """Write tables; a kind of file that holds one table gives a folder for several. Returns what was written.

    Raises UsageError: an unknown kind, a missing package, a table that the kind cannot hold.
    Raises WriteError: the target cannot be written.
    """
    if kind not in KINDS:
        raise UsageError(f"no kind of file {kind!r}", hint="one of " + ", ".join(KINDS))
    writer = KINDS[kind]
    if writer.holds_many or len(tables) == 1:
        with new_file(target) as incoming, writing_to(target):
            writer.write(incoming, tables)
        return target
    with replacing_folder(target) as folder:
        taken: set[str] = set()
        for stream, table in tables.items():
            name = slug(stream, taken)
            taken.add(name.casefold())
            with writing_to(folder):
                writer.write(folder / f"{name}.{kind}", {stream: table})
    return target


# ------------------------------------------------------------------------------------------- tables


def _physical(table: pa.Table, clock: LogClock) -> pa.Table:
    time_s = numeric(seconds_of(table, clock))
    columns = [time_s]
    fields = [pa.field(SECONDS, pa.float64(), metadata=field_metadata(unit="s"))]
    if len(pc.unique(table[BOOT])) > 1:
        columns.append(table[BOOT].combine_chunks())
        fields.append(pa.field(BOOT, pa.int32()))
    for name in table.column_names:
        if name in (TIME, BOOT, RECEIVED):
            continue
        field = table.schema.field(name)
        for label, values in _elements(name, table[name].combine_chunks()):
            scaled = _scale(values, field_scale(field))
            if label == SECONDS and scaled.equals(time_s):
                continue
            columns.append(scaled)
            fields.append(pa.field(label, scaled.type, metadata=field_metadata(unit=field_unit(field))))
    names = once_each([field.name for field in fields])
    return pa.table(columns, schema=pa.schema(f.with_name(n) for f, n in zip(fields, names, strict=True)))


def _elements(name: str, column: pa.Array) -> Iterator[tuple[str, pa.Array]]:
    """An array of fixed size element by element; lists of any length and structures as JSON."""
    if pa.types.is_fixed_size_list(column.type):
        for i in range(column.type.list_size):
            yield f"{name}[{i}]", pc.list_element(column, i)
    elif (
        pa.types.is_nested(column.type)
        or pa.types.is_binary(column.type)
        or pa.types.is_large_binary(column.type)
    ):
        yield (
            name,
            pa.array([None if v is None else json.dumps(v, default=_as_hex) for v in column.to_pylist()]),
        )
    else:
        yield name, column


def _as_hex(value: Any) -> str:
    return value.hex() if isinstance(value, bytes) else str(value)


def _scale(column: pa.Array, scale: float) -> pa.Array:
    if scale == 1.0 or not is_number(column.type):
        return column
    factor = numeric(np.array([scale]))[0]  # to make a scalar of Python's number imports pandas
    return pc.multiply(column.cast(pa.float64(), safe=False), factor)


def _boots(table: pa.Table) -> Any:
    return int_values(table[BOOT]) if BOOT in table.column_names else np.zeros(table.num_rows, dtype=np.int32)


def _gridded_boot(numbers: Sequence[tuple[str, pa.Table, str]], boot: int, dt_ns: int) -> pa.Table:
    times = {}
    for stream, table, _ in numbers:
        if stream not in times:
            inside = _boots(table) == boot
            times[stream] = (inside, np.round(float_values(table[SECONDS])[inside] * 1e9).astype(np.int64))
    flown = [t_ns for _, t_ns in times.values() if len(t_ns)]
    start_ns = min(int(t_ns.min()) for t_ns in flown) if flown else 0
    end_ns = max(int(t_ns.max()) for t_ns in flown) if flown else 0
    grid = grid_in((start_ns, end_ns + 1), dt_ns, start_ns) if flown else np.zeros(0, dtype=np.int64)
    columns = [numeric(grid / 1e9), numeric(np.full(len(grid), boot, dtype=np.int32))]
    fields = [pa.field(SECONDS, pa.float64(), metadata=field_metadata(unit="s")), pa.field(BOOT, pa.int32())]
    for stream, table, name in numbers:
        inside, t_ns = times[stream]
        column = table[name].combine_chunks()
        values = float_values(column)[inside]
        columns.append(
            pa.array(_on_grid(t_ns, values, grid, pa.types.is_floating(column.type)), from_pandas=True)
        )
        fields.append(pa.field(f"{stream}.{name}", pa.float64(), metadata=table.schema.field(name).metadata))
    return pa.table(columns, schema=pa.schema(fields))


def _on_grid(t_ns: Any, values: Any, grid: Any, is_smooth: bool) -> Any:
    """Values at grid times; NaN outside the stream and inside its pauses."""
    series = tidy(t_ns, values)
    found = np.full(len(grid), np.nan)
    if not len(series.t_ns):
        return found
    longest_ns = 2.0 * GAP_PERIODS * period_ns(series.t_ns) if len(series.t_ns) > 2 else float("inf")
    for start, stop in spans_between_gaps(series.t_ns, longest_ns):
        inside = slice(*np.searchsorted(grid, [start, stop]))
        found[inside] = linear(series, grid[inside]) if is_smooth else hold_last(series, grid[inside])
    return found


# ------------------------------------------------------------------------------------------- files


def _title(table: pa.Table) -> list[str]:
    """Headings with units, as flysid's own reader of tables takes them."""
    units = [field_unit(field) for field in table.schema]
    return [
        name if not unit or name == SECONDS else f"{name} [{unit}]"
        for name, unit in zip(table.column_names, units, strict=True)
    ]


def _write_csv(path: Path, tables: Mapping[str, pa.Table]) -> None:
    from pyarrow import csv

    [table] = tables.values()
    titles = [inert_cell(one_line(title)) for title in _title(table)]
    csv.write_csv(inert(table).rename_columns(titles), path)


def inert(table: pa.Table) -> pa.Table:
    """A table whose texts no spreadsheet takes for formulas, and no terminal for commands."""
    for at, field in enumerate(table.schema):
        if pa.types.is_string(field.type) or pa.types.is_large_string(field.type):
            texts = [None if v is None else inert_cell(one_line(v)) for v in table.column(at).to_pylist()]
            table = table.set_column(at, field, pa.array(texts, field.type))
    return table


def _write_parquet(path: Path, tables: Mapping[str, pa.Table]) -> None:
    import pyarrow.parquet as pq

    [table] = tables.values()
    pq.write_table(table, path, compression="zstd")


def _write_mat(path: Path, tables: Mapping[str, pa.Table]) -> None:
    """One structure per stream, its fields as column vectors, and `units` beside them."""
    from scipy.io import savemat

    document: dict[str, Any] = {}
    for stream, table in tables.items():
        structure: dict[str, Any] = {}
        units: dict[str, str] = {}
        for field, column in zip(table.schema, table.columns, strict=True):
            name = _matlab_name(field.name, structure)
            structure[name] = _matlab_column(column.combine_chunks())
            units[name] = field_unit(field)
        document[_matlab_name(stream, document)] = {**structure, _matlab_name("units", structure): units}
    with path.open("wb") as file:
        savemat(file, document, long_field_names=True, do_compression=True, oned_as="column")


def _matlab_column(column: pa.Array) -> Any:
    if is_number(column.type):
        return float_values(column)
    return np.array(["" if v is None else str(v) for v in column.to_pylist()], dtype=object)


def _matlab_name(name: str, taken: Mapping[str, Any]) -> str:
    """A name that MATLAB takes: letters, digits and underscores, a letter first, 63 at most."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_")
    plain = plain if plain[:1].isalpha() else f"x{plain}"
    plain = plain[:MATLAB_NAME]
    number = 1
    unique = plain
    while unique in taken:
        number += 1
        unique = f"{plain[: MATLAB_NAME - 6]}_{number}"
    return unique


def _write_xlsx(path: Path, tables: Mapping[str, pa.Table]) -> None:
    """One sheet per stream."""
    if importlib.util.find_spec("openpyxl") is None:
        raise UsageError("openpyxl is not installed", hint='pip install "flysid[xlsx]"')
    from openpyxl import Workbook

    book = Workbook(write_only=True)
    taken: set[str] = set()
    for stream, table in tables.items():
        if table.num_rows >= EXCEL_ROWS:
            raise UsageError(
                f"{stream} has {table.num_rows:,} rows, an Excel sheet holds {EXCEL_ROWS:,}",
                hint="--rate HZ thins it; --to csv or parquet hold any number",
            )
        sheet = book.create_sheet(_sheet_name(stream, taken))
        sheet.append([_as_text(sheet, title) for title in _title(table)])
        columns = [column.to_pylist() for column in table.columns]
        for row in zip(*columns, strict=True):
            sheet.append([_as_text(sheet, v) if isinstance(v, str) else v for v in row])
    book.save(path)


def _as_text(sheet: Any, text: str) -> Any:
    """A cell that is a text, whatever it begins with: openpyxl makes a formula of "=1+1" by itself."""
    from openpyxl.cell import WriteOnlyCell
    from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE

    cell = WriteOnlyCell(sheet, ILLEGAL_CHARACTERS_RE.sub("", text.encode("utf-8", "replace").decode()))
    cell.data_type = "s"
    return cell


def _sheet_name(stream: str, taken: set[str]) -> str:
    """At most 31 characters without those that Excel refuses."""
    plain = re.sub(r"[\[\]:*?/\\']", "_", one_line(stream))[:31] or "sheet"
    number = 1
    unique = plain
    while unique.casefold() in taken:
        number += 1
        unique = f"{plain[:26]}_{number}"
    taken.add(unique.casefold())
    return unique


def _write_mcap(path: Path, tables: Mapping[str, pa.Table]) -> None:
    """One JSON topic per stream; the log time is the vehicle's clock in ns."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="", library="flysid")
        for stream, table in tables.items():
            _write_topic(writer, stream, table)
        writer.finish()  # type: ignore[no-untyped-call]


def _write_topic(writer: Any, stream: str, table: pa.Table) -> None:
    names = [name for name in table.column_names if name != SECONDS]
    properties = {
        name: {
            "type": _json_type(table.schema.field(name).type),
            "unit": field_unit(table.schema.field(name)),
        }
        for name in names
    }
    schema = {"title": stream, "type": "object", "properties": properties}
    schema_id = writer.register_schema(name=stream, encoding="jsonschema", data=json.dumps(schema).encode())
    topic = writer.register_channel(topic=stream, message_encoding="json", schema_id=schema_id)
    stamps = np.round(float_values(table[SECONDS]) * 1e9).astype(np.int64).tolist()
    for i, (stamp, row) in enumerate(zip(stamps, table.select(names).to_pylist(), strict=True)):
        finite = {k: None if isinstance(v, float) and not np.isfinite(v) else v for k, v in row.items()}
        writer.add_message(topic, max(0, stamp), json.dumps(finite).encode(), max(0, stamp), sequence=i)


def _json_type(kind: Any) -> str:
    if pa.types.is_boolean(kind):
        return "boolean"
    return "integer" if pa.types.is_integer(kind) else "number" if pa.types.is_floating(kind) else "string"


KINDS: Mapping[str, FileKind] = {
    "csv": FileKind(_write_csv, holds_many=False),
    "parquet": FileKind(_write_parquet, holds_many=False),
    "mat": FileKind(_write_mat, holds_many=True),
    "xlsx": FileKind(_write_xlsx, holds_many=True),
    "mcap": FileKind(_write_mcap, holds_many=True),
}
