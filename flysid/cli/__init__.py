"""The command line: one small module per verb, imported only when that verb is run.

The only place that prints, catches FlysidError and chooses exit codes: 0 done, 1 failed, 2 wrong usage
or configuration, 3 done, but a log that this call read lost data or was
skipped, or something in question could not be answered, 4 a check that the user asked for
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
from flysid.cli.output import explain, final_code
from flysid.cli.verbs import ENTRY_POINTS, VERBS
from flysid.errors import FlysidError
from flysid.escaping import one_line
from flysid.extras import hearing
from flysid.showing import WIDTH
from flysid.surroundings import ignore_matplotlib_style, keep_working_folder_out, refuse_numba_settings

LESS_MEMORY = "close other programs; where the verb has them, --jobs 1 and a smaller --memory take less"


@click.group(
    cls=LazyVerbs,
    verbs=VERBS,
    modules="flysid.cli.{}:command",
    group=ENTRY_POINTS,
    of_a_file="review",
    context_settings={
        "help_option_names": ["-h", "--help"],
        "auto_envvar_prefix": "FLYSID",
        "max_content_width": WIDTH,
    },
    epilog="'flysid VERB --help' has examples. Exit code 3 of every verb: it read a log that lost data.",
)
@click.version_option(flysid.__version__, prog_name="flysid")
@click.pass_context
def root(ctx: click.Context) -> None:
    """Flight logs in, trustworthy models out."""
    ctx.with_resource(hearing(cache(explain)))  # each sentence once
    refuse_numba_settings(Path.cwd())
    ignore_matplotlib_style(Path.cwd())
    take_settings(ctx)


root.result_callback()(final_code)


def report_error(error: FlysidError) -> None:
    """What, where, what to try; on stderr."""
    click.secho(f"error: {one_line(error.message)}", fg="red", err=True)
    if error.where:
        click.echo(f"  where: {one_line(error.where)}", err=True)
    if error.hint:
        click.echo(f"  try:   {one_line(error.hint)}", err=True)


def main() -> None:
    """Entry point of the `flysid` command."""
    keep_working_folder_out()
    try:
        code = root.main(prog_name="flysid", standalone_mode=False)
    except FlysidError as error:
        report_error(error)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        shown = "\n".join(map(one_line, error.format_message().split("\n")))  # file names come from strangers
        click.UsageError(shown, getattr(error, "ctx", None)).show()
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
