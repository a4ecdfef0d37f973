"""`flysid review LOG...`: does the vehicle fly well, and what should be changed?"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import click

from flysid.cli.addresses import SOURCE
from flysid.cli.checks import Reading
from flysid.cli.display import Display
from flysid.cli.options import condition_option, target_options
from flysid.cli.output import ExitCode, explain, print_json, say
from flysid.cli.source import flight_options, opened_flights, reading_options, recipe_option
from flysid.cli.trust import Setting
from flysid.escaping import one_line
from flysid.extras import Extra, Missing, extra
from flysid.showing import fold

if TYPE_CHECKING:
    from flysid.ingest.align.recipe import Recipe
    from flysid.ingest.lake.chosen_flights import Selection
    from flysid.reviews.reviewed import Review
    from flysid.reviews.series import Series


@click.command("review")
@click.argument("sources", type=SOURCE, nargs=-1, required=True, metavar="LOG...")
@flight_options
@target_options(
    "-o",
    "--output",
    replaced="page",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the page to this file, and proposed parameters beside it.",
)
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.option("--markdown", "as_markdown", is_flag=True, help="Print Markdown, for a pull request.")
@condition_option("'vibration.accel_rms > 30'")
@click.option(
    "--limit",
    "limits",
    cls=Setting,
    multiple=True,
    metavar="FIGURE=WATCH,BAD",
    help="Judge a figure by your own limits, e.g. power.motor_spread=15,40; repeatable.",
)
@recipe_option
@reading_options
def command(
    sources: tuple[Path, ...],
    selection: Selection,
    output: Path | None,
    as_json: bool,
    as_markdown: bool,
    condition: str | None,
    limits: tuple[str, ...],
    recipe: str,
    reading: Reading,
) -> int:
    """Review a log: does the vehicle fly well, and what should be changed?

    The first sentence is the answer. What follows are at most three next actions, each from evidence in the
    log, and every figure that it holds: tracking, vibration, power, estimator, events. What it does not hold
    is named with the parameter that logs it. `flysid LOG` does the same. With --recipe, a table's
    columns are setpoints, measurements and body rates: see docs/recipes.md.

    Of several logs, or a folder, the first sentences are printed, and what the flights of one vehicle show
    together: their gains and figures in order, what a change did beyond the scatter between flights, and what
    to try next.

    Exit code 3: nothing in a log could be judged, because it did not fly, say, or it was read with losses;
    4: --fail-if holds.
    """
    from flysid.errors import UsageError
    from flysid.ingest.align.recipe import load_recipe
    from flysid.reviews.figures import own_limits, parse_limits
    from flysid.validate.compare.condition import check_grammar

    if as_json and as_markdown:
        raise UsageError("--json and --markdown each say what to print", hint="give one of them")
    if condition:
        check_grammar(condition)
    own = load_recipe(recipe) if recipe else None
    with own_limits(parse_limits(limits)):
        found, series = _reviewed(sources, reading, selection, own, with_evidence=output is not None)
    if as_json:
        print_json(_document(found, series))
    elif as_markdown:
        from flysid.reviews.lines import markdown

        together = ["\n".join(["```", *map(one_line, series.lines()), "```"])] if series.vehicles else []
        click.echo("\n\n".join([*together, *map(markdown, found)]))
    else:
        click.echo(_text(found, series))
    logs = list(map(str, sources))
    named = shlex.join([*logs, "--recipe", recipe] if recipe else logs)
    if output is not None:
        _write(output, found, series, named)
    elif not any(review.is_judged for review in found):
        say(f"next: what to log, and what a log is good for as it is: flysid doctor {shlex.join(logs)}")
    elif not (as_json or as_markdown):
        page = "series.html" if series.vehicles else "review.html"
        say(f"next: the page with pictures and evidence: flysid review {named} -o {page}")
    if condition and _holds(condition, found):
        return ExitCode.CHECK_FAILED
    return 0 if all(review.is_judged for review in found) else 3


def _reviewed(
    sources: Sequence[Path],
    reading: Reading,
    selection: Selection,
    recipe: Recipe | None,
    *,
    with_evidence: bool,
) -> tuple[list[Review], Series]:
    """The reviews of all flights of all sources in their order, and what several of one vehicle show."""
    Thread(target=_load_reviews, daemon=True).start()
    with ExitStack() as stack:
        stack.enter_context(Display().shown())
        lakes = [stack.enter_context(opened_flights(each, reading, selection=selection)) for each in sources]
        from flysid.ingest.lake.chosen_flights import select
        from flysid.reviews.logged import LoggedFlight
        from flysid.reviews.review import review_flight
        from flysid.reviews.series import Series, series

        pairs: list[tuple[Review, LoggedFlight]] = []
        for log in (log for lake in lakes for log in select(lake, selection).logs):
            flight = LoggedFlight(log, log.manifest.damage, log.manifest.source.name, recipe=recipe)
            pairs.append((review_flight(flight, with_evidence=with_evidence), flight))
        missing = Missing()
        with missing.gathering():
            compared = extra(Extra.SERIES, partial(series, pairs), Series(()))
        compared = replace(compared, missing=missing.sentences)
    for sentence in compared.missing:
        explain(sentence)
    return [review for review, _ in pairs], compared


def _load_reviews() -> None:
    """Import what reviews need: while another process reads the log, it costs no time."""
    from flysid.reviews.review import load_sections

    load_sections()


def _document(found: Sequence[Review], series: Series) -> dict[str, Any]:
    """A log's document; of several logs all of them, and what they show together."""
    if len(found) == 1:
        return found[0].to_dict()
    missing = {"missing": list(series.missing)} if series.missing else {}
    return {"reviews": [review.to_dict() for review in found], "series": series.to_dict(), **missing}


def _text(found: Sequence[Review], series: Series) -> str:
    """For a terminal: one log whole; of several what they show together, and what they complain of."""
    from flysid.reviews.lines import MOST_LINES, headline, shared_findings, terminal_text

    if len(found) == 1:
        return terminal_text(found[0])
    alone = [headline(review) for review in found if not series.holds(review)]
    shared = shared_findings([review for review in found if series.holds(review)])
    lines = [*alone, *series.lines(MOST_LINES - len(shared)), *shared]
    return "\n".join(fold(one_line(line)) for line in lines)


def _write(output: Path, found: Sequence[Review], series: Series, named: str) -> None:
    """The page, and the parameters that it proposes in a file beside it."""
    from flysid.reviews.page import write_review
    from flysid.reviews.parameter_file import file_suffix, parameter_text

    command = f"flysid review {named} -o {shlex.quote(str(output))}"
    write_review(output, found, command, series.tables, series.missing)
    click.echo(str(output))
    for review in found:
        text = parameter_text(review.actions, review.family, review.whole)
        if text:
            beside = output.with_name(f"{output.stem}-{Path(review.name).stem}{file_suffix(review.family)}")
            beside.write_text(text, "utf-8")
            say(f"proposed parameters: {beside}")


def _holds(condition: str, found: Sequence[Review]) -> bool:
    """Whether it holds of any log; which, and why, is printed."""
    from flysid.validate.compare.condition import matching_channels

    names = [review.name for review in found]
    called = [f"{name} ({i})" if names.count(name) > 1 else name for i, name in enumerate(names, 1)]
    values = (review.values for review in found)
    document: dict[str, Any] = {"channels": dict(zip(called, values, strict=True))}
    failed = matching_channels(condition, document)
    for name, why in failed.items():
        say(f"check failed on {name}: {condition}" + (f" ({why})" if why else ""))
    return bool(failed)
