"""What verbs work on: an ingested folder, or logs; with a recipe or a few words instead of one."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import click

from flysid.cli import complete
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading, Request, check_flights, check_source, is_ingested, refuse_reading_again
from flysid.cli.options import gather
from flysid.cli.output import NAMES_SHOWN, say
from flysid.cli.trust import ProjectFile, Setting
from flysid.errors import FlysidError, FormatError, RecipeError, UsageError, WriteError
from flysid.extras import Extra, extra
from flysid.showing import first_of

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.ingest.lake.finding import FoundLogs
    from flysid.ingest.lake.lake import Lake
    from flysid.reviews.logged import LoggedFlight

READING_OF_A_FIT = 0.05
READING_OF_A_LOOK = 0.5
"""Shares of the work that reading the logs is, before a fit and before a look."""


def _known_format(_ctx: click.Context, _param: click.Parameter, name: str) -> str:
    from flysid.ingest.formats.registry import find_format

    return find_format(name).name if name else ""


def _known_unit(_ctx: click.Context, _param: click.Parameter, unit: str) -> str:
    from flysid.ingest.formats.common.time_units import known_unit

    return known_unit(unit) if unit else ""


def _known_order(_ctx: click.Context, _param: click.Parameter, order: str) -> str:
    from flysid.ingest.formats.common.stamps import known_order

    return known_order(order) if order else ""


format_option = click.option(
    "--format",
    cls=Setting,
    default="",
    metavar="NAME",
    callback=_known_format,
    help="Format of the log, where it is not detected: tlog, csv, ...",
)
_READING = (
    click.option(
        "--time-unit",
        cls=Setting,
        default="",
        metavar="UNIT",
        callback=_known_unit,
        help="Unit of a table's times, where it names none: s, ms, us, ns, min, h or d.",
    ),
    click.option(
        "--date-order",
        cls=Setting,
        default="",
        metavar="ORDER",
        callback=_known_order,
        help="Order of a table's dates, where 04/05/2025 may be meant two ways: dmy, mdy or ymd.",
    ),
    format_option,
)
_FIELD = "[STREAM.]FIELD"
recipe_option = click.option(
    "--recipe",
    "-r",
    cls=ProjectFile,
    default="",
    shell_complete=complete.recipes,
    help="A shipped recipe, or a .toml file.",
)
_CHANNELS = (
    recipe_option,
    click.option(
        "--from",
        "inputs",
        cls=Setting,
        multiple=True,
        metavar=_FIELD,
        help="Input, instead of a recipe; repeatable.",
    ),
    click.option("--to", "outputs", cls=Setting, multiple=True, metavar=_FIELD, help="Output; repeatable."),
    click.option(
        "--dt", type=POSITIVE, metavar="SECONDS", help="Sample time of a table without a time column."
    ),
)
_FLIGHTS = (
    click.option(
        "--flight",
        "only_flights",
        cls=Setting,
        multiple=True,
        metavar="FLIGHT",
        shell_complete=complete.flights,
        help="Only this flight, by the beginning of its id; repeatable.",
    ),
    click.option(
        "--exclude",
        cls=Setting,
        multiple=True,
        metavar="FLIGHT[@FROM..TO]",
        shell_complete=complete.flights,
        help="Leave out a flight, or a part: 0042@12:30..14:00; repeatable.",
    ),
    click.option(
        "--vehicle",
        cls=Setting,
        default="",
        metavar="NAME",
        help="Only this vehicle; part of its name is enough.",
    ),
    click.option("--pool", is_flag=True, help="Allow flights of several vehicles."),
)
_STRETCHES = (
    click.option(
        "--between",
        cls=Setting,
        default="",
        metavar="FROM..TO",
        help="Only this part of every flight: 12:30..14:00 (min:s).",
    ),
    click.option(
        "--mode",
        "modes",
        cls=Setting,
        multiple=True,
        metavar="MODE",
        help="Only this flight mode; repeatable.",
    ),
)
_MISHAPS = click.option(
    "--keep-mishaps",
    "mishaps",
    is_flag=True,
    help="Keep crashes, failsafes and losses of control.",
)


def _selection(
    only_flights: tuple[str, ...],
    exclude: tuple[str, ...],
    vehicle: str,
    pool: bool,
    between: str = "",
    modes: tuple[str, ...] = (),
    mishaps: bool = False,
) -> Selection:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.ingest.lake.stretches import Stretches

    without = tuple(text for text in exclude if "@" in text or "#" in text)
    whole = tuple(text for text in exclude if text not in without)
    return Selection(only_flights, whole, vehicle, pool, Stretches(between, modes, mishaps, without))


source_options = gather("reading", Reading, *_CHANNELS, *_READING)
"""--recipe, --from, --to, --dt and those of `reading_options`."""
reading_options = gather("reading", Reading, *_READING)
"""--time-unit, --date-order and --format."""
flight_options = gather("selection", _selection, *_FLIGHTS)
"""Which flights, and of which vehicle: --flight, --exclude, --vehicle, --pool."""
plot_options = gather("selection", _selection, *_FLIGHTS, *_STRETCHES)
"""As `flight_options`, and --between and --mode."""
selection_options = gather("selection", _selection, *_FLIGHTS, *_STRETCHES, _MISHAPS)
"""As `plot_options`, and --keep-mishaps."""


def given(selection: Selection) -> Selection | None:
    """The selection, if one was made."""
    return selection if selection.options else None


@contextmanager
def open_source(data: Path, request: Request, place: Path | None, quiet: bool) -> Iterator[tuple[Lake, str]]:
    """The flights that are meant, and the name of a recipe; both hold until the block ends.

    Logs are ingested first, into the folder `place`, which goes again where the block fails; for as long as
    the block lasts where `place` is None. Logs of an earlier run that are there are removed.
    Raises UsageError: as `check_source`; flights of several vehicles that are not to be pooled.
    Raises RecipeError: as `check_source`; a field is not there.
    """
    logs = check_source(data, request)
    from flysid.cli.losses import say_lost
    from flysid.ingest.lake.chosen_flights import of_one_vehicle, select
    from flysid.ingest.lake.lake import open as open_lake

    if place is not None and place.exists():
        from flysid.manifest import check_data_folder

        shutil.rmtree(check_data_folder(place))
    with TemporaryDirectory() as folder:
        target = place or Path(folder) / "data"
        try:
            with _naming(data, target):
                whole = open_lake(
                    data if logs is None else _taken_in(logs, data, target, request.reading, quiet)
                )
                lake = select(whole, request.selection)
                if not request.selection.pool:
                    served = of_one_vehicle(lake, request.reading.recipe)
                    _say_left_out(lake, served, request.reading.recipe, quiet)
                    lake = served
                if logs is None:
                    say_lost(lake.facts)
                yield lake, _recipe_for(lake, request, Path(folder) / "quick.toml", quiet)
        except BaseException:
            if place is not None:
                shutil.rmtree(place, ignore_errors=True)
            raise


def _say_left_out(lake: Lake, served: Lake, recipe: str, quiet: bool) -> None:
    """Name the flights of other vehicles, which lack the streams of the recipe."""
    kept = {facts.id for facts in served.facts}
    others = [facts.id for facts in lake.facts if facts.id not in kept]
    if others:
        names = first_of(others, NAMES_SHOWN)
        say(f"left out: {names}: of another vehicle, without the streams of {recipe}", quiet)


def _recipe_for(lake: Lake, request: Request, quick: Path, quiet: bool) -> str:
    """The recipe that is named, the one that is chosen, or one of fields, which is written to `quick`."""
    reading = request.reading
    if reading.recipe:
        require_fit(lake, reading.recipe)
        return reading.recipe
    if request.is_open and (request.channels or lake.recipes()):
        from flysid.ingest.lake.recipe_choice import choose_recipe

        choice = choose_recipe(lake, request.channels)
        say(choice.words, quiet)
        return choice.name
    quick.write_text(_written(reading, lake), "utf-8")
    return str(quick)


def require_fit(lake: Lake, recipe: str) -> None:
    """Raise RecipeError where no flight has the streams of any channel.

    It names what the first channel lacks in the first flight, streams of a like name, and recipes that fit.
    """
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.align.signals import find_source, missing

    wanted = load_recipe(recipe)
    if not lake.facts or lake.channels(wanted):
        return
    first = lake.logs[0]
    signals = wanted.signals_of(next(iter(wanted.channels)))
    absent = next(n for n in signals if find_source(wanted.signals[n].sources, first) is None)
    lacks = missing(absent, wanted.signals[absent].sources, [first])
    fitting = [f"{name} ({', '.join(channels)})" for name, channels in lake.recipes().items()]
    other = f"these fit: {'; '.join(fitting)}" if fitting else "--from FIELD --to FIELD needs no recipe"
    raise RecipeError(
        f"no flight has the streams of recipe {recipe!r}: {lacks.message}",
        path=lake.address or lake.folder,
        hint=f"{lacks.hint}; {other}",
    )


@contextmanager
def opened_flights(
    source: Path,
    reading: Reading | None = None,
    share: float = READING_OF_A_LOOK,
    selection: Selection | None = None,
) -> Iterator[Lake]:
    """The flights of an ingested folder, or of logs, which are read for this block only.

    `share`: of all the work that reading logs is.
    `selection`: flights that it names are there: which is looked at before logs are read.
    Raises UsageError: there is no such file or folder, or no log in it; a unit of time for an ingested
    folder; a flight that is not there. Raises FormatError: nothing of a log can be read.
    """
    from flysid.cli.losses import say_lost
    from flysid.ingest.lake.chosen_flights import select
    from flysid.ingest.lake.finding import find_logs
    from flysid.ingest.lake.lake import open as open_lake
    from flysid.ingest.lake.workers import Bounds

    reading = reading or Reading()
    if is_ingested(source):
        refuse_reading_again(source, reading)
        whole = open_lake(source)
        say_lost((select(whole, selection) if selection else whole).facts)
        yield whole
        return
    logs = find_logs([source], Bounds())
    if selection is not None:
        check_flights(logs, source, selection)
    with TemporaryDirectory() as folder:
        place = Path(folder) / "data"
        with _naming(source, place):
            yield open_lake(_taken_in(logs, source, place, reading, True, share))


@contextmanager
def flights_of_one_vehicle(source: Path, reading: Reading, selection: Selection) -> Iterator[Lake]:
    """The flights that are chosen of a source, read for this block only, as the first part of a look.

    Raises UsageError: several vehicles that are not to be pooled; as `opened_flights`. Raises FormatError: as
    there.
    """
    from flysid.ingest.lake.chosen_flights import require_one_vehicle, select
    from flysid.progress import part

    with opened_flights(source, reading, selection=selection) as lake, part(READING_OF_A_LOOK):
        chosen = select(lake, selection)
        if not selection.pool:
            require_one_vehicle(chosen)
        yield chosen


@contextmanager
def reviewed_logs(source: Path, reading: Reading, selection: Selection) -> Iterator[list[LoggedFlight]]:
    """The chosen flights as a review reads them, for this block only.

    Raises UsageError, FormatError: as `opened_flights`.
    """
    from flysid.ingest.lake.chosen_flights import select
    from flysid.progress import part
    from flysid.reviews.logged import LoggedFlight

    with opened_flights(source, reading, selection=selection) as lake, part(READING_OF_A_LOOK):
        yield [
            LoggedFlight(log, log.manifest.damage, log.manifest.source.name)
            for log in select(lake, selection).logs
        ]


@contextmanager
def _naming(source: Path, place: Path) -> Iterator[None]:
    """An error in the block names the logs as the user did, not the folder that they were read into.

    But where that folder cannot be written to.
    """
    try:
        yield
    except FlysidError as error:
        if error.path == str(place) and not isinstance(error, WriteError):
            error.path = str(source)
        raise


def say_mixed_gains(lake: Lake, quiet: bool) -> None:
    """Say that flights flew several sets of gains: a closed loop over all of them is an average."""
    if quiet:
        return
    from flysid.loops.judged import sets_of_gains

    sets = extra(Extra.GAIN_SETS, partial(sets_of_gains, lake.logs), 0)
    if sets > 1:
        say(
            f"caution: these flights flew {sets} sets of gains. A response to the setpoint is an average "
            "over them: 'flysid gains DATA' names the sets, --flight chooses"
        )


def _written(reading: Reading, lake: Lake) -> str:
    """A recipe for the requested fields; without any, the error names what there is."""
    from flysid.ingest.align.quick import NEITHER, quick_recipe

    if not (reading.inputs or reading.outputs) and (served := lake.recipes()):
        raise UsageError(
            NEITHER,
            hint=f"--recipe {', or --recipe '.join(served)}; 'flysid ls DATA --suggest' says how well",
        )
    return quick_recipe(lake.logs, reading.inputs, reading.outputs, reading.dt)


def _taken_in(
    logs: FoundLogs,
    source: Path,
    place: Path,
    reading: Reading,
    quiet: bool,
    share: float = READING_OF_A_FIT,
) -> Path:
    """Ingest the logs that `source` names, as a `share` of the work.

    Raises FormatError: nothing of them can be read.
    """
    from flysid.cli.losses import report
    from flysid.ingest.lake.batch import ingest_logs
    from flysid.ingest.lake.workers import Bounds
    from flysid.progress import part

    with part(0.0, share):
        results = list(ingest_logs(logs, place, limits=reading.limits, bounds=Bounds()))
    skipped = [result for result in results if result.skipped]
    if len(skipped) == len(results) == 1:
        reason, _, hint = skipped[0].reason.partition("; try: ")
        raise FormatError(reason, path=skipped[0].path, hint=hint)
    report(results, quiet)
    if len(skipped) == len(results):
        raise FormatError("nothing could be read", path=source, hint="what the reasons above name")
    return place
