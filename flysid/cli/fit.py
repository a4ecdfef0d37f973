"""`flysid fit DATA --recipe R -o RUN`, or `--from FIELD --to FIELD` instead; or a dataset file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.checks import Reading, Request, check_source, is_ingested
from flysid.cli.display import Display, progress_options
from flysid.cli.options import channels_option, effort_option, force_option, gather, jobs_option
from flysid.cli.output import check_target, cores, explain, say, say_left_out
from flysid.cli.source import (
    READING_OF_A_FIT,
    open_source,
    say_mixed_gains,
    selection_options,
    source_options,
)
from flysid.cli.trust import Own, ProjectFile, Setting
from flysid.errors import UsageError
from flysid.extras import Extra, extra
from flysid.model.structures import OWN
from flysid.progress import part

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.validate.runs.run import ChannelRun, FitSettings, Run

DATASET = ".parquet"
SHARE = 0.3
LEAST_SHARE = 0.05
MOST_SHARE = 0.8


class Held(NamedTuple):
    """What a fit holds out: a share by chance, or flights and parts of them where any are named."""

    share: float
    parts: tuple[str, ...]


def _rules(_ctx: click.Context, _param: click.Parameter, value: str) -> int | str:
    if value == "auto":
        return value
    if value.isdigit() and int(value) > 0:
        return int(value)
    raise click.BadParameter("a positive whole number, or auto")


def _held(_ctx: click.Context, _param: click.Parameter, words: tuple[str, ...]) -> Held:
    shares = [float(word) for word in words if re.fullmatch(r"[0-9]*\.[0-9]+", word)]
    if any(not LEAST_SHARE <= share <= MOST_SHARE for share in shares):
        raise click.BadParameter(f"a share from {LEAST_SHARE} to {MOST_SHARE}")
    if shares and len(words) > 1:
        raise click.BadParameter("one share, or flights and parts of them")
    return Held(shares[0] if shares else SHARE, () if shares else words)


def _names(*fitted: str) -> list[str]:
    """flysid's own structures that a run fits so, for the help."""
    rows = (row for row in OWN.values() if row.fitted in fitted)
    return sorted(row.name + "[:FILE]" * row.takes_file for row in rows)


_STREAMED = ", ".join(sorted(row.name for row in OWN.values() if row.streams and row.has_memory))


def _settings(holdout: Held, models: str, memory: float, **chosen: Any) -> FitSettings:
    from flysid.validate.runs.run import FitSettings

    share, held = holdout
    return FitSettings(share, models=labels_of(models), held=held, memory_mb=memory, **chosen)


fit_options = gather(
    "settings",
    _settings,
    channels_option,
    click.option(
        "--models",
        "-m",
        cls=ProjectFile,
        default="",
        metavar="A,B",
        shell_complete=complete.models,
        help="Models besides the references, ARX, OE and the baseline: "
        f"{', '.join(_names('on request', 'usually'))}, and those of installed packages "
        f"(docs/models.md).  [default: {','.join(_names('usually'))}]",
    ),
    click.option(
        "--rules",
        cls=Setting,
        default="auto",
        callback=_rules,
        show_default=True,
        help="Number of rules of the TS model.",
    ),
    click.option(
        "--antecedent",
        "-a",
        "antecedents",
        cls=Setting,
        multiple=True,
        help="Variable that chooses between rules.",
    ),
    effort_option("Effort of the search for rules."),
    click.option(
        "--flight-offsets",
        "flight_offsets",
        default="auto",
        show_default=True,
        type=click.Choice(["auto", "yes", "no"]),
        help="A constant of every flight beside the models: wind, trim, bias. auto: where flights differ.",
    ),
    click.option(
        "--holdout",
        cls=Setting,
        multiple=True,
        metavar="SHARE|FLIGHT[@FROM..TO]",
        callback=_held,
        help="Held out: a share by chance, or flights, or parts of them; repeatable.  [default: 0.3]",
    ),
    click.option(
        "--by",
        default="auto",
        show_default=True,
        type=click.Choice(["auto", "flight", "time"]),
        help="Hold out whole flights, or stretches of time.",
    ),
    click.option("--seed", default=7, show_default=True, help="Of the split and of all random starts."),
    click.option(
        "--rotate/--no-rotate",
        default=True,
        show_default=True,
        help="With five flights or more, hold out each of them once (five more fits) if --holdout leaves "
        "fewer than five.",
    ),
    click.option(
        "--memory",
        cls=Own,
        default=64.0,
        show_default=True,
        metavar="MB",
        type=click.FloatRange(0.0),
        help=f"Samples of a channel above this are fitted from disk, by {_STREAMED}.",
    ),
)
"""How a run is fitted; the verb takes it as `FitSettings` without a selection."""


@click.command("fit")
@click.argument("data", type=SOURCE)
@source_options
@selection_options
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), help="Folder of the run.")
@fit_options
@jobs_option("Channels in parallel.  [default: one per core]")
@force_option("run")
@click.option("--json", "as_json", is_flag=True, help="Print the run as JSON.")
@progress_options
def command(
    data: Path,
    selection: Selection,
    reading: Reading,
    output: Path,
    settings: FitSettings,
    jobs: int,
    force: bool,
    as_json: bool,
    display: Display,
) -> int:
    """Fit linear and Takagi-Sugeno models to every channel of a recipe, or between given fields.

    Part of the data is held out first; 'flysid validate RUN' judges the models on it. DATA is an ingested
    folder; or a log, a folder of logs or a quoted pattern, read into RUN.data; or one channel that Python
    wrote (.parquet). Channels that the data do not support are named and left out. Exit code 3: --channel
    named one of them, or a log was read with losses; 130: interrupted, the run has the finished models.
    """
    check_target(output, force)
    is_dataset = _is_dataset(data)
    if is_dataset:
        refuse_reading(data, reading)
    place = place_of_logs(output, force) if not is_dataset and not is_ingested(data) else None
    settings = replace(settings, selection=selection)
    request = Request(reading, selection, settings.channels, settings.held)
    if not is_dataset:
        check_source(data, request)
    from flysid.validate.runs.fitting import fit_file, fit_run
    from flysid.validate.runs.wanted_models import check_settings

    check_settings(settings)
    check_antecedents(settings.antecedents, reading, settings.channels)
    if is_dataset:
        with display.shown():
            run = fit_file(data, output, settings)
    else:
        with display.shown(), open_source(data, request, place, display.quiet) as (lake, chosen):
            with part(0.0 if is_ingested(data) else READING_OF_A_FIT):
                run = fit_run(lake, chosen, output, settings, jobs=jobs or cores())
            say_mixed_gains(lake, display.quiet)
    if as_json:
        click.echo((output / "run.json").read_text("utf-8"), nl=False)
    else:
        click.echo(str(output))
    _say_what_was_fitted(run, display.quiet)
    if run.interrupted:
        say(
            f"interrupted: {output} holds what was finished. 'flysid validate {output}' judges it; "
            "--force fits anew"
        )
        return 130
    say(f"next: flysid validate {output}", display.quiet)
    return 3 if set(settings.channels) & set(run.skipped) else 0


def _say_what_was_fitted(run: Run, quiet: bool) -> None:
    from flysid.ingest.align.doubts import doubt_lines
    from flysid.validate.runs.fitting import FROM_DISK

    for channel in run.channels:
        if channel.on_disk:
            explain(f"{channel.name}{FROM_DISK}", quiet)
        for label, why in channel.failed.items():
            explain(f"{channel.name}: {label} could not be fitted: {why}")
        for line in doubt_lines(channel.doubts):
            explain(f"{channel.name}: {line}")
        for said in (*channel.dead_times, *channel.nonlinear):
            explain(f"{channel.name}: {said}", quiet)
        for loop in channel.loops:
            explain(f"{channel.name}: caution: {loop}")
        make = partial(transfer_lines, run, channel)
        for line in extra(Extra.TRANSFER_TEXT, make, (), channel.name):
            say(line, quiet)
        for missing in channel.missing:
            explain(missing)
    for name, why in run.skipped.items():
        say_left_out(name, why)


def _is_dataset(data: Path) -> bool:
    if data.suffix != DATASET or not data.is_file():
        return False
    from flysid.datasetfile import is_dataset

    return is_dataset(data)


def refuse_reading(data: Path, reading: Reading) -> None:
    """Raise UsageError where a dataset file comes with a recipe or with fields."""
    if reading != Reading():
        raise UsageError(
            "a dataset file is one channel already",
            path=data,
            hint="leave out --recipe, --from, --to, --dt and --time-unit",
        )


def labels_of(models: str) -> tuple[str, ...]:
    """What --models names."""
    return tuple(_label(word) for word in models.split(",") if word.strip())


def _label(word: str) -> str:
    """A model's label in small letters; the path of its file stays as it is."""
    label, mark, file = word.strip().partition(":")
    return label.lower() + mark + file


def place_of_logs(output: Path, force: bool) -> Path:
    """The folder RUN.data for the logs of a run; raises where it is there, and not to be replaced."""
    place = output.with_name(output.name + ".data")
    check_target(place, force)
    if place.exists():
        from flysid.manifest import check_data_folder

        check_data_folder(place)
    return place


def check_antecedents(antecedents: Sequence[str], reading: Reading, channels: Sequence[str]) -> None:
    """Raise UsageError where a recipe is named, and antecedents that none of its channels has."""
    if reading.recipe and antecedents:
        from flysid.ingest.align.recipe import load_recipe
        from flysid.validate.runs.wanted_models import refused_antecedents

        recipe = load_recipe(reading.recipe)
        refused_antecedents(antecedents, recipe, recipe.chosen(channels))


def transfer_lines(run: Run, channel: ChannelRun) -> list[str]:
    """The transfer functions of a channel's models with their intervals; nothing where they have none."""
    from flysid.model.capabilities import HasTransferFunctions

    models = (run.model(file) for file in channel.models.values())
    found = [t for model in models if isinstance(model, HasTransferFunctions) for t in model.transfers]
    lines = [line for t in found for line in ["", f"{channel.name}:", *str(t).split("\n")]]
    return [*lines, ""] if lines else []
