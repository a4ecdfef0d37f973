"""`flysid fly DESIGN`: gains of a design on many vehicles, simulated or identified, beside those of today."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.bounds import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE
from flysid.cli.design import a_range, refuse_given
from flysid.cli.display import Display, progress_options
from flysid.cli.options import target_options
from flysid.cli.output import ExitCode, align_columns, print_json, say
from flysid.cli.trust import Setting
from flysid.errors import UsageError
from flysid.escaping import one_line
from flysid.showing import counted

if TYPE_CHECKING:
    from flysid.design.campaign import Campaign

OF_SIMULATED, OF_MODELS = ("wind", "mass", "drag"), ("limit", "data")
"""Options of one kind of vehicle alone."""
NO_WIND = (
    "leave it out: gusts are those of the run's held-out flights, and models differ within their intervals"
)


@click.command("fly")
@click.argument("design", type=click.Path(path_type=Path))
@click.option(
    "--on",
    "run",
    type=click.Path(path_type=Path),
    metavar="RUN",
    help="Fly on the models of this run instead of the demo's simulated vehicle.",
)
@click.option("--vehicles", default=100, type=AT_LEAST_ONE, show_default=True, help="Number of vehicles.")
@click.option(
    "--wind",
    default=4.0,
    type=NOT_NEGATIVE,
    show_default=True,
    help="Strongest wind, m/s; it differs from vehicle to vehicle.",
)
@click.option("--seed", default=1, show_default=True, help="Seed of vehicles, wind and noise.")
@click.option(
    "--mass", cls=Setting, callback=a_range, metavar="LOW..HIGH", help="Times nominal.  [default: 0.8..1.2]"
)
@click.option(
    "--drag", cls=Setting, callback=a_range, metavar="LOW..HIGH", help="Times nominal.  [default: 0.6..1.4]"
)
@click.option(
    "--delay",
    cls=Setting,
    callback=a_range,
    metavar="LOW..HIGH",
    help="Delay of the link, s.  [default: 0.02..0.08; with --on 0, beside the models' own]",
)
@click.option(
    "--limit", type=POSITIVE, help="With --on: input limit, in its unit.  [default: the largest flown]"
)
@click.option(
    "--data", type=click.Path(path_type=Path), help="With --on: the run's data, if they have moved."
)
@target_options("-o", "--out", replaced="page", help="The page, an HTML file.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@progress_options
@click.pass_context
def command(
    context: click.Context,
    design: Path,
    run: Path | None,
    vehicles: int,
    wind: float,
    seed: int,
    mass: tuple[float, float] | None,
    drag: tuple[float, float] | None,
    delay: tuple[float, float] | None,
    limit: float | None,
    data: Path | None,
    out: Path | None,
    as_json: bool,
    display: Display,
) -> int:
    """Fly a design on vehicles that differ from the identified one.

    Without --on: simulated vehicles of the demo. Mass, drag, delay, motors and inner loop of each are random
    and differ from what its inner loop assumes. Noise and wind are the same for every set of gains: the
    present ones, twice the present ones, those for the next flight, and where the design leads.

    With --on: every good model of the run, as it is and drawn from the distribution of its numbers. What
    held-out flights held beyond the model acts on it as gusts and noise. The run may be a later one than
    that of the design, with the same channels.

    Exit code 4: a vehicle is lost under designed gains, or a true vehicle's loop is unstable.
    """
    from flysid.design.firmware import SAFETY
    from flysid.design.trialpage import trial_page
    from flysid.files import write_atomically, writing_to

    with display.shown():
        if run is None:
            refuse_given(context, OF_MODELS, "simulated vehicles", "flies the demo's", "name a run: --on RUN")
            campaign = _fly_simulated(design, vehicles, seed, wind, mass, drag, delay)
        else:
            refuse_given(context, OF_SIMULATED, "a run", "flies its models", NO_WIND)
            campaign = _fly_on(run, design, vehicles, seed, delay, limit, data)
    if as_json:
        print_json(campaign.to_dict())
    else:
        for axis in campaign.rows:
            click.echo(one_line(f"{axis}, {counted(campaign.vehicles, 'vehicle')}"))
            click.echo("\n".join(f"  {line}" for line in align_columns(campaign.table(axis))) + "\n")
        held = " and ".join(f"{v:.1f} m/s along {a}" for a, v in campaign.held_wind_m_s.items())
        if held:
            say(
                f"full tilt of the nominal vehicle holds {held}; beyond that, no gains can hold the position",
                display.quiet,
            )
        for note in campaign.notes:
            say(one_line(note), display.quiet)
        say(SAFETY, display.quiet)
    if out is not None:
        with writing_to(out):
            write_atomically(out, trial_page(campaign, f"Trial flights of {design.name}").encode())
        say(f"page: {out}", display.quiet)
    mine = [row for rows in campaign.rows.values() for row in rows if not row.law.startswith("present")]
    return ExitCode.CHECK_FAILED if any(row.lost or not row.stable for row in mine) else 0


def _fly_simulated(
    design: Path,
    vehicles: int,
    seed: int,
    wind: float,
    mass: tuple[float, float] | None,
    drag: tuple[float, float] | None,
    delay: tuple[float, float] | None,
) -> Campaign:
    from dataclasses import replace

    from flysid.design.campaign import fly_design
    from flysid.design.designed import open_design
    from flysid.design.trialflight import Doubtful

    nominal = Doubtful()
    doubtful = replace(
        nominal,
        wind_m_s=(0.0, wind),
        mass=mass or nominal.mass,
        drag=drag or nominal.drag,
        delay_s=delay or nominal.delay_s,
    )
    return fly_design(open_design(design), vehicles, seed, doubtful)


def _fly_on(
    run: Path,
    design: Path,
    vehicles: int,
    seed: int,
    delay: tuple[float, float] | None,
    limit: float | None,
    data: Path | None,
) -> Campaign:
    from flysid.design.designed import open_design
    from flysid.design.modelcampaign import OnModels, fly_on_run
    from flysid.sixdof.fitted import FILE as VEHICLE_FILE
    from flysid.validate.runs.run import open_run

    if (run / VEHICLE_FILE).is_file() or run.name == VEHICLE_FILE:
        raise UsageError(
            "a vehicle of rates and accelerations: a position loop is flown on the models of a run",
            path=run,
            hint="flysid fit DATA --recipe R -o RUN, and --on RUN",
        )
    how = OnModels(vehicles, seed, delay or (0.0, 0.0), limit)
    return fly_on_run(open_design(design), open_run(run), how, data)
