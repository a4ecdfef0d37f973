"""Rules in words: labels from position, equations with names, numbers with the digits they deserve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.base import Rule
from flysid.model.fuzzy.memberships import Partition

_SCALES: Mapping[int, tuple[str, ...]] = {
    2: ("low", "high"),
    3: ("low", "middle", "high"),
    4: ("very low", "low", "high", "very high"),
    5: ("very low", "low", "middle", "high", "very high"),
    6: ("extremely low", "very low", "low", "high", "very high", "extremely high"),
    7: ("extremely low", "very low", "low", "middle", "high", "very high", "extremely high"),
}
_SIZES: Mapping[int, tuple[str, ...]] = {
    2: ("slow", "fast"),
    3: ("slow", "moderate", "fast"),
    4: ("very slow", "slow", "fast", "very fast"),
    5: ("very slow", "slow", "moderate", "fast", "very fast"),
}
_CHANGES: Mapping[int, tuple[str, ...]] = {2: ("slowly", "quickly"), 3: ("slowly", "steadily", "quickly")}
_DIRECTIONS: Mapping[str, tuple[str, str]] = {
    "vx": ("backward", "forward"),
    "vy": ("to the left", "to the right"),
    "vz": ("down", "up"),
}
_SPEED_UNITS = frozenset({"m/s", "m s-1", "m*s-1", "cm/s", "mm/s", "km/h"})
_ON_CIRCLE = 1e-6  # a pole so near to one that it integrates, but for rounding
_SAME_PLACE = 0.25  # of the narrowest width: centres closer than this are at one place
_WIDER = 1.5  # a set is told from another at the same place when it is this much wider


def number(value: float) -> str:
    """Three significant digits, plain where that is short."""
    if value == 0 or not np.isfinite(value):
        return "0" if value == 0 else str(value)
    return f"{value:.3g}" if 1e-3 <= abs(value) < 1e4 else f"{value:.2e}"


def equation(left: str, gains: FloatArray, terms: Sequence[str], offset: float) -> str:
    """ "v(k) = 0.97 v(k-1) - 0.003 u(k-1) + 0.01"; terms with gain 0 are left out."""
    parts = [(float(g), f" {t}") for g, t in zip(gains, terms, strict=True) if g != 0] + [(float(offset), "")]
    text = ""
    for value, term in parts:
        if value == 0 and text:
            continue
        sign = "-" if value < 0 else "+"
        text += f" {sign} {precise(abs(value)) if term else number(abs(value))}{term}"
    return f"{left} = {text[3:] if text.startswith(' + ') else text[1:]}"


def precise(value: float) -> str:
    """Four digits, more where a lag polynomial near 1, 2, 3 needs them to mean anything."""
    return f"{value:.4g}" if value < 0.5 or value >= 1e4 else f"{value:.5f}".rstrip("0").rstrip(".")


def labels(
    values: FloatArray, name: str = "", unit: str = "", span: float = 0.0, *, apart: float = 0.0
) -> list[str]:
    """A linguistic label for each value, from its position among the others.

    Speeds are told by size and direction ("fast forward", "slow backward", "hovering"), changes of a signal
    from sample to sample as falling or rising, everything else as low, middle, high; beyond seven they are
    numbered. Values closer than `apart`, or 2 % of `span`, share a label; where all do, it is empty.
    """
    levels, level = _levels(values, max(apart, 0.02 * span))
    if len(levels) < 2:
        return ["" for _ in values]
    if ")-" in name:
        words = _signed_words(levels, span, ("falling", "steady", "rising"), _CHANGES)
    elif unit in _SPEED_UNITS and span > 0 and levels[0] < 0.05 * span:
        below, above = _direction(name)
        words = _signed_words(levels, span, (below, "hovering", above), _SIZES)
    elif len(levels) in _SCALES:
        words = list(_SCALES[len(levels)])
    else:
        words = [f"level {i + 1} of {len(levels)}" for i in range(len(levels))]
    return [words[i] for i in level]


def _levels(values: FloatArray, tolerance: float) -> tuple[list[float], list[int]]:
    """Distinct values in order, and which of them each value is."""
    levels: list[float] = []
    for value in np.sort(values):
        if not levels or value - levels[-1] > tolerance:
            levels.append(float(value))
    level = [int(np.abs(np.array(levels) - v).argmin()) for v in values]
    return levels, level


def _direction(name: str) -> tuple[str, str]:
    """What a negative and a positive speed of that name are called."""
    key = "".join(c for c in name.lower() if c.isalnum())
    return next((d for k, d in _DIRECTIONS.items() if key.startswith(k)), ("negative", "positive"))


def _signed_words(
    levels: Sequence[float], span: float, names: tuple[str, str, str], sizes: Mapping[int, tuple[str, ...]]
) -> list[str]:
    """A word per level: `names` are for below, at and above zero; several on one side differ by size.

    At most one level, the nearest to zero and within 8 % of the span of it, is "at zero".
    """
    below, still, above = names
    nearest = min(levels, key=abs)
    rest = nearest if abs(nearest) <= 0.08 * span else None
    sides = (
        [v for v in reversed(levels) if v < 0 and v != rest],
        [v for v in levels if v >= 0 and v != rest],
    )
    words = []
    for value in levels:
        if value == rest:
            words.append(still)
            continue
        side, direction = (sides[0], below) if value < 0 else (sides[1], above)
        words.append(_sized(side, side.index(value), direction, span, sizes))
    return words


def _sized(
    side: Sequence[float], rank: int, direction: str, span: float, sizes: Mapping[int, tuple[str, ...]]
) -> str:
    """ "slow forward" for the first of two speeds on a side; a single one is told by its size."""
    if len(side) == 1:
        small, large = sizes[2]
        word = large if abs(side[0]) > 0.35 * span else small
    elif len(side) in sizes:
        word = sizes[len(side)][rank]
    else:
        word = f"{rank + 1} of {len(side)}"
    return f"{word} {direction}" if sizes is _SIZES else f"{direction} {word}"


def set_words(partition: Partition, j: int, name: str, unit: str) -> list[str]:
    """A word for every rule's set over one antecedent; empty where it tells this rule from no other.

    Sets at one place are told apart by their widths: the narrow one speaks near it, the wide one away from
    it, because the narrow one outshouts it there.
    """
    centre = partition.centre[:, j]
    width = 0.5 * (partition.left[:, j] + partition.right[:, j])
    span = float(partition.high[j] - partition.low[j])
    words = labels(centre, name, unit, span, apart=_SAME_PLACE * float(width.min()))
    for word in set(words):
        same = [r for r, w in enumerate(words) if w == word]
        if len(same) < 2 or width[same].max() < _WIDER * width[same].min():
            continue
        middle = np.sqrt(width[same].max() * width[same].min())
        for r in same:
            near = width[r] < middle
            place = number(float(centre[same].mean())) + (f" {unit}" if unit else "")
            alone = f"near {place}" if near else f"away from {place}"
            words[r] = f"{word}, {'narrowly' if near else 'widely'}" if word else alone
    return words


def condition_in_words(partition: Partition, r: int, names: Sequence[str], units: Sequence[str]) -> str:
    """ "v_x(k-1) is A2 'slow forward' (about 0.51 +- 0.2 m/s) and ...", or "always" for a single rule.

    An antecedent that tells this rule from no other, or whose set covers the whole range, is left out.
    """
    if len(partition) == 1:
        return "always"
    parts = []
    for j, (name, unit) in enumerate(zip(names, units, strict=True)):
        span = float(partition.high[j] - partition.low[j])
        width = 0.5 * float(partition.left[r, j] + partition.right[r, j])
        word = set_words(partition, j, name, unit)[r]
        if not word or (width > span and len(names) > 1):
            continue
        about = f"about {number(float(partition.centre[r, j]))} +- {number(width)}" + (
            f" {unit}" if unit else ""
        )
        parts.append(f"{name} is A{r + 1} '{word}' ({about})")
    return " and ".join(parts) if parts else "always, a little"


def in_words(title: str, rules: Sequence[Rule], notes: Sequence[str]) -> str:
    """A whole model as text: title, rules with what they mean, notes."""
    lines = [title]
    for rule in rules:
        always = rule.condition.startswith("always")
        then = f"{rule.condition.capitalize()}:" if always else f"If {rule.condition}, then"
        lines.append(f"  {rule.label}. {then} {rule.conclusion}  [{meaning(rule)}]")
    return "\n".join([*lines, *(f"  - {note}" for note in notes)])


def meaning(rule: Rule) -> str:
    """ "gain 0.11, time constant 0.48 s, strongest for 32 % of the samples"; * where nearly integrating."""
    parts = [f"gain {', '.join(gains(rule))}"]
    if rule.pole_radius > 0:
        star = "*" if rule.pole_radius > 0.999 else ""
        parts.append(f"time constant {number(rule.time_constant_s)} s{star}")
    if rule.pole_radius >= 1.0 + _ON_CIRCLE:
        parts.append("unstable by itself")
    return ", ".join([*parts, f"strongest for {100 * rule.support:.0f} % of the samples"])


def gains(rule: Rule) -> list[str]:
    """Every steady gain with its 95 % interval where that is known: "0.29 [0.27, 0.31]"."""
    intervals = (
        np.full((2, *rule.dc_gain.shape), np.nan) if rule.gain_interval is None else rule.gain_interval
    )
    low, high = intervals.reshape(2, -1)
    return [_gain(*values) for values in zip(rule.dc_gain.ravel(), low, high, strict=True)]


def _gain(value: float, low: float, high: float) -> str:
    if not np.isfinite(value):
        return "integrates"
    known = low <= value <= high
    return f"{number(value)} [{number(low)}, {number(high)}]" if known else number(value)
