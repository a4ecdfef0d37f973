"""`flysid fleet compact LAKE`: many small tables into few large ones."""

from __future__ import annotations

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import say
from flysid.showing import counted


@click.command("compact")
@click.argument("lake", metavar="LAKE")
@progress_options
def command(lake: str, display: Display) -> None:
    """Merge the tables of all flights into parts of about 128 MB, by message and month.

    The flights are not changed. A month whose flights have not changed is skipped. 'flysid fleet files'
    lists the parts; readers see either the old or the new ones. One compaction runs at a time.
    """
    from flysid.fleet.compaction import compact
    from flysid.fleet.lakes import open_lake

    with display.shown():
        done = compact(open_lake(lake))
    written = f"tables of a month: {done.written:,} written, {done.unchanged:,} as before"
    say(f"{written}; {counted(done.rows, 'row')}, {counted(done.parts, 'part')}", display.quiet)
