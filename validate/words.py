"""Numbers and names as people read them, the same on the terminal, in Markdown and on the page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from flysid.validate.compare import Pair
from flysid.validate.trials import FREE_RUN
from flysid.validate.verdict import LARGE_PCT, MARGIN_PCT, Verdict

BELOW = "< resolution"


def one_line(text: str) -> str:
    """`text` without control characters or line breaks: names come from logs."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in text)


def number(value: float | None, digits: int = 3) -> str:
    """`digits` significant digits without an exponent where that is short; "-" for None or not finite."""
    if value is None or not math.isfinite(value):
        return "-"
    if value == 0.0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        places = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{places}f}"
    return f"{value:.{digits - 1}e}"


def percent(value: float, places: int = 0) -> str:
    """A signed percentage with a true minus; "> +1000 %" where the number says nothing more."""
    if value > 1000.0:
        return "> +1000 %"
    text = f"{value:+.{places}f}"
    if float(text) == 0.0:
        text = f"{0.0:.{places}f}"
    return text.replace("-", "−") + " %"


def percentage(value: float | None) -> str:
    """One decimal and a true minus, without the sign of per cent; "-" for None, "< −999" below that."""
    if value is None or not math.isfinite(value):
        return "-"
    return "< −999" if value < -999.0 else f"{round(value, 1) + 0.0:.1f}".replace("-", "−")


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


def verdict_words(pair: Pair) -> str:
    """ "TS better", "no difference shown", "same within 5 %", "not enough data"; who diverged where one did.

    "Same within 5 %" is a difference that was shown and does not matter.
    """
    model, base = one_line(pair.model).upper(), one_line(pair.baseline).upper()
    if pair.evidence.diverged_baseline:
        return "both diverged" if pair.evidence.diverged_model else f"{model} better: {base} diverged"
    if pair.evidence.diverged_model:
        return f"{model} worse: it diverged"
    if pair.contested:
        return f"{model} better than {base}, not shown against {named(pair.short_of)}"
    if pair.verdict in (Verdict.BETTER, Verdict.WORSE):
        return f"{model} {pair.verdict}" + (" (one rule: linear)" if pair.one_rule else "")
    if pair.verdict is Verdict.SAME:
        small = pair.ci95 is not None and max(map(abs, pair.ci95)) < MARGIN_PCT
        return f"same within {MARGIN_PCT:g} %" if small and _shown(pair) else "no difference shown"
    return str(pair.verdict)


def _shown(pair: Pair) -> bool:
    """Whether the interval excludes no difference, of errors that the data can tell apart."""
    e = pair.evidence
    if pair.ci95 is None or abs(e.rmse_model - e.rmse_baseline) < e.resolution:
        return False
    return not pair.ci95[0] <= 0.0 <= pair.ci95[1]


def named(models: Sequence[str]) -> str:
    """ "ARX", "ARX and OE", "ARX, OE and LINE"."""
    names = [one_line(m).upper() for m in models]
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


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
