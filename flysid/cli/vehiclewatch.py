"""`flysid watch VEHICLE LOG`: which motor, mass or drag of a vehicle has changed in a later flight."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flysid.cli.output import ExitCode, printable
from flysid.errors import UsageError
from flysid.showing import fold


def watch_vehicle(folder: Path, log: Path, recipe: str, *, fail: bool, as_json: bool) -> int:
    """Print what has changed; the verb's exit code.

    Raises
    ------
    UsageError : no such log; another number of motors. StoreError : no vehicle. DataError : nothing flies.
    """
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.align.vehicle_channel import vehicle_data
    from flysid.ingest.formats.registry import read
    from flysid.sixdof.changes import changes_since
    from flysid.sixdof.fitted import load_vehicle

    if not log.is_file():
        raise UsageError("no such log", path=log, hint="a vehicle is watched in a log, not on a link")
    vehicle = load_vehicle(folder)
    data = vehicle_data([FlightLog(read(log))], load_recipe(recipe)).dataset
    found = changes_since(vehicle, data)
    if as_json:
        click.echo(json.dumps(found.to_dict()))
    else:
        click.echo("\n".join(fold(printable(line)) for line in found.lines()))
    return ExitCode.ALARM if fail and found.found else 0
