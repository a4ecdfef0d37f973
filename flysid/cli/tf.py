"""`flysid tf DATA [--recipe R]`: transfer functions with intervals, and the measured frequency response."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading, Request, check_source
from flysid.cli.display import Display, progress_options
from flysid.cli.options import channels_option, condition_option, gather, picture_options
from flysid.cli.output import ExitCode, align_columns, explain, print_json, say, say_drawn, say_left_out
from flysid.cli.source import open_source, say_mixed_gains, selection_options, source_options
from flysid.cli.trust import Setting
from flysid.extras import Missing
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.model.transfer_function import TF
    from flysid.validate.transfers.identify import ChannelTransfers


def _auto_or(kind: type, words: str) -> Any:
    def parsed(_ctx: click.Context, _param: click.Parameter, value: str) -> Any:
        if value == "auto":
            return value
        try:
            number = kind(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number) or number < 0:
            raise click.BadParameter(f"{words} of at least 0, or auto, not {value!r}")
        return number

    return parsed


def _estimator(unstable: bool, no_refine: bool, dead_time: Any, **settings: Any) -> TF:
    from flysid.model.transfer_function import TF

    refine = not (unstable or no_refine)
    return TF(dead_time_s=dead_time, stable=not unstable, refine=refine, **settings)


estimator_options = gather(
    "estimator",
    _estimator,
    click.option(
        "--poles",
        cls=Setting,
        default="auto",
        callback=_auto_or(int, "a whole number"),
        show_default=True,
        help="Number of poles, per output.",
    ),
    click.option(
        "--zeros",
        cls=Setting,
        default="auto",
        callback=_auto_or(int, "a whole number"),
        show_default=True,
        help="Number of zeros, per input.",
    ),
    click.option(
        "--dead-time",
        cls=Setting,
        default="auto",
        callback=_auto_or(float, "a number"),
        show_default=True,
        metavar="S",
    ),
    click.option(
        "--hold",
        default="zero",
        show_default=True,
        type=click.Choice(["zero", "first"]),
        help="Inputs between samples: constant (commands) or linear (measured signals).",
    ),
    click.option(
        "--trend",
        default="none",
        show_default=True,
        type=click.Choice(["none", "remove", "estimate"]),
        help="A line per segment: removed before the fit, or estimated with it.",
    ),
    click.option(
        "--band",
        nargs=2,
        type=POSITIVE,
        metavar="LOW HIGH",
        help="Fit the response in this band only, rad/s.",
    ),
    click.option(
        "--no-refine",
        is_flag=True,
        help="Keep the fit to the frequency response: no refinement of the free run.",
    ),
    click.option("--unstable", is_flag=True, help="Allow unstable poles; fits the frequency response only."),
    click.option(
        "--method",
        default="local",
        show_default=True,
        type=click.Choice(["local", "welch", "multitaper"]),
        help="How the frequency response is measured.",
    ),
)
"""How a transfer function is identified; the verb takes it as an estimator."""


@click.command("tf")
@click.argument("data", type=SOURCE)
@source_options
@selection_options
@channels_option
@click.option(
    "--reference",
    cls=Setting,
    multiple=True,
    metavar="FIELD",
    help="What drives a closed loop from outside (a chirp, a setpoint), instead of the recipe's; repeatable.",
)
@click.option(
    "--reference-at",
    default="",
    type=click.Choice(["", "input", "setpoint"]),
    metavar="input|setpoint",
    help="For margins: it enters at the plant's input, or at the controller's setpoint.",
)
@condition_option("'loop.phase_margin_deg.low < 45'")
@estimator_options
@click.option("--table", is_flag=True, help="Print the measured frequency response, too.")
@picture_options("a Bode plot")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@progress_options
def command(
    data: Path,
    selection: Selection,
    reading: Reading,
    channels: tuple[str, ...],
    reference: tuple[str, ...],
    reference_at: str,
    condition: str | None,
    table: bool,
    plot: Path | None,
    as_json: bool,
    estimator: TF,
    display: Display,
) -> int:
    """Identify transfer functions in s, with intervals, from the frequency response and the free run.

    DATA is an ingested folder, a log or table (.csv), a folder of logs or a quoted pattern. Without a recipe
    and fields, the shipped recipe is taken that fits, with its channels of a command and the response to
    it. All flights are used; 'flysid fit --models tf' and 'flysid validate' judge such a model on
    held-out flights. Channels that the data do not support are named. Exit code 3: --channel named one of
    them, or a log was read with losses; 4: --fail-if holds.
    """
    request = Request(reading, selection, channels, chooses=True)
    check_source(data, request)
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.recipe_choice import commands_of
    from flysid.validate.transfers.expected_figures import Figures
    from flysid.validate.transfers.identify import identify

    estimator.check()
    figures = Figures(tuple(channels), tuple(reference), reference_at, condition)
    if reading.recipe:
        figures.check(reading.recipe)
    missing = Missing()
    with display.shown(), open_source(data, request, None, display.quiet) as (lake, chosen):
        recipe = load_recipe(chosen)
        wanted = channels or (commands_of(recipe) if request.is_open else ())
        replace(figures, channels=wanted).check(chosen)
        with missing.gathering():
            found, skipped = identify(
                lake, chosen, estimator, channels=wanted, reference=reference, reference_at=reference_at
            )
        say_mixed_gains(lake, display.quiet)
    if as_json:
        body = {
            "recipe": reading.recipe or recipe.name,
            "channels": [c.to_dict() for c in found],
            "skipped": dict(skipped),
            **missing.to_dict(),
        }
        print_json(body)
    else:
        click.echo("\n\n".join(text_of(c, table) for c in found))
    if plot is not None:
        from flysid.validate.transfers.bodeplot import draw_bode

        say_drawn("Bode plot", plot, partial(draw_bode, found, plot), display.quiet)
    for sentence in missing.sentences:
        explain(sentence)
    for name, why in skipped.items():
        say_left_out(name, why)
    if condition is not None:
        from flysid.validate.compare.condition import matching_channels
        from flysid.validate.transfers.identify import figures_document

        held = matching_channels(condition, figures_document(found))
        for name, why in held.items():
            say(f"{name}: {condition} holds{f': {why}' if why else ''}")
        if held:
            return ExitCode.CHECK_FAILED
    return 3 if set(channels) & set(skipped) else 0


def text_of(channel: ChannelTransfers, table: bool) -> str:
    """What is printed of one channel."""
    from flysid.escaping import one_line

    lines = [one_line(line) for text in channel.lines() for line in text.split("\n")]
    lines = [fold(line) if line.startswith("- ") else line for line in lines]  # no polynomial is broken
    if table:
        for i, output in enumerate(channel.data.outputs):
            for j, source in enumerate(channel.data.inputs):
                lines += ["", one_line(f"{source.name} to {output.name}, measured (+- 95 %) and modelled")]
                lines += align_columns(channel.table(i, j))
    return "\n".join(lines)
