"""`flysid fleet files LAKE MESSAGE`: where a message's rows are, for DuckDB, Polars, pandas or Spark."""

from __future__ import annotations

import click

from flysid.cli.trust import Own


@click.command("files")
@click.argument("lake", metavar="LAKE")
@click.argument("message", metavar="MESSAGE")
@click.option(
    "--where",
    cls=Own,
    default="",
    metavar="SQL",
    help="Only flights for which this holds, in their own tables.",
)
def command(lake: str, message: str, where: str) -> None:
    """Print the addresses of a message's parquet files: compacted parts, and tables of other flights."""
    from flysid.fleet.compaction import files_of
    from flysid.fleet.lakes import open_lake

    for address in files_of(open_lake(lake), message, where):
        click.echo(address)
