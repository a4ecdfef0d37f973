"""`flysid fleet fit LAKE --recipe R --by vehicle,firmware`: linear models of groups; runs of vehicles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.fleet_data import FleetData, fleet_data_options
from flysid.cli.options import effort_option
from flysid.cli.output import align_columns, check_target, explain, say, say_left_out
from flysid.cli.trust import Own, ProjectFile, Setting
from flysid.errors import UsageError
from flysid.extras import Missing
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.fleet.cluster import Cluster
    from flysid.fleet.models.group_models import FleetFit
    from flysid.ingest.lake.lake import Lake
    from flysid.validate.runs.run import FitSettings

MODELS = "fleet.json"
HEADINGS = ("GROUP", "CHANNEL", "FLIGHTS", "SAMPLES", "RMSE", "GAIN", "AT")


@click.command("fit")
@fleet_data_options
@click.option(
    "--by",
    cls=Setting,
    default="vehicle",
    show_default=True,
    metavar="A,B",
    help="Group by vehicle, firmware, month.",
)
@click.option("--output", "-o", type=click.Path(path_type=Path), help="Folder for the models.")
@click.option(
    "--vehicle", is_flag=True, help="Whole vehicles instead, as 'flysid vehicle' fits one; -r sixdof."
)
@click.option("--ts", is_flag=True, help="Also a run for each vehicle, as 'fit --vehicle' makes it.")
@click.option(
    "--models", "-m", cls=ProjectFile, default="", metavar="A,B", help="Models of those runs, as for 'fit'."
)
@effort_option("Effort of the search for rules in these runs.")
@click.option("--force", cls=Own, is_flag=True, help="Replace the models if they exist.")
@click.option("--json", "as_json", is_flag=True, help="Print the models as JSON.")
@progress_options
def command(
    data: FleetData,
    by: str,
    output: Path | None,
    vehicle: bool,
    ts: bool,
    models: str,
    effort: str,
    force: bool,
    as_json: bool,
    display: Display,
) -> int:
    """Fit a linear model to every group of a fleet's flights, and Takagi-Sugeno models to every vehicle.

    Flights are read once; their triangular factors are cached beside them, so another --by reads none.
    Covariances come from the scatter between flights. With -o the models are written as fleet.json; --ts
    adds a run folder for each vehicle, ready for 'flysid validate'. --vehicle fits every vehicle with six
    degrees of freedom instead, and -o takes a folder of each. Exit code 3: a group or a vehicle could not be
    fitted.
    """
    if vehicle:
        from flysid.cli.fleet_vehicles import check_alone, fit_fleet_vehicles

        check_alone(data, by, ts, models, effort)
        return fit_fleet_vehicles(data, output, force, as_json, display)
    if output is not None:
        check_target(output / MODELS, force)
    elif ts:
        raise click.UsageError("--ts makes run folders: -o says where")
    if models and not ts:
        raise UsageError("--models are those of a vehicle's run", hint="add --ts -o DIR")
    from flysid.files import write_atomically, writing_to
    from flysid.fleet.models.group_models import check_keys, fit_groups
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.validate.runs.wanted_models import check_settings

    opened = open_lake(data.folder)
    asked = load_recipe(data.recipe)
    missing = Missing()
    keys = tuple(key for key in by.replace(" ", "").split(",") if key)
    check_keys(keys)
    settings = settings_of(data, models, effort)
    check_settings(settings)
    with data.engine(opened, display.quiet) as cluster:
        with display.shown(), missing.gathering():
            gathered = data.gather(opened, asked, cluster, display.quiet)
            fitted = fit_groups(gathered, keys)
        document = fitted.document(asked.name) | missing.to_dict()
        text = json.dumps(document, indent=1, allow_nan=False) + "\n"
        if output is not None:
            with writing_to(output / MODELS):
                output.mkdir(parents=True, exist_ok=True)
                write_atomically(output / MODELS, text.encode())
        click.echo(text if as_json else "\n".join(table(fitted)), nl=not as_json)
        for name, why in fitted.skipped.items():
            say_left_out(name, why)
        for sentence in missing.sentences:
            explain(sentence)
        unfit = [group for group in fitted.groups if group.reason]
        for group in unfit:
            say(f"{name_of(group.key)}, {group.channel}: {group.reason}")
        failed = 0
        if ts and output is not None:
            failed = run_vehicles(opened, data, output, settings, cluster, display, display.quiet)
    return 3 if unfit or failed else 0


def table(fitted: FleetFit) -> list[str]:
    """One line for each group and channel."""
    import numpy as np

    rows = [HEADINGS]
    for group in fitted.groups:
        if group.reason:
            continue
        gain = at = "-"
        omega = fitted.omega[group.channel]
        if group.response is not None:
            middle = len(omega) // 2
            gain = f"{np.exp(group.response.value[middle]):.4g}"
            at = f"{omega[middle] / 2.0 / np.pi:.2g} Hz"
        model = group.models[0]
        rows.append((name_of(group.key), group.channel, str(len(group.flights)), f"{model.rows:,}",
                     f"{model.rmse:.3g}", gain, at))  # fmt: skip
    return align_columns(rows)


def name_of(key: object) -> str:
    """A group as people call it."""
    values = [value or "-" for value in dict(key).values()] if isinstance(key, dict) else []
    return " ".join(values) or "fleet"


def settings_of(data: FleetData, models: str, effort: str) -> FitSettings:
    """How the vehicles' own runs are fitted."""
    from flysid.cli.fit import labels_of
    from flysid.validate.runs.run import FitSettings

    return FitSettings(channels=data.channels, models=labels_of(models), effort=effort)


def run_vehicles(
    lake: Lake,
    data: FleetData,
    output: Path,
    settings: FitSettings,
    cluster: Cluster | None,
    display: Display,
    quiet: bool,
) -> int:
    """A run folder for each vehicle; returns how many there could not be."""
    from flysid.fleet.models.vehicle_runs import fit_vehicles, folder_of
    from flysid.ingest.lake.chosen_flights import vehicles

    named = [name for name in vehicles(lake) if name]
    with display.shown():
        done = fit_vehicles(lake, data.recipe, output, settings, named, data.jobs, cluster)
    failed = {name: why for name, why in done.items() if isinstance(why, str)}
    for name, why in failed.items():
        say(f"{name}: {why}")
    for name, run in done.items():
        for channel in () if isinstance(run, str) else run.channels:
            for sentence in channel.missing:
                explain(f"{name}: {sentence}")
    say(f"{counted(len(done) - len(failed), 'run')} in {output}", quiet)
    if len(done) > len(failed):
        first = next(name for name in done if name not in failed)
        say(f"next: flysid validate {output / folder_of(first)}", quiet)
    return len(failed)
