"""Cautions about what a simpler model can do as well, and about what a model cannot be trusted with."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from flysid.escaping import one_line
from flysid.model.structures import least, references, row_of
from flysid.showing import number
from flysid.validate.compare.comparison import Comparison, Entry
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare.words import named
from flysid.validate.diagnose.beyond import beyond
from flysid.validate.diagnose.caution import Caution, Comparisons, Diagnoses, heads, join

COLLINEAR = 1e5
"""Condition number above which single coefficients mean little."""
CHEAP_PCT = 2.0
"""Growth of the free run's RMSE that a simpler rule base is worth."""


def useless(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Models of the headline that a reference or a static line beats in free run: the simplest that does."""
    del diagnoses
    said: dict[str, list[str]] = {row.file_name: [] for row in least()}
    for channel, c in comparisons.items():
        if FREE_RUN not in c.horizons:
            continue
        for output in c.test.outputs:
            entry = c.entry(output.name, FREE_RUN)
            name = output.name if len(c.test.outputs) > 1 or not channel else channel
            for kind, found in said.items():
                beaten = _beaten_by(kind, entry, c)
                if beaten:
                    found.append(f"{one_line(name)} (RMSE: {beaten})")
                    break
    yield from (_nothing_learnt(kind, join(found)) for kind, found in said.items() if found)


def _beaten_by(kind: str, entry: Entry, c: Comparison) -> str:
    """ "TS 0.31, ARX 0.32 against 0.30 m/s", or "" where every model of the headline is better."""
    line = next((n for n, info in c.models.items() if info.structure == kind), None)
    if line is None:
        return ""
    bound = entry.models[line].scores.rmse
    lost = [n for n in heads(c) if n != line and entry.models[n].scores.rmse >= bound]
    if not lost or bound < entry.resolution:
        return ""
    unit = one_line(entry.output.unit)
    said = [f"{one_line(n).upper()} {number(entry.models[n].scores.rmse)}" for n in reversed(lost)]
    return f"{', '.join(said)} against {number(bound)} {unit}".rstrip()


def _nothing_learnt(kind: str, where: str) -> Caution:
    row = row_of(kind)
    if row.kind != "reference":
        return Caution(
            "warning",
            f"In free run the model is no better than {row.least} on {where}: the data show no dynamics.",
            "use the line, or fly manoeuvres that excite the dynamics.",
            3.6,
        )
    return Caution(
        "danger",
        f"In free run the model is no better than {row.least} on {where}: what was learnt does not hold "
        "on these flights.",
        "do not use this model; check the recipe's signals and units, the excitation, and what else moves "
        "the output.",
        9.0 - references().index(row.name),
    )


def contested(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Better than the baseline only: another linear model in the table does as well."""
    del diagnoses
    said = []
    for c in comparisons.values():
        for output, pair in c.verdict.items():
            if pair.contested:
                entry = c.entry(output, c.head)
                rmse = {n: entry.models[n].scores.rmse for n in pair.short_of}
                best = min(rmse, key=lambda n: rmse[n])
                figures = ", ".join(
                    f"{one_line(n).upper()} {number(entry.models[n].scores.rmse)}"
                    for n in (pair.baseline, best, pair.model)
                )
                said.append(f"{output} (not against {named(pair.short_of)}; RMSE: {figures})")
    if said:
        yield Caution(
            "warning",
            "Better than the linear model chosen on the training data, but not than every linear model: "
            f"{join(said)}.",
            "quote the change against the best linear model of the table; train on more flights, so that the "
            "choice of the baseline is less subject to chance.",
            7.0,
        )


def own_constants(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Constants of flights that the models of the headline leave out."""
    del diagnoses
    said = []
    for c in comparisons.values():
        for name in heads(c):
            own = getattr(c.fitted[name], "flight_offsets", None)
            if own is None:
                continue
            said += [
                one_line(f"{output.name} {number(low)} to {number(high)} {unit}".rstrip())
                for output, low, high, unit in own.spans(c.test.outputs)
            ]
            break
    if said:
        yield Caution(
            "note",
            f"Flights differ by constants, as wind, trim or a sensor's bias give: {join(said)}. Every score "
            "leaves out the constant of its flight.",
            "if the flights were flown at other speeds on purpose, fit with --flight-offsets no.",
            9.0,
        )


def one_rule(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """A better fuzzy model that is a linear one."""
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


def beyond_band(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Models that answer strongly at frequencies at which nothing measured says how the vehicle does."""
    said = []
    for channel, d in diagnoses.items():
        c = comparisons[channel]
        model = c.fitted[c.contender or c.baseline]
        said += [
            f"{c.test.inputs[j].name} to {out.output.name} of {channel} ({number(end)} Hz)"
            for i, out in enumerate(d.outputs)
            for j, end in beyond(model, out.responses, i)
        ]
    if said:
        yield Caution(
            "note",
            "The flights excite the vehicle up to a limited frequency, and the model still responds "
            f"strongly above it: {join(said)}.",
            "do not use its gain there, as in a fast control loop; fly faster manoeuvres, such as a chirp.",
            0.7,
        )


def spare_words(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Rules that could go for next to nothing."""
    said = [
        f"{channel} ({checks.simpler[0]})"
        for channel, d in diagnoses.items()
        for name, checks in d.checks.items()
        if name == comparisons[channel].contender
        and checks.simpler
        and checks.simpler[0].loss_pct < CHEAP_PCT
    ]
    if said:
        yield Caution(
            "note",
            f"Fewer rules or conditions would do nearly as well on {join(said)}, by free-run RMSE on the "
            "training flights.",
            "fit with one rule less (--rules), or model.simplifications(train).",
            0.65,
        )


def runs_away(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Models that reach their limits in a long run although they did not on the held-out part."""
    for channel, d in diagnoses.items():
        judged = comparisons[channel].entry(horizon=comparisons[channel].head).models
        tried = {n: c.robustness for n, c in d.checks.items() if not judged[n].diverged}
        ends = {n: r.limits_s for n, r in tried.items() if r is not None}
        for at in dict.fromkeys(t for t in ends.values() if t is not None):
            names = [n for n, end in ends.items() if end == at]  # several are one model under two names
            one = len(names) == 1
            reaches = "reaches its output limits" if one else "reach their output limits"
            fewer = (
                "fewer rules or " if any(comparisons[channel].models[n].n_rules > 1 for n in names) else ""
            )
            yield Caution(
                "warning",
                f"In a long free run under random steps within the training range {named(names)} {reaches} "
                f"on {one_line(channel)}, first at t = {at:.1f} s.",
                f"do not use {'it' if one else 'them'} for long simulations or for control; "
                f"use {fewer}a lower order.",
                4.5,
            )


def unsure_gains(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Rules whose gain may have either sign, or any size."""
    said = []
    for channel, d in diagnoses.items():
        for name, checks in d.checks.items():
            sure = checks.intervals
            if sure is None or len(comparisons[channel].test.inputs) > 1:
                continue  # a second input may well have no effect
            low, high = sure.gain
            told = np.array([bool(r.here) for r in comparisons[channel].fitted[name].rules()])
            seen = told if told.any() else np.ones(len(low), dtype=bool)
            bad = (np.isnan(low) | ((low < 0.0) & (high > 0.0))).any(axis=(1, 2))
            unsure = np.flatnonzero(bad & seen)
            rules = ", ".join(f"R{r + 1}" for r in unsure) + " of " if len(low) > 1 else ""
            if len(unsure):
                said.append(f"{channel} ({rules}{name.upper()})")
    if said:
        yield Caution(
            "note",
            f"The data do not pin down the steady gain on {join(said)}: its 95 % interval includes zero, "
            "or spans more than a factor of two.",
            "do not quote these gains; fly longer steps, or use fewer rules.",
            0.85,
        )


def collinear(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Regressors that hardly differ."""
    del comparisons
    said = [
        f"{channel} ({name.upper()}: {max(checks.conditions):.0e})"
        for channel, d in diagnoses.items()
        for name, checks in d.checks.items()
        if checks.conditions and max(checks.conditions) > COLLINEAR
    ]
    if said:
        yield Caution(
            "note",
            f"The regressors are nearly collinear on {join(said)}: single coefficients mean little there.",
            "read gains and time constants, not coefficients; lower the order or the sample rate.",
            0.55,
        )
