"""The verdict in sentences; every number comes with its horizon."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.escaping import one_line
from flysid.model.structures import row_of
from flysid.showing import counted, list_words, number, percent, percentage, rough_duration, significant
from flysid.validate.compare.comparison import Comparison, Pair
from flysid.validate.compare.intervals import Scope
from flysid.validate.compare.verdict import Verdict
from flysid.validate.compare.words import horizon_words, named, scope_words, verdict_words

SYMBOLS = {Verdict.BETTER: "▲", Verdict.WORSE: "▼", Verdict.SAME: "=", Verdict.NOT_ENOUGH: "?"}
CSS = {
    Verdict.BETTER: "better",
    Verdict.WORSE: "worse",
    Verdict.SAME: "same",
    Verdict.NOT_ENOUGH: "unsure",
}

CONTESTED = ("△", "unsure")
"""Symbol and CSS class of "better than the baseline, not shown against another linear model"."""

Heads = Sequence[tuple[str, Pair]]


def symbol(pair: Pair) -> str:
    """Of the verdict: never colour alone."""
    return CONTESTED[0] if pair.contested else SYMBOLS[pair.verdict]


def css(pair: Pair) -> str:
    """CSS class of the verdict."""
    return CONTESTED[1] if pair.contested else CSS[pair.verdict]


def badge(pair: Pair) -> dict[str, str]:
    """Symbol, words and CSS class of a verdict: never colour alone."""
    words = verdict_words(pair)
    return {"symbol": symbol(pair), "words": words, "css": css(pair)}


def heads(comparisons: Mapping[str, Comparison]) -> list[tuple[str, Pair]]:
    """(label, free-run pair) of every channel and output."""
    return [
        (_label(channel, output, c), pair)
        for channel, c in comparisons.items()
        for output, pair in c.verdict.items()
    ]


def _label(channel: str, output: str, c: Comparison) -> str:
    return one_line(output if len(c.test.outputs) > 1 or not channel else channel)


def as_good_as_constant(comparisons: Mapping[str, Comparison]) -> list[str]:
    """Labels of `heads` on which the mean or the held start does as well as both models of the headline."""
    found = []
    for channel, c in comparisons.items():
        for output, pair in c.verdict.items():
            rmse = {name: score.scores.rmse for name, score in c.entry(output, c.head).models.items()}
            constants = [rmse[name] for name, info in c.models.items() if info.reference]
            if constants and min(constants) <= min(rmse[pair.baseline], rmse[pair.model]):
                found.append(_label(channel, output, c))
    return found


def worse_than_constant(comparisons: Mapping[str, Comparison]) -> list[str]:
    """Where the baseline errs more than a constant: stated first, as beating it proves little."""
    said = []
    for channel, c in comparisons.items():
        for output, pair in c.verdict.items():
            rmse = {name: score.scores.rmse for name, score in c.entry(output, c.head).models.items()}
            constants = {rmse[name]: name for name, info in c.models.items() if info.reference}
            best = min(constants, default=np.inf)
            if not rmse[pair.model] < best < rmse[pair.baseline]:
                continue
            less = percent(100.0 * (rmse[pair.model] / best - 1.0))
            constant = row_of(c.models[constants[best]].structure).called
            said.append(
                f"On {_label(channel, output, c)} the {base_words([('', pair)])} is worse than the "
                f"{constant}: against that, the RMSE of the {name_model(pair.model)} changes by {less}, "
                f"{number(best)} to {number(rmse[pair.model])}."
            )
    return said


def name_model(model: str) -> str:
    """ "fuzzy model" for "ts", "fuzzy model of run A" for "a:ts"; an unknown name stays as it is."""
    run, _, label = model.rpartition(":")
    if run in ("a", "b") and (words := row_of(label).words):
        return f"{words} of run {run.upper()}"
    return row_of(model).words or one_line(model)


def base_words(pairs: Heads) -> str:
    """What the baselines are called: "linear model" beside a fuzzy one, whatever structure each has."""
    pair = pairs[0][1]
    return "linear model" if "fuzzy" in row_of(pair.model).words else name_model(pair.baseline)


def contender_words(pairs: Heads) -> str:
    """What the models seen from the baselines are called; of those that are linear nothing of "fuzzy"."""
    return "outcome of the search for rules" if _all_linear(pairs) else name_model(pairs[0][1].model)


def title(pairs: Heads, idle: Sequence[str] = ()) -> str:
    """The verdict in one sentence; `idle` is `as_good_as_constant`."""
    if not pairs:
        return "One model, nothing to compare it with."
    model = name_model(pairs[0][1].model)
    base = base_words(pairs)
    scope = narrow_scope(pairs)
    worth = [(n, p) for n, p in pairs if n not in idle]
    heard = [p for _, p in worth if p.scope is scope or (p.scope.is_unseen and scope.is_unseen)]
    count = {v: sum(p.verdict is v for p in heard) for v in Verdict}
    count[Verdict.NOT_ENOUGH] = sum(p.verdict is Verdict.NOT_ENOUGH for _, p in worth)
    one_rule = sum(p.verdict is Verdict.BETTER and p.one_rule for _, p in worth)
    contested = [p for _, p in worth if p.contested]
    count[Verdict.BETTER] -= one_rule + len(contested)
    count[Verdict.SAME] += one_rule
    total = len(pairs)
    every = "both" if total == 2 else f"all {total}"
    on_all = f"on {every} channels" if total > 1 else f"on {pairs[0][0]}"
    here = "" if scope is Scope.ANOTHER else f" on {scope}"
    if all(map(_both_diverged, pairs)):
        return f"Neither the {model} nor the {base} is usable {on_all}."
    if len(idle) == total:
        return f"Neither the {model} nor the {base} is better than a constant {on_all}."
    if count[Verdict.NOT_ENOUGH] == total:
        return "Not enough held-out data for a verdict."
    if count[Verdict.BETTER] == total:
        return f"The {model} is better{here}{',' * bool(here)} {on_all}."
    if count[Verdict.BETTER]:
        return f"The {model} is better{here} on {count[Verdict.BETTER]} of {total} channels."
    if contested:
        rest = f" on {len(contested)} of {total} channels" if total > 1 else ""
        rivals = named(tuple(dict.fromkeys(n for p in contested for n in p.short_of)))
        return f"The {model} is better than the chosen linear model{rest}, not shown against {rivals}."
    if count[Verdict.WORSE] == total:
        return f"The {base} is better{here}{',' * bool(here)} {on_all}."
    if count[Verdict.WORSE]:
        return (
            f"The {base} is better{here} on {count[Verdict.WORSE]} of {total} channels; the {model} on none."
        )
    if count[Verdict.SAME] == total and _two_runs(pairs):
        return f"The two runs are the same{here} {on_all}."
    if count[Verdict.SAME] == total and _all_linear(pairs):
        return f"A linear model is enough{here} {on_all}."
    if count[Verdict.SAME] == total:
        return f"{'A' if one_rule else 'The'} {base} is enough{here} {on_all}."
    left = total - count[Verdict.SAME]
    rest = f"on {'the other' if left == 1 else 'the others'}"
    rest = f"not enough data {rest}" if not idle else f"{rest} see below"
    return f"The same{here} on {count[Verdict.SAME]} of {total} channels; {rest}."


def narrow_scope(pairs: Heads) -> Scope:
    """The scope of all verdicts where they share one, else that of flights like these, or another flight."""
    scopes = {p.scope for _, p in pairs}
    if len(scopes) == 1:
        return scopes.pop()
    return Scope.LIKE if any(s.is_unseen and s is not Scope.ANOTHER for s in scopes) else Scope.ANOTHER


def alone(comparisons: Mapping[str, Comparison]) -> str:
    """What there is to say where a channel has one model only: its error."""
    said = []
    for channel, c in comparisons.items():
        for output in () if c.contender else c.test.outputs:
            s = c.entry(output.name, c.head).models[c.baseline].scores
            unit = f" {output.unit}" if output.unit else ""
            error = f"{number(s.rmse)}{one_line(unit)} (fit {percentage(s.fit_pct)} %)"
            said.append(f"{_label(channel, output.name, c)} {error}")
    first = next(iter(comparisons.values()))
    return f"RMSE in {horizon_words(first.head, first.dt_s)}: {list_words(said)}." if said else ""


def subtitle(pairs: Heads, idle: Sequence[str] = ()) -> str:
    """What the title leaves open, and what to do; `idle` is `as_good_as_constant`."""
    if idle:
        rest = subtitle([(name, pair) for name, pair in pairs if name not in idle])
        who = f"On {list_words(idle)} a" if len(idle) < len(pairs) else "A"
        return f"{who} constant does as well in free run as either model: see the cautions. {rest}".rstrip()
    lost = [name for name, pair in pairs if _both_diverged((name, pair))]
    if lost:
        rest = subtitle([(name, pair) for name, pair in pairs if name not in lost])
        return f"Both models diverged in free run on {list_words(lost)}: see the cautions. {rest}".rstrip()
    if pairs and all(pair.verdict is Verdict.SAME for _, pair in pairs) and _all_linear(pairs):
        return " ".join(["A search for rules found none that lowers the error.", *_scopes(pairs)])
    if pairs and all(pair.verdict is Verdict.SAME for _, pair in pairs):
        both = f"the {name_model(pairs[0][1].model)} and the {base_words(pairs)}"
        said = f"In free run {both} are the same: keep the simpler one."
        return " ".join([said, *_scopes(pairs)])
    sentences = [
        *_gains(pairs),
        *_say_divergence(pairs),
        *_say_contested(pairs),
        *_one_rule(pairs),
        *_scopes(pairs),
    ]
    base = base_words(pairs) if pairs else ""
    for verdict, text in (
        (Verdict.SAME, "both are the same in free run: keep the {base} there."),
        (Verdict.WORSE, "the {base} is better in free run: keep it there."),
        (Verdict.NOT_ENOUGH, "there is not enough held-out data to tell."),
    ):
        names = [name for name, pair in pairs if pair.verdict is verdict]
        if names and len(names) < len(pairs):
            sentences.append(f"On {list_words(names)} {text.format(base=base)}")
    return " ".join(sentences)


def _all_linear(pairs: Heads) -> bool:
    """What the search for rules came back with is a linear model on every channel."""
    return all(pair.one_rule for _, pair in pairs)


def _two_runs(pairs: Heads) -> bool:
    """The same structure of two runs against each other: neither is the simpler by its nature."""
    labels = [name.partition(":") for name in (pairs[0][1].model, pairs[0][1].baseline)]
    return all(mark for _, mark, _ in labels) and labels[0][2] == labels[1][2]


def _both_diverged(head: tuple[str, Pair]) -> bool:
    return head[1].evidence.diverged_baseline and head[1].evidence.diverged_model


def _say_divergence(pairs: Heads) -> list[str]:
    """Where a better verdict only says that the baseline diverged: no error to compare, so no number."""
    names = [n for n, p in pairs if p.evidence.diverged_baseline and not p.evidence.diverged_model]
    if not names:
        return []
    base = base_words(pairs)
    return [f"On {list_words(names)} the {base} diverged in free run, so there is no error to compare with."]


def _gains(pairs: Heads) -> list[str]:
    """Where the model is better, by how much, and how sure that is; of four channels at most."""
    said = [
        f"{-p.change_pct:.0f} % smaller on {name} (95 %: {-p.ci95[1]:.0f} to {-p.ci95[0]:.0f} %)"
        for name, p in pairs
        if p.earned and p.change_pct is not None and p.ci95 is not None
    ]
    typical = " on a typical flight" if narrow_scope(pairs).is_unseen else ""
    return [f"In free run{typical} its error is {list_words(said)}."] if 0 < len(said) <= 4 else []


def _scopes(pairs: Heads) -> list[str]:
    """What the verdicts leave open of other flights, each reservation once."""
    said: dict[str, list[str]] = {}
    for name, pair in pairs:
        for words in scope_words(pair):
            said.setdefault(words, []).append(name)
    if len(pairs) == 1:
        return [f"{words[0].upper()}{words[1:]}." for words in said]
    return [f"On {list_words(names)}: {words}." for words, names in said.items()]


def _say_contested(pairs: Heads) -> list[str]:
    """Where a better verdict is owed to the choice of the baseline."""
    return [
        f"On {name} {one_line(p.model).upper()} is better than {one_line(p.baseline).upper()}, which the "
        f"training data chose, and not shown to be better than {named(p.short_of)}: do not quote it so."
        for name, p in pairs
        if p.contested
    ]


def _one_rule(pairs: Heads) -> list[str]:
    """Where a better verdict only says that another linear model is better."""
    names = [n for n, p in pairs if p.verdict is Verdict.BETTER and p.one_rule]
    if not names:
        return []
    return [
        f"On {list_words(names)} {pairs[0][1].model.upper()} is better with one rule. That is a linear "
        "model: the gain comes from its order or refinement, not from fuzziness."
    ]


def basis(comparisons: Mapping[str, Comparison], train_s: float | None) -> str:
    """On what data, and how it was judged."""
    pairs = heads(comparisons)
    first = next(iter(comparisons.values()))
    segments = max(c.scored_segments for c in comparisons.values())
    seconds = max(sum(len(s) for s in c.test.segments) * c.dt_s for c in comparisons.values())
    rates = sorted({round(1.0 / c.dt_s, 3) for c in comparisons.values()})
    bases = dict.fromkeys(one_line(c.baseline).upper() for c in comparisons.values())
    against = _introduce(base_words(pairs) if pairs else name_model(first.baseline), " or ".join(bases))
    if first.contender:
        name = contender_words(pairs) if pairs else name_model(first.contender)
        model = _introduce(name, one_line(first.contender).upper())
        against = f"{model} against {against}"
    held = f"{counted(segments, 'held-out segment')} ({rough_duration(seconds)})"
    words = f"{against[0].upper()}{against[1:]} on {held}"
    if train_s:
        words += f" after training on {rough_duration(train_s)}"
    words += ", " + " and ".join(significant(r) for r in rates) + " Hz."
    if pairs:
        words += f" Judged on free-run error over {_units(pairs)}"
        words += ", each left out once" if any(p.basis.rotated for _, p in pairs) else ""
        words += ", corrected for several channels (Holm)." if len(pairs) > 1 else "."
    if any(p.basis.rotated for _, p in pairs):
        words += (
            " Each flight was judged by models that were fitted in the same way to the others. How far these "
            "are from the models shown and saved, those of the split, is taken off: by what both do on "
            "flights that both have seen."
        )
    return f"{words} {start_words(comparisons)}"


def _units(pairs: Heads) -> str:
    """ "30 flights", "16 blocks of 7.18 s", or where channels differ "14 to 20 blocks of time"."""
    said = []
    for kind in dict.fromkeys(p.unit.partition(" ")[0] for _, p in pairs):
        alike = dict.fromkeys((p.units, p.unit) for _, p in pairs if p.unit.startswith(kind))
        few = min(units for units, _ in alike)
        many = max(units for units, _ in alike)
        number_of = f"{few}" if few == many else f"{few} to {many}"
        unit = next(iter(alike))[1] if len(alike) == 1 else {"blocks": "blocks of time"}.get(kind, kind)
        said.append(f"{number_of} {one_line(unit)}")
    return " or ".join(said)


def _introduce(name: str, label: str) -> str:
    """ "fuzzy model (TS)"; the label alone where it is all there is to say."""
    return label if name.upper() == label else f"{name} ({label})"


def start_words(comparisons: Mapping[str, Comparison]) -> str:
    """How free runs start."""
    longest = max(c.start_s for c in comparisons.values())
    return (
        "The initial condition of every model is estimated from the same measured window of up to "
        f"{longest:.2g} s, which is not scored."
    )
