"""`flysid scrub LOG -o OUT`."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import force_option, gather
from flysid.cli.output import ExitCode, explain, say
from flysid.cli.source import format_option
from flysid.errors import FormatError
from flysid.escaping import one_line
from flysid.progress import tell

if TYPE_CHECKING:
    from flysid.ingest.formats.common.scrub_rules import Gps
    from flysid.ingest.formats.scrubbing import Scrubbed


@click.command("scrub")
@click.argument("log", type=SOURCE)
@click.option("--output", "-o", required=True, type=click.Path(path_type=Path), help="The copy to write.")
@click.option(
    "--gps",
    type=click.Choice(["shift", "remove"]),
    default="shift",
    show_default=True,
    help="Move all positions to a neutral place, keeping the motion; or empty them.",
)
@gather("reading", Reading, format_option)
@force_option("copy")
@click.option("--json", "as_json", is_flag=True, help="Print what was removed as JSON.")
@click.option("--quiet", "-q", is_flag=True)
def command(
    log: Path, output: Path, gps: Gps, reading: Reading, force: bool, as_json: bool, quiet: bool
) -> int:
    """Write a copy of a log without private data, in the same format.

    Positions are moved or removed. Serial numbers, names, passwords, paths, texts with identifiers and
    embedded files are removed. Unreadable bytes are left out. Prints what was removed, and where. Exit code
    3: something could not be read.
    """
    from flysid.ingest.formats.common.scrub_rules import UNREADABLE
    from flysid.ingest.formats.scrubbing import KEPT, scrub_log

    work = partial(scrub_log, out=output, gps=gps, force=force, limits=reading.limits)
    with Display(quiet=quiet).shown():
        tell("scrubbing", log=log.name)
        done = apart(work, log)
    click.echo(as_json_text(done, output) if as_json else table(done))
    for note in done.notes:
        explain(note, quiet)
    explain(KEPT, quiet)
    say(f"written: {output}", quiet)
    return ExitCode.LOSSES if any(what == UNREADABLE for what, _ in done.removed) else 0


def apart(work: Callable[[Path], Scrubbed], log: Path) -> Scrubbed:
    """What `work` makes of a log in a process of its own: a log that is cut meanwhile ends the reader.

    Raises FormatError: the process ended, or the log cannot be read. Besides, what `work` raises.
    """
    from flysid.ingest.lake.workers import Bounds, Lost, read_bounded

    bounds = Bounds(memory_bytes=None, seconds=None)
    ((_, outcome),) = read_bounded(work, [log], 1, bounds)
    if isinstance(outcome, Lost):
        hint = "once it is no longer written, try again" if outcome.has_ended else outcome.error.hint
        raise FormatError(outcome.error.message, path=log, byte=outcome.error.byte, hint=hint)
    return outcome


def table(done: Scrubbed) -> str:
    """What was removed: kind, number of fields, where."""
    if not done.removed:
        return "found nothing to remove"
    rows = [(what, f"{n:,}", one_line(where)) for (what, where), n in done.removed.items()]
    rows.insert(0, ("REMOVED", "COUNT", "WHERE"))
    first, second = (max(len(row[k]) for row in rows) for k in (0, 1))
    return "\n".join(f"{what:<{first}}  {count:>{second}}  {where}" for what, count, where in rows)


def as_json_text(done: Scrubbed, output: Path) -> str:
    removed = [{"what": what, "where": where, "count": n} for (what, where), n in done.removed.items()]
    document = {"output": str(output), "format": done.format, "removed": removed, "notes": list(done.notes)}
    return json.dumps(document, indent=1)
