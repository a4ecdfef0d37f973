"""The command line: one small module per verb, imported only when that verb is run.

The only place that prints, catches FlysidError and chooses exit codes: 0 done, 1 failed, 2 wrong usage
or configuration, 3 done but data was lost or files were skipped, 4 a check that the user asked for
failed, 5 a disk refused what `record` received, 6 `watch --fail` has
alarmed, 75 a store or a cluster did not answer (run it again), 130 interrupted. stdout carries data
only; everything else
goes to stderr.
"""

from __future__ import annotations

import sys
from functools import cache
from pathlib import Path

import click

import flysid
from flysid.cli.config import take_settings
from flysid.cli.lazy import LazyVerbs
from flysid.cli.output import explain, printable
from flysid.errors import FlysidError
from flysid.extras import hearing
from flysid.showing import WIDTH
from flysid.surroundings import ignore_matplotlib_style, keep_working_folder_out, refuse_numba_settings

LESS_MEMORY = "close other programs; where the verb has them, --jobs 1 and a smaller --memory take less"
VERBS = {
    "compare": "Compare the models of two runs on flights that neither has trained on.",
    "demo": "Simulate flights, ingest, fit and validate them; open the report.",
    "design": "Robust controller gains over all good models of a run, beside the present ones.",
    "doctor": "Check logs: contents, losses, and what to log next time.",
    "export": "Export a flight or a model (C99, FMU, MATLAB) to other programs.",
    "fleet": "Work with many logs of many vehicles: catalogue, upkeep, models.",
    "fit": "Fit linear and Takagi-Sugeno models to flights.",
    "fly": "Test a design's gains on many simulated vehicles, beside the present ones.",
    "gains": "Crossover, margins, bandwidth and noise of the gains in a log.",
    "import": "Import a linear model from MATLAB or python-control.",
    "ingest": "Read flight logs into a folder of typed Parquet tables.",
    "ls": "List flights, and what they can identify.",
    "plan": "Plan the next flight, and predict the accuracy of its results.",
    "plot": "Plot fields of a log over time, with modes and messages.",
    "recipes": "List the recipes, or explain one; which ones fit a log.",
    "record": "Record MAVLink links to a tlog, with losses counted.",
    "reproduce": "Reproduce a paper's results and compare them.",
    "runs": "List run folders and rank them by free-run error.",
    "scrub": "Write a copy of a log without positions, serial numbers and names.",
    "show": "Show a flight or one of its streams: fields, units, rates, losses.",
    "step": "Estimate step responses from ordinary flight; compare two logs.",
    "studio": "Browse logs, fit, judge and compare in the browser.",
    "synth": "Simulate flights and write the logs that the vehicle would have written.",
    "tf": "Identify transfer functions with intervals, and measure the frequency response.",
    "validate": "Compare fitted models on held-out segments; write the report.",
    "watch": "Raise an alarm when a vehicle no longer behaves as a run's models predict.",
}

STEPS = {
    "Look": ("doctor", "show", "plot", "ls", "recipes", "studio"),
    "Prepare": ("ingest", "record", "synth", "scrub", "plan"),
    "Fit": ("fit", "tf", "step"),
    "Judge": ("validate", "compare", "runs", "gains", "design", "fly", "watch", "reproduce"),
    "Share": ("export", "import"),
    "Many": ("fleet",),
    "Try": ("demo",),
}
"""What a user does, in this order, and with which verbs."""


@click.group(
    cls=LazyVerbs,
    verbs=VERBS,
    modules="flysid.cli.{}",
    steps=STEPS,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "auto_envvar_prefix": "FLYSID",
        "max_content_width": WIDTH,
    },
    epilog="'flysid VERB --help' has examples.",
)
@click.version_option(flysid.__version__, prog_name="flysid")
@click.pass_context
def root(ctx: click.Context) -> None:
    """Flight logs in, trustworthy models out."""
    ctx.with_resource(hearing(cache(explain)))  # each sentence once
    refuse_numba_settings(Path.cwd())
    ignore_matplotlib_style(Path.cwd())
    take_settings(ctx)


def report_error(error: FlysidError) -> None:
    """What, where, what to try; on stderr."""
    click.secho(f"error: {printable(error.message)}", fg="red", err=True)
    if error.where:
        click.echo(f"  where: {printable(error.where)}", err=True)
    if error.hint:
        click.echo(f"  try:   {printable(error.hint)}", err=True)


def main() -> None:
    """Entry point of the `flysid` command."""
    keep_working_folder_out()
    try:
        code = root.main(prog_name="flysid", standalone_mode=False)
    except FlysidError as error:
        report_error(error)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted; it is safe to run the same command again", err=True)
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        report_error(FlysidError(f"operating system error: {error.strerror or error}", path=error.filename))
        sys.exit(1)
    except MemoryError:
        report_error(FlysidError("not enough memory", hint=LESS_MEMORY))
        sys.exit(1)
    sys.exit(code if isinstance(code, int) else 0)
