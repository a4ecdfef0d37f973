"""`flysid compare RUN_A RUN_B [-o REPORT]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.options import comparison_forms, condition_option, target_options
from flysid.cli.output import end_comparison
from flysid.cli.source import given, selection_options
from flysid.cli.trust import Setting
from flysid.manifest import check_data_folder
from flysid.progress import part

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection

FOLDER = click.Path(path_type=Path)


@click.command("compare")
@click.argument("run_a", type=FOLDER)
@click.argument("run_b", type=FOLDER)
@target_options(
    "--output", "-o", replaced="report", help="Folder of the report; none is written when not given."
)
@click.option(
    "--model",
    "-m",
    "label",
    cls=Setting,
    help="Model of the headline, in both runs [default: ts, else the baseline of RUN_B].",
)
@click.option("--data-a", type=FOLDER, help="The ingested folder of RUN_A, if it has moved since the fit.")
@click.option("--data-b", type=FOLDER, help="The ingested folder of RUN_B, if it has moved since the fit.")
@condition_option("'free_run.change_pct > 5'")
@selection_options
@comparison_forms
@progress_options
def command(
    run_a: Path,
    run_b: Path,
    output: Path | None,
    label: str | None,
    data_a: Path | None,
    data_b: Path | None,
    condition: str | None,
    selection: Selection,
    form: str,
    display: Display,
) -> int:
    """Compare the models of two runs on flights that neither has trained on.

    The data are those that RUN_B held out, except flights that RUN_A was trained on. Changes are those of
    RUN_B's models relative to RUN_A's; below 0 % RUN_B is better. Exit code 3: a channel of both runs could
    not be compared; 4: --fail-if holds.
    """
    from flysid.validate.compare.condition import check_condition
    from flysid.validate.runs.crossrun import RunSource, expected_of_runs, judge_runs
    from flysid.validate.runs.run import open_run
    from flysid.validate.show.finish import finish, write_finished

    a = RunSource(open_run(run_a), data_a)
    b = RunSource(open_run(run_b), data_b)
    for source in (a, b):
        if source.data is not None and source.run.recipe:
            check_data_folder(source.data)
    expected = expected_of_runs(a.run, b.run, label)  # refuses a label that a run lacks
    if condition is not None:
        check_condition(condition, expected)
    with display.shown():
        with part(0.0, 0.5):
            judgement = judge_runs(a, b, label=label, only=given(selection))
        with part(0.5, 1.0):
            finished = finish(judgement, page=output is not None)
            page = None if output is None else write_finished(finished, output)
    click.echo(finished.text(form))
    return end_comparison(finished, condition, page, display.quiet)
