"""`flysid fleet changed LAKE --recipe R`: which vehicles no longer fly as they did, or not as the others."""

from __future__ import annotations

import json
import shlex
import sys
from datetime import UTC, datetime
from pathlib import Path

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.fleet_data import FleetData, fleet_data_options
from flysid.cli.options import force_option
from flysid.cli.output import ExitCode, check_target, say
from flysid.cli.trust import Setting
from flysid.errors import UsageError
from flysid.showing import counted

PAGE = "report.html"
DOCUMENT = "report.json"


def _day(_ctx: click.Context, _param: click.Parameter, value: str) -> int | None:
    """UTC in ns of a date, or of a time where one is given."""
    if not value:
        return None
    try:
        at = datetime.fromisoformat(value)
    except ValueError:
        raise click.BadParameter("a date, e.g. 2026-05-03") from None
    at = at if at.tzinfo else at.replace(tzinfo=UTC)
    return int(at.timestamp()) * 10**9


@click.command("changed")
@fleet_data_options
@click.option("--output", "-o", type=click.Path(path_type=Path), help="Folder of the page.  [LAKE/changed]")
@click.option(
    "--before", "before_ns", cls=Setting, default="", metavar="DATE", callback=_day,
    help="Compare flights before this date (UTC) with later ones.",
)  # fmt: skip
@click.option(
    "--halves", is_flag=True, help="Compare each vehicle's first half of flights with its second (default)."
)
@click.option(
    "--rate", default=0.05, show_default=True, type=click.FloatRange(0.0, 0.5, min_open=True),
    help="Largest share of false positives among the flagged.",
)  # fmt: skip
@click.option(
    "--runs", type=click.Path(path_type=Path), help="Output of 'fleet fit --ts', whose reports are linked."
)
@click.option(
    "--fail-if", type=click.Choice(["changed", "unlike"]), help="Exit with 4 if a vehicle is flagged."
)
@force_option("page")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
@progress_options
def command(
    data: FleetData,
    output: Path | None,
    before_ns: int | None,
    halves: bool,
    rate: float,
    runs: Path | None,
    fail_if: str | None,
    force: bool,
    as_json: bool,
    display: Display,
) -> int:
    """Find the vehicles of a fleet that have changed, and those that differ from the others.

    Compares gain and phase of each channel in the band that the flights determine. Writes report.html and
    report.json, and prints one line per finding. Flights are read once; a second call with the same recipe
    reads none. Exit code 4: --fail-if holds.
    """
    if halves and before_ns is not None:
        raise UsageError("--halves and --before are mutually exclusive", hint="leave out one of them")
    if runs is not None and not runs.is_dir():
        raise UsageError(
            "no such folder", path=runs, hint="of runs of the vehicles: flysid fleet fit --ts -o DIR"
        )
    target = output or data.folder / "changed"
    check_target(target, force or (output is None and (target / DOCUMENT).is_file()))
    from flysid.files import write_atomically, writing_to
    from flysid.fleet.models.changed import compare
    from flysid.fleet.models.changed_page import headline, write_fleet_page
    from flysid.ingest.align.recipe import load_recipe
    from flysid.ingest.lake.lake import open as open_lake

    opened = open_lake(data.folder)
    asked = load_recipe(data.recipe)
    with data.engine(opened, display.quiet) as cluster, display.shown():
        gathered = data.gather(opened, asked, cluster, display.quiet)
        compared = compare(gathered, asked, opened.facts, rate, before_ns)
    document = json.dumps(compared.document(), indent=1, allow_nan=False) + "\n"
    reports = _reports(runs, list(compared.names)) if runs else {}
    words = shlex.join(["flysid", *sys.argv[1:]])
    page = write_fleet_page(target / PAGE, compared, words, reports)
    with writing_to(target / DOCUMENT):
        write_atomically(target / DOCUMENT, document.encode())
    if as_json:
        click.echo(document, nl=False)
    else:
        for found in compared.findings:
            click.echo(f"{found.channel}: {found.sentence}")
    for name, why in compared.skipped.items():
        say(f"channel {name} skipped: {why}")
    for judged in compared.channels:
        hides = asked.channel(judged.channel).hides
        if hides:
            say(f"{judged.channel} cannot show {hides}", display.quiet)
        if judged.too_few:
            few = [compared.names[v] for v in judged.too_few]
            say(
                f"{judged.channel}: {counted(len(few), 'vehicle')} with too few flights: {', '.join(few[:8])}"
            )
    title, lead = headline(compared)
    say(f"{title}. {lead}".strip(), display.quiet)
    say(f"page: {page}", display.quiet)
    return ExitCode.CHECK_FAILED if any(found.question == fail_if for found in compared.findings) else 0


def _reports(runs: Path, vehicles: list[str]) -> dict[str, Path]:
    """The pages of the vehicles' own runs, where they are."""
    from flysid.fleet.models.vehicle_runs import folder_of

    pages = {v: runs / folder_of(v) / "report" / PAGE for v in vehicles}
    return {v: page for v, page in pages.items() if page.is_file()}
