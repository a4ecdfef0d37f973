"""Rules in words: labels from position, equations with names, numbers with the digits they deserve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.base import Rule
from flysid.model.memberships import Partition

_SCALES: Mapping[int, tuple[str, ...]] = {
    1: ("any",),
    2: ("low", "high"),
    3: ("low", "middle", "high"),
    4: ("very low", "low", "high", "very high"),
    5: ("very low", "low", "middle", "high", "very high"),
    6: ("extremely low", "very low", "low", "high", "very high", "extremely high"),
    7: ("extremely low", "very low", "low", "middle", "high", "very high", "extremely high"),
}
_SPEED = ("hovering", "slow", "moderate", "fast", "very fast", "extremely fast")
_DIRECTIONS: Mapping[str, tuple[str, str]] = {
    "vx": ("backward", "forward"),
    "vy": ("to the left", "to the right"),
    "vz": ("down", "up"),
}
_SPEED_UNITS = frozenset({"m/s", "m s-1", "m*s-1", "cm/s", "mm/s", "km/h"})


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


def labels(values: FloatArray, name: str = "", unit: str = "", span: float = 0.0) -> list[str]:
    """A linguistic label for each value, from its position among the others.

    Speeds are told by size and direction ("fast forward", "slow backward", "hovering"); everything else
    as low, middle, high. Values closer than 2 % of `span` share a label. More than seven distinct values
    are numbered.
    """
    levels, level = _levels(values, 0.02 * span)
    if unit in _SPEED_UNITS and len(levels) > 1 and span > 0 and levels[0] < 0.05 * span:
        words = _speed_words(levels, name, span)
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


def _speed_words(levels: Sequence[float], name: str, span: float) -> list[str]:
    """Direction from the sign, size from the rank on that side of zero."""
    key = "".join(c for c in name.lower() if c.isalnum())
    below, above = next((d for k, d in _DIRECTIONS.items() if key.startswith(k)), ("negative", "positive"))
    still = 0.08 * span
    negative = sorted((v for v in levels if v < -still), reverse=True)
    positive = sorted(v for v in levels if v > still)
    words = []
    for value in levels:
        side, direction = (negative, below) if value < -still else (positive, above)
        if abs(value) <= still:
            rest = [v for v in levels if abs(v) <= still]
            words.append("hovering" if len(rest) == 1 else f"nearly hovering ({number(value)})")
            continue
        rank = side.index(value) + 1
        size = "fast" if len(side) == 1 and abs(value) > 0.35 * span else _SPEED[min(rank, len(_SPEED) - 1)]
        if len(side) == 2 and rank == 2:
            size = "fast"
        words.append(f"{size} {direction}")
    return words


def condition_in_words(partition: Partition, r: int, names: Sequence[str], units: Sequence[str]) -> str:
    """ "v_x(k-1) is A2 'slow forward' (about 0.51 +- 0.2 m/s) and ...", or "always" for a single rule.

    An antecedent whose set covers the whole range for this rule says nothing and is left out.
    """
    if len(partition) == 1:
        return "always"
    parts = []
    for j, (name, unit) in enumerate(zip(names, units, strict=True)):
        span = float(partition.high[j] - partition.low[j])
        width = 0.5 * float(partition.left[r, j] + partition.right[r, j])
        if width > span and len(names) > 1:
            continue
        centre = float(partition.centre[r, j])
        word = labels(partition.centre[:, j], name, unit, span)[r]
        about = f"about {number(centre)} +- {number(width)}" + (f" {unit}" if unit else "")
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
    if rule.pole_radius >= 1.0:
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
    known = np.isfinite(low) and np.isfinite(high)
    return f"{number(value)} [{number(low)}, {number(high)}]" if known else number(value)
