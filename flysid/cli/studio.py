"""`flysid studio [DATA]`: flysid in the browser, on this machine."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import click

from flysid.cli.output import say
from flysid.errors import UsageError


@click.command("studio")
@click.argument("data", default="data", type=click.Path(path_type=Path))
@click.option("--port", default=0, metavar="N", help="Port on 127.0.0.1; a free one when not given.")
@click.option(
    "--runs", "runs", multiple=True, type=click.Path(path_type=Path), help="Also list runs in here."
)
@click.option("--open/--no-open", "show", default=True, show_default=True, help="Open the browser.")
def command(data: Path, port: int, runs: tuple[Path, ...], show: bool) -> None:
    """See logs, choose, fit, judge and compare in the browser.

    DATA is an ingested folder, or a new one; the studio keeps its uploads, jobs and runs in DATA.studio.
    The server answers on this machine alone, to the address that it prints. Whatever the page does is a
    command that it shows. Ctrl-C ends the server; a fit that runs goes on, and the next studio finds it.

    \b
    flysid studio
    flysid studio data --port 8765 --no-open
    """
    if importlib.util.find_spec("starlette") is None or importlib.util.find_spec("uvicorn") is None:
        raise UsageError("the studio is not installed", hint='pip install "flysid[studio]"')
    from flysid.studio.places import open_workspace
    from flysid.studio.serve import serve

    workspace = open_workspace(data, runs)

    def ready(address: str) -> None:
        click.echo(address)
        say("Ctrl-C ends the server")

    serve(workspace, port, ready, show)
