"""`flysid referee LOG`."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

import flysid


@click.command("referee")
@click.argument("log", type=click.Path(path_type=Path))
def command(log: Path) -> None:
    """Count the bounces in a log: turns of the height from falling to rising."""
    height = np.asarray(flysid.read(log)["ball"]["height"])
    moves = np.sign(np.diff(height))
    click.echo(f"{int(np.sum((moves[:-1] < 0) & (moves[1:] > 0)))} bounces")
