"""`flysid gains LOG|DATA`: what the gains that a log states mean for its loops."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.addresses import SOURCE, here
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import picture_options
from flysid.cli.output import align_columns, explain, print_json, say, say_drawn
from flysid.cli.source import flight_options, flights_of_one_vehicle, reading_options
from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.loops.judged import Judged


@click.command("gains")
@click.argument("source", type=SOURCE)
@click.option(
    "--axis",
    "axes",
    multiple=True,
    type=click.Choice(["roll", "pitch", "yaw"]),
    help="[default: roll, pitch]",
)
@flight_options
@picture_options("a Nyquist plot")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@reading_options
def command(
    source: Path,
    axes: tuple[str, ...],
    selection: Selection,
    plot: Path | None,
    as_json: bool,
    reading: Reading,
) -> int:
    """Estimate crossover, margins, bandwidth and noise of the present gains, each with a 95 % interval.

    Reads the gains from the log (Betaflight 3.1 on, INAV, PX4 1.12 on, ArduCopter 4.0 on), measures the plant
    from the response to the sticks, and computes the loop. If the flights do not determine a figure, or the
    stated gains do not reproduce the recorded output, it says so, and what to fly (exit code 3: nothing is
    known of any axis, or a log was read with losses). It proposes no gains. Given the folder of a run, it
    reads the flights of that run. The run's verdict compares models and decides nothing here.
    """
    from flysid.loops.judged import CAUTION, judge
    from flysid.validate.runs.run import RUN_FILE

    if (source / RUN_FILE).is_file():
        source, own = _of_run(source)
        selection = replace(selection, flights=selection.flights or own)
    with Display().shown(), flights_of_one_vehicle(source, reading, selection) as chosen:
        logs = chosen.logs
        found = judge(logs, axes or ("roll", "pitch"))
    known = [j for j in found if j.margins is not None]
    if as_json:
        from flysid.loops.contradictions import contradiction_of

        told_of = [j.to_dict() | {"contradiction": contradiction_of(j, found) or None} for j in found]
        print_json(told_of)
    else:
        click.echo("\n\n".join("\n".join(fold(one_line(line)) for line in j.lines()) for j in found))
        by_name = {log.name: log for log in logs}
        extra(Extra.SETS_TABLE, partial(_print_sets, found, by_name, source), None)
        if known:
            explain(CAUTION)
    if plot is not None and known:
        from flysid.loops.nyquist import draw_nyquist
        from flysid.pictures import save_picture

        say_drawn("Nyquist plot", plot, lambda: save_picture(draw_nyquist(known), plot))
    return 0 if known else 3


def _print_sets(found: Sequence[Judged], logs: Mapping[str, Any], source: Path) -> None:
    """Several sets of gains in one table, and what sets them apart."""
    from flysid.loops.contradictions import contradiction_of
    from flysid.loops.gain_sets import differences, gain_sets

    rows = gain_sets(found)
    if not rows:
        return
    click.echo("\n".join(["", *align_columns(rows), *differences(found)]))
    for judged in found:
        if sentence := contradiction_of(judged, found):
            click.echo(fold(f"{judged.axis}: {sentence}"))
    axis = next(j.axis for j in found if j.gains)
    of_axis = [logs[j.flights[0]] for j in found if j.axis == axis and j.gains]
    say(f"next: {_words_of_next(of_axis, source)}; between two equal ones take the larger margin")


def _words_of_next(logs: Sequence[Any], source: Path) -> str:
    """The command that draws step responses: of two sets where their logs are at hand, else of one."""
    from flysid.loops.judged import rate_recipe

    files = [source / log.facts.log for log in logs]
    own = [file for file in files if file.is_file() and files.count(file) == 1]
    recipe = rate_recipe(logs[0])
    if len(own) > 1:
        one, other = (shlex.quote(str(file)) for file in own[:2])
        return f"two sets in one plot: flysid step {one} -r {recipe} --against {other} --plot step.png"
    place, flight = shlex.quote(str(source)), shlex.quote(logs[0].name)
    return (
        f"how the vehicle answers one set: flysid step {place} -r {recipe} --flight {flight} --plot step.png"
    )


def _of_run(folder: Path) -> tuple[Path, tuple[str, ...]]:
    """The data of a run, and its flights, whatever the run's verdict: that is about its models."""
    from flysid.place import is_address
    from flysid.validate.runs.run import open_run

    run = open_run(folder)
    return here(run.data) if is_address(run.data) else Path(run.data), tuple(run.flights)
