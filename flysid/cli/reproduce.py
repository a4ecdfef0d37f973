"""`flysid reproduce ardrone-ts`."""

from __future__ import annotations

import re
import textwrap
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import click

from flysid.cli.display import Display, progress_options
from flysid.cli.output import print_json
from flysid.extras import Extra, extra

if TYPE_CHECKING:
    from flysid.validate.paper.reproduction import LoopResult

LABELS = {
    "static_ts_7": "static TS, 7 rules",
    "static_ts_3": "static TS, 3 rules",
    "line": "best single line",
    "arx": "ARX, free run",
    "dynamic_ts_3": "dynamic TS, 3 rules, free run",
}
NOISE_LABELS = {
    "arx_one_step": "ARX, least squares one step ahead",
    "arx": "ARX, default (refined on the simulation error where that helps)",
    "dynamic_ts_3": "dynamic TS, 3 rules",
}
VERDICTS = {
    "same": "no difference that matters: on this linear loop a linear model is enough",
    "worse": "the dynamic TS model is worse than ARX: on this linear loop use the linear model",
    "better": "the dynamic TS model is better than ARX",
    "not enough data": "not enough data for a verdict",
}


@click.command("reproduce")
@click.argument("paper", type=click.Choice(["ardrone-ts"]))
@click.option("--json", "as_json", is_flag=True, help="Print the figures of merit as JSON.")
@click.option(
    "--figures",
    type=click.Path(path_type=Path),
    metavar="FOLDER",
    help="Also draw the paper's figures 4 to 6 as PDF (needs matplotlib: flysid[plot]).",
)
@progress_options
def command(paper: str, as_json: bool, figures: Path | None, display: Display) -> None:  # noqa: ARG001
    """Reproduce a paper's figures and rule tables, and state what cannot be reproduced.

    ardrone-ts: Takagi-Sugeno identification of the AR.Drone's longitudinal, lateral and vertical loops.
    """
    from flysid.pictures import require_matplotlib
    from flysid.validate.paper.printed import CANNOT_REPRODUCE
    from flysid.validate.paper.reproduction import draw_figures, reproduce_ardrone_ts, to_document

    if figures is not None:
        require_matplotlib()
    with display.shown():
        results = reproduce_ardrone_ts()
    if figures is not None:
        extra(Extra.FIGURES, partial(draw_figures, results, figures), ())
    if as_json:
        print_json(to_document(results))
        return
    click.echo("\n\n".join(loop_text(r) for r in results))
    click.echo("\nWhat cannot be reproduced, and why")
    for reason in CANNOT_REPRODUCE:
        click.echo(textwrap.fill(reason, 100, initial_indent="- ", subsequent_indent="  "))


def loop_text(result: LoopResult) -> str:
    """One loop: figures of merit, noise, rule tables."""
    loop = result.paper
    lines = [
        f"{loop.name.upper()} LOOP {loop.equation}, {loop.input_name} -> {loop.output_name}; "
        "trained on (13), validated on (14), T = 0.01 s, 400 s",
        f"  {'':48}{'RMSE, m/s':>12}{'VAF, %':>12}",
        f"  {'paper, 7 rules':48}{loop.rmse_text:>12}{'> 95':>12}   (its summary: {loop.rmse_summary})",
    ]
    for label, words in LABELS.items():
        values = result.scores[label]
        vaf = values["vaf_pct"]
        lines.append(f"  {words:48}{values['rmse']:>12.3g}{'-' if vaf is None else f'{vaf:.6g}':>12}")
    lines.append(f"  verdict, dynamic TS against ARX: {result.verdict} ({VERDICTS[result.verdict]})")
    lines.append("  with 0.02 m/s of measurement noise, free run against the noise-free truth, RMSE in m/s")
    lines += [f"    {words:66}{result.noisy_rmse[label]:>10.3g}" for label, words in NOISE_LABELS.items()]
    best = min(NOISE_LABELS, key=lambda label: result.noisy_rmse[label])
    lines.append(f"    best: {NOISE_LABELS[best]}")
    return "\n".join([*lines, *extra(Extra.RULE_TABLES, partial(_rule_tables, result), (), loop.name)])


def _rule_tables(result: LoopResult) -> list[str]:
    """The paper's two tables of this loop beside flysid's of the same form, then the dynamic rules."""
    from flysid.model.rule_tables import if_then, parameters
    from flysid.model.static_ts import FittedStaticTS

    static = result.models["static_ts_7"]
    assert isinstance(static, FittedStaticTS)
    theirs = result.paper.table
    ours = static.table()
    first, second = re.findall(r"\d", result.paper.tables)
    lines = _beside(
        [f"the paper's table {first}", *if_then(theirs)], [f"flysid's table {first}", *if_then(ours)], 52
    )
    lines += _beside(
        [f"the paper's table {second}", *parameters(theirs)],
        [f"flysid's table {second}", *parameters(ours)],
        52,
    )
    lines.append("  where flysid's sets lie")
    lines += [f"    {rule.label}: {rule.condition}" for rule in static.rules()]
    lines.append("  flysid's dynamic TS, 3 rules")
    lines += [
        f"    {r.label}: if {r.condition} then {r.conclusion}" for r in result.models["dynamic_ts_3"].rules()
    ]
    return lines


def _beside(left: list[str], right: list[str], width: int) -> list[str]:
    """Two tables side by side, each under its head."""
    rows = zip_longest(left, right, fillvalue="")
    return [f"{'  ' if i == 0 else '    '}{a:{width - 2 * (i > 0)}}{b}" for i, (a, b) in enumerate(rows)]
