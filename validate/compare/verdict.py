"""The four verdicts, and the rule that chooses one.

| verdict | when (first that holds) |
|---|---|
| worse / better | only the model / only the baseline diverged in free run |
| same | both diverged |
| not enough data | the measured output, or every input, does not vary |
| same | the RMSEs differ by less than the data can resolve |
| not enough data | an error is zero, which leaves no interval |
| same | the 95 % interval of the change lies inside +-5 % |
| better / worse | the interval excludes 0 and so does the test after Holm's correction over channels |
| same | no difference shown, and the interval lies inside +-10 %: a large one is excluded |
| not enough data | everything else: a difference that matters is neither shown nor excluded |

"Better" and "worse" describe the model, against the baseline; a change below 0 % is a smaller error.
What a verdict speaks of, another flight or only these, is its scope
(`flysid.validate.compare.intervals.Scope`).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from flysid.model.selection import MARGIN

MARGIN_PCT = 100.0 * MARGIN
LARGE_PCT = 10.0
ALPHA = 0.05


class Verdict(StrEnum):
    BETTER = "better"
    WORSE = "worse"
    SAME = "same"
    NOT_ENOUGH = "not enough data"


@dataclass(frozen=True)
class Evidence:
    """What the rule looks at.

    Attributes
    ----------
    rmse_baseline, rmse_model : in the output's unit.
    resolution : smallest difference in RMSE that the data can show, same unit.
    diverged_baseline, diverged_model : any held-out segment reached the output limits in free run.
    low_pct, high_pct : interval of the change; None where it could not be computed.
    p : two-sided p-value after correction.
    constant : the measured output does not vary.
    still : no input varies, so nothing is shown of how the output answers one.
    """

    rmse_baseline: float
    rmse_model: float
    resolution: float
    diverged_baseline: bool = False
    diverged_model: bool = False
    low_pct: float | None = None
    high_pct: float | None = None
    p: float | None = None
    constant: bool = False
    still: bool = False


def decide(e: Evidence) -> tuple[Verdict, str]:
    """The verdict and its reason in words; see the module's docstring for the rule."""
    if e.diverged_model != e.diverged_baseline:
        if e.diverged_model:
            return Verdict.WORSE, "the model diverged in free run and the baseline did not"
        return Verdict.BETTER, "the baseline diverged in free run and the model did not"
    if e.diverged_model:
        return Verdict.SAME, "both diverged in free run: neither is usable"
    if e.constant:
        return Verdict.NOT_ENOUGH, "the measured output does not vary"
    if e.still:
        return Verdict.NOT_ENOUGH, "no input moves on the held-out part"
    if abs(e.rmse_model - e.rmse_baseline) < e.resolution:
        return Verdict.SAME, "the difference is below what the data can resolve"
    if e.low_pct is None or e.high_pct is None or e.p is None:
        return Verdict.NOT_ENOUGH, "an error is zero, which leaves no interval"
    return outcome_of_interval(e.low_pct, e.high_pct, e.p)


def outcome_of_interval(low: float, high: float, p: float) -> tuple[Verdict, str]:
    """The verdict and its reason from the interval of a change, percent, and the p-value of none."""
    if low > -MARGIN_PCT and high < MARGIN_PCT:
        return Verdict.SAME, f"the interval lies inside ±{MARGIN_PCT:g} %"
    if p < ALPHA and high < 0.0:
        return Verdict.BETTER, "the interval lies below 0 %"
    if p < ALPHA and low > 0.0:
        return Verdict.WORSE, "the interval lies above 0 %"
    if low > -LARGE_PCT and high < LARGE_PCT:
        return Verdict.SAME, f"a difference above {LARGE_PCT:g} % is excluded, and none is shown"
    return Verdict.NOT_ENOUGH, "a difference that matters is neither shown nor excluded"
