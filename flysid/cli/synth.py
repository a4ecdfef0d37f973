"""flysid synth: fly simulated plants, write the logs that a vehicle would have written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.output import check_target, say
from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.ingest.synth import Order
    from flysid.ingest.telemetry import Recording

Writer = tuple[str, Callable[["Recording"], bytes]]


def list_all(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    """Print plants, plans and formats, one `kind name` per line, and end."""
    if not wanted:
        return
    from flysid.ingest.plans import PLANS
    from flysid.ingest.synth import WRITERS
    from flysid.ingest.vehicles import VEHICLES

    for kind, names in (("plant", VEHICLES), ("plan", PLANS), ("format", WRITERS)):
        for name in names:
            click.echo(f"{kind}\t{name}")
    context.exit()


@click.command("synth")
@click.option("-o", "--output", type=click.Path(path_type=Path), required=True, help="Folder for the logs.")
@click.option("--plant", default="ardrone-linear", show_default=True, help="What flies.")
@click.option("--plan", default="mixed", show_default=True, help="What is flown; --list names all.")
@click.option("--duration", default=120.0, show_default=True, metavar="S", help="Seconds of each flight.")
@click.option("--noise", default=0.02, show_default=True, help="Velocity noise, m/s (one sigma).")
@click.option("--amplitude", default=1.0, show_default=True, help="Factor on the plan's amplitudes.")
@click.option("--seed", default=1, show_default=True, help="Same seed, same bytes.")
@click.option(
    "--format", "formats", multiple=True, metavar="NAME", help="Again for several.  [default: tlog]"
)
@click.option(
    "--dropout", "dropouts", multiple=True, metavar="START:LENGTH", help="The link is silent then, s."
)
@click.option(
    "--list",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=list_all,
    help="Name the plants, plans, formats.",
)
@click.option("--force", is_flag=True, help="Replace logs that exist.")
@click.option("-q", "--quiet", is_flag=True, help="Only paths and errors.")
def command(
    output: Path,
    formats: tuple[str, ...],
    dropouts: tuple[str, ...],
    force: bool,
    quiet: bool,
    **order: Any,
) -> None:
    """Fly simulated plants and write the logs that a vehicle would have written; prints their paths."""
    from flysid.ingest.synth import Order, flight_names

    writers = writers_named(formats or ("tlog",))
    asked = Order(
        plant=order["plant"],
        plan=order["plan"],
        duration_s=order["duration"],
        noise=order["noise"],
        seed=order["seed"],
        amplitude=order["amplitude"],
        dropouts_s=tuple(parse_dropout(text) for text in dropouts),
    )
    for name in flight_names(asked):
        for suffix, _ in writers:
            check_target(output / f"{name}{suffix}", force)
    make_folder(output)
    for path in write_flights(asked, output, writers, lambda text: say(text, quiet)):
        click.echo(path)


def write_flights(
    order: Order, folder: Path, writers: Sequence[Writer], tell: Callable[[str], None]
) -> list[Path]:
    """Fly the whole order; every log appears whole."""
    from flysid.flightwriter import write_atomically, writing_to
    from flysid.ingest.synth import flight_names, fly_one

    written = []
    for index, name in enumerate(flight_names(order)):
        tell(f"fly {name}: {order.duration_s:g} s")
        recording = fly_one(order, index)
        for suffix, encode in writers:
            path = folder / f"{name}{suffix}"
            with writing_to(path):
                write_atomically(path, encode(recording))
            written.append(path)
    return written


def writers_named(names: Sequence[str]) -> list[Writer]:
    """The writers of these formats, each once."""
    from flysid.ingest.synth import WRITERS

    for name in names:
        if name not in WRITERS:
            raise UsageError(f"no format {name!r} to write", hint="one of " + ", ".join(WRITERS))
    return [WRITERS[name] for name in dict.fromkeys(names)]


def parse_dropout(text: str) -> tuple[float, float]:
    """START:LENGTH in seconds."""
    try:
        start, length = (float(part) for part in text.split(":"))
    except ValueError:
        raise UsageError(f"no drop-out {text!r}", hint="START:LENGTH in seconds, e.g. 20:5") from None
    return start, length


def make_folder(folder: Path) -> None:
    """Create the folder for the logs."""
    from flysid.flightwriter import writing_to

    if folder.exists() and not folder.is_dir():
        raise UsageError("the target is not a folder", path=folder, hint="choose another with -o")
    with writing_to(folder):
        folder.mkdir(parents=True, exist_ok=True)
