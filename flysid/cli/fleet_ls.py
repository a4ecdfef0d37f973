"""`flysid fleet ls DATA`: the flights of a fleet, from its catalogue alone."""

from __future__ import annotations

from pathlib import Path

import click

from flysid.cli.ls import clock_text
from flysid.cli.output import aligned

HEADINGS = ("FLIGHT", "VEHICLE", "FIRMWARE", "TIME", "RECORDS", "LOST")


@click.command("ls")
@click.argument("data", type=click.Path(path_type=Path))
@click.option("--vehicle", default="", metavar="NAME", help="Its flights alone.")
@click.option("--firmware", default="", metavar="NAME", help="Flights of this firmware alone.")
def command(data: Path, vehicle: str, firmware: str) -> None:
    """List the flights of a fleet: whose they are, which firmware flew, what was lost."""
    from flysid.catalogue import catalogue
    from flysid.ingest.align.vehicle import vehicle_of

    rows = [HEADINGS]
    for facts in catalogue(data):
        own = vehicle_of(facts.info)
        version = facts.info.get("firmware", "")
        if (not vehicle or own == vehicle) and (not firmware or version == firmware):
            time = clock_text(facts.duration_s)
            rows.append((facts.id, own or "-", version or "-", time, f"{facts.rows:,}", "yes" * facts.lossy))
    click.echo("\n".join(aligned(rows)))
