"""`flysid step DATA [--recipe R]`: step responses from ordinary flying, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading, Request, check_source
from flysid.cli.display import Display
from flysid.cli.options import channels_option, picture_options
from flysid.cli.output import print_json, say_drawn, say_left_out
from flysid.cli.source import open_source, say_mixed_gains, selection_options, source_options
from flysid.cli.trust import Own
from flysid.escaping import one_line

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.validate.transfers.steps import ChannelStep


@click.command("step")
@click.argument("data", type=SOURCE)
@source_options
@selection_options
@channels_option
@click.option(
    "--horizon",
    default=None,
    type=POSITIVE,
    metavar="S",
    help="Length of the response; default: 2 s, doubled until it has settled.",
)
@click.option(
    "--fast",
    type=POSITIVE,
    metavar="SIZE",
    help="Two responses: where the input exceeds SIZE within the horizon, and where it does not.",
)
@click.option(
    "--anyway",
    cls=Own,
    is_flag=True,
    help="Also where the input reacts to the output, with a caution beside the figures.",
)
@click.option("--against", type=SOURCE, help="A second log or folder, drawn over the first.")
@picture_options("a plot")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("--quiet", "-q", is_flag=True, help="Print errors and warnings only.")
def command(
    data: Path,
    selection: Selection,
    reading: Reading,
    channels: tuple[str, ...],
    horizon: float | None,
    fast: float | None,
    anyway: bool,
    against: Path | None,
    plot: Path | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Estimate the step response from ordinary flight: latency, rise time, overshoot, settling time.

    DATA is an ingested folder, a log or table (.csv), a folder of logs or a quoted pattern. Without a recipe
    and fields, the shipped recipe is taken that fits, with its channels of a command and the response to
    it. A channel whose input reacts to its output is refused, because its record holds no step response
    (--anyway estimates it, with a caution).
    Exit code 3: --channel named such a channel, or a log was read with losses.
    """
    request = Request(reading, selection, channels, chooses=True)
    places = [data] if against is None else [data, against]
    for place in places:
        check_source(place, request)
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.recipe_choice import commands_of
    from flysid.validate.transfers.steps import channel_steps, draw_steps

    found: list[ChannelStep] = []
    skipped: dict[str, str] = {}
    name = reading.recipe
    for place, of in zip(places, _names(places), strict=True):
        with Display(quiet=quiet).shown(), open_source(place, request, None, quiet) as (lake, chosen):
            recipe = load_recipe(chosen)
            name = name or recipe.name
            if request.is_open:  # the second place is looked at as the first one is
                wanted = channels or commands_of(recipe)
                request = replace(request, reading=replace(reading, recipe=chosen), channels=wanted)
            steps, why = channel_steps(
                lake, chosen, channels=request.channels, horizon_s=horizon, fast=fast, of=of, anyway=anyway
            )
            say_mixed_gains(lake, quiet)
        found += steps
        skipped |= {f"{name} of {of}" if of else name: reason for name, reason in why.items()}
    if as_json:
        body = {"recipe": name, "steps": [s.to_dict() for s in found], "skipped": skipped}
        print_json(body)
    else:
        for step in sorted(found, key=lambda s: s.name):
            click.echo("\n".join(one_line(line) for line in step.line().split("\n")))
    if plot is not None and found:
        say_drawn("step responses", plot, partial(draw_steps, found, plot), quiet)
    for name, reason in skipped.items():
        say_left_out(name, reason)
    refused = any(name.split(" of ")[0] in channels for name in skipped)
    return 3 if refused or not found else 0


def _names(places: Sequence[Path]) -> list[str]:
    """What tells responses of several places apart: their names, or their paths where they share a name."""
    if len(places) < 2:
        return [""] * len(places)
    names = [place.name for place in places]
    return names if len(set(names)) == len(names) else [str(place) for place in places]
