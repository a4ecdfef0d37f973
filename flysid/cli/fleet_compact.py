"""`flysid fleet compact LAKE`: many small tables into few large ones."""

from __future__ import annotations

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import say


@click.command("compact")
@click.argument("lake", metavar="LAKE")
@progress_options
def command(lake: str, quiet: bool, display: Display) -> None:
    """Merge the tables of all flights into parts of about 128 MB, by message and month.

    The flights are not changed. A month whose flights have not changed is skipped. 'flysid fleet files'
    lists the parts; readers see either the old or the new ones. One compaction runs at a time.
    """
    from flysid.fleet.compaction import compact
    from flysid.fleet.lakes import open_lake

    with display.shown():
        done = compact(open_lake(lake))
    written = f"{done.written:,} tables of a month"
    say(f"{written} written, {done.unchanged:,} as before; {done.rows:,} rows, {done.parts:,} parts", quiet)
