"""What the fleet's models are made from: a lake, a recipe, some of its channels, on one grid."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.lakeoptions import CLUSTER, check_one_cluster, dask_cluster
from flysid.cli.options import channels_option, gather, jobs_option
from flysid.cli.output import cores, say
from flysid.cli.trust import ProjectFile
from flysid.errors import UsageError
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.fleet.cluster import Cluster
    from flysid.fleet.models.gather import Gathered
    from flysid.ingest.align.recipe import Recipe
    from flysid.ingest.lake.lake import Lake


@dataclass(frozen=True)
class FleetData:
    """The request.

    `folder`: of the lake, or its address.
    `recipe`: a name, or the path of a .toml file.
    `channels`: of the recipe; all when there are none.
    `rate_hz`: of the grid; chosen from the flights when None.
    `jobs`: processes.
    `cluster`, `workers`: a Dask cluster to be found or made; neither: this machine's processes.
    """

    folder: Path
    recipe: str
    channels: tuple[str, ...]
    rate_hz: float | None
    jobs: int
    cluster: str = ""
    workers: int = 0

    @contextmanager
    def engine(self, lake: Lake, quiet: bool) -> Iterator[Cluster | None]:
        """The requested cluster; None: this machine.

        Raises UsageError: a cluster cannot reach a folder of this machine.
        """
        if not self.cluster and not self.workers:
            yield None
            return
        if not lake.address:
            raise UsageError(
                "--cluster and --workers are for a lake at an address",
                path=lake.folder,
                hint="on this machine, -j sets the number of processes",
            )
        with dask_cluster(self.cluster, self.workers, quiet) as cluster:
            yield cluster

    def gather(self, lake: Lake, recipe: Recipe, cluster: Cluster | None, quiet: bool) -> Gathered:
        """The fleet's triangles; says how many flights were read for them."""
        from flysid.cli.losses import say_lost
        from flysid.cli.source import require_fit
        from flysid.fleet.models.gather import gather
        from flysid.fleet.models.triangle_store import Folder

        require_fit(lake, self.recipe)
        say_lost(lake.facts)
        found = gather(lake, recipe, Folder(lake.folder), self.channels, self.rate_hz, self.jobs, cluster)
        say(f"{counted(found.read, 'flight')} read, {len(lake) - found.read:,} known", quiet)
        for flight, why in found.lost.items():
            say(f"{flight}: could not be read: {why}")
        return found


def _fleet_data(lake: Path, recipe: str, channels: tuple[str, ...], jobs: int, **more: Any) -> FleetData:
    from flysid.ingest.align.recipe import load_recipe

    check_one_cluster(more["cluster"], more["workers"])
    load_recipe(recipe).chosen(channels)
    return FleetData(lake, recipe, channels, jobs=jobs or cores(), **more)


fleet_data_options = gather(
    "data",
    _fleet_data,
    click.argument("lake", type=SOURCE),
    click.option(
        "--recipe",
        "-r",
        cls=ProjectFile,
        required=True,
        shell_complete=complete.recipes,
        help="Name or .toml file.",
    ),
    channels_option,
    click.option("--grid", "rate_hz", type=POSITIVE, metavar="HZ", help="Rate of the grid."),
    jobs_option("Processes; one per core when not given."),
    *CLUSTER,
)
"""LAKE and the options of `FleetData`; the verb takes them as `data`."""
