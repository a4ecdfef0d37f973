"""`flysid plan [SOURCE]`: the flight to fly next, and what more flying would tell."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.bounds import POSITIVE
from flysid.cli.checks import Reading, Request
from flysid.cli.display import Display
from flysid.cli.options import gather, target_options
from flysid.cli.output import print_json
from flysid.cli.source import open_source, selection_options, source_options
from flysid.cli.trust import Setting
from flysid.errors import UsageError
from flysid.escaping import one_line
from flysid.manifest import RUN_FILE

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.plan.flightplan import CommandedAxis, FlightPlan, Kind
    from flysid.plan.precision import Known


@dataclass(frozen=True)
class Beginning:
    """What a source tells a plan: its axes, a band, the recipe of its log, and how well it is known."""

    axes: tuple[CommandedAxis, ...] = ()
    band_hz: tuple[float, float] | None = None
    recipe: str = ""
    known: tuple[Known, ...] = ()
    unknown: tuple[str, ...] = ()


@dataclass(frozen=True)
class Signals:
    """What the command line says of the signals to fly.

    `band`: Hz; of a run's models where there is none.
    `place`: where a sweep of ArduPilot enters; None: no parameters for ArduPilot.
    """

    band: tuple[float, float] | None
    seconds: float
    rate: float
    kind: Kind
    place: str | None
    px4_plane: bool

    def check(self) -> None:
        """Raise UsageError where no signal can meet the request, whatever the flights show."""
        from flysid.plan.autopilots import require_chirp
        from flysid.plan.flightplan import check_flight

        if self.band is not None:
            check_flight(self.band, self.seconds, self.rate)
        if self.place is not None:
            require_chirp(self.kind, "ArduPilot")
        if self.px4_plane:
            require_chirp(self.kind, "PX4")


signal_options = gather(
    "signals",
    Signals,
    click.option(
        "--band",
        nargs=2,
        type=POSITIVE,
        metavar="LOW HIGH",
        help="Hz.  [default: around the poles of a run's models]",
    ),
    click.option("--seconds", default=60.0, type=POSITIVE, show_default=True, help="Duration of the flight."),
    click.option(
        "--rate",
        default=50.0,
        type=POSITIVE,
        show_default=True,
        metavar="HZ",
        help="Sample rate of plan.csv.",
    ),
    click.option(
        "--kind",
        default="multisine",
        show_default=True,
        type=click.Choice(["multisine", "chirp", "doublets"]),
        help="Multisines on all axes at once, or one axis after the other.",
    ),
    click.option(
        "--ardupilot",
        "place",
        type=click.Choice(["mixer", "rate", "angle", "recover"]),
        help="With --kind chirp: also SID_* parameters; where the sweep enters.",
    ),
    click.option(
        "--px4-plane", is_flag=True, help="With --kind chirp: also FW_AT_* parameters (PX4 v1.16 on)."
    ),
)


@click.command("plan")
@click.argument("source", type=click.Path(path_type=Path), required=False)
@click.option(
    "--axis",
    "axes",
    cls=Setting,
    multiple=True,
    metavar="NAME=PEAK",
    help="Input and peak amplitude, e.g. theta_in=5deg, instead of those of SOURCE; repeatable.",
)
@click.option(
    "--limit", "limits", cls=Setting, multiple=True, metavar="NAME=PEAK", help="Largest amplitude of an axis."
)
@signal_options
@click.option(
    "--more",
    default=3.0,
    type=POSITIVE,
    show_default=True,
    metavar="MINUTES",
    help="Further minutes of the same flying, for a run.",
)
@click.option(
    "--aim",
    type=POSITIVE,
    metavar="PERCENT",
    help="Flight time until every figure is known to this accuracy.",
)
@click.option(
    "--channel",
    "-c",
    "channels",
    cls=Setting,
    multiple=True,
    help="Channel of the recipe or run; repeatable.",
)
@click.option(
    "--data", type=click.Path(path_type=Path), help="The run's data, if they have moved since the fit."
)
@target_options("-o", "--out", replaced="folder", help="Folder for the plan's files.")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("--quiet", "-q", is_flag=True, help="Print errors and warnings only.")
@source_options
@selection_options
def command(
    source: Path | None,
    selection: Selection,
    reading: Reading,
    axes: tuple[str, ...],
    limits: tuple[str, ...],
    signals: Signals,
    more: float,
    aim: float | None,
    channels: tuple[str, ...],
    data: Path | None,
    out: Path | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Plan the next flight: input signals, safe amplitudes, and the accuracy to expect.

    SOURCE is a run (its accuracy, now and after more of the same flying), an ingested folder or a log
    (amplitudes from its last flight), or nothing: then give --axis and --band. -o writes plan.csv, a
    recipe.toml for its log, and parameters for autopilots that can fly it. Exit code 3: a run does not
    determine some of its figures.
    """
    from flysid.plan.flightplan import axis_of, check_limits, lowest_hz, make_plan, within

    if source is not None and not source.exists():
        raise UsageError("no such run, folder or log", path=source, hint="without one: --axis and --band")
    own, bounds = (tuple(map(axis_of, texts)) for texts in (axes, limits))
    names = [axis.name for axis in own] or _commanded(source, reading, channels)
    if names:
        check_limits(names, bounds)
    signals.check()
    if signals.band is None and not is_run(source):
        raise no_band()
    begun = _begun(source, Request(reading, selection, channels), data, quiet)
    chosen = within(own or begun.axes, bounds)
    plan = None
    if signals.band or begun.band_hz or not begun.known:
        lowest = lowest_hz(signals.kind, len(chosen), signals.seconds)
        band = signals.band or _band_of_models(begun, signals.rate, lowest)
        plan = make_plan(signals.kind, chosen, band, signals.seconds, signals.rate)
    files = _files(plan, begun, reading.outputs, signals) if plan is not None else {}
    if as_json:
        print_json(_document(plan, begun, more, files))
    else:
        _print(plan, begun, more, aim, files)
    if out is not None and plan is not None:
        _write(out, {name: text for name, (text, _) in files.items()})
        click.echo("\n".join(str(out / name) for name in files))
    return 3 if begun.unknown or any(not k.is_determined for k in begun.known) else 0


def _commanded(source: Path | None, reading: Reading, channels: tuple[str, ...]) -> list[str]:
    """Inputs of the channels that are meant, as far as a recipe tells before anything is read."""
    from flysid.ingest.align.recipe import load_recipe
    from flysid.validate.runs.run import RECIPE_FILE, open_run

    name: str | Path = reading.recipe
    if source is not None and is_run(source):
        open_run(source).check_channels(channels)
        name = source / RECIPE_FILE if (source / RECIPE_FILE).is_file() else ""
    if not name:
        return []
    recipe = load_recipe(name)
    return list(dict.fromkeys(i for c in recipe.chosen(channels) for i in recipe.channel(c).inputs))


def is_run(source: Path | None) -> bool:
    """Whether a plan begins from a run."""
    return source is not None and (source / RUN_FILE).is_file()


def _begun(source: Path | None, request: Request, data: Path | None, quiet: bool) -> Beginning:
    """What the source tells."""
    if source is None:
        return Beginning()
    if is_run(source):
        return _of_run(source, request.channels, data)
    from flysid.ingest.align.recipe import load_recipe, recipe_text
    from flysid.plan.briefing import axes_of_last_flight

    with Display(quiet=quiet).shown(), open_source(source, request, None, quiet) as (lake, name):
        recipe = load_recipe(name)
        wanted = request.channels or lake.channels(recipe)
        found = [axes_of_last_flight(lake.dataset(recipe, channel)) for channel in wanted]
        return Beginning(_once(found), None, recipe_text(name)[0])


def _of_run(folder: Path, channels: tuple[str, ...], data: Path | None) -> Beginning:
    from flysid.plan.briefing import axes_of_last_flight
    from flysid.plan.precision import band_of_models, known_of_channel
    from flysid.validate.runs.run import RECIPE_FILE, held_out, open_run, run_file

    run = open_run(folder)
    run.check_channels(channels)
    held = [h for h in held_out(run, data) if not channels or h.channel.name in channels]
    lost = [f"{n}: {why}" for n, why in run.skipped.items() if not channels or n in channels]
    if not held:
        raise UsageError(
            f"the run has no model to plan from: {'; '.join(lost) or 'it has no channel'}",
            path=folder,
            hint="fly what excites it: flysid plan --axis NAME=PEAK --band LOW HIGH -o plan",
        )
    known = {h.channel.name: tuple(known_of_channel(h)) for h in held}
    lost += [
        f"{name}: its linear model integrates or has no covariance; its gain cannot be predicted"
        for name, found in known.items()
        if not found
    ]
    recipe = run_file(folder, RECIPE_FILE)
    return Beginning(
        _once([axes_of_last_flight(h.train) for h in held]),
        band_of_models([h.models[h.channel.baseline] for h in held if h.channel.baseline in h.models]),
        recipe.read_text("utf-8") if recipe.is_file() else "",
        tuple(k for found in known.values() for k in found),
        tuple(lost),
    )


def _once(found: list[tuple[CommandedAxis, ...]]) -> tuple[CommandedAxis, ...]:
    """Every axis once; channels may share inputs."""
    return tuple({axis.name: axis for axes in found for axis in axes}.values())


def _band_of_models(begun: Beginning, rate: float, lowest: float) -> tuple[float, float]:
    """As far as this flight can show it: a pole near an integrator would ask for days."""
    if begun.band_hz is None:
        raise no_band()
    low, high = begun.band_hz
    return max(low, lowest), min(high, 0.2 * rate)


def no_band() -> UsageError:
    """What to say where neither the command line nor a run's models tell what to excite."""
    return UsageError(
        "no band to excite",
        hint="--band LOW HIGH in Hz: 0.3 times the slowest to 3 times the fastest motion",
    )


def _files(
    plan: FlightPlan, begun: Beginning, outputs: tuple[str, ...], signals: Signals
) -> dict[str, tuple[str, str]]:
    """Name -> text, and what to do with it."""
    from flysid.plan import autopilots
    from flysid.plan.briefing import recipe_for

    files = {"plan.csv": (plan.csv(), "send it as commands, row by row, and log them")}
    if begun.recipe or outputs:
        text = begun.recipe or recipe_for(plan, outputs)
        files["recipe.toml"] = (text, "afterwards: flysid fit LOG -r recipe.toml -o run")
    own = autopilots.ardupilot(plan, signals.place) if signals.place else []
    own += [autopilots.px4_plane(plan)] if signals.px4_plane else []
    return files | {f.name: (f.text, f.words) for f in own}


def _print(
    plan: FlightPlan | None,
    begun: Beginning,
    more: float,
    aim: float | None,
    files: dict[str, tuple[str, str]],
) -> None:
    from flysid.plan.briefing import briefing

    goal = None if aim is None else aim / 100.0
    for known in begun.known:
        click.echo(one_line(f"{known.channel} ({known.model}): {known.words(60.0 * more, goal)}"))
    for line in begun.unknown:
        click.echo(one_line(line))
    if plan is None:
        return
    if begun.known or begun.unknown:
        click.echo()
    click.echo("\n".join(map(one_line, briefing(plan))))
    for name, (_, words) in files.items():
        click.echo(f"{name}: {words}.")


def _document(
    plan: FlightPlan | None, begun: Beginning, more: float, files: dict[str, tuple[str, str]]
) -> dict[str, Any]:
    known = [
        {
            "channel": k.channel,
            "model": k.model,
            "what": k.what,
            "value": k.value,
            "unit": k.unit,
            "known_pct": 100.0 * k.share,
            "determined": k.is_determined,
            "after_pct": 100.0 * k.share_after(60.0 * more) if k.is_determined else None,
            "seconds": k.seconds,
        }
        for k in begun.known
    ]
    body: dict[str, Any] = {
        "known": known,
        "unknown": list(begun.unknown),
        "more_minutes": more,
        "plan": None,
    }
    if plan is not None:
        body["plan"] = {
            "kind": plan.kind,
            "axes": [{"name": a.name, "peak": a.peak, "unit": a.unit} for a in plan.axes],
            "band_hz": list(plan.band_hz),
            "seconds": plan.seconds,
            "rate_hz": plan.rate_hz,
            "lines": [own.tolist() for own in plan.lines],
            "correlation": plan.correlation,
            "relative_peak_factors": list(plan.peak_factors),
            "files": list(files),
        }
    return body


def _write(out: Path, files: dict[str, str]) -> None:
    from flysid.files import replacing_folder, writing_to

    with replacing_folder(out) as folder:
        for name, text in files.items():
            with writing_to(folder / name):
                (folder / name).write_text(text, "utf-8")
