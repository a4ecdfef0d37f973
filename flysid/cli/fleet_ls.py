"""`flysid fleet ls LAKE`: the flights of a fleet, from its catalogue alone."""

from __future__ import annotations

import json
from datetime import datetime
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.output import NAMES_SHOWN, align_columns, say
from flysid.cli.trust import Own, Setting
from flysid.facts.losses import lines_of_flights
from flysid.showing import clock, counted

if TYPE_CHECKING:
    import pyarrow as pa

HEADINGS = ("FLIGHT", "VEHICLE", "FIRMWARE", "START", "TIME", "RECORDS", "LOST")
COLUMNS = ("flight", "vehicle", "firmware", "start", "duration_s", "rows", "lost", "losses")


@click.command("ls")
@click.argument("lake", metavar="LAKE|DATA")
@click.option("--vehicle", cls=Setting, default="", metavar="NAME", help="Only flights of this vehicle.")
@click.option("--firmware", cls=Setting, default="", metavar="NAME", help="Only flights with this firmware.")
@click.option(
    "--where", cls=Own, default="", metavar="SQL", help="Only flights for which this condition holds."
)
@click.option(
    "--sql", cls=Own, default="", metavar="SELECT", help="Run this query on the table 'flights' instead."
)
@click.option(
    "--by", cls=Own, default="", metavar="COLUMN", help="Print flights and hours per group instead."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON, one row per line.")
def command(lake: str, vehicle: str, firmware: str, where: str, sql: str, by: str, as_json: bool) -> None:
    """List the flights of a fleet: vehicle, firmware and losses.

    \b
    flysid fleet ls s3://lake --vehicle v017
    flysid fleet ls s3://lake --where "start > '2026-10-01' and array_has(modes, 'LOITER')"
    flysid fleet ls s3://lake --sql "select firmware, count(*) from flights group by firmware"
    """
    from flysid.fleet.asking import answer

    conditions = [f"{name} = {_quote(value)}" for name, value in _name_columns(vehicle, firmware) if value]
    conditions += [f"({where})"] if where else []
    table = answer(lake, sql or _question(conditions, by))
    if as_json:
        for row in table.to_pylist():
            click.echo(json.dumps(row, default=str))
    elif sql or by:
        rows = [[_cell(value) for value in row.values()] for row in table.to_pylist()]
        click.echo("\n".join(align_columns([[name.upper() for name in table.column_names], *rows])))
    else:
        click.echo("\n".join(align_columns([HEADINGS, *(_row(row) for row in table.to_pylist())])))
        for line in lines_of_flights(
            {row["flight"]: row["losses"] or "" for row in table.to_pylist()}, NAMES_SHOWN
        ):
            say(f"lost: {line}")
        _sum_up(table)


def _name_columns(vehicle: str, firmware: str) -> tuple[tuple[str, str], ...]:
    return ("vehicle", vehicle), ("firmware", firmware)


def _quote(text: str) -> str:
    doubled = text.replace("'", "''")
    return f"'{doubled}'"


def _question(conditions: list[str], by: str) -> str:
    where = f" where {' and '.join(conditions)}" if conditions else ""
    if by:
        return (
            f"select {by}, count(*) as flights, sum(duration_s) / 3600 as hours from flights{where} "
            f"group by {by} order by {by}"
        )
    return f"select {', '.join(COLUMNS)} from flights{where} order by flight"


def _row(row: dict[str, Any]) -> tuple[str, ...]:
    return (
        row["flight"],
        row["vehicle"] or "-",
        row["firmware"] or "-",
        _cell(row["start"]),
        clock(row["duration_s"], padded=True),
        f"{row['rows']:,}",
        "yes" if row["lost"] else "-",
    )


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, datetime):
        return f"{value:%Y-%m-%d %H:%M}"
    if isinstance(value, list):
        return ", ".join(map(str, value))
    return f"{value:,.2f}" if isinstance(value, float) else str(value)


def _sum_up(table: pa.Table) -> None:
    hours = sum(table["duration_s"].to_pylist()) / 3600.0
    vehicles = len(set(table["vehicle"].to_pylist()))
    say(f"{counted(table.num_rows, 'flight')} of {counted(vehicles, 'vehicle')}, {hours:,.1f} h")
