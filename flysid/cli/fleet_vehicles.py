"""`flysid fleet fit LAKE -r sixdof --vehicle`: every vehicle of a fleet, with six degrees of freedom."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path

import click

from flysid.cli.display import Display
from flysid.cli.fleet_data import FleetData
from flysid.cli.output import align_columns, check_target, print_json, say
from flysid.cli.vehicle import Fitted, fit_flights
from flysid.errors import FlysidError, UsageError
from flysid.showing import counted

HEADINGS = ("VEHICLE", "FLIGHTS", "SECONDS", "BY")
SHOWN = {
    "thrust of a motor": "THRUST m/s^2",
    "motor lag": "LAG s",
    "rotor drag x": "DRAG X 1/s",
    "rotor drag y": "DRAG Y 1/s",
}
"""Numbers of the table, and the heading of each."""
LINEAR = "--by, --ts, --models, --effort, --channel, --grid, --cluster and --workers"


def check_alone(data: FleetData, by: str, ts: bool, models: str, effort: str) -> None:
    """Raise UsageError where an option stands beside --vehicle that is of the linear models."""
    others = ts or models or data.channels or data.rate_hz or data.cluster or data.workers
    if others or by != "vehicle" or effort != "normal":
        raise UsageError(
            "--vehicle fits whole vehicles, one for each name",
            hint=f"leave out {LINEAR}: they belong to linear models and runs",
        )


def fit_fleet_vehicles(
    data: FleetData, output: Path | None, force: bool, as_json: bool, display: Display
) -> int:
    """Fit every vehicle that flights name, as `flysid vehicle LAKE --vehicle NAME` does; the exit code.

    `output`: a folder a vehicle is made in it (`folder_of`); None: nothing is written.
    """
    from flysid.cli.source import require_fit
    from flysid.fleet.models.vehicle_runs import folder_of
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.chosen_flights import Selection, select, vehicles
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.progress import part
    from flysid.sixdof.vehicle import Vehicle

    lake = open_lake(data.folder)
    recipe = load_recipe(data.recipe)
    require_fit(lake, data.recipe)
    known = vehicles(lake)
    nameless = known.pop("", [])
    if not known:
        raise UsageError(
            "no flight names its vehicle",
            path=data.folder,
            hint="flysid ingest --vehicle-in PATTERN takes names from paths",
        )
    targets = {} if output is None else {name: output / folder_of(name) for name in known}
    for target in targets.values():
        check_target(target, force)
    done: dict[str, Fitted | str] = {}
    with display.shown():
        for i, name in enumerate(known):
            with part(i / len(known), (i + 1) / len(known)):
                try:
                    flights = select(lake, Selection(vehicle=name)).logs
                    found = fit_flights(flights, recipe, Vehicle(), judge=True)
                except FlysidError as error:
                    done[name] = error.message
                    continue
            done[name] = found
            if output is not None:
                output.mkdir(parents=True, exist_ok=True)
                found.write(targets[name], _typed(data, name, targets[name]))
    fitted = {name: found for name, found in done.items() if isinstance(found, Fitted)}
    failed = {name: why for name, why in done.items() if isinstance(why, str)}
    if as_json:
        documents = {name: found.to_dict() for name, found in fitted.items()}
        print_json({"recipe": recipe.name, "vehicles": documents, "failed": failed})
    else:
        click.echo("\n".join(align_columns(_table(fitted))))
    for name, why in failed.items():
        say(f"{name}: {why}")
    if nameless:
        say(f"{counted(len(nameless), 'flight')} left out: whose is not known")
    if output is not None and fitted:
        say(f"{counted(len(fitted), 'vehicle')} in {output}", display.quiet)
    return 3 if failed else 0


def _typed(data: FleetData, name: str, target: Path) -> str:
    """The command that fits one of them alone."""
    words = ["vehicle", str(data.folder), "-r", data.recipe, "--vehicle", name, "-o", str(target)]
    return shlex.join(["flysid", *words])


def _table(fitted: Mapping[str, Fitted]) -> list[tuple[str, ...]]:
    """A line a vehicle; "-" for a number that its flights do not determine."""
    rows = [(*HEADINGS, *SHOWN.values())]
    for name, found in fitted.items():
        flights = found.vehicle.flights
        cells = [name, str(len(flights)), f"{sum(f.seconds for f in flights):.0f}", found.vehicle.method]
        for number in (found.vehicle[shown] for shown in SHOWN):
            size = f"{number.value:.3g} +- {number.half_width:.1g}"
            cells.append(size if number.is_determined else "-")
        rows.append(tuple(cells))
    return rows
