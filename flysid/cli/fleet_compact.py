"""`flysid fleet compact LAKE`: many small tables into few large ones."""

from __future__ import annotations

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import say


@click.command("compact")
@click.argument("lake", metavar="LAKE")
@progress_options
def command(lake: str, quiet: bool, display: Display) -> None:
    """Put the tables of all flights into parts of about 128 MB, a message and a month each.

    The flights stay as they are. A month whose flights are as before is left alone. 'flysid fleet files'
    names the parts to whoever reads them; readers see the old or the new. One compaction runs at a time.
    """
    from flysid.fleet.compaction import compact
    from flysid.fleet.lakes import open_lake

    with display.shown():
        done = compact(open_lake(lake))
    written = f"{done.written:,} tables of a month"
    say(f"{written} written, {done.unchanged:,} as before; {done.rows:,} rows, {done.parts:,} parts", quiet)
