"""`flysid design LOG...`: gains and D filters of rate loops for the next flight, within a factor of two."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.output import print_json, say
from flysid.cli.predict import describe_forecast
from flysid.cli.source import flights_of_one_vehicle
from flysid.escaping import one_line
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.loops.gain_bounds import RateBounds
    from flysid.loops.proposal import Proposal

AXES = ("roll", "pitch", "yaw")
OLD, NEW, DOCUMENT = "old", "new", "design.json"


def design_rates(
    source: Path,
    axes: Sequence[str],
    bounds: RateBounds,
    selection: Selection,
    reading: Reading,
    out: Path | None,
    *,
    as_json: bool,
    display: Display,
) -> int:
    """Print a proposal, and write its files; exit code 3 where no axis has one.

    Raises UsageError: no such log, several vehicles, or a folder that is there.
    """
    from flysid.design.firmware import SAFETY
    from flysid.loops.proposal import propose

    with display.shown(), flights_of_one_vehicle(source, reading, selection) as chosen:
        found = propose(chosen.logs, axes or AXES, bounds)
    if as_json:
        print_json(found.to_dict())
    else:
        for one in found.axes:
            click.echo("\n".join(fold(one_line(line)) for line in describe_forecast(one)) + "\n")
        for angle in found.angles:
            click.echo(one_line(angle.line()))
        click.echo("\n".join(_stated(found.new, found)))
    for axis, why in found.refused.items():
        say(f"{axis}: refused: {why.message}. Try: {why.hint}")
    if out is not None and found.new:
        _write(found, out, SAFETY)
    if found.new and not as_json:
        say(SAFETY)
    return 0 if found.new else 3


def _stated(settings: Mapping[str, str], found: Proposal) -> list[str]:
    """Lines of a command line, or parameters."""
    if not found.command_line:
        return [f"{name} {value}" for name, value in settings.items()]
    return [*(f"set {name} = {value}" for name, value in settings.items()), *(["save"] if settings else [])]


def _write(found: Proposal, out: Path, safety: str) -> None:
    from flysid.design.designed import RATE_FORMAT
    from flysid.files import replacing_folder

    end = "txt" if found.command_line else "param"
    heads = {OLD: "The settings before the design: the way back.", NEW: "For the next flight only."}
    with replacing_folder(out) as place:
        for name, settings in ((OLD, found.old), (NEW, found.new)):
            lines = [f"# {heads[name]}", *(f"# {line}" for line in fold(safety).split("\n"))]
            text = "\n".join([*lines, *_stated(settings, found)]) + "\n"
            (place / f"{name}.{end}").write_text(text, "utf-8")
        document = {"format": RATE_FORMAT, "version": 1, "safety": safety} | found.to_dict()
        (place / DOCUMENT).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", "utf-8")
    say(f"written: {out}: {NEW}.{end} for the next flight, {OLD}.{end} for the way back")
