"""`flysid studio [DATA]`: flysid in the browser, on this machine."""

from __future__ import annotations

import importlib.util
import signal
import time
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.bounds import ALARM_RATE
from flysid.cli.output import say
from flysid.cli.trust import Own
from flysid.errors import UsageError

if TYPE_CHECKING:
    from flysid.live.session import Session


@click.command("studio")
@click.argument("data", default="data", type=SOURCE)
@click.option(
    "--port",
    cls=Own,
    default=0,
    type=click.IntRange(0, 65535),
    metavar="N",
    help="Port on 127.0.0.1; a free one when not given.",
)
@click.option(
    "--runs",
    "runs",
    multiple=True,
    type=click.Path(path_type=Path),
    help="Also list the runs in this folder.",
)
@click.option("--open/--no-open", "show", cls=Own, default=True, show_default=True, help="Open the browser.")
@click.option(
    "--live",
    "links",
    cls=Own,
    multiple=True,
    metavar="LINK",
    help="Record this link and show it in real time.",
)
@click.option(
    "--watch", "run", type=click.Path(path_type=Path), help="With --live: a run's models beside it."
)
@click.option(
    "--false-alarms",
    default=0.1,
    type=ALARM_RATE,
    show_default=True,
    metavar="RATE",
    help="False alarms per hour of flight.",
)
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    help="With --live: the tlog.  [default: a new one in DATA.studio/recordings]",
)
def command(
    data: Path,
    port: int,
    runs: tuple[Path, ...],
    show: bool,
    links: tuple[str, ...],
    run: Path | None,
    false_alarms: float,
    output: Path | None,
) -> int:
    """Browse logs, choose, fit, judge and compare in the browser.

    DATA is an ingested folder, or a new one; the studio keeps its uploads, jobs and runs in DATA.studio.
    The server answers only this machine, at the address that it prints. Everything that the page does is a
    command, which it shows. Ctrl-C ends the server; a running fit continues, and the next studio finds it.

    With --live, a link is recorded (see 'flysid record') and drawn in real time. With --watch, the
    predictions of a run's models are drawn beside it, with alarms (see 'flysid watch'). This page is also
    served where the studio's packages are not installed.
    """
    is_installed = all(importlib.util.find_spec(name) is not None for name in ("starlette", "uvicorn"))
    if not is_installed and not links:
        raise UsageError("the studio is not installed", hint='pip install "flysid[studio]"')
    if not links and (run is not None or output is not None):
        raise UsageError("--watch and -o belong to --live", hint="--live udp:0.0.0.0:14550")
    from flysid.studio.folders import open_workspace

    workspace = open_workspace(data, runs)

    def ready(address: str) -> None:
        click.echo(address)
        say("Ctrl-C ends the server")

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # the server raises what ended it once more
    if not links:
        from flysid.studio.serve import serve

        serve(workspace, port, ready, show)
        return 0
    session = open_session(links, run, false_alarms, output or new_recording(workspace.folder / "recordings"))
    from flysid.cli.record import finish

    session.start()
    try:
        with suppress(KeyboardInterrupt):
            if is_installed:
                from flysid.studio.serve import serve

                serve(workspace, port, ready, show, session)
            else:
                from flysid.studio.live_server import serve_live

                say("the studio is not installed: the live page alone")
                serve_live(session, port, ready, show=show)
    finally:
        session.stop()

    for path in session.recording.parts.paths:
        click.echo(path)
    return finish(session.recording, quiet=False)


def new_recording(folder: Path) -> Path:
    """A name by the time of day, in a folder that exists."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / f"{time.strftime('%Y-%m-%dT%H%M%S')}.tlog"


def open_session(links: tuple[str, ...], run: Path | None, false_alarms: float, target: Path) -> Session:
    """Links to be recorded, with the watches of a run where one is given; not yet started."""
    from flysid.cli.record import open_links
    from flysid.cli.watch import calibrate, recipe_of
    from flysid.live.receiving import warm_up
    from flysid.live.recording import Recording
    from flysid.live.session import Session
    from flysid.validate.runs.run import open_run

    watches = []
    recipe = None
    if run is not None:
        fitted = open_run(run)
        recipe = recipe_of(fitted, "a link")
        say("calibrating on held-out flights")
        watches = calibrate(fitted, None, (), None, false_alarms)
    warm_up()
    recording = Recording(open_links(links, None, sends=False), target)
    for text in recording.receiver.warnings():
        say(text)
    return Session(recording, watches, recipe)
