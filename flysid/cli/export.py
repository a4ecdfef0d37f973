"""`flysid export LOG|DATA --to KIND`: a flight for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from flysid.cli.source import format_option, opened_flights

KINDS = ("csv", "parquet", "mat", "xlsx", "mcap")


@click.command("export")
@click.argument("source", type=click.Path(path_type=Path))
@click.argument("streams", nargs=-1, metavar="[STREAM...]")
@click.option(
    "--to", "kind", type=click.Choice(KINDS), default="csv", show_default=True, help="Kind of file."
)
@click.option("--flight", default="", help="The flight of a folder, by id or its beginning.")
@click.option("--rate", "rate_hz", type=float, help="One table on a grid of this many rows a second.")
@click.option("-o", "--out", type=click.Path(path_type=Path), help="File, or folder for several tables.")
@format_option
@click.option("--force", is_flag=True, help="Replace the target if it is there.")
def command(
    source: Path,
    streams: tuple[str, ...],
    kind: str,
    flight: str,
    rate_hz: float | None,
    out: Path | None,
    force: bool,
    format_: str,
) -> None:
    """Write a flight's streams for other programs, in physical units.

    Without --rate every stream keeps its own times and has a table of its own.

    \b
    flysid export flight.bin ATT RATE --to mat -o flight.mat
    flysid export data --flight 0042 --rate 50 -o flight.csv
    """
    from flysid.cli.output import check_target
    from flysid.errors import UsageError
    from flysid.ingest.lake.export import GRID, export_tables, gridded_table, physical_tables
    from flysid.ingest.lake.selection import Selection, select

    with opened_flights(source, format_) as lake:
        logs = select(lake, Selection(flights=(flight,) if flight else ())).logs
        if len(logs) != 1:
            raise UsageError(
                f"{source} holds {len(logs)} flights",
                hint="--flight " + ", or --flight ".join(log.name for log in logs[:3]),
            )
        tables = physical_tables(logs[0], streams)
        if rate_hz is not None:
            tables = {GRID: gridded_table(tables, rate_hz)}
        single = len(tables) == 1 or kind in ("mat", "xlsx", "mcap")
        target = out or Path(f"{logs[0].name}.{kind}" if single else f"{logs[0].name}-{kind}")
        check_target(target, force)
        click.echo(str(export_tables(tables, kind, target)))
