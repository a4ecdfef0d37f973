"""`flysid fly DESIGN`: the gains of a design on many simulated vehicles, beside the present ones."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flysid.cli.bounds import AT_LEAST_ONE, NOT_NEGATIVE
from flysid.cli.design import a_range
from flysid.cli.display import Display, progress_options
from flysid.cli.output import ExitCode, align_columns, check_target, say
from flysid.cli.trust import Own, Setting


@click.command("fly")
@click.argument("design", type=click.Path(path_type=Path))
@click.option(
    "--vehicles", default=100, type=AT_LEAST_ONE, show_default=True, help="Number of simulated vehicles."
)
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
    help="Delay of the link, s.  [default: 0.02..0.08]",
)
@click.option("-o", "--out", type=click.Path(path_type=Path), help="The page, an HTML file.")
@click.option("--force", cls=Own, is_flag=True, help="Replace the page if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@progress_options
def command(
    design: Path,
    vehicles: int,
    wind: float,
    seed: int,
    mass: tuple[float, float] | None,
    drag: tuple[float, float] | None,
    delay: tuple[float, float] | None,
    out: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
    display: Display,
) -> int:
    """Fly a design on simulated vehicles that differ from the identified one.

    Mass, drag, delay, motors and inner loop of each vehicle are random and differ from what its inner loop
    assumes. Noise and wind are the same for every set of gains: the present ones, twice the present ones,
    those for the next flight, and where the design leads. Exit code 4: a vehicle is lost under designed
    gains, or a true vehicle's loop is unstable.
    """
    from dataclasses import replace

    from flysid.design.campaign import fly_design
    from flysid.design.designed import open_design
    from flysid.design.firmware import SAFETY
    from flysid.design.trialflight import Doubtful
    from flysid.design.trialpage import trial_page
    from flysid.files import write_atomically, writing_to

    if out is not None:
        check_target(out, force)
    nominal = Doubtful()
    doubtful = replace(
        nominal,
        wind_m_s=(0.0, wind),
        mass=mass or nominal.mass,
        drag=drag or nominal.drag,
        delay_s=delay or nominal.delay_s,
    )
    with display.shown():
        campaign = fly_design(open_design(design), vehicles, seed, doubtful)
    if as_json:
        click.echo(json.dumps(campaign.to_dict(), indent=1, allow_nan=False))
    else:
        for axis in campaign.rows:
            click.echo(f"{axis}, {vehicles} vehicles")
            click.echo("\n".join(f"  {line}" for line in align_columns(campaign.table(axis))) + "\n")
        held = " and ".join(f"{v:.1f} m/s along {a}" for a, v in campaign.held_wind_m_s.items())
        say(
            f"full tilt of the nominal vehicle holds {held}; beyond that, no gains can hold the position",
            quiet,
        )
        for note in campaign.notes:
            say(note, quiet)
        say(SAFETY, quiet)
    if out is not None:
        with writing_to(out):
            write_atomically(out, trial_page(campaign, f"Trial flights of {design.name}").encode())
        say(f"page: {out}", quiet)
    mine = [row for rows in campaign.rows.values() for row in rows if not row.law.startswith("present")]
    return ExitCode.CHECK_FAILED if any(row.lost or not row.stable for row in mine) else 0
