"""What every verb does alike: words to stderr, and targets that are not overwritten."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.errors import UsageError
from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.showing import align, counted, first_of, fold

if TYPE_CHECKING:
    from flysid.ingest.lake.finding import PassedOver
    from flysid.validate.show.finish import Finished

REASONS_SHOWN = 5
NAMES_SHOWN = 3
FORMS = {"json": "JSON", "markdown": "Markdown", "csv": "CSV"}


class ExitCode(IntEnum):
    """What a verb says beside 0, 1 (failed), 2 (wrongly called) and 75 (try again)."""

    LOSSES = 3  # done, but something was lost or left out
    CHECK_FAILED = 4  # something was asked of a result, and does not hold
    DISK_REFUSED = 5
    ALARM = 6


_LOSSES = "flysid.losses"
"""Of click's notes on a call: whether what the verb read lost something."""


def note_losses() -> None:
    """That a log which this call reads lost something, or could not be read: the exit code will tell."""
    context = click.get_current_context(silent=True)
    if context is not None:
        context.meta[_LOSSES] = True


def final_code(code: int | None) -> int | None:
    """The exit code of a verb that ends with `code`: LOSSES in place of 0 after `note_losses`."""
    return code or (ExitCode.LOSSES if click.get_current_context().meta.get(_LOSSES) else code)


def align_columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of cells as lines with aligned columns, control characters removed."""
    return align([[one_line(cell) for cell in cells] for cells in rows])


def shorten(name: str, longest: int = 18) -> str:
    """A name with its middle left out where it is too long."""
    half = (longest - 1) // 2
    return name if len(name) <= longest else f"{name[:half]}…{name[-half:]}"


def say(text: str, quiet: bool = False) -> None:
    """A line for people, on stderr."""
    if not quiet:
        click.echo(one_line(text), err=True)


def print_lines(lines: Iterable[str]) -> None:
    """Lines for people, on stdout, each within the width."""
    click.echo("\n".join(fold(one_line(line)) for line in lines))


def print_json(body: object) -> None:
    """A document for programs, on stdout."""
    click.echo(json.dumps(body, indent=1, allow_nan=False))


def explain(text: str, quiet: bool = False) -> None:
    """A sentence or two for people, on stderr, within the width."""
    if not quiet:
        click.echo(fold(one_line(text)), err=True)


def say_left_out(channel: str, why: str, done: str = "skipped") -> None:
    """That a channel was skipped or not judged, and why; a reason may begin with the channel's name."""
    explain(f"channel {channel} {done}: {why.removeprefix(f'channel {channel!r}: ')}")


def say_drawn(what: str, path: Path, draw: Callable[[], object], quiet: bool = False) -> None:
    """Draw a picture beside what was printed, and say where it is; or what broke."""

    def done() -> bool:
        draw()
        return True

    if extra(Extra.PLOT, done, False):
        say(f"{what}: {path}", quiet)


def say_passed_over(files: Sequence[PassedOver], quiet: bool) -> None:
    """One line about the files that are not logs: how many of each kind, and the first of them by name."""
    if not files:
        return
    kinds: dict[str, list[str]] = {}
    for file in files:
        kinds.setdefault(file.kind, []).append(file.path.name)
    told = [f"{kind} ({len(names)}): {first_of(names, NAMES_SHOWN)}" for kind, names in kinds.items()]
    logs = "is not a log" if len(files) == 1 else "are not logs"
    explain(f"ignored {counted(len(files), 'file')} that {logs}: {'; '.join(told)}", quiet)


def cores() -> int:
    """Processors that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on every system
        return os.cpu_count() or 1


def check_target(path: Path, force: bool, *, makes_folders: bool = True) -> None:
    """What can be known wrong of a target before the work that it is for.

    `makes_folders`: whether the folders on the way to it are made.
    Raises UsageError: it exists and may not be replaced. Raises WriteError: nothing can be written there.
    """
    from flysid.files import check_place

    if os.path.lexists(path) and not force:
        raise UsageError("the target exists", path=path, hint="choose another with -o, or add --force")
    check_place(path, makes_folders=makes_folders)


def chosen_form(**flags: bool) -> str:
    """The requested form, "table" where none; raises UsageError where there is more than one."""
    asked = [name for name in FORMS if flags[name]]
    if len(asked) > 1:
        raise UsageError(
            f"only one form can be printed, not {' and '.join(asked)}",
            hint="run it twice with different -o, or read report.json",
        )
    return asked[0] if asked else "table"


def end_comparison(finished: Finished, condition: str | None, report: Path | None, quiet: bool) -> int:
    """The words that end a comparison, and the exit code: 4 a check failed, 3 a channel was not judged."""
    for name, why in finished.found["skipped"].items():
        say_left_out(name, why, "not judged")
    if report is not None:
        say(f"report: {report}", quiet)
    failed = finished.violations(condition) if condition is not None else {}
    if failed:
        where = f" on {', '.join(failed)}" if len(failed) < len(finished.found["channels"]) else ""
        say(f"check failed{where}: {condition}")
        for name, why in failed.items():
            if why:
                say(f"{name}: {why}: a channel that cannot be judged counts as failed")
        return ExitCode.CHECK_FAILED
    return 3 if finished.unjudged else 0
