"""`flysid fleet VERB`: one module per verb, `fleet_<verb>.py`, imported when that verb is run."""

from __future__ import annotations

import click

from flysid.cli.config import take_settings
from flysid.cli.lazy import LazyVerbs

FLEET_VERBS: dict[str, str] = {
    "changed": "List vehicles that have changed, or differ from the rest of the fleet.",
    "check": "Compare a lake's manifests with its tables and its catalogue.",
    "compact": "Put many small tables into few large ones, a message and a month each.",
    "files": "Print the addresses of the parquet files that hold a message.",
    "fit": "Linear models of any group of flights; runs of every vehicle.",
    "forget": "Remove everything of a vehicle from a lake.",
    "ls": "List a fleet's flights from its catalogue.",
}


@click.group("fleet", cls=LazyVerbs, verbs=FLEET_VERBS, modules="flysid.cli.fleet_{}", parent="fleet")
@click.pass_context
def command(ctx: click.Context) -> None:
    """Many logs of many vehicles: their catalogue, their upkeep, their models."""
    take_settings(ctx)
