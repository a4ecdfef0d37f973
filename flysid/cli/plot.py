"""What `flysid show DATA [FLIGHT] --plot FILE` draws: the channels of a recipe, segment by segment."""

from __future__ import annotations

from pathlib import Path

import click


def plot_flight(data: str, flight: str | None, recipe: str | None, path: str, force: bool) -> None:
    """Draw every channel that the flights can serve, and print the picture's path.

    Raises
    ------
    UsageError : no recipe serves the flights, several do and none was chosen, the target exists.
    """
    from flysid.cli.output import check_target
    from flysid.errors import UsageError
    from flysid.ingest.align.picture import draw
    from flysid.ingest.lake.lake import Lake
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.manifest import find_flight

    check_target(Path(path), force)
    lake = open_lake(data)
    if flight is not None:
        lake = Lake(lake.folder, (find_flight(data, flight),))
    served = [recipe] if recipe else list(lake.recipes())
    if len(served) != 1:
        raise UsageError(
            f"{len(served)} shipped recipes fit", hint="--recipe " + (", ".join(served) or "PATH of your own")
        )
    draw(lake.datasets(served[0]), path, title=f"{', '.join(m.id for m in lake.flights[:3])}: {served[0]}")
    click.echo(path)
