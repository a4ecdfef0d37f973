"""Verdicts and changes in words, the same on the terminal, in Markdown and on the page."""

from __future__ import annotations

from collections.abc import Sequence

from flysid.escaping import one_line
from flysid.showing import list_words, percent
from flysid.validate.compare.comparison import Comparison, Pair
from flysid.validate.compare.intervals import FEW, Scope
from flysid.validate.compare.trials import FREE_RUN
from flysid.validate.compare.verdict import ALPHA, LARGE_PCT, MARGIN_PCT, Verdict

BELOW = "< resolution"


def change_words(pair: Pair) -> str:
    """ "−30 %", or why there is no such number."""
    if pair.evidence.diverged_model or pair.evidence.diverged_baseline:
        return "diverged"
    if pair.change_pct is None:
        return "-"
    if abs(pair.evidence.rmse_model - pair.evidence.rmse_baseline) < pair.evidence.resolution:
        # a ratio of two errors that are both too small to tell apart says nothing, however large it is
        return percent(pair.change_pct, 1) if abs(pair.change_pct) < LARGE_PCT else BELOW
    return percent(pair.change_pct, 1)


def verdict_words(pair: Pair, scoped: bool = True) -> str:
    """ "TS better", "TS better on this flight", "same within 5 %", "not enough data"; or who diverged.

    Without more words a verdict is of another flight; `scoped` is False where what it is of stands above.
    """
    model = one_line(pair.model).upper()
    base = one_line(pair.baseline).upper()
    if pair.evidence.diverged_baseline:
        return "both diverged" if pair.evidence.diverged_model else f"{model} better: {base} diverged"
    if pair.evidence.diverged_model:
        return f"{model} worse: it diverged"
    where = "" if pair.scope is Scope.ANOTHER or not scoped else f" on {pair.scope}"
    if pair.contested:
        return f"{model} better than {base}{where}, not shown against {named(pair.short_of)}"
    if pair.verdict in (Verdict.BETTER, Verdict.WORSE):
        return f"{model} {pair.verdict}{where}" + (" (one rule: linear)" if pair.one_rule else "")
    if pair.verdict is Verdict.SAME and pair.ci95 is not None:
        e = pair.evidence
        reach = max(map(abs, pair.ci95))
        told = abs(e.rmse_model - e.rmse_baseline) >= e.resolution
        within = next((f" within {m:g} %" for m in (MARGIN_PCT, LARGE_PCT) if told and reach < m), "")
        return f"{pair.verdict}{within}{where}"
    return str(pair.verdict)


def judged_words(pair: Pair) -> str:
    """The reason of a verdict, and what has to be known of its scope."""
    return "; ".join([pair.reason, *scope_words(pair)])


def scope_words(pair: Pair) -> list[str]:
    """What a verdict leaves open, by how many flights it rests on."""
    if pair.ci95 is None:
        return []
    shown = pair.verdict in (Verdict.BETTER, Verdict.WORSE)
    if pair.basis.rotated:
        turns = f"each of {pair.units} flights was left out once and judged by models fitted to the others"
        return [turns, *_refit_words(pair), *_rare_words(pair, shown), *_alike_words(pair)]
    if pair.scope.is_unseen:
        few = _few_words(pair, shown)
        return [*few, *_rare_words(pair, shown), *_alike_words(pair), *_pooled_words(pair)]
    said = []
    if pair.scope is Scope.THESE:
        said.append("these are parts of flights that the models trained on: another flight may differ")
    else:
        said.append("one flight does not show whether another would agree")
    if pair.basis.slow:
        lasts = f"{pair.scope} last{'s' * (pair.scope is not Scope.THESE)}"
        said.append(f"the error changes more slowly than {lasts}: only a large difference can be seen")
    return said


def _few_words(pair: Pair, shown: bool) -> list[str]:
    changes = list(pair.basis.by_flight.values())
    if len(changes) > FEW or shown or pair.verdict is Verdict.SAME or pair.change_pct is None:
        return []
    lower = sum(c < 0.0 for c in changes)
    return [
        f"too few flights to generalise to another; on these {pair.units}: lower on {lower}, "
        f"{percent(pair.change_pct)} typically"
    ]


def _refit_words(pair: Pair) -> list[str]:
    """Where fits to other flights give models that are as far off as matters: they end in several minima."""
    e = pair.evidence
    told = abs(e.rmse_model - e.rmse_baseline) >= e.resolution
    if pair.change_pct is None or pair.ci95 is None or not told:
        return []
    whole = 1.0 + pair.change_pct / 100.0
    changes = [100.0 * (whole * (1.0 + d / 100.0) - 1.0) for d in pair.basis.apart.values()]
    low, high = min(changes), max(changes)
    if low >= pair.ci95[0] - MARGIN_PCT and high <= pair.ci95[1] + MARGIN_PCT:
        return []
    return [
        f"fitted to some of these flights, models come out at {percent(low)} to {percent(high)}: what a fit "
        "finds depends on the flights it is given; try more --effort, or more flights"
    ]


def _rare_words(pair: Pair, shown: bool) -> list[str]:
    """Which kinds of flights may be missing: those that N flights hold with less than 95 % certainty."""
    often_pct = 100.0 * (1.0 - ALPHA ** (1.0 / pair.units))
    if not shown or often_pct > 50.0:  # of fewer than five flights more is said, or too little to say this
        return []
    kind = f"a kind of flight that makes up less than {often_pct:.0f} % of all"
    return [f"among {pair.units} flights {kind} may be missing"]


def _alike_words(pair: Pair) -> list[str]:
    """Where neighbours are alike: for how many flights of other days all of them stand."""
    if pair.basis.effective is None or pair.scope is Scope.ANOTHER:
        return []
    return [
        f"flights next to each other are alike: for other days these {pair.units} count as about "
        f"{max(pair.basis.effective, 1.0):.0f}"
    ]


def _pooled_words(pair: Pair) -> list[str]:
    """Where all samples together say something else than a typical flight: one flight carries them."""
    pooled = pair.pooled_pct
    flights = pair.basis.by_flight
    if pooled is None or not flights or pair.ci95 is None or pair.ci95[0] <= pooled <= pair.ci95[1]:
        return []
    side = 1.0 if pooled > pair.ci95[1] else -1.0
    far = max(flights.items(), key=lambda flight: side * flight[1])
    return [f"pooled over all samples the change is {percent(pooled)}: flight {one_line(far[0])} dominates"]


def named(models: Sequence[str]) -> str:
    """ "ARX", "ARX and OE", "ARX, OE and LINE"."""
    return list_words([one_line(m).upper() for m in models])


def interval_words(pair: Pair) -> str:
    """ "[−38, −24]", or "" where there is none or it would say nothing."""
    if pair.ci95 is None or change_words(pair) in (BELOW, "diverged") or pair.ci95[0] > 1000.0:
        return ""
    low, high = (percent(v, 1).removesuffix(" %") for v in pair.ci95)
    return f"[{low}, {high}]"


def horizon_words(horizon: str, dt_s: float) -> str:
    """ "free run", "10 steps (0.5 s)", "1 step (0.05 s)"."""
    if horizon == FREE_RUN:
        return "free run"
    steps = int(horizon)
    return f"{steps} step{'s' if steps > 1 else ''} ({steps * dt_s:.3g} s)"


def physics_words(comparison: Comparison, only: str | None = None) -> list[str]:
    """Whether a physical model is enough, for every output and every such model that was compared.

    `only`: of this output alone, which is then not named.
    """
    said = []
    for entry in comparison.entries:
        if entry.horizon != comparison.head or only not in (None, entry.output.name):
            continue
        for name, info in comparison.models.items():
            pair = entry.pairs.get(name)
            if pair is None or not info.physical:
                continue
            against = f"{verdict_words(pair)}, against {one_line(pair.baseline).upper()}"
            if pair.verdict is Verdict.NOT_ENOUGH:
                words = "these flights do not show whether a physical model is enough."
            elif pair.verdict is Verdict.WORSE:
                words = f"a physical model is not enough ({against})."
            else:
                words = f"a physical model is enough ({against})."
            whole = f"{words[0].upper()}{words[1:]}"
            said.append(f"{one_line(entry.output.name)}: {words}" if only is None else whole)
    return said
