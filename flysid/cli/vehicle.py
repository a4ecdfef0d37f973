"""`flysid vehicle LOG... -o vehicle`: one model of six degrees of freedom of the whole vehicle."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.checks import Reading
from flysid.cli.display import Display, progress_options
from flysid.cli.options import target_options
from flysid.cli.output import print_json, print_lines, say
from flysid.cli.source import READING_OF_A_FIT, flight_options, opened_flights, reading_options
from flysid.cli.trust import ProjectFile, Setting

if TYPE_CHECKING:
    from flysid.ingest.align.recipe import Recipe
    from flysid.ingest.align.signals import Log
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.sixdof.fitted import FittedVehicle
    from flysid.sixdof.judging import Judgement
    from flysid.sixdof.vehicle import Vehicle
    from flysid.stretch import FloatArray

RECIPE = "sixdof"


@click.command("vehicle")
@click.argument("logs", nargs=-1, required=True, type=SOURCE)
@click.option(
    "--recipe",
    "-r",
    cls=ProjectFile,
    default=RECIPE,
    show_default=True,
    shell_complete=complete.recipes,
    help="Where motors and instruments are logged: a shipped recipe, or a .toml file.",
)
@flight_options
@click.option(
    "--full-scale",
    cls=Setting,
    type=click.FloatRange(min=0.0, min_open=True),
    help="What motor commands are shares of, beyond --zero.  [default: found]",
)
@click.option("--zero", cls=Setting, type=float, help="The motor command that stops.  [default: found]")
@click.option("--calm", is_flag=True, help="Indoors: hold the wind at zero.")
@click.option(
    "--arms",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Where motors sit: a .toml file, a line as 'motor1 = [0.12, -0.10]' each, m forward and left.",
)
@target_options(
    "--output",
    "-o",
    replaced="folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write the vehicle here.",
)
@click.option("--judge/--no-judge", default=True, help="Fit some flights anew, and judge on the others.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@reading_options
@progress_options
def command(
    logs: tuple[Path, ...],
    recipe: str,
    selection: Selection,
    full_scale: float | None,
    zero: float | None,
    calm: bool,
    arms: Path | None,
    output: Path | None,
    judge: bool,
    as_json: bool,
    reading: Reading,
    display: Display,
) -> int:
    """Fit one model of the whole vehicle, with six degrees of freedom, to ordinary flights.

    LOGS are logs, tables (.csv), or an ingested folder. Motors and gyro are needed. Voltage, accelerometer,
    attitude, velocity and position each tell more. A number that the flights do not determine is named, with
    the flight that would tell. Where motors sit (--arms) adds inertias over mass and the centre of mass.
    'flysid export' writes the vehicle for simulators and controllers.
    """
    from flysid.ingest.align.recipe import load_recipe
    from flysid.sixdof.arms import read_arms
    from flysid.sixdof.fitted import FILE
    from flysid.sixdof.vehicle import Vehicle

    places = None if arms is None else read_arms(arms)
    estimator = Vehicle(zero=zero, full=full_scale, calm=True if calm else None)
    chosen = load_recipe(recipe)
    with display.shown(), _flights(logs, reading, selection) as flights:
        found = fit_flights(flights, chosen, estimator, judge, places)
    if as_json:
        print_json(found.to_dict())
    else:
        print_lines(found.lines())
    if found.lacking:
        say(f"not logged: {', '.join(found.lacking)}", display.quiet)
    if output is not None:
        page = found.write(output, _typed(logs, recipe, arms, output))
        say(f"written: {output / FILE}", display.quiet)
        if page is not None:
            say(f"its page, with pictures: {output / page}", display.quiet)
    return 0


@dataclass(frozen=True, eq=False)
class Fitted:
    """A vehicle, how far it holds on flights left out where that was wanted, and what its logs lack."""

    vehicle: FittedVehicle
    judged: Judgement | None
    lacking: tuple[str, ...]

    def lines(self) -> list[str]:
        """For people."""
        return [*self.vehicle.lines(), *(self.judged.lines() if self.judged is not None else [])]

    def to_dict(self) -> dict[str, Any]:
        """As JSON."""
        judged = {} if self.judged is None else {"judged": self.judged.to_dict()}
        return self.vehicle.to_dict() | judged

    def write(self, output: Path, typed: str) -> str | None:
        """Write the folder of the vehicle; the name of its page, None where that broke.

        `typed`: the command that makes it again, for the page.
        """
        from flysid.extras import Extra, extra
        from flysid.files import replacing_folder
        from flysid.reviews.vehicle_page import PAGE, write_vehicle_page
        from flysid.sixdof.fitted import FILE

        with replacing_folder(output) as folder:
            self.vehicle.save(folder / FILE)
            draw = partial(write_vehicle_page, folder / PAGE, self.vehicle, self.judged, typed)
            page = extra(Extra.PAGE, draw, None, of="the vehicle")
        return None if page is None else PAGE


def fit_flights(
    logs: Sequence[Log], recipe: Recipe, estimator: Vehicle, judge: bool, places: FloatArray | None = None
) -> Fitted:
    """A vehicle of flights, judged on some of them where `judge`; raises what `Vehicle.fit` does.

    `places`: of its motors, see `FittedVehicle.placed`.
    """
    from flysid.ingest.align.vehicle_channel import vehicle_data
    from flysid.sixdof.judging import judge_vehicle

    data = vehicle_data(logs, recipe)
    vehicle = estimator.fit(data.dataset)
    if places is not None:
        vehicle = vehicle.placed(places)
    judged = judge_vehicle(estimator, data.dataset, vehicle) if judge else None
    return Fitted(vehicle, judged, data.lacking)


def _typed(logs: Sequence[Path], recipe: str, arms: Path | None, output: Path) -> str:
    """The command, as it would be typed again, without its settings."""
    own = [] if recipe == RECIPE else ["-r", recipe]
    own += [] if arms is None else ["--arms", str(arms)]
    return shlex.join(["flysid", "vehicle", *map(str, logs), *own, "-o", str(output)])


@contextmanager
def _flights(paths: Sequence[Path], reading: Reading, selection: Selection) -> Iterator[list[Log]]:
    """The flights of all paths; of an ingested folder, those that are chosen."""
    from flysid.ingest.lake.chosen_flights import require_one_vehicle, select

    found: list[Log] = []
    with ExitStack() as stack:
        for path in paths:
            share = READING_OF_A_FIT / len(paths)
            own = select(stack.enter_context(opened_flights(path, reading, share, selection)), selection)
            if not selection.pool:
                require_one_vehicle(own)
            found += own.logs
        yield found
