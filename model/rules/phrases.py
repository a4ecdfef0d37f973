"""Rules in words: labels from position, equations with names, numbers with the digits they deserve."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.model.base import OperatingPoint, Rule
from flysid.model.rules.linguistics import Piece, words_of_one, words_of_several
from flysid.model.rules.memberships import Partition
from flysid.model.rules.operating_words import Signals, answers_alike, at_loudest, near, sentences
from flysid.model.rules.vocabulary import Axis, number

ELSEWHERE = "always, strongest where no other rule applies"
_INTEGRATES = "integrates"
# spreads of an input: a hair, and farther than it ever went
_LEAST_PUSH = 0.05
_MOST_PUSH = 3.0
_NEARLY_ONE = 0.999  # a pole so near to one nearly integrates
_ON_CIRCLE = 1e-6  # a pole so near to one that it integrates, but for rounding


def push_in_words(pushes: FloatArray, weights: FloatArray, r: int, given: Signal, spread: float) -> str:
    """What a rule's constant does, as if the input were another one than for the rules on average; "" where
    that is nothing, or more than was ever flown.

    Parameters
    ----------
    pushes : (R,) constant of every rule over its weight of the input.
    weights : (R,) of the rules in the mean.
    spread : of the input.
    """
    if not np.isfinite(pushes).all():
        return ""
    size = float(pushes[r] - np.average(pushes, weights=weights))
    if not _LEAST_PUSH * spread < abs(size) < _MOST_PUSH * spread:
        return ""
    way = "less" if size < 0 else "more"
    unit = f" {given.unit}" if given.unit else ""
    return f"its constant acts like {number(abs(size))}{unit} {way} {given.name}"


def from_to(before: FloatArray, after: FloatArray, signals: Sequence[Signal]) -> str:
    """ "0.036 -> 0.037 m/s", one of every signal: what a figure (n,) was and is."""
    return ", ".join(
        f"{number(float(a))} -> {number(float(b))} {s.unit}".rstrip()
        for a, b, s in zip(before, after, signals, strict=True)
    )


def equation(left: str, gains: FloatArray | Sequence[float], terms: Sequence[str], offset: float) -> str:
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


def condition_in_words(partition: Partition, r: int, names: Sequence[str], units: Sequence[str]) -> str:
    """ "v_x(k-1) is A2 'forward' (about 0.51 +- 0.2 m/s) and ...", or "always" for a single rule.

    With one antecedent the word is of where the rule is the strongest, which is said in numbers too where
    the centre does not tell it. With several, an antecedent that tells this rule from no other is left out.
    """
    if len(partition) == 1:
        return "always"
    ranges = zip(partition.low.tolist(), partition.high.tolist(), strict=True)
    axes = [Axis(n, u, low, high) for n, u, (low, high) in zip(names, units, ranges, strict=True)]
    if len(axes) == 1:
        words, places = words_of_one(partition, axes[0])
        return _is(partition, r, 0, axes[0], words[r], _strongest(partition, r, axes[0], places[r]))
    said = words_of_several(partition, axes)[r]
    parts = [_is(partition, r, j, axes[j], word) for j, word in enumerate(said) if word]
    return " and ".join(parts) if parts else ELSEWHERE


def _is(partition: Partition, r: int, j: int, axis: Axis, word: str, where: str = "") -> str:
    """ "v_x(k-1) is A2 'forward' (about 0.51 +- 0.2 m/s)"."""
    width = 0.5 * float(partition.left[r, j] + partition.right[r, j])
    about = f"{number(float(partition.centre[r, j]))} +- {number(width)}" + (
        f" {axis.unit}" if axis.unit else ""
    )
    return f"{axis.name} is A{r + 1} '{word}' (about {about}{where})"


def _strongest(partition: Partition, r: int, axis: Axis, places: Sequence[Piece]) -> str:
    """ "; strongest below -1.6 and from -0.9 to 0.2 m/s" where a rule's centre does not tell; else ""."""
    centre = float(np.clip(partition.centre[r, 0], axis.low, axis.high))
    if not places:
        return "; hardly anywhere the strongest"
    if len(places) == 1 and places[0].low <= centre <= places[0].high:
        return ""
    unit = f" {axis.unit}" if axis.unit else ""
    return "; strongest " + " and ".join(_between(p, axis) for p in places) + unit


def _between(piece: Piece, axis: Axis) -> str:
    if piece.low <= axis.low:
        return f"below {number(piece.high)}"
    if piece.high >= axis.high:
        return f"above {number(piece.low)}"
    return f"from {number(piece.low)} to {number(piece.high)}"


def in_words(
    title: str,
    rules: Sequence[Rule],
    notes: Sequence[str],
    signals: Signals = ((), ()),
    points: Sequence[OperatingPoint] = (),
) -> str:
    """A whole model as text: title, what it does from slow to fast, rules with what they mean, notes.

    Parameters
    ----------
    signals : outputs and inputs, for the names and units of gains.
    points : what the model does where its vehicle rests.
    """
    lines = [title, *(f"  * {sentence}" for sentence in sentences(points, signals))]
    for at, rule in enumerate(rules):
        always = rule.condition.startswith("always")
        then = f"{rule.condition.capitalize()}:" if always else f"If {rule.condition}, then"
        means = "" if points and len(rules) == 1 else f"  [{meaning(rule, signals, rules[:at], points)}]"
        lines.append(f"  {rule.label}. {then} {rule.conclusion}{means}")
    if any(_nearly_integrates(rule) and not rule.here for rule in rules):
        lines.append(
            "  * nearly integrates: gain and time constant depend on the last digits of the coefficients"
        )
    return "\n".join([*lines, *(f"  - {note}" for note in notes)])


def meaning(
    rule: Rule,
    signals: Signals = ((), ()),
    others: Sequence[Rule] = (),
    points: Sequence[OperatingPoint] = (),
) -> str:
    """What the model does where the rule speaks its loudest, and for which share of the samples it does.

    Of a model that comes to no rest, or whose operating points nobody looked for: the rule's own gain and
    slowest time constant; * where nearly integrating.

    Parameters
    ----------
    others : rules told already: where one of them answers alike, it is named with the place, and no number
        told again.
    points : the model's operating points.
    """
    parts = _where_loudest(rule, signals, others) if points else _by_itself(rule, signals)
    pushes = [rule.push] if rule.push else []
    return ", ".join([*parts, *pushes, f"strongest for {100 * rule.support:.0f} % of the samples"])


def _where_loudest(rule: Rule, signals: Signals, others: Sequence[Rule]) -> list[str]:
    if not rule.here:
        return ["never the strongest in equilibrium"]
    like = next((other for other in others if answers_like(rule, other)), None)
    if like is not None:
        return [f"same response {near(rule.here[0], signals)} as {like.label}"]
    return [f"strongest {at_loudest(point, signals)}" for point in rule.here]


def answers_like(rule: Rule, other: Rule) -> bool:
    """Whether the model answers alike where either is the loudest, within 10 % or the 95 % intervals."""
    same = len(rule.here) == len(other.here) > 0
    return same and all(answers_alike(p, q) for p, q in zip(rule.here, other.here, strict=True))


def _by_itself(rule: Rule, signals: Signals) -> list[str]:
    parts = [f"gain {', '.join(gains(rule, signals))}"]
    if rule.pole_radius > 0:
        star = "*" if _nearly_integrates(rule) else ""
        parts.append(f"time constant {number(rule.time_constant_s)} s{star}")
    if rule.pole_radius >= 1.0 + _ON_CIRCLE:
        parts.append("unstable by itself")
    return parts


def _nearly_integrates(rule: Rule) -> bool:
    return rule.pole_radius > _NEARLY_ONE


def gains(rule: Rule, signals: Signals = ((), ())) -> list[str]:
    """Every steady gain of the rule by itself: "0.29 m/s per deg".

    Of several, each with its names: "theta_in -> v_x 0.29".
    """
    said = [number(g) if np.isfinite(g) else _INTEGRATES for g in np.ravel(rule.dc_gain).tolist()]
    pairs = [(i, o) for o in signals[0] for i in signals[1]]
    if len(pairs) != len(said):
        return said
    texts = [
        text if text == _INTEGRATES else f"{text} {_per(i, o)}".rstrip()
        for text, (i, o) in zip(said, pairs, strict=True)
    ]
    if len(pairs) == 1:
        return texts
    return [f"{i.name} -> {o.name} {text}" for text, (i, o) in zip(texts, pairs, strict=True)]


def _per(given: Signal, answer: Signal) -> str:
    """ "m/s per deg"; "" where a unit is not known, or both are one."""
    if not (given.unit and answer.unit) or given.unit == answer.unit:
        return ""
    return f"{answer.unit} per {given.unit}"
