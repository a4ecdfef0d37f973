"""Cautions about what a simpler model can do as well: a constant, a straight line, one rule."""

from __future__ import annotations

from collections.abc import Iterator

from flysid.validate.caution import Caution, Comparisons, Diagnoses, heads, join
from flysid.validate.comparison import Comparison, Entry
from flysid.validate.trials import FREE_RUN
from flysid.validate.verdict import Verdict
from flysid.validate.words import number, one_line


def useless(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Models of the headline that a reference or a static line beats in free run."""
    del diagnoses
    for channel, c in comparisons.items():
        if FREE_RUN not in c.horizons:
            continue
        for output in c.test.outputs:
            entry = c.entry(output.name, FREE_RUN)
            name = output.name if len(c.test.outputs) > 1 or not channel else channel
            for kind in ("mean", "persistence", "line"):
                beaten = _beaten_by(kind, entry, c)
                if beaten:
                    yield _nothing_learnt(kind, beaten, one_line(name))


def _beaten_by(kind: str, entry: Entry, c: Comparison) -> str:
    """ "TS 0.31, ARX 0.32 against 0.30 m/s", or "" where every model of the headline is better."""
    line = next((n for n, info in c.models.items() if info.structure == kind), None)
    if line is None:
        return ""
    least = entry.models[line].scores.rmse
    lost = [n for n in heads(c) if n != line and entry.models[n].scores.rmse >= least]
    if not lost or least < entry.resolution:
        return ""
    unit = one_line(entry.output.unit)
    said = [f"{one_line(n).upper()} {number(entry.models[n].scores.rmse)}" for n in reversed(lost)]
    return f"{', '.join(said)} against {number(least)} {unit}".rstrip()


def _nothing_learnt(kind: str, figures: str, name: str) -> Caution:
    called = {"mean": "the training mean", "persistence": "the held starting value", "line": "a static line"}
    if kind == "line":
        return Caution(
            "warning",
            f"In free run {called[kind]} is as good on {name} as a model (RMSE: {figures}): no dynamics are "
            "shown.",
            "use the line, or fly manoeuvres that excite the dynamics.",
            3.6,
        )
    return Caution(
        "danger",
        f"In free run {called[kind]} is as good on {name} as a model (RMSE: {figures}): what it has learnt "
        "does not hold on these flights.",
        "do not use them; check the recipe's signals and units, the excitation, and what else moves the "
        "output.",
        9.0 if kind == "mean" else 8.0,
    )


def one_rule(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    del diagnoses
    said = [
        output
        for c in comparisons.values()
        for output, pair in c.verdict.items()
        if pair.verdict is Verdict.BETTER and pair.one_rule
    ]
    if said:
        yield Caution(
            "warning",
            f"On {join(said)} the better Takagi-Sugeno model has one rule: it is a linear model, and the "
            "gain comes from its order or refinement, not from fuzziness.",
            "use it as a linear model; do not quote it as evidence for rules.",
            3.5,
        )
