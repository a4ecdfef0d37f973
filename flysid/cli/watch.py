"""flysid watch: a vehicle beside its model, live or afterwards."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli import complete
from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import ALARM_RATE, POSITIVE
from flysid.cli.losses import say_damage
from flysid.cli.options import gather
from flysid.cli.output import ExitCode, check_target, print_lines, say
from flysid.cli.trust import Own, ProjectFile, Setting
from flysid.cli.vehicleexport import is_vehicle
from flysid.errors import DataError, UsageError
from flysid.escaping import one_line
from flysid.showing import counted, one_of
from flysid.surroundings import environment_of_the_user

if TYPE_CHECKING:
    from flysid.ingest.align.recipe import Recipe
    from flysid.live.watching import ChannelWatch, Notice
    from flysid.validate.runs.run import Run

KINDS = ("udp:", "udpout:", "tcp:", "serial:")


@dataclass(frozen=True)
class Watched:
    """Which channels are watched, by which model, how strictly."""

    false_alarms: float
    label: str | None
    channels: tuple[str, ...]
    data: Path | None


@dataclass(frozen=True)
class Reception:
    """How a link is received; a log has no use for any of it."""

    output: Path | None
    heartbeat: bool
    seconds: float | None


watched_options = gather(
    "watched",
    Watched,
    click.option(
        "--false-alarms",
        default=0.1,
        type=ALARM_RATE,
        show_default=True,
        metavar="RATE",
        help="False alarms per hour of flight, over all channels.",
    ),
    click.option(
        "--model", "label", cls=Setting, help="ts, arx, ...  [default: each channel's best linear one]"
    ),
    click.option("--channel", "channels", cls=Setting, multiple=True, help="Only this channel; repeatable."),
    click.option("--data", type=SOURCE, help="The run's data, if it has moved."),
)

reception_options = gather(
    "reception",
    Reception,
    click.option(
        "-o", "--output", type=click.Path(path_type=Path), help="Also record the link to this file."
    ),
    click.option("--heartbeat", cls=Own, is_flag=True, help="Send heartbeats; otherwise nothing is sent."),
    click.option("--for", "seconds", type=POSITIVE, metavar="S", help="Stop after this many seconds."),
)


@click.command("watch")
@click.argument("run", type=click.Path(path_type=Path))
@click.argument("source", metavar="LINK|LOG")
@watched_options
@reception_options
@click.option(
    "--exec",
    "hook",
    cls=Own,
    metavar="COMMAND",
    help="Command to run at every event; it reads the event as JSON from stdin.",
)
@click.option(
    "--recipe",
    "-r",
    cls=ProjectFile,
    default="sixdof",
    show_default=True,
    shell_complete=complete.recipes,
    help="Of a vehicle: where its log keeps motors and instruments.",
)
@click.option("--fail", is_flag=True, help="Exit with 6 if there was an alarm, or a vehicle changed.")
@click.option("--json", "as_json", is_flag=True, help="Print events as JSON lines.")
@click.option("-q", "--quiet", is_flag=True, help="Only events and errors.")
def command(
    run: Path,
    source: str,
    watched: Watched,
    reception: Reception,
    hook: str | None,
    recipe: str,
    fail: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Raise an alarm when a vehicle no longer behaves as a RUN's models predict, on a LINK or in a LOG.

    Thresholds come from the run's held-out flights. An input outside the training range is shown, but is
    not an alarm. The vehicle is never commanded. Where RUN is what 'flysid vehicle -o' wrote, the LOG is
    fitted anew, and the answer names the motor, mass or drag that has changed.
    """
    from flysid.validate.runs.run import open_run

    if is_vehicle(run):
        return watch_vehicle(run, Path(source), recipe, fail=fail, as_json=as_json)

    opened = open_run(run)
    check_watch(opened, source, watched, hook)
    if not is_link(source) and reception != Reception(None, False, None):
        raise UsageError("-o, --heartbeat and --for are for a LINK", path=source, hint="leave them out")
    if reception.output is not None:
        check_target(reception.output, force=False)
    say("calibrating on held-out flights", quiet)
    watches = calibrate(opened, watched.data, watched.channels, watched.label, watched.false_alarms)
    for one in watches:
        for text in one.visibility:
            say(text, quiet)
    alarms: list[Notice] = []

    def tell(event: Notice) -> None:
        if event.kind == "alarm":
            alarms.append(event)
        click.echo(json.dumps(event.to_dict()) if as_json else line(event))
        if hook:
            call(hook, event)

    if is_link(source):
        follow(opened, watches, source, reception, tell)
    else:
        look_back(opened, watches, Path(source), tell, quiet)
    say(counted(len(alarms), "alarm"), quiet)
    return ExitCode.ALARM if fail and alarms else 0


def is_link(source: str) -> bool:
    """Whether a link is watched, and no log."""
    return source.startswith(KINDS)


def check_watch(run: Run, source: str, watched: Watched, hook: str | None) -> None:
    """What can be known wrong before flights are read.

    Raises UsageError: the run has no such channel or model; no such log; no such command.
    """
    if is_link(source):
        from flysid.live.links import parse_link

        parse_link(source)
    run.check_channels(watched.channels)
    chosen = (c for c in run.channels if c.name in (watched.channels or (c.name,)))
    known = dict.fromkeys(m for c in chosen for m in c.models)
    label = watched.label
    if label is not None and label not in known:
        raise UsageError(f"the run has no model {label!r}", path=run.folder, hint=one_of(list(known), label))
    if not is_link(source) and not Path(source).is_file():
        links = ", ".join(f"{kind}..." for kind in KINDS)
        raise UsageError("no such log", path=source, hint=f"check its name and folder; links are {links}")
    if hook and shutil.which((shlex.split(hook) or [""])[0]) is None:
        raise UsageError(f"--exec {hook!r} names no command", hint="check its name, or give its whole path")


def calibrate(
    run: Run, data: Path | None, channels: tuple[str, ...], label: str | None, false_alarms: float
) -> list[ChannelWatch]:
    """The watches of the chosen channels; says which cannot be watched. Raises where none can."""
    from flysid.live.watching import watches_of
    from flysid.validate.runs.run import held_out

    held = [h for h in held_out(run, data) if not channels or h.channel.name in channels]
    watches, skipped = watches_of(held, label, false_alarms)
    for name, why in skipped.items():
        say(f"{name} is not watched: {why}")
    if not watches:
        raise DataError(
            "no channel can be watched, for the reasons above", hint="what they name", path=run.folder
        )
    return watches


def recipe_of(run: Run, source: str) -> Recipe:
    """How a run's channels are read from a log or a link; raises UsageError where the run does not say."""
    from flysid.ingest.align.recipe import load_recipe
    from flysid.validate.runs.run import RECIPE_FILE, run_file

    if not run.recipe:
        raise UsageError(
            f"this run was fitted to a dataset file: it does not say how to read {source}", path=run.folder
        )
    return load_recipe(run_file(run.folder, RECIPE_FILE))


def look_back(
    run: Run, watches: list[ChannelWatch], log: Path, tell: Callable[[Notice], None], quiet: bool
) -> None:
    """All events of a log, in the order of time."""
    import flysid
    from flysid.ingest.align.align import segments_of

    recipe = recipe_of(run, "a log")
    flight = flysid.read(log)
    say_damage(log, flight.damage)
    events = []
    for one in watches:
        report, segments = segments_of(flight, recipe, one.name, one.model.dt_s)
        if not segments:
            say(f"{one.name} is not in {log.name}: {report.reason or 'no stretch is long enough'}")
        seconds = sum(map(len, segments)) * one.model.dt_s
        say(f"{one.name}: {seconds:.0f} s looked at", quiet)
        events += [event for segment in segments for event in one.run(segment)]
    for event in sorted(events, key=lambda e: (e.flight, e.time_s)):
        tell(event)


def follow(
    run: Run,
    watches: list[ChannelWatch],
    link: str,
    reception: Reception,
    tell: Callable[[Notice], None],
) -> None:
    """Watch a link until interrupted, or the time is over."""
    from flysid.cli.record import run as record
    from flysid.live.following import WATCH_NAP_S, Follower
    from flysid.live.links import open_link
    from flysid.live.receiving import Receiver, warm_up
    from flysid.live.recording import Recording, heartbeat_of

    follower = Follower(watches, recipe_of(run, "a link"), tell)
    warm_up()
    opened = open_link(link, sends=reception.heartbeat)
    stop = threading.Event()
    thread = threading.Thread(target=follower.run, args=(stop,), name="watch", daemon=True)
    thread.start()
    try:
        if reception.output is not None:
            recording = Recording(
                [opened], reception.output, heartbeat=reception.heartbeat, listener=follower.listen
            )
            record(recording, reception.seconds, True)
        else:
            beat = heartbeat_of(None) if reception.heartbeat else None
            receiver = Receiver([opened], follower.listen, heartbeat=beat, nap_s=WATCH_NAP_S)
            receive(receiver.run, reception.seconds)
            receiver.close()
    finally:
        stop.set()
        thread.join()


def receive(run: Callable[[threading.Event], None], seconds: float | None) -> None:
    """Run until interrupted, or the time is over."""
    over = threading.Event()
    thread = threading.Thread(target=run, args=(over,), name="receive", daemon=True)
    thread.start()
    until = None if seconds is None else time.monotonic() + seconds
    with suppress(KeyboardInterrupt):
        while thread.is_alive() and (until is None or time.monotonic() < until):
            time.sleep(0.1)
    over.set()
    thread.join()


def line(event: Notice) -> str:
    """An event for people: when, in which flight, and what."""
    where = f"{event.flight} " if event.flight else ""
    mark = "ALARM " if event.kind == "alarm" else ""
    return one_line(f"{where}{event.time_s:.2f} s  {mark}{event.text}")


def call(hook: str, event: Notice) -> None:
    """Start the user's command with the event on its stdin; it runs beside us."""
    try:
        process = subprocess.Popen(
            shlex.split(hook), stdin=subprocess.PIPE, start_new_session=True, env=environment_of_the_user()
        )
        assert process.stdin is not None
        with suppress(BrokenPipeError), process.stdin as pipe:  # it need not read what it is given
            pipe.write(json.dumps(event.to_dict()).encode() + b"\n")
    except (OSError, ValueError) as error:
        say(f"--exec {hook!r} could not be run: {error}")


def watch_vehicle(folder: Path, log: Path, recipe: str, *, fail: bool, as_json: bool) -> int:
    """Print what has changed; the verb's exit code.

    Raises UsageError: no such log; another number of motors. Raises StoreError: no vehicle. Raises DataError:
    nothing flies.
    """
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.align.signals import FlightLog
    from flysid.ingest.align.vehicle_channel import vehicle_data
    from flysid.ingest.formats.registry import read
    from flysid.sixdof.changes import changes_since
    from flysid.sixdof.fitted import load_vehicle

    if not log.is_file():
        raise UsageError("no such log", path=log, hint="a vehicle is watched in a log, not on a link")
    vehicle = load_vehicle(folder)
    flight = read(log)
    say_damage(log, flight.damage)
    data = vehicle_data([FlightLog(flight)], load_recipe(recipe)).dataset
    found = changes_since(vehicle, data)
    if as_json:
        click.echo(json.dumps(found.to_dict()))
    else:
        print_lines(found.lines())
    return ExitCode.ALARM if fail and found.found else 0
