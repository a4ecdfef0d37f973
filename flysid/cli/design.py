"""`flysid design RUN|LOG`: gains beside the present ones, of a run's position loop or of logs' rate loops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import POSITIVE, Number
from flysid.cli.checks import Reading
from flysid.cli.display import Display, progress_options
from flysid.cli.options import channels_option, gather, target_options
from flysid.cli.output import align_columns, print_json, say
from flysid.cli.ratedesign import AXES, design_rates
from flysid.cli.source import flight_options, reading_options
from flysid.cli.trust import ProjectFile, Setting
from flysid.errors import UsageError
from flysid.escaping import one_line

if TYPE_CHECKING:
    from flysid.design.designed import Design
    from flysid.design.designing import Wish
    from flysid.design.rule_design import RuleDesign
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.loops.gain_bounds import RateBounds

FIRMWARES = ("pid", "px4", "ardupilot", "tum-ardrone")


def a_range(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """LOW..HIGH as two numbers; None where nothing was given."""
    if value is None:
        return None
    low, dots, high = value.partition("..")
    try:
        return (float(low), float(high if dots else low))
    except ValueError:
        raise click.BadParameter(f"as 0.85..1.15, not {value!r}") from None


OF_LOGS = ("axes", "only_flights", "exclude", "vehicle", "pool", "format", "time_unit", "date_order")
OF_RUNS = ("channels", "method", "firmware", "old", "peak", "limit", "gain", "delay", "feed_forward", "data")
"""Options of one kind of design alone."""
OF_ONE_KIND = "leave it out; a run has channels, logs have axes"
LARGEST_MS = 1.6
"""Of a position loop, where none is given."""


@dataclass(frozen=True)
class Given:
    """The options of a design, by their names."""

    axes: tuple[str, ...]
    channels: tuple[str, ...]
    method: str
    firmware: str
    old: str | None
    ms: float | None
    peak: float
    noise: float | None
    limit: float | None
    gain: tuple[float, float] | None
    delay: tuple[float, float] | None
    feed_forward: bool
    data: Path | None

    def bounds(self) -> RateBounds:
        """Of rate loops."""
        from flysid.loops.gain_bounds import RateBounds

        given = {name: value for name, value in (("ms", self.ms), ("noise", self.noise)) if value is not None}
        return RateBounds(**given)

    def wish(self) -> Wish:
        """For the position loop of a run's channels; raises UsageError where options contradict."""
        from flysid.design.designing import Wish
        from flysid.design.drawn_plants import Spread

        if self.method == "pdc" and (self.firmware != "pid" or self.old is not None or self.feed_forward):
            raise UsageError(
                "--for, --old and --feed-forward are for the gains of a PID",
                hint="leave them out, or --method pid",
            )
        return Wish(
            self.channels,
            self.firmware,
            old_parameters(self.old, self.firmware),
            LARGEST_MS if self.ms is None else self.ms,
            self.peak,
            self.noise,
            self.limit,
            Spread(self.gain or (1.0, 1.0), self.delay or (0.0, 0.0)),
            feedforward=self.feed_forward,
        )


design_options = gather(
    "given",
    Given,
    click.option(
        "--axis", "axes", multiple=True, type=click.Choice(AXES), help="Of a log: only this axis; repeatable."
    ),
    channels_option,
    click.option(
        "--method",
        type=click.Choice(["pid", "pdc"]),
        default="pid",
        show_default=True,
        help="pdc: gains for every rule of the TS model, with a proof; needs --limit.",
    ),
    click.option(
        "--for",
        "firmware",
        type=click.Choice(FIRMWARES),
        default="pid",
        show_default=True,
        help="Names and units of the gains.",
    ),
    click.option(
        "--old",
        cls=ProjectFile,
        metavar="FILE",
        help="Parameter file with the present gains; 'published' for those that come with tum-ardrone.",
    ),
    click.option(
        "--ms",
        type=Number(min=1.0, min_open=True),
        help="Largest sensitivity peak (Ms) on any plant.  [default: 1.6; of rate loops 1.7]",
    ),
    click.option(
        "--peak",
        default=1.15,
        type=Number(min=1.0, min_open=True),
        show_default=True,
        help="Largest peak of reference to position on any plant.",
    ),
    click.option(
        "--noise",
        type=POSITIVE,
        help="Largest input per m/s of noise; of rate loops the most that noise to the motors may grow, as a "
        "factor.  [default: 5 % of what was flown; of rate loops 1.5]",
    ),
    click.option("--limit", type=POSITIVE, help="Input limit, in its unit."),
    click.option(
        "--gain",
        cls=Setting,
        callback=a_range,
        metavar="LOW..HIGH",
        help="Range of the plant's gain, as a factor.",
    ),
    click.option(
        "--delay", cls=Setting, callback=a_range, metavar="LOW..HIGH", help="Range of additional delay, s."
    ),
    click.option("--feed-forward", is_flag=True, help="Also find the input per unit of reference speed."),
    click.option("--data", type=click.Path(path_type=Path), help="The run's data, if they have moved."),
)


@click.command("design")
@click.argument("source", metavar="RUN|LOG", type=SOURCE)
@design_options
@target_options("-o", "--out", replaced="folder", help="Folder for design.json, old.param, new.param.")
@click.option("--json", "as_json", is_flag=True, help="Print the design as JSON.")
@flight_options
@reading_options
@progress_options
@click.pass_context
def command(
    context: click.Context,
    source: Path,
    given: Given,
    out: Path | None,
    as_json: bool,
    selection: Selection,
    reading: Reading,
    display: Display,
) -> int:
    """Find robust gains, optimised for the worst of all good models; compare them with the present gains.

    Of a run: a cascade from position to velocity to the channel's input. The bounds hold on every plant: all
    good models, all rules, linearisations and the ends of intervals.

    Of logs: the rate loops that flew (Betaflight, INAV, PX4, ArduCopter), gains and D filters together. The
    error over the last flight becomes as small as bounds allow that hold on every plant that the flights
    leave possible. The files are lines for the command line, or parameters.

    For the next flight no gain changes by more than a factor of two. If the flights do not identify the
    plant, the output says why and what to fly (exit code 3: a channel was refused; of logs, every axis). The
    gains have not been flown.
    """
    from flysid.design.designing import design_run
    from flysid.design.rule_design import design_rules
    from flysid.validate.runs.run import RUN_FILE, open_run

    if not (source / RUN_FILE).is_file():
        if source.exists():  # what is missing is named where it is read
            refuse_given(context, OF_RUNS, "logs", "designs the rate loops that flew", OF_ONE_KIND)
        return design_rates(
            source, given.axes, given.bounds(), selection, reading, out, as_json=as_json, display=display
        )
    refuse_given(context, OF_LOGS, "a run", "designs the position loop of its channels", OF_ONE_KIND)
    wish = given.wish()
    find: Callable[..., Design | RuleDesign] = design_rules if given.method == "pdc" else design_run
    with display.shown():
        design = find(open_run(source), wish, given.data)
    if as_json:
        print_json(design.to_dict())
    else:
        for axis in design.axes:
            click.echo("\n".join(one_line(line) for line in axis.lines()))
            click.echo("\n".join(f"    {line}" for line in align_columns(axis.table())) + "\n")
    _write(design, out, display.quiet)
    if not as_json:
        say(design.caution)
    return 3 if design.refused else 0


def refuse_given(context: click.Context, names: Sequence[str], source: str, does: str, hint: str) -> None:
    """Raise UsageError where an option is given that the verb has for another kind of source."""
    given = [name for name in names if context.get_parameter_source(name) == ParameterSource.COMMANDLINE]
    if given:
        options = {parameter.name: parameter.opts[0] for parameter in context.command.params}
        raise UsageError(
            f"{', '.join(options[name] for name in given)}: not for {source}: flysid {does}",
            hint=hint,
        )


def _write(design: Design | RuleDesign, out: Path | None, quiet: bool) -> None:
    """Say why channels were refused, and write the files of the others."""
    from flysid.files import replacing_folder

    for name, (why, hint) in design.refused.items():
        say(f"{name}: refused: {why}. Try: {hint}", quiet)
    if out is not None:
        with replacing_folder(out) as place:
            for file, text in design.files().items():
                (place / file).write_text(text, "utf-8")
        say(f"written: {out}", quiet)


def old_parameters(old: str | None, firmware: str) -> dict[str, float]:
    """The present gains: of a file, published ones, or none.

    Raises UsageError: none are published for this firmware, or the file cannot be read.
    """
    from flysid.design.firmware import SCHEMES, read_parameters

    if old is None:
        return {}
    if old == "published":
        found = dict(SCHEMES[firmware][0].published)
        if not found:
            raise UsageError(
                f"no gains are published for {firmware} that fit every vehicle", hint="--old FILE"
            )
        return found
    return read_parameters(Path(old))
