"""`flysid validate RUN [-o REPORT]`."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flysid.cli.output import check_target, say, status


@click.command("validate")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--output", "-o", type=click.Path(path_type=Path), help="Folder of the report [default: RUN/report]."
)
@click.option(
    "--data", type=click.Path(path_type=Path), help="The ingested folder, where it moved since the fit."
)
@click.option("--fail-if", "condition", help="Exit with 4 where this holds, e.g. 'free_run.change_pct > 5'.")
@click.option("--force", is_flag=True, help="Replace the report if it is there.")
@click.option("--json", "as_json", is_flag=True, help="Print the comparison as JSON instead of a table.")
@click.option("--quiet", "-q", is_flag=True)
def command(
    run: Path,
    output: Path | None,
    data: Path | None,
    condition: str | None,
    force: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Compare the models of a run on its held-out segments; write report.html and report.json.

    Free run is the headline: models see the inputs and a window at the start, nothing else.
    """
    target = output if output is not None else run / "report"
    from flysid.validate.judge import judge_run, write_judgement
    from flysid.validate.run import open_run

    opened = open_run(run)
    check_target(target, force)
    with status(quiet) as progress:
        judgement = judge_run(opened, data, progress)
        progress("writing the report")
        page = write_judgement(judgement, target)
    click.echo(json.dumps(judgement.document, indent=1) if as_json else judgement.table)
    say(f"report: {page}", quiet)
    if condition is not None and judgement.violates(condition):
        say(f"check failed: {condition}")
        return 4
    return 0
