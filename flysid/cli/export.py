"""`flysid export`: a flight, or a fitted model, for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import force_option, gather
from flysid.cli.output import say
from flysid.cli.source import opened_flights, reading_options
from flysid.cli.trust import Setting
from flysid.cli.vehicleexport import FILES, is_vehicle, write_vehicle
from flysid.errors import UsageError
from flysid.facts.clock import log_clock
from flysid.progress import tell

if TYPE_CHECKING:
    from flysid.export.fmu import FMIVersion

KINDS = ("csv", "parquet", "mat", "xlsx", "mcap")
CALLED = {"casadi": "model_casadi.py", "jax": "model_jax.py", "onnx": "model.onnx"}
"""Kinds of a model's file that other code calls, and what each is called where no name is given."""


place_options = gather(
    "places",
    dict,
    click.option("--c", type=click.Path(path_type=Path), metavar="DIR", help="A model as C99, into DIR."),
    click.option("--fmu", type=click.Path(path_type=Path), metavar="F.fmu", help="A model as an FMU."),
    click.option(
        "--matlab", type=click.Path(path_type=Path), metavar="DIR", help="A model as .m files, into DIR."
    ),
    click.option(
        "--lpv",
        type=click.Path(path_type=Path),
        metavar="F.json|F.mat",
        help="A model as affine systems and their weights, in physical units.",
    ),
    click.option(
        "--casadi",
        type=click.Path(path_type=Path),
        metavar="F.py",
        help="A model as CasADi functions, for MPC.",
    ),
    click.option(
        "--jax",
        type=click.Path(path_type=Path),
        metavar="F.py",
        help="A model as JAX functions, for learning.",
    ),
    click.option(
        "--onnx",
        type=click.Path(path_type=Path),
        metavar="F.onnx",
        help="One step of a model in float32, and F.json with names and units.",
    ),
)
"""Where to write a model; the verb takes the places by target, None where nothing is written."""


@click.command("export")
@click.argument("source", type=SOURCE)
@click.argument("streams", nargs=-1, metavar="[STREAM...]")
@click.option(
    "--to",
    "kind",
    type=click.Choice([*KINDS, *dict.fromkeys([*CALLED, *FILES])]),
    default="csv",
    show_default=True,
    help=f"File type: of a flight; for code that calls a model: {', '.join(CALLED)}; of a vehicle: "
    f"{', '.join(FILES)}.",
)
@click.option("--mass", "mass_kg", type=POSITIVE, metavar="KG", help="Of a vehicle, as weighed.")
@click.option("--arm", "arm_m", type=POSITIVE, metavar="M", help="From a vehicle's centre to its motors.")
@click.option("--flight", cls=Setting, default="", help="The flight of a folder, by id or its beginning.")
@click.option(
    "--rate",
    "rate_hz",
    type=POSITIVE,
    help="One table on a grid of this many rows per second; for a transfer function: steps per second.",
)
@click.option("-o", "--out", type=click.Path(path_type=Path), help="File, or folder for several tables.")
@reading_options
@place_options
@click.option(
    "--fmi", type=click.Choice(["2", "3"]), default="2", show_default=True, help="Version of the FMU."
)
@click.option("--float32", is_flag=True, help="C in float32, if it is accurate enough on the training data.")
@click.option("--channel", "-c", cls=Setting, default="", help="Channel of the run.")
@click.option(
    "--model",
    "label",
    cls=Setting,
    default="",
    help="Model of the channel.  [default: the one that the verdict is of]",
)
@click.option("--data", type=SOURCE, help="The run's data, if they have moved since the fit.")
@force_option("target")
def command(
    source: Path,
    streams: tuple[str, ...],
    kind: str,
    mass_kg: float | None,
    arm_m: float | None,
    flight: str,
    rate_hz: float | None,
    out: Path | None,
    force: bool,
    reading: Reading,
    places: dict[str, Path | None],
    fmi: str,
    float32: bool,
    channel: str,
    label: str,
    data: Path | None,
) -> None:
    """Export a flight's streams, or a fitted model, to other programs.

    Each stream of a flight has its own table with its own times; --rate puts all on one grid. A model (a
    run's folder, or a model file) becomes C99 without allocation, an FMU, MATLAB files, or functions for code
    of MPC and of learning: --to casadi is --casadi with the file after -o, or model_casadi.py. A vehicle
    (what 'flysid vehicle -o' wrote) becomes parameters of a simulator, or functions for a controller.
    """
    version: FMIVersion = 3 if fmi == "3" else 2
    named = {target: place for target, place in places.items() if place is not None}
    if is_vehicle(source) or (kind in FILES and kind not in CALLED):
        if "c" in named:
            named["c"] /= FILES["c"]
        if kind in FILES:
            named[kind] = named.get(kind) or out or Path(FILES[kind])
        if named and ({"matlab", "lpv"} & {*named} or any((float32, channel, label, data))):
            raise UsageError(
                "--matlab, --lpv, --float32, --channel, --model and --data are for a run's model",
                hint=f"--to {' or '.join(FILES)}",
            )
        for target, place in named.items():
            click.echo(str(write_vehicle(source, target, place, mass_kg, arm_m, force, version)))
        if named:
            return
    if mass_kg is not None or arm_m is not None:
        raise UsageError("--mass and --arm are of a vehicle", hint=f"--to {' or '.join(FILES)}")
    if kind in CALLED:
        named[kind] = named.get(kind) or out or Path(CALLED[kind])
    if named:
        from flysid.cli.modelexport import Wanted, write_model

        wanted = Wanted(source, channel, label, rate_hz, data, float32, version)
        for target, place in named.items():
            write_model(wanted, target, place, force=force)
        click.echo("\n".join(map(str, named.values())))
        return
    if channel or label or float32:
        raise UsageError(
            "--channel, --model and --float32 are for a model",
            hint="add --c DIR, --fmu F.fmu, --matlab DIR, --lpv F.json, --casadi F.py, --jax F.py "
            "or --onnx F.onnx",
        )
    export_flight(source, streams, kind, flight, rate_hz, out, force, reading)


def export_flight(
    source: Path,
    streams: tuple[str, ...],
    kind: str,
    flight: str,
    rate_hz: float | None,
    out: Path | None,
    force: bool,
    reading: Reading,
) -> None:
    """Write the streams of one flight."""
    from flysid.cli.output import check_target
    from flysid.ingest.lake.chosen_flights import Selection, select
    from flysid.ingest.lake.flight_export import GRID, export_tables, gridded_table, physical_tables

    chosen = Selection(flights=(flight,) if flight else ())
    if out is not None:
        check_target(out, force)
    with Display().shown(), opened_flights(source, reading, selection=chosen) as lake:
        logs = select(lake, chosen).logs
        if len(logs) != 1:
            raise UsageError(
                f"{source} holds {len(logs)} flights",
                hint="--flight " + ", or --flight ".join(log.name for log in logs[:3]),
            )
        tables = physical_tables(logs[0], streams)
        if rate_hz is not None:
            tables = {GRID: gridded_table(tables, rate_hz)}
        single = len(tables) == 1 or kind in ("mat", "xlsx", "mcap")
        target = out or Path(f"{logs[0].name}.{kind}" if single else f"{logs[0].name}-{kind}")
        check_target(target, force)
        tell("writing", log=target.name)
        click.echo(str(export_tables(tables, kind, target)))
        say(f"time_s: {log_clock(logs[0].clocks).words}")
