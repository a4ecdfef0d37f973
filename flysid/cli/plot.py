"""`flysid plot LOG|DATA STREAM.FIELD...`: fields over time, with modes, messages and parameter changes."""

from __future__ import annotations

import shutil
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.display import Display
from flysid.cli.options import force_option
from flysid.cli.source import opened_flights, plot_options, reading_options
from flysid.cli.trust import Own, ProjectFile
from flysid.showing import first_of

if TYPE_CHECKING:
    from flysid.cli.checks import Reading
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.ingest.lake.lake import StoredLog
    from flysid.ingest.lake.timeline import Curve

PAIRS = ("attitude", "rate", "velocity")


@click.command("plot")
@click.argument("source", type=SOURCE)
@click.argument("fields", nargs=-1, metavar="STREAM.FIELD...")
@plot_options
@click.option("--pair", type=click.Choice(PAIRS), help="Setpoint and measurement together.")
@click.option(
    "-r", "--recipe", cls=ProjectFile, default="", help="The channels of this recipe instead of fields."
)
@click.option(
    "-o", "--out", type=click.Path(dir_okay=False, path_type=Path), help="x.html, .png, .svg or .pdf."
)
@click.option("--term", is_flag=True, help="Draw in the terminal.")
@click.option("--open/--no-open", "show", cls=Own, default=False, help="Open the page in the browser.")
@reading_options
@force_option("file")
def command(
    source: Path,
    fields: tuple[str, ...],
    selection: Selection,
    pair: str | None,
    recipe: str,
    out: Path | None,
    term: bool,
    show: bool,
    force: bool,
    reading: Reading,
) -> None:
    """Plot fields of a log, or of flights of an ingested folder, over time.

    Each argument is one panel. It is STREAM.FIELD with wildcards; commas join several in one panel. A message
    of several things, such as gyros, is named with one of them: 'IMU[0].GyrX'. Without fields, the setpoints
    and measurements of the first recipe that fits are drawn.
    """
    from dataclasses import replace

    from flysid.cli.output import check_target
    from flysid.errors import UsageError
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.chosen_flights import select
    from flysid.ingest.lake.timeline import lay_out

    if sum(map(bool, (fields, pair, recipe))) > 1:
        raise UsageError("fields, --pair and --recipe each say what to draw", hint="give one of them")
    target = out or Path(f"{source.name or 'flights'}.html".replace("/", "_"))
    if not term:
        check_target(target, force, makes_folders=is_page(target))
        if not is_page(target):
            from flysid.pictures import check_picture

            check_picture(target)
    if recipe:
        load_recipe(recipe)
    with Display().shown(), opened_flights(source, reading, selection=selection) as lake:
        shown = replace(selection.stretches, mishaps=True)  # a crash is what people look for
        timelines = [
            lay_out(log, choose_curves(log, fields, pair, recipe), shown.allowed(log))
            for log in select(lake, replace(selection, stretches=shown)).logs
        ]
    if term:
        from flysid.validate.show.flightplot import flights_as_text

        click.echo(flights_as_text(timelines, shutil.get_terminal_size().columns))
        return
    title = first_of([t.name for t in timelines], 3)
    if is_page(target):
        from flysid.validate.show.page.flight_page import render_flights
        from flysid.validate.show.page.html import write_page

        write_page(target, render_flights(timelines, title))
    else:
        from flysid.validate.show.flightplot import draw_flights

        draw_flights(timelines, target, title)
    click.echo(str(target))
    if show:
        webbrowser.open(target.resolve().as_uri())


def is_page(target: Path) -> bool:
    """Whether a page is written, and no picture."""
    return target.suffix.lower() in (".html", ".htm")


def choose_curves(log: StoredLog, fields: Sequence[str], pair: str | None, recipe: str) -> list[list[Curve]]:
    """What to draw of a log: the fields named, the channels of a recipe that it can serve, or its only table.

    Raises UsageError: a field is not there; no shipped recipe serves the log.
    """
    from flysid.errors import UsageError
    from flysid.flight import BOOT, RECEIVED, TIME
    from flysid.ingest.align.recipe import load_recipe, shipped_recipes
    from flysid.ingest.lake.timeline import read_channels, read_fields

    if fields:
        return read_fields(log, fields)
    for name in [recipe] if recipe else [n for n in shipped_recipes() if pair is None or pair in n]:
        panels = read_channels(log, load_recipe(name))
        if panels:
            return panels
    streams = log.manifest.streams
    if not pair and not recipe and len(streams) == 1:  # a table: all that it holds, but for its own time
        clock = streams[0].metadata.get("time_source", "").partition(" in ")[0]
        own = [c.name for c in streams[0].columns if c.name not in (TIME, BOOT, RECEIVED, clock)]
        return read_fields(log, [f"{streams[0].stream}.{name}" for name in own])
    raise UsageError(
        f"the log has no {pair or 'setpoint'} beside a measurement that a shipped recipe knows"
        if not recipe
        else f"the log has no channel of {recipe}",
        path=log.name,
        hint="name the fields: flysid plot LOG STREAM.FIELD; 'flysid show LOG --fields' lists them",
    )
