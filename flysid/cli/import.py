"""`flysid import FILE --run RUN -o MODEL.json`: a linear model from elsewhere, as a model file."""

from __future__ import annotations

from pathlib import Path

import click

from flysid.cli.options import target_options
from flysid.cli.trust import Setting
from flysid.errors import UsageError


@click.command("import")
@click.argument("source", type=click.Path(path_type=Path))
@click.option(
    "--run",
    required=True,
    type=click.Path(path_type=Path),
    help="Run whose signals, units and sample time the model is converted to.",
)
@click.option("--channel", "-c", cls=Setting, default="", help="Of the run.")
@target_options("--out", "-o", replaced="file", required=True, help="Model file to write.")
def command(source: Path, run: Path, channel: str, out: Path) -> None:
    """Import a linear model from MATLAB or python-control (.mat, .m, .npz, .json).

    The result is a model file like any other: export it, plot it, or pass it to 'flysid validate --with'.
    Functions and FMUs are not imported; pass them to 'flysid validate --with' directly.
    """
    from flysid.outside.bring import bring
    from flysid.outside.like import Like
    from flysid.outside.simulator import Simulated
    from flysid.validate.runs.run import models_of, open_run

    opened = open_run(run)
    channels = {c.name: c for c in opened.channels}
    if channel not in channels and (channel or len(channels) > 1):
        what = f"no channel {channel!r}" if channel else f"{len(channels)} channels"
        raise UsageError(f"the run has {what}", hint="--channel " + ", or --channel ".join(channels))
    chosen = channels[channel] if channel else next(iter(channels.values()))
    like = Like.of(next(iter(models_of(opened, chosen).values())))
    model = bring(str(source), like)
    if isinstance(model, Simulated):
        raise UsageError(
            f"{model.simulator.words} is run where it is",
            hint=f"flysid validate {run} --with LABEL={source}",
        )
    model.save(out)
    click.echo(str(out))
