"""`flysid show DATA FLIGHT [STREAM]`: one flight from its manifest, or one stream with its first rows."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.ingest import losses
from flysid.cli.ls import aligned, clock_text
from flysid.cli.output import counted, printable
from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.manifest import Manifest, StreamEntry


@click.command("show")
@click.argument("data")
@click.argument("flight", required=False)
@click.argument("stream", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print the manifest (or the stream's entry) as JSON.")
@click.option("-n", "--rows", default=5, show_default=True, help="First rows of the stream to print.")
def command(
    data: str,
    flight: str | None,
    stream: str | None,
    as_json: bool,
    rows: int,
) -> None:
    """Show one flight, or one stream of it: columns, units, rates, what was lost, the first rows.

    FLIGHT may be the beginning of an id, and is not needed where the folder holds one flight.
    """
    from flysid.manifest import check_data_folder, find_flight, stamps

    if flight is None:
        flight = only_flight(data, list(stamps(check_data_folder(data))))
    manifest = find_flight(data, flight)
    if stream is None:
        click.echo(flight_json(manifest) if as_json else flight_text(manifest))
    else:
        entry = manifest.stream(stream)
        click.echo(stream_json(entry) if as_json else stream_text(Path(data), manifest, entry, rows))


def only_flight(data: str, flights: Sequence[str]) -> str:
    """The flight of a folder that holds one; raises UsageError that names those it holds otherwise."""
    if len(flights) == 1:
        return flights[0]
    if not flights:
        raise UsageError("the folder holds no flights", path=data, hint=f"flysid ingest LOG... -o {data}")
    some = ", ".join(flights[:3]) + (", ..." if len(flights) > 3 else "")
    raise UsageError(f"the folder holds {len(flights)} flights", path=data, hint=f"name one: {some}")


def flight_json(manifest: Manifest) -> str:
    """The manifest as it is stored, indented."""
    import msgspec

    from flysid.manifest import to_json

    return msgspec.json.format(to_json(manifest), indent=1).decode()


def stream_json(entry: StreamEntry) -> str:
    """One entry of the manifest."""
    import msgspec

    return json.dumps(msgspec.to_builtins(entry), indent=1)


def flight_text(manifest: Manifest) -> str:
    """Source, facts, losses and streams of a flight."""
    source = manifest.source
    lines = [
        f"flight        {printable(manifest.id)}",
        f"log           {printable(source.name)} ({source.format}, {source.size_bytes:,} bytes)",
        f"sha256        {source.sha256}",
        f"time          {clock_text(manifest.duration_s)} in {counted(len(manifest.clocks), 'boot')}",
    ]
    lines += [f"{printable(k):13} {printable(v)}" for k, v in sorted(manifest.info.items()) if v]
    lines += [f"lost          {printable(line)}" for line in losses(manifest.damage)]
    for source_name, count in sorted(manifest.damage.sequence_gaps.items()):
        lines.append(f"gaps          {count:,} messages of {printable(source_name)} never arrived")
    rows = [("STREAM", "ROWS", "RATE", "COLUMNS", "TIME FROM")]
    rows += [
        (
            s.stream,
            f"{s.rows:,}",
            rate_text(s.rate_hz),
            str(len(s.columns)),
            s.metadata.get("time_source", ""),
        )
        for s in manifest.streams
    ]
    return "\n".join([*lines, "", *aligned(rows)])


def rate_text(rate_hz: float | None) -> str:
    """A rate for people."""
    return "-" if rate_hz is None else f"{rate_hz:.1f} Hz" if rate_hz < 100 else f"{rate_hz:.0f} Hz"


def stream_text(data: Path, manifest: Manifest, entry: StreamEntry, count: int) -> str:
    """Columns of a stream with units, and its first rows."""
    columns = [("COLUMN", "TYPE", "UNIT", "SCALE", "VALUES")]
    for c in entry.columns:
        names = ", ".join(f"{k}={v}" for k, v in list(c.enum.items())[:3]) + (
            ", ..." if len(c.enum) > 3 else ""
        )
        columns.append((c.name, c.type, c.unit, "" if c.scale == 1.0 else f"{c.scale:g}", names))
    title = f"{printable(entry.stream)}: {entry.rows:,} rows, {rate_text(entry.rate_hz)}"
    return "\n".join([title, "", *aligned(columns), "", *aligned(first_rows(data, manifest, entry, count))])


def first_rows(data: Path, manifest: Manifest, entry: StreamEntry, count: int) -> list[tuple[str, ...]]:
    """The first rows as cells, cut to a readable width."""
    from flysid.manifest import FLIGHTS
    from flysid.store import read_entry

    names = tuple(c.name for c in entry.columns)
    if count <= 0:
        return [names]
    table = read_entry(data / FLIGHTS / manifest.id, entry).slice(0, count)
    return [names, *(tuple(str(row[n])[:24] for n in names) for row in table.to_pylist())]
