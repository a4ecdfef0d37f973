"""`flysid validate RUN [-o REPORT]`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.display import Display, progress_options
from flysid.cli.options import comparison_forms, condition_option, force_option
from flysid.cli.output import check_target, end_comparison
from flysid.cli.source import given, selection_options
from flysid.cli.trust import Own, Setting
from flysid.progress import part

if TYPE_CHECKING:
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.validate.runs.run import Beside


@click.command("validate")
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--output", "-o", type=click.Path(path_type=Path), help="Folder of the report [default: RUN/report]."
)
@click.option("--data", type=SOURCE, help="The ingested folder, if it has moved since the fit.")
@condition_option("'free_run.change_pct > 5'")
@click.option(
    "--figures",
    type=click.Choice(["pdf", "svg", "png"]),
    help="Draw figures for a paper, too (flysid[plot]).",
)
@click.option(
    "--with",
    "wanted",
    cls=Own,
    multiple=True,
    metavar="[CHANNEL/]LABEL=MODEL",
    help="A model of your own beside the run's: .mat, .m, .npz, .json, .fmu, or module:function; repeatable.",
)
@click.option(
    "--start",
    "starts",
    cls=Setting,
    multiple=True,
    metavar="LABEL=VARIABLE",
    help="A variable of an FMU that a run starts from; repeatable.",
)
@force_option("report")
@selection_options
@comparison_forms
@progress_options
def command(
    run: Path,
    output: Path | None,
    data: Path | None,
    condition: str | None,
    figures: str | None,
    wanted: tuple[str, ...],
    starts: tuple[str, ...],
    force: bool,
    selection: Selection,
    form: str,
    display: Display,
) -> int:
    """Compare the models of a run on its held-out segments; write report.html and report.json.

    Models are judged in free run: they see the inputs and a window at the start, nothing else. Exit code 3:
    a fitted channel could not be judged; 4: --fail-if holds.
    """
    from flysid.pictures import require_matplotlib
    from flysid.validate.compare.condition import check_condition
    from flysid.validate.runs.expected import expected_of_run
    from flysid.validate.runs.judge import judge_run
    from flysid.validate.runs.run import REPORT, models_of, open_run
    from flysid.validate.show.finish import finish, remember, write_finished

    target = output if output is not None else run / REPORT
    if figures is not None:
        require_matplotlib()
    opened = open_run(run)
    check_target(target, force or is_own_report(target, run))
    beside: Beside = {}
    if wanted or starts:
        from flysid.outside.bring import brought

        beside = brought(wanted, {c.name: models_of(opened, c) for c in opened.channels}, starts)
    if condition is not None:
        check_condition(condition, expected_of_run(opened, beside))
    with display.shown():
        with part(0.0, 0.5):
            judgement = judge_run(opened, data, only=given(selection), beside=beside)
        with part(0.5, 1.0):
            finished = finish(judgement, page=True, figures=figures)
            page = write_finished(finished, target)
    if target != run / REPORT and not beside and given(selection) is None:
        remember(finished, opened)
    click.echo(finished.text(form))
    return end_comparison(finished, condition, page, display.quiet)


def is_own_report(target: Path, run: Path) -> bool:
    """Whether `target` is the report inside the run, which follows from the run and may be made anew."""
    from flysid.validate.runs.run import DOCUMENT, REPORT

    return target == run / REPORT and (target / DOCUMENT).is_file()
