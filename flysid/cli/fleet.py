"""`flysid fleet VERB`: one module per verb, `fleet_<verb>.py`, imported when that verb is run."""

from __future__ import annotations

import click

from flysid.cli.config import take_settings
from flysid.cli.lazy import LazyVerbs
from flysid.cli.verbs import FLEET_VERBS


@click.group("fleet", cls=LazyVerbs, verbs=FLEET_VERBS, modules="flysid.cli.fleet_{}:command")
@click.pass_context
def command(ctx: click.Context) -> None:
    """Many logs of many vehicles: their catalogue, their upkeep, their models."""
    take_settings(ctx)
