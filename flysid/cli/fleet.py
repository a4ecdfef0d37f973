"""`flysid fleet VERB`: one module per verb, `fleet_<verb>.py`, imported when that verb is run."""

from __future__ import annotations

import click

from flysid.cli.lazy import LazyVerbs

FLEET_VERBS: dict[str, str] = {
    "changed": "Which vehicles no longer fly as they did, or not as the others.",
    "check": "Compare a lake's manifests with its tables and its catalogue.",
    "fit": "Linear models of any group of flights; runs of every vehicle.",
    "ls": "List a fleet's flights from its catalogue.",
}


@click.group("fleet", cls=LazyVerbs, verbs=FLEET_VERBS, modules="flysid.cli.fleet_{}", parent="fleet")
def command() -> None:
    """Many logs of many vehicles: their catalogue, their upkeep, their models."""
