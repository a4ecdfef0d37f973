"""`flysid step DATA --recipe R`: step responses from ordinary flying, with intervals."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.display import Display
from flysid.cli.output import check_target, printable, say_drawn, say_left_out
from flysid.cli.source import Words, open_source, say_mixed_gains, selection_options, words_options
from flysid.cli.trust import Own, Setting

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.validate.steps import ChannelStep


@click.command("step")
@click.argument("data", type=SOURCE)
@words_options
@selection_options
@click.option(
    "--channel", "-c", "channels", cls=Setting, multiple=True, help="Only this channel; repeatable."
)
@click.option("--horizon", default=2.0, show_default=True, metavar="S", help="Length of the response.")
@click.option(
    "--fast",
    type=float,
    metavar="SIZE",
    help="Two responses: where the input exceeds SIZE within the horizon, and where it does not.",
)
@click.option("--against", type=SOURCE, help="A second log or folder, drawn over the first.")
@click.option("--plot", type=click.Path(dir_okay=False, path_type=Path), help="Write a plot to this file.")
@click.option("--force", cls=Own, is_flag=True, help="Replace the plot if it exists.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("--quiet", "-q", is_flag=True, help="Print errors and warnings only.")
def command(
    data: Path,
    selection: Selection,
    words: Words,
    channels: tuple[str, ...],
    horizon: float,
    fast: float | None,
    against: Path | None,
    plot: Path | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Estimate the step response from ordinary flight: latency, rise time, overshoot, settling time.

    DATA is an ingested folder, a log or table (.csv), a folder of logs or a quoted pattern. A channel whose
    input reacts to its output is refused, because its record holds no step response. Exit code 3: --channel
    named such a channel.
    """
    from flysid.validate.pictures import check_picture
    from flysid.validate.steps import channel_steps, draw_steps

    if plot is not None:
        check_picture(plot)
        check_target(plot, force)
    found: list[ChannelStep] = []
    skipped: dict[str, str] = {}
    for place in (data, *([against] if against is not None else [])):
        of = place.name if against is not None else ""
        with (
            Display(quiet=quiet).shown(),
            open_source(place, words, selection, None, quiet) as (lake, chosen),
        ):
            steps, why = channel_steps(lake, chosen, channels=channels, horizon_s=horizon, fast=fast, of=of)
            say_mixed_gains(lake, quiet)
        found += steps
        skipped |= {f"{name} of {of}" if of else name: reason for name, reason in why.items()}
    if as_json:
        body = {"recipe": words.recipe or "quick", "steps": [s.to_dict() for s in found], "skipped": skipped}
        click.echo(json.dumps(body, indent=1, allow_nan=False))
    else:
        for step in sorted(found, key=lambda s: s.name):
            click.echo("\n".join(printable(line) for line in step.line().split("\n")))
    if plot is not None and found:
        say_drawn("step responses", plot, partial(draw_steps, found, plot), quiet)
    for name, reason in skipped.items():
        say_left_out(name, reason)
    asked = any(name.split(" of ")[0] in channels for name in skipped)
    return 3 if asked or not found else 0
