"""Datasets as tables: Arrow, pandas, polars, xarray, and what a notebook shows.

One row per sample: `flight`, `segment` (number), `time_ns`, `marks` (JSON), then inputs and outputs under
their names, with role, unit and resolution in the columns' metadata. Whatever reads the Arrow stream
protocol (`polars.DataFrame(data)`, `pyarrow.table(data)`, DuckDB) reads a Dataset.
"""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from flysid.stretch import Stretch

if TYPE_CHECKING:
    import pyarrow as pa

FIXED = ("flight", "segment", "time_ns", "marks")
FORMAT = "flysid-dataset"
VERSION = 1
META = b"flysid"


class Named(Protocol):
    """A signal."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def resolution(self) -> float: ...


class Marked(Stretch, Protocol):
    """A segment: a stretch with marks."""

    @property
    def marks(self) -> Mapping[str, str | float]: ...


class Head(Protocol):
    """What all segments of a dataset share."""

    @property
    def dt_s(self) -> float: ...
    @property
    def inputs(self) -> Sequence[Any]: ...
    @property
    def outputs(self) -> Sequence[Any]: ...
    @property
    def name(self) -> str: ...


class Tabular(Head, Protocol):
    """A dataset."""

    @property
    def segments(self) -> Sequence[Any]: ...


def column_names(head: Head) -> tuple[str, ...]:
    """Names of the columns of inputs and outputs, made unique."""
    taken = set(FIXED)
    names: list[str] = []
    for prefix, signals in (("u", head.inputs), ("y", head.outputs)):
        for i, signal in enumerate(signals):
            name = signal.name if signal.name not in taken else f"{prefix}{i + 1}_{signal.name}"
            taken.add(name)
            names.append(name)
    return tuple(names)


def schema_of(head: Head) -> pa.Schema:
    """Arrow schema of a dataset; its metadata holds what `head_from` reads."""
    import pyarrow as pa

    text = pa.dictionary(pa.int32(), pa.string())
    fields = [
        pa.field("flight", text),
        pa.field("segment", pa.int32()),
        pa.field("time_ns", pa.int64()),
        pa.field("marks", text),
    ]
    signals = [*head.inputs, *head.outputs]
    roles = ["input"] * len(head.inputs) + ["output"] * len(head.outputs)
    for column, signal, role in zip(column_names(head), signals, roles, strict=True):
        meta = {"role": role, "unit": signal.unit, "resolution": repr(float(signal.resolution))}
        fields.append(pa.field(column, pa.float64(), metadata=meta))
    document = {
        "format": FORMAT,
        "version": VERSION,
        "dt_s": head.dt_s,
        "name": head.name,
        "inputs": [_signal_document(s) for s in head.inputs],
        "outputs": [_signal_document(s) for s in head.outputs],
    }
    return pa.schema(fields, metadata={META: json.dumps(document).encode()})


def _signal_document(signal: Named) -> dict[str, Any]:
    return {"name": signal.name, "unit": signal.unit, "resolution": float(signal.resolution)}


def batch_of(head: Head, piece: Marked, number: int) -> pa.RecordBatch:
    """One segment as a record batch of `schema_of(head)`."""
    import pyarrow as pa

    rows = len(piece.y)
    times = piece.t0_ns + np.round(np.arange(rows) * (head.dt_s * 1e9)).astype(np.int64)
    zeros = pa.array(np.zeros(rows, dtype=np.int32))
    arrays = [
        pa.DictionaryArray.from_arrays(zeros, pa.array([piece.flight])),
        pa.array(np.full(rows, number, dtype=np.int32)),
        pa.array(times),
        pa.DictionaryArray.from_arrays(zeros, pa.array([json.dumps(dict(piece.marks))])),
        *(pa.array(np.ascontiguousarray(c)) for c in (*piece.u.T, *piece.y.T)),
    ]
    return pa.RecordBatch.from_arrays(arrays, schema=schema_of(head))


def table_of(data: Tabular) -> pa.Table:
    """The whole dataset as an Arrow table."""
    import pyarrow as pa

    schema = schema_of(data)
    if not data.segments:
        return schema.empty_table()
    return pa.Table.from_batches(
        [batch_of(data, s, i) for i, s in enumerate(data.segments)]
    ).unify_dictionaries()


def xarray_of(data: Tabular) -> Any:
    """An xarray.Dataset: one variable per signal over `sample`; flight, segment and time as coordinates."""
    import xarray as xr

    signals = [*data.inputs, *data.outputs]
    columns = [np.concatenate([s.u[:, i] for s in data.segments]) for i in range(len(data.inputs))]
    columns += [np.concatenate([s.y[:, j] for s in data.segments]) for j in range(len(data.outputs))]
    lengths = [len(s.y) for s in data.segments]
    times = [
        s.t0_ns + np.round(np.arange(len(s.y)) * (data.dt_s * 1e9)).astype(np.int64) for s in data.segments
    ]
    return xr.Dataset(
        {
            name: ("sample", values, {"units": signal.unit})
            for name, values, signal in zip(column_names(data), columns, signals, strict=True)
        },
        coords={
            "flight": ("sample", np.repeat([s.flight for s in data.segments], lengths)),
            "segment": ("sample", np.repeat(np.arange(len(lengths)), lengths)),
            "time_ns": ("sample", np.concatenate(times)),
        },
        attrs={"dt_s": data.dt_s, "name": data.name},
    )


# ----------------------------------------------------------------------------------------- notebooks


def html_of(data: Tabular) -> str:
    """The dataset as an HTML table: signals, then a bar per flight; white parts of a bar are lost time."""
    escape = html.escape
    signals = ", ".join(
        f"<b>{escape(s.name)}</b>{f' [{escape(s.unit)}]' if s.unit else ''}" for s in data.inputs
    )
    outputs = ", ".join(
        f"<b>{escape(s.name)}</b>{f' [{escape(s.unit)}]' if s.unit else ''}" for s in data.outputs
    )
    total = sum(len(s.y) for s in data.segments)
    head = (
        f"<p>{escape(data.name or 'dataset')}: {signals} &rarr; {outputs}; {len(data.segments)} segments, "
        f"{total:,} samples, {1 / data.dt_s:.4g} Hz</p>"
    )
    rows = "".join(_flight_row(name, parts, data.dt_s) for name, parts in _by_flight(data).items())
    titles = "".join(f"<th>{t}</th>" for t in ("flight", "segments", "seconds", "lost", "time"))
    return f"<div>{head}<table><thead><tr>{titles}</tr></thead><tbody>{rows}</tbody></table></div>"


def _by_flight(data: Tabular) -> dict[str, list[Any]]:
    flights: dict[str, list[Any]] = {}
    for segment in data.segments:
        flights.setdefault(segment.flight, []).append(segment)
    return flights


def cover(segments: Sequence[Marked], dt_s: float) -> Iterator[tuple[float, float]]:
    """(start, stop) of every segment as shares of the time from the first sample to the last."""
    begin = min(s.t0_ns for s in segments) * 1e-9
    end = max(s.t0_ns * 1e-9 + len(s.y) * dt_s for s in segments)
    for s in sorted(segments, key=lambda s: s.t0_ns):
        start = s.t0_ns * 1e-9 - begin
        yield start / (end - begin), (start + len(s.y) * dt_s) / (end - begin)


def _flight_row(name: str, segments: Sequence[Marked], dt_s: float) -> str:
    parts = list(cover(segments, dt_s))
    seconds = sum(len(s.y) for s in segments) * dt_s
    lost = max(0.0, 1.0 - sum(stop - start for start, stop in parts))
    bars = "".join(
        f'<rect x="{200 * a:.2f}" width="{max(200 * (b - a), 0.5):.2f}" height="12" fill="#4477aa"/>'
        for a, b in parts
    )
    svg = (
        f'<svg width="200" height="12" role="img" aria-label="{100.0 * lost:.0f} % lost">'
        f'<rect width="200" height="12" fill="none" stroke="#999"/>{bars}</svg>'
    )
    cells = (html.escape(name), str(len(segments)), f"{seconds:.1f}", f"{100.0 * lost:.1f} %", svg)
    return "<tr>" + "".join(f"<td>{c}</td>" for c in cells) + "</tr>"
