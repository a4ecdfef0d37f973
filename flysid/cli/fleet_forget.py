"""`flysid fleet forget LAKE --vehicle NAME`: everything of a vehicle, out of a lake."""

from __future__ import annotations

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import say
from flysid.cli.trust import Own
from flysid.errors import UsageError
from flysid.escaping import one_line
from flysid.showing import counted

SHOWN = 3


@click.command("forget")
@click.argument("lake", metavar="LAKE")
@click.option("--vehicle", cls=Own, required=True, metavar="NAME", help="Full name of the vehicle.")
@click.option("--yes", cls=Own, is_flag=True, help="Do not ask.")
@progress_options
def command(lake: str, vehicle: str, yes: bool, display: Display) -> None:
    """Remove a vehicle's flights: objects, rows, its part of compacted tables, and the catalogue's history.

    It lists what it cannot remove. Do not ingest or compact at the same time.
    """
    from flysid.fleet.forgetting import forget
    from flysid.fleet.lakes import open_lake
    from flysid.ingest.lake.flighttable import facts_in, select

    place = open_lake(lake)
    named = vehicle.replace("'", "''")
    flights = facts_in(select(place, f"vehicle = '{named}'"))
    if not flights:
        raise UsageError(
            f"no vehicle {vehicle!r} in this lake", path=lake, hint=f"flysid fleet ls {lake} --by vehicle"
        )
    if not yes:
        click.confirm(
            f"Remove {counted(len(flights), 'flight')} of {vehicle} for good?", abort=True, err=True
        )
    with display.shown():
        done = forget(place, flights)
    say(f"{counted(done.flights, 'flight')} and {counted(done.objects, 'object')} removed", display.quiet)
    if done.sources:
        some = ", ".join(done.sources[:SHOWN]) + (", ..." if len(done.sources) > SHOWN else "")
        say(f"the logs are still there, and the next ingest would bring them back: {one_line(some)}")
    say(
        "not removed: former versions that the bucket keeps, its backups and access logs, caches in "
        "~/.cache/flysid of everyone who read them, and models that were fitted to them",
        display.quiet,
    )
