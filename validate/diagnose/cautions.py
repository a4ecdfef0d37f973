"""Before you rely on this: what a reader must know, in words, worst first, each with what to do."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial

from flysid.escaping import one_line
from flysid.extras import Extra, extra
from flysid.feedback import BIASED, REMEDY
from flysid.ingest.align.doubts import REMARKS, Doubt
from flysid.showing import counted, percent
from flysid.validate.compare.comparison import Comparison, Pair
from flysid.validate.compare.intervals import FEW
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import Verdict
from flysid.validate.diagnose.caution import Caution, Comparisons, Diagnoses, heads, join
from flysid.validate.diagnose.caution_models import (
    beyond_band,
    collinear,
    contested,
    one_rule,
    own_constants,
    runs_away,
    spare_words,
    unsure_gains,
    useless,
)
from flysid.validate.diagnose.diagnostics import Diagnosis, Outside
from flysid.validate.diagnose.nearness import UNUSUAL

MOST = 6
LISTED = 3
"""Channels that a caution describes one by one."""
UNDECIDED: Mapping[str, tuple[str, str]] = {
    "units": (
        "Not enough held-out data for a verdict in free run on {}.",
        "fly more, or hold out a larger share.",
    ),
    "output": (
        "The held-out output of {} does not vary, so no model can be judged on it.",
        "hold out flights that move it, or check the recipe's signals.",
    ),
    "input": (
        "No input of {} moves on the held-out part: the response to an input was not tested.",
        "hold out flights with manoeuvres, or check the recipe's signals.",
    ),
}
CautionRule = Callable[[Comparisons, Diagnoses], Iterator[Caution]]
_ORDER = ("danger", "warning", "note", "good")
WEIGHTS: Mapping[str, float] = {
    "quiet": 9.0,
    "slow": 6.0,
    "short": 5.5,
    "narrow": 4.5,
    "holes": 4.2,
    "kinematics": 4.0,
    "pooled": 3.5,
    "band": 0.4,
}
"""Coherence is left out: it is judged on the held-out part, by a rule of its own."""


def cautions(
    comparisons: Mapping[str, Comparison],
    diagnoses: Mapping[str, Diagnosis],
    doubts: Mapping[str, Sequence[Doubt]] | None = None,
) -> tuple[Caution, ...]:
    """At most six, worst first; what holds for several channels stands once.

    `doubts` are reasons in the training data themselves, by channel.
    """
    found = [*extra(Extra.CAUTIONS, lambda: list(in_the_data(doubts or {})), (), "the data")]
    for rule in _rules():
        own = partial(_cautions_by, rule, comparisons, diagnoses)
        found += extra(Extra.CAUTIONS, own, (), f"'{rule.__name__.strip('_').replace('_', ' ')}'")
    if not any(c.level == "danger" for c in found):
        found += extra(Extra.CAUTIONS, partial(_all_stable, comparisons, diagnoses), (), "'all stable'")
    found.sort(key=lambda c: (_ORDER.index(c.level), -c.weight))
    return tuple(found[:MOST])


def _cautions_by(rule: CautionRule, comparisons: Comparisons, diagnoses: Diagnoses) -> list[Caution]:
    return list(rule(comparisons, diagnoses))


def _rules() -> tuple[CautionRule, ...]:
    return (
        _diverged, useless, contested, one_rule, own_constants, runs_away, _unstable, _unexplained,
        _extrapolates, _holes,
        _missing_dynamics, _undecided, _few, unsure_gains, collinear, _feedback, _noisy_start, _not_white,
        _one_step_flatters, _idle_rules, beyond_band, spare_words, _unused,
    )  # fmt: skip


def _who(said: Mapping[str, set[str]]) -> str:
    """ "v_x, v_y (both models), v_z (ts)"."""
    return join(
        f"{name} ({'both models' if len(who) > 1 else next(iter(who)).upper()})" for name, who in said.items()
    )


def _diverged(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """One caution per model: the verdict is about those of the headline, so these come first."""
    del diagnoses
    said: dict[tuple[bool, str], list[str]] = {}
    for channel, c in comparisons.items():
        if FREE_RUN not in c.horizons:
            continue
        entry = c.entry(horizon=FREE_RUN)
        for name, score in entry.models.items():
            if score.diverged:
                first = min(score.diverged, key=lambda s: s.diverged_s or 0.0)
                said.setdefault((name in heads(c), name), []).append(
                    f"{channel}, in {len(score.diverged)} of "
                    f"{counted(len(score.segments), 'held-out segment')}, "
                    f"first at t = {first.diverged_s:.1f} s ({one_line(c.segments[first.segment])})"
                )
    for (headline, name), where in said.items():
        more = f"; and on {len(where) - LISTED} more" if len(where) > LISTED else ""
        yield Caution(
            "danger" if headline else "warning",
            one_line(f"{name.upper()} diverged in free run on {'; '.join(where[:LISTED])}{more}.")
            + (" It is counted as a loss." if headline else ""),
            "do not simulate with it; lower its order, or train on flights that cover this range.",
            10.0 if headline else 0.5,
        )


def _unstable(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    local: list[str] = []
    linear: list[str] = []
    for channel, d in diagnoses.items():
        for name, radius in d.pole_radius.items():
            info = comparisons[channel].models.get(name)
            if info is not None and radius > 1.0 + 1e-6:
                said = f"{channel} ({name.upper()}, largest pole radius {radius:.4f})"
                (local if info.n_rules > 1 else linear).append(said)
    if local:
        yield Caution(
            "warning",
            f"A local model is unstable by itself (a pole outside the unit circle) on {join(local)}.",
            "check long simulations: the neighbouring rules may or may not stabilise it.",
            5.0,
        )
    if linear:
        yield Caution(
            "warning",
            f"A model is unstable for small motions (a pole outside the unit circle) on {join(linear)}.",
            "do not use it for long simulations; fit with a lower order.",
            5.0,
        )


def _extrapolates(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    of: list[tuple[str, Outside]] = [
        (n, o) for n, d in diagnoses.items() for o in d.outside if o.share > 0.01
    ]
    if of:
        shared = {o.signal.name for n, o in of for m, p in of if n != m and o.signal.name == p.signal.name}
        said = join(
            f"{o.signal.name}{f' of {n}' if o.signal.name in shared else ''} ({100 * o.share:.1f} %)"
            for n, o in of
        )
        channel, worst = max(of, key=lambda item: item[1].share)
        where = one_line(comparisons[channel].segments[worst.worst_segment])
        yield Caution(
            "warning",
            f"Held-out samples leave the training range on {said}, most in "
            f"{where} ({100 * worst.worst_share:.0f} % of {one_line(worst.signal.name)}). "
            "Models extrapolate poorly; these samples are included in every number here.",
            "train on flights that reach this range, or hold out others.",
            2.0 + worst.share,
        )


def _holes(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Held-out samples where training has been all around, and never near."""
    of = [(name, d.near) for name, d in diagnoses.items() if d.near is not None and d.near.far > UNUSUAL]
    if of:
        said = join(f"{name} ({100 * near.far:.0f} %)" for name, near in of)
        channel, worst = max(of, key=lambda item: item[1].far)
        where = one_line(comparisons[channel].segments[worst.worst_segment])
        yield Caution(
            "warning",
            "Held-out samples lie in holes of the training data, inside its range but far from every sample: "
            f"{said}, most in {where} ({100 * worst.worst_far:.0f} %). The models are untested there.",
            "train on inputs of many amplitudes, over the whole range of the output.",
            2.0 + worst.far,
        )


def _missing_dynamics(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    said: dict[str, set[str]] = {}
    peaks: list[float] = []
    for channel, d in diagnoses.items():
        c = comparisons[channel]
        for out in d.outputs:
            for name in heads(c):
                for correlation in out.dependence.get(name, ()):
                    lag, rho = correlation.peak
                    if correlation.fails and abs(rho) > 0.1:
                        said.setdefault(out.output.name, set()).add(name)
                        peaks.append(lag * c.dt_s)
    if said:
        span = f"{min(peaks):.2g} to {max(peaks):.2g} s" if max(peaks) > min(peaks) else f"{peaks[0]:.2g} s"
        yield Caution(
            "warning",
            f"The free-run error still follows the input on {_who(said)}; peak {span} after the input. "
            "Some dynamics are missing.",
            "more input lags, a higher order or another antecedent variable.",
            1.0 + 0.01 * len(said),
        )


def _unexplained(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    said = [
        out.output.name
        for channel, d in diagnoses.items()
        for out in d.outputs
        if any(s is not None for s in out.responses)
        and all(s is None or s.largest < 0.5 for s in out.responses)
        and not _followed(comparisons[channel], out.output.name)
    ]
    if said:
        yield Caution(
            "warning",
            f"No input explains half of the output at any frequency on {join(said)} (coherence below 0.5): "
            "no model from these inputs can follow it.",
            "excite the command more, look for a missing input or wind, or check the recipe's signals.",
            4.0,
        )


def _followed(c: Comparison, output: str) -> bool:
    """Some model's free run explains half of the output, whatever a short record's coherence says."""
    if FREE_RUN not in c.horizons:
        return False
    return any((m.scores.vaf_pct or 0.0) >= 50.0 for m in c.entry(output, FREE_RUN).models.values())


def _noisy_start(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    del diagnoses
    said: dict[str, set[str]] = {}
    for c in comparisons.values():
        steps = [h for h in c.horizons if h not in (FREE_RUN, "1")]
        if FREE_RUN not in c.horizons or not steps:
            continue
        for output in c.test.outputs:
            free = c.entry(output.name, FREE_RUN)
            ahead = c.entry(output.name, steps[0])
            for name in heads(c):
                pair = [e.models[name].scores.rmse for e in (free, ahead)]
                if pair[1] > 1.2 * pair[0] and pair[1] > pair[0] + free.resolution:
                    said.setdefault(output.name, set()).add(name)
    if said:
        yield Caution(
            "note",
            f"A few steps ahead, the error is larger than in free run on {_who(said)}: each prediction "
            "starts from a few raw, noisy samples.",
            "simulate with these models; to predict, filter the measurement first.",
            0.9,
        )


def _undecided(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Why there is no verdict, one caution per reason."""
    del diagnoses
    said: dict[str, list[str]] = {}
    for c in comparisons.values():
        for output, pair in c.verdict.items():
            if pair.verdict is Verdict.NOT_ENOUGH:
                e = pair.evidence
                kind = "output" if e.constant else "input" if e.still else "units"
                said.setdefault(kind, []).append(
                    f"{output} ({pair.units} {pair.unit})" if kind == "units" else output
                )
    for kind, where in said.items():
        words, todo = UNDECIDED[kind]
        yield Caution("warning", words.format(join(where)), todo, 3.0 if kind == "units" else 6.5)


def _few(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """Verdicts that rest on too few flights to speak of others, or not on flights at all."""
    del diagnoses
    few = {name: c for name, c in comparisons.items() if any(_is_few(p) for p in c.verdict.values())}
    if few:
        counts = sorted({len(c.test.flights) for c in few.values()})
        number = f"{counts[0]} to {counts[-1]}" if len(counts) > 1 else str(counts[0])
        yield Caution(
            "note",
            f"Only {number} held-out flight{'s' if counts[-1] > 1 else ''} on {join(list(few))}: too few to "
            "generalise to another day, battery or wind.",
            f"hold out whole flights, {FEW + 1} or more.",
            2.0 if counts[0] == 1 else 0.95,
        )


def _is_few(pair: Pair) -> bool:
    return not pair.scope.is_unseen or pair.units <= FEW


def _feedback(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    """The test is the fit's own, `flysid.feedback`."""
    del comparisons
    said = list(dict.fromkeys(loop.seen for d in diagnoses.values() for loop in d.loops if loop.closed))
    if said:
        yield Caution("note", one_line(f"{' '.join(said)} {BIASED}."), f"{REMEDY}.", 1.0)


def _not_white(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    failed = {
        name.upper()
        for channel, d in diagnoses.items()
        for out in d.outputs
        for name in heads(comparisons[channel])
        if name in out.whiteness and out.whiteness[name].fails
    }
    if failed:
        yield Caution(
            "note",
            f"One-step residuals of {join(sorted(failed))} are not white (see Residual tests). That limits "
            "the noise model, not the free-run comparison above, which serves simulation and control design.",
            "quote free-run numbers.",
            0.6,
        )


def _one_step_flatters(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    del diagnoses
    gains: list[tuple[float, float]] = []
    for c in comparisons.values():
        if c.contender and {FREE_RUN, "1"} <= set(c.horizons):
            for output in c.test.outputs:
                free = c.entry(output.name, FREE_RUN).pairs[c.contender].change_pct
                one = c.entry(output.name, "1").pairs[c.contender].change_pct
                if free is not None and one is not None and abs(free) > 10.0 and abs(one) < 0.5 * abs(free):
                    gains.append((free, one))
    if gains:
        free, one = max(gains, key=lambda g: abs(g[0]))
        yield Caution(
            "note",
            f"One step ahead the error changes by {percent(one)}, in free run by {percent(free)}: one-step "
            "error flatters every model and says little about either.",
            "quote free-run numbers.",
            0.5,
        )


def _idle_rules(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    said = [
        f"R{i + 1} of {name.upper()} ({channel})"
        for channel, d in diagnoses.items()
        for name in heads(comparisons[channel])
        if name in d.rule_use
        for i, mean in enumerate(d.rule_use[name].mean)
        if mean < 0.01
    ]
    if said:
        yield Caution(
            "note",
            f"Rules that hardly fire on held-out data: {join(said[:6])}"
            f"{' and more' if len(said) > 6 else ''}. The held-out data do not test them.",
            "use fewer rules, or hold out flights that reach them.",
            0.8,
        )


def _unused(comparisons: Comparisons, diagnoses: Diagnoses) -> Iterator[Caution]:
    del diagnoses
    short = sum(c.unused_segments for c in comparisons.values())
    if short:
        yield Caution(
            "note",
            f"{counted(short, 'held-out segment')} too short to score "
            f"{'were' if short > 1 else 'was'} left out.",
            "log without gaps, or hold out longer segments.",
            0.7,
        )


def _all_stable(comparisons: Comparisons, diagnoses: Diagnoses) -> Sequence[Caution]:
    """Only of models that have poles: a static one is stable without merit. Of all of them, or of none."""
    for channel, d in diagnoses.items():
        asked = {name for name, info in comparisons[channel].models.items() if not info.reference}
        if not asked <= d.pole_radius.keys():
            return ()
    dynamic = {
        (channel, m): r for channel, d in diagnoses.items() for m, r in d.pole_radius.items() if r > 0.0
    }
    rules = sum(comparisons[channel].models[m].n_rules for channel, m in dynamic)
    if not dynamic or max(dynamic.values()) > 1.0:
        return ()
    models = f"All {rules} local models are" if rules > 1 else "The model is"
    radius = max(dynamic.values())
    return (
        Caution("good", f"{models} stable (largest pole radius {radius:.3f}); no free run diverged.", ""),
    )


def in_the_data(doubts: Mapping[str, Sequence[Doubt]]) -> Iterator[Caution]:
    """What alignment found in the data, by channel; the same of several channels stands once."""
    said: dict[tuple[str, str, str], list[str]] = {}
    for channel, own in doubts.items():
        for d in own:
            if d.kind == "band":  # another one for every channel: listed
                said.setdefault((d.kind, "", d.todo), []).append(d.text)
            else:
                said.setdefault((d.kind, d.text, d.todo), []).append(channel)
    for (kind, text, todo), whom in said.items():
        if kind in WEIGHTS:
            words = f"{join(whom)}: {text}." if text else f"{join(whom)}."
            level = "note" if kind in REMARKS else "warning"
            yield Caution(level, one_line(words), f"{todo}." if todo else "", WEIGHTS[kind])
