"""`flysid fleet check LAKE`: whether every flight has its tables and its row, and what else lies there."""

from __future__ import annotations

import json
from datetime import timedelta
from typing import TYPE_CHECKING

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.lakeoptions import seconds
from flysid.cli.output import ExitCode, say
from flysid.cli.trust import Own
from flysid.escaping import one_line
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.fleet.upkeep import LakeState


@click.command("check")
@click.argument("lake", metavar="LAKE")
@click.option(
    "--repair",
    cls=Own,
    is_flag=True,
    help="Rebuild the catalogue and remove objects that belong to no flight.",
)
@click.option(
    "--older",
    cls=Own,
    default="1d",
    show_default=True,
    callback=seconds,
    metavar="TIME",
    help="With --repair: remove only older objects; newer ones may belong to a running ingest.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@progress_options
def command(lake: str, repair: bool, older: float, as_json: bool, display: Display) -> int:
    """Check a lake's tables and catalogue against its manifests.

    Exit code 4: something is wrong and was not repaired.
    """
    from flysid.fleet.lakes import open_lake
    from flysid.fleet.upkeep import check
    from flysid.fleet.upkeep import repair as put_right

    place = open_lake(lake)
    with display.shown():
        state = check(place)
        removed = put_right(place, state, timedelta(seconds=older)) if repair else 0
        if repair and not state.is_whole:
            for line in faults(state):
                say(f"was: {line}", display.quiet)
            state = check(place)
    if as_json:
        click.echo(json.dumps(as_document(lake, state, removed), indent=1))
    else:
        click.echo(f"{counted(len(state.flights), 'flight')}, {'whole' if state.is_whole else 'not whole'}")
        for line in faults(state):
            click.echo(one_line(line))
    if removed:
        say(f"{counted(removed, 'object')} removed", display.quiet)
    if state.unlisted or state.stale or state.orphans:
        say(
            "flysid fleet check --repair rebuilds the catalogue and removes old orphans",
            display.quiet or repair,
        )
    return 0 if state.is_whole else ExitCode.CHECK_FAILED


def faults(state: LakeState) -> list[str]:
    """What is wrong, a line for each kind."""
    kinds = {
        "manifests that cannot be read": [f"{key}: {why}" for key, why in state.damaged.items()],
        "tables that are missing": list(state.missing),
        "logs with more than one flight": list(state.twice),
        "flights missing from the catalogue": list(state.unlisted),
        "catalogue rows that differ from their manifests": list(state.stale),
        "objects that belong to no flight": [found.key for found in state.orphans],
    }
    return [f"{len(names):,} {kind}: {_some(names)}" for kind, names in kinds.items() if names]


def _some(names: list[str], *, most: int = 5) -> str:
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


def as_document(lake: str, state: LakeState, removed: int) -> dict[str, object]:
    """What was found, for `--json`."""
    return {
        "lake": lake,
        "flights": len(state.flights),
        "is_whole": state.is_whole,
        "damaged": state.damaged,
        "missing": list(state.missing),
        "twice": list(state.twice),
        "unlisted": list(state.unlisted),
        "stale": list(state.stale),
        "orphans": [found.key for found in state.orphans],
        "removed": removed,
    }
