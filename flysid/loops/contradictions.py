"""Results of two sets of gains that no plant can give, and how to read them.

At a loop's crossover a controller that amplifies more holds the loop's gain above one. On one plant its
crossover therefore lies higher, whatever that plant is. Where it came out lower, the plants differed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from flysid.loops.judged import Judged


def find_contradiction(soft: Judged, hard: Judged) -> str:
    """The sentence on two sets of an axis, where the stronger controller crosses lower beyond both intervals.

    Parameters
    ----------
    soft, hard : of one axis. "" where they do not contradict each other, or one of them is not known.

    Each interval is the set's own: that of one flight has the scatter of its stretches alone.
    """
    if soft.margins is None or hard.margins is None or soft.axis != hard.axis:
        return ""
    before, after = soft.margins.crossover_hz, hard.margins.crossover_hz
    if before.value is None or after.value is None or not after.high < before.low:
        return ""
    if not _amplifies_more(soft, hard):
        return ""
    changed = words_of_change(soft.gains, hard.gains)
    fell = f"{before.said('.1f', ' Hz')} to {after.said('.1f', ' Hz')}"
    return (
        f"contradiction: {changed}, yet crossover falls from {fell}. On one plant stronger gains raise it. "
        "Most likely the flights differ (battery, air, throttle, props): fly both sets again, alternating"
    )


def contradiction_of(judged: Judged, found: Iterable[Judged]) -> str:
    """The contradiction of a set of gains to the weaker one of its axis that crosses highest; "" of none."""
    told = [(soft, sentence) for soft in found if (sentence := find_contradiction(soft, judged))]
    return max(told, key=lambda pair: _crossover(pair[0]), default=(judged, ""))[1]


def words_of_change(before: Mapping[str, float], after: Mapping[str, float]) -> str:
    """ "P 55 -> 59, all else equal", of gains as the firmware names them."""
    changed = [
        f"{short_name(name)} {before[name]:g} -> {after[name]:g}"
        for name in before
        if name in after and before[name] != after[name]
    ]
    return f"{', '.join(changed) or 'filters changed'}, all else equal"


def short_name(gain: str) -> str:
    """ "P" of "rollPID P" and of "MC_ROLLRATE_P"."""
    return gain.split()[-1].split("_")[-1]


def _crossover(judged: Judged) -> float:
    return (judged.margins.crossover_hz.value if judged.margins is not None else None) or 0.0


def _amplifies_more(soft: Judged, hard: Judged) -> bool:
    """Whether one controller is the stronger wherever the crossover of the other may lie."""
    if soft.controller is None or hard.controller is None or soft.law != hard.law or soft.margins is None:
        return False
    crossover = soft.margins.crossover_hz
    f = np.linspace(crossover.low, crossover.high)
    weak, strong = (np.abs(own.controller.at_rest().feedback(f)) for own in (soft, hard) if own.controller)
    return bool(np.all(strong >= weak))
