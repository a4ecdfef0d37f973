"""`flysid spectrum LOG [FIELD...]`: at which frequencies a vehicle shakes, and why."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import picture_options
from flysid.cli.output import print_json, print_lines, say_drawn
from flysid.cli.source import flight_options, reading_options, reviewed_logs

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.reviews.field_spectra import FieldSpectrum
    from flysid.reviews.logged import LoggedFlight

OVER = ("time", "throttle", "rpm")


@click.command("spectrum")
@click.argument("source", type=SOURCE)
@click.argument("fields", nargs=-1, metavar="[STREAM.FIELD]...")
@flight_options
@click.option(
    "--window", default=1.0, show_default=True, type=POSITIVE, metavar="S", help="Length of a window."
)
@click.option(
    "--lowest", default=3.0, show_default=True, type=POSITIVE, metavar="HZ", help="No peaks below it: motion."
)
@click.option("--ground", is_flag=True, help="The whole log, not only the time in the air.")
@click.option(
    "--over",
    type=click.Choice(OVER),
    help="Of the plot's map.  [default: throttle where it moves, else time]",
)
@picture_options("a plot")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@reading_options
def command(
    source: Path,
    fields: tuple[str, ...],
    selection: Selection,
    window: float,
    lowest: float,
    ground: bool,
    over: str | None,
    plot: Path | None,
    as_json: bool,
    reading: Reading,
) -> None:
    """Show at which frequencies a vehicle shakes: peaks, their height, their cause where the log shows it.

    Without fields it is the gyro, before its filters where the log has it. A peak has its 95 % interval. A
    tone above half the rate of the log shows at another frequency: where no cause is known, the
    frequencies that it may have stand beside it. Motors are named from ESC telemetry. A tone that moves with
    the throttle, or stays while it moves, is called so.
    """
    from flysid.reviews.field_spectra import field_spectra, quantity_over

    with Display().shown(), reviewed_logs(source, reading, selection) as flights:
        found = [
            (flight, field_spectra(flight, fields, window_s=window, lowest_hz=lowest, on_ground=ground))
            for flight in flights
        ]
        _print(found, as_json)
        if plot is not None:
            from flysid.reviews.spectrum_plot import draw_spectra

            flight, spectra = found[0]
            quantity = quantity_over(flight, spectra[0].windows, over) if over else None
            say_drawn("spectrum", plot, partial(draw_spectra, flight, spectra, quantity, over, plot))


def _print(found: Sequence[tuple[LoggedFlight, Sequence[FieldSpectrum]]], as_json: bool) -> None:
    if as_json:
        body = [{"log": flight.name, "spectra": [s.to_dict() for s in spectra]} for flight, spectra in found]
        print_json(body)
        return
    for flight, spectra in found:
        head = [flight.name] if len(found) > 1 else []
        lines = [*head, *(line for spectrum in spectra for line in spectrum.lines())]
        print_lines(lines)
