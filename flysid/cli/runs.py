"""`flysid runs [FOLDER...]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.output import align_columns, print_json, say

if TYPE_CHECKING:
    from flysid.validate.runs.history import RunChannel

HEADINGS = ("RECIPE", "CHANNEL", "HELD OUT", "RANK", "RUN", "LINEAR", "TS", "UNIT", "VERDICT", "FITTED (UTC)")


@click.command("runs")
@click.argument("folders", nargs=-1, type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def command(folders: tuple[Path, ...], as_json: bool) -> int:
    """List run folders and rank them by free-run error, channel by channel.

    Searches the given folders, or the current one. Runs are ranked only against runs judged on the same
    held-out data. A run that cannot be read is named and left out (exit code 3). Results are cached in
    .flysid-runs.parquet in the folder; a run is read again only if it has changed.
    """
    from flysid.validate.runs.history import ranked
    from flysid.validate.runs.runindex import list_runs

    channels, damaged = list_runs(folders or (Path(),))
    order = ranked(channels)
    if as_json:
        print_json({"runs": [c.to_dict() for c in order]})
    elif order:
        click.echo("\n".join(align_columns([HEADINGS, *(row(c) for c in order)])))
    for reason in damaged:
        say(f"left out: {reason}")
    return 3 if damaged else 0


def linear_text(channel: RunChannel) -> str:
    """ "0.163 arx": the baseline's error and its name."""
    from flysid.showing import number

    rmse = channel.rmse.get(channel.baseline)
    return number(rmse) if rmse is None else f"{number(rmse)} {channel.baseline}"


def fuzzy_text(channel: RunChannel) -> str:
    """ "0.035", or "0.035 ts_ss" where it is not the usual one."""
    from flysid.model.structures import leaders
    from flysid.showing import number

    label = channel.fuzzy
    return number(channel.rmse.get(label or "")) + (f" {label}" if label not in (None, leaders()[0]) else "")


def row(channel: RunChannel) -> tuple[str, ...]:
    """One channel of a run as the cells of a table; the errors are free-run RMSE on the held-out part."""

    return (
        channel.recipe,
        channel.channel,
        channel.held_out[:8] or "-",
        "-" if channel.rank is None else str(channel.rank),
        channel.folder,
        linear_text(channel),
        fuzzy_text(channel),
        channel.unit,
        channel.verdict,
        channel.fitted_at[:16].replace("T", " "),
    )
