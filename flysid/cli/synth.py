"""flysid synth: fly simulated vehicles, write the logs that they would have written."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.output import check_target, say
from flysid.cli.trust import Own, Setting
from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.ingest.synth.dryden import Gust
    from flysid.ingest.synth.synth import Change, Order
    from flysid.ingest.synth.telemetry import Recording

Writer = tuple[str, Callable[["Recording"], bytes]]


def list_all(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print plants, plans, sensors and formats, one `kind name` per line, and end."""
    if not wanted:
        return
    from flysid.ingest.synth.plans import PLANS
    from flysid.ingest.synth.sensors import SENSORS
    from flysid.ingest.synth.synth import WRITERS
    from flysid.ingest.synth.vehicles import VEHICLES

    for kind, names in (("plant", VEHICLES), ("plan", PLANS), ("sensor", SENSORS), ("format", WRITERS)):
        for name in names:
            click.echo(f"{kind}\t{name}")
    context.exit()


@click.command("synth")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Folder for the logs.")
@click.option(
    "--plant", cls=Setting, default="ardrone-linear", show_default=True, help="Vehicle; ardrone is nonlinear."
)
@click.option("--plan", cls=Setting, default="mixed", show_default=True, help="Manoeuvres; --list names all.")
@click.option("--duration", default=120.0, show_default=True, metavar="S", help="Seconds of each flight.")
@click.option("--amplitude", default=1.0, show_default=True, help="Factor on the plan's amplitudes.")
@click.option("--sensor", cls=Setting, default="telemetry", show_default=True, help="Sensors.")
@click.option(
    "--noise", default=0.02, show_default=True, help="Velocity noise of telemetry, m/s (one sigma)."
)
@click.option("--wind", default=0.0, show_default=True, metavar="M/S", help="Steady wind with turbulence.")
@click.option(
    "--gust",
    "gusts",
    cls=Setting,
    multiple=True,
    metavar="START:RISE:X:Y:Z",
    help="1 - cosine gust, s and m/s.",
)
@click.option(
    "--without", cls=Setting, multiple=True, metavar="EFFECT", help="Switch off an effect of the vehicle."
)
@click.option("--altitude", default=20.0, show_default=True, metavar="M", help="Above ground at the start.")
@click.option(
    "--fleet",
    default=1,
    show_default=True,
    metavar="N",
    help="Number of vehicles, with dispersed parameters.",
)
@click.option(
    "--change",
    "changes",
    cls=Setting,
    multiple=True,
    metavar="VEHICLE:FLIGHT:WHAT:FACTOR",
    help="Multiply a vehicle's mass, thrust, drag or lag by FACTOR from this flight on.",
)
@click.option("--seed", default=1, show_default=True, help="Same seed, same bytes.")
@click.option(
    "--format",
    "formats",
    cls=Setting,
    multiple=True,
    metavar="NAME",
    help="May be repeated.  [default: tlog]",
)
@click.option(
    "--dropout",
    "dropouts",
    cls=Setting,
    multiple=True,
    metavar="START:LENGTH",
    help="Dropout of the link, s.",
)
@click.option("--truth/--no-truth", default=True, help="Also write the true signals: NAME.truth.parquet.")
@click.option(
    "-j", "--jobs", cls=Own, default=1, show_default=True, metavar="N", help="Processes; 0 for one per core."
)
@click.option(
    "--live", cls=Own, metavar="udp:HOST:PORT", help="Fly now and send MAVLink there instead of writing logs."
)
@click.option("--speed", default=1.0, show_default=True, help="Speed of --live: 2 is twice real time.")
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=list_all,
    help="List the plants, plans, sensors and formats.",
)
@click.option("--force", cls=Own, is_flag=True, help="Replace logs that exist.")
@click.option("-q", "--quiet", is_flag=True, help="Only paths and errors.")
def command(
    output: Path | None,
    formats: tuple[str, ...],
    live: str | None,
    force: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Simulate flights, write the logs that the vehicles would have written, and print their paths."""
    order = read_order(**options)
    if live is not None and output is not None:
        raise UsageError("-o and --live are mutually exclusive", hint="leave out one of them")
    if live is not None:
        from flysid.ingest.synth.live import Pace, fly_live

        say(f"flying to {live}; interrupt to end", quiet)
        sent = fly_live(order, live, Pace(options["speed"]))
        say(f"{sent:,} messages sent", quiet)
        return
    if output is None:
        raise UsageError("no folder for the logs", hint="-o DIR, or --live udp:HOST:PORT")
    writers = writers_named(formats or ("tlog",))
    from flysid.ingest.lake.finding import TRUTH_SUFFIX

    if options["truth"]:
        from flysid.ingest.synth.truth import truth_bytes

        writers.append((TRUTH_SUFFIX, truth_bytes))
    check_paths(order, output, writers, force)
    make_folder(output)
    say(f"flying {order.plan} with {order.plant}: {order.duration_s:g} s each", quiet)
    for path in fly_all(order, output, tuple(s for s, _ in writers), options["jobs"]):
        if path.name.endswith(TRUTH_SUFFIX):
            say(f"truth: {path}", quiet)  # not a log, so not among the paths that a pipe passes on
        else:
            click.echo(path)


def read_order(*, dropouts: tuple[str, ...], **options: Any) -> Order:
    """The order that the options describe."""
    from flysid.ingest.synth.synth import Order

    return Order(
        plant=options["plant"],
        plan=options["plan"],
        duration_s=options["duration"],
        noise=options["noise"],
        seed=options["seed"],
        amplitude=options["amplitude"],
        dropouts_s=tuple(parse_dropout(text) for text in dropouts),
        sensor=options["sensor"],
        wind_m_s=options["wind"],
        fleet=options["fleet"],
        gusts=tuple(parse_gust(text) for text in options["gusts"]),
        altitude_m=options["altitude"],
        without=options["without"],
        changes=tuple(parse_change(text) for text in options["changes"]),
    )


def check_paths(order: Order, folder: Path, writers: Sequence[Writer], force: bool) -> None:
    """Raise UsageError where a log would replace another; before anything flies."""
    from flysid.ingest.synth.synth import flight_names

    for name in flight_names(order):
        for suffix, _ in writers:
            check_target(folder / f"{name}{suffix}", force)


def fly_all(order: Order, folder: Path, suffixes: tuple[str, ...], jobs: int) -> Iterator[Path]:
    """Fly and write every flight, in `jobs` processes; paths in the order of the flights."""
    import os

    from flysid.ingest.synth.synth import flight_names

    tasks = [(order, index, folder, suffixes) for index in range(len(flight_names(order)))]
    jobs = min(jobs or os.cpu_count() or 1, len(tasks))
    if jobs <= 1:
        for task in tasks:
            yield from fly_and_write(*task)
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    with ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn")) as pool:
        for paths in pool.map(fly_and_write, *zip(*tasks, strict=True)):
            yield from paths


def fly_and_write(order: Order, index: int, folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Fly one flight and write it in every format; each log appears whole."""
    from flysid.files import write_atomically, writing_to
    from flysid.ingest.lake.finding import TRUTH_SUFFIX
    from flysid.ingest.synth.synth import WRITERS, fly_one
    from flysid.ingest.synth.truth import truth_bytes

    encoders = {**dict(WRITERS.values()), TRUTH_SUFFIX: truth_bytes}
    recording = fly_one(order, index)
    paths = [folder / f"{recording.name}{suffix}" for suffix in suffixes]
    for path, suffix in zip(paths, suffixes, strict=True):
        with writing_to(path):
            write_atomically(path, encoders[suffix](recording))
    return paths


def writers_named(names: Sequence[str]) -> list[Writer]:
    """The writers of these formats, each once."""
    from flysid.ingest.synth.synth import WRITERS

    for name in names:
        if name not in WRITERS:
            raise UsageError(f"no format {name!r} to write", hint="one of " + ", ".join(WRITERS))
    return [WRITERS[name] for name in dict.fromkeys(names)]


def parse_dropout(text: str) -> tuple[float, float]:
    """START:LENGTH in seconds."""
    try:
        start, length = (float(part) for part in text.split(":"))
    except ValueError:
        raise UsageError(f"no dropout {text!r}", hint="START:LENGTH in seconds, e.g. 20:5") from None
    return start, length


def parse_gust(text: str) -> Gust:
    """START:RISE:X:Y:Z in seconds and m/s."""
    from flysid.ingest.synth.dryden import Gust

    try:
        start, rise, x, y, z = (float(part) for part in text.split(":"))
        return Gust(start, rise, (x, y, z))
    except ValueError:
        raise UsageError(f"no gust {text!r}", hint="START:RISE:X:Y:Z, e.g. 20:2:3:0:-1") from None


def parse_change(text: str) -> Change:
    """VEHICLE:FLIGHT:WHAT:FACTOR."""
    from flysid.ingest.synth.synth import Change

    try:
        vehicle, flight, name, factor = text.split(":")
        return Change(int(vehicle), int(flight), name, float(factor))
    except ValueError:
        raise UsageError(
            f"no change {text!r}", hint="VEHICLE:FLIGHT:WHAT:FACTOR, e.g. 3:2:mass:1.25"
        ) from None


def make_folder(folder: Path) -> None:
    """Create the folder for the logs."""
    from flysid.files import writing_to

    if folder.exists() and not folder.is_dir():
        raise UsageError("the target is not a folder", path=folder, hint="choose another with -o")
    with writing_to(folder):
        folder.mkdir(parents=True, exist_ok=True)
