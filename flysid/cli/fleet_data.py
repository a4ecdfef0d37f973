"""What the fleet's models are made from: a lake, a recipe, some of its channels, on one grid."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.output import cores, say
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.fleet.models.gather import Gathered
    from flysid.ingest.align.recipe import Recipe
    from flysid.ingest.lake.lake import Lake

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class FleetData:
    """What was asked for.

    Attributes
    ----------
    folder : of the lake, or its address.
    recipe : a name, or the path of a .toml file.
    channels : of the recipe; all when there are none.
    rate_hz : of the grid; chosen from the flights when None.
    jobs : processes.
    """

    folder: Path
    recipe: str
    channels: tuple[str, ...]
    rate_hz: float | None
    jobs: int

    def gather(self, lake: Lake, recipe: Recipe, quiet: bool) -> Gathered:
        """The fleet's triangles; says how many flights were read for them."""
        from flysid.fleet.models.gather import gather
        from flysid.fleet.models.triangle_store import Folder

        found = gather(lake, recipe, Folder(lake.folder), self.channels, self.rate_hz, self.jobs)
        say(f"{counted(found.read, 'flight')} read, {len(lake) - found.read:,} known", quiet)
        for flight, why in found.lost.items():
            say(f"{flight}: could not be read: {why}")
        return found


def fleet_data_options(function: F) -> F:
    """Adds LAKE, --recipe, --channel, --grid and --jobs; the verb takes them as `data`."""

    @wraps(function)
    def verb(
        *args: Any,
        lake: Path,
        recipe: str,
        channels: tuple[str, ...],
        rate_hz: float | None,
        jobs: int,
        **options: Any,
    ) -> Any:
        return function(*args, data=FleetData(lake, recipe, channels, rate_hz, jobs or cores()), **options)

    decorated: Any = verb
    for option in (
        click.option("--jobs", "-j", default=0, metavar="N", help="Processes; one per core when not given."),
        click.option(
            "--grid",
            "rate_hz",
            type=click.FloatRange(0.0, min_open=True),
            metavar="HZ",
            help="Rate of the grid.",
        ),
        click.option(
            "--channel", "-c", "channels", multiple=True, help="Only this channel; may be repeated."
        ),
        click.option(
            "--recipe", "-r", required=True, shell_complete=complete.recipes, help="Name or .toml file."
        ),
        click.argument("lake", type=SOURCE),
    ):
        decorated = option(decorated)
    chosen: F = decorated
    return chosen
