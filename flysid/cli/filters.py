"""`flysid filters LOG [--try ...]`: the gyro's filters, their cost, and that of others."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.output import align_columns, print_json
from flysid.cli.source import flight_options, reading_options, reviewed_logs
from flysid.cli.trust import Setting
from flysid.escaping import one_line
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection


@click.command("filters")
@click.argument("source", type=SOURCE)
@flight_options
@click.option(
    "--try",
    "more",
    cls=Setting,
    multiple=True,
    metavar="FILTER",
    help="Add one: 'notch HZ WIDTH', 'pt1 HZ', 'pt2 HZ', 'pt3 HZ', 'biquad HZ'; repeatable.",
)
@click.option(
    "--without",
    cls=Setting,
    multiple=True,
    metavar="TEXT",
    help="Take away those with this in their name; repeatable.",
)
@click.option(
    "--crossover",
    type=POSITIVE,
    metavar="HZ",
    help="Where phase counts.  [default: that of the gains in the log, else 30]",
)
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@reading_options
def command(
    source: Path,
    selection: Selection,
    more: tuple[str, ...],
    without: tuple[str, ...],
    crossover: float | None,
    as_json: bool,
    reading: Reading,
) -> int:
    """Show what the gyro's filters cost and remove, beside other filters.

    The chain is rebuilt from the parameters in the log (Betaflight 3.1 on, INAV 6 on, PX4 1.10 on, ArduPilot
    4.0 on), at the real time of an iteration. It is run again on the raw gyro, where the log has it, and
    compared with what the vehicle logged. Notches whose frequencies are not in the log, and filters that
    INAV's headers do not state, are named, and not run.
    """
    from flysid.reviews.filter_trial import crossover_of, stage_of, try_filters

    for words in more:
        stage_of(words)
    with Display().shown(), reviewed_logs(source, reading, selection) as flights:
        found = []
        for flight in flights:
            hz, known_from = (crossover, "as given") if crossover else crossover_of(flight)
            trial = try_filters(flight, more, without, crossover_hz=hz, crossover_from=known_from)
            found.append((flight.name, trial))
    if as_json:
        body = [{"log": name, **trial.to_dict()} for name, trial in found]
        print_json(body)
    for name, trial in found if not as_json else ():
        head = [name] if len(found) > 1 else []
        lines = [*head, *align_columns(trial.rows()), *(fold(note) for note in trial.notes())]
        click.echo("\n".join(one_line(line) for text in lines for line in text.splitlines()))
    return 0 if any(trial.is_whole for _, trial in found) else 3
