"""Rules in words: labels from position, equations with names, numbers with the digits they deserve."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from flysid.dataset import FloatArray, Signal
from flysid.extras import Extra, extra
from flysid.model.base import OperatingPoint, Rule
from flysid.model.polynomials import NEARLY_ONE, ROUNDING
from flysid.model.rules.linguistics import Piece, words_of_one, words_of_several
from flysid.model.rules.memberships import Partition
from flysid.model.rules.operating_words import WORTH, Signals, after, answers_like, near
from flysid.model.rules.vocabulary import Axis
from flysid.showing import significant

ELSEWHERE = "always, strongest where no other rule applies"
UNTOLD = "its sets hold"
"""A condition without words."""
# spreads of an input: farther than it ever went
_MOST_PUSH = 3.0


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
    if not WORTH * spread < abs(size) < _MOST_PUSH * spread:
        return ""
    way = "less" if size < 0 else "more"
    unit = f" {given.unit}" if given.unit else ""
    return f"its constant acts like {significant(abs(size))}{unit} {way} {given.name}"


def from_to(before: FloatArray, after: FloatArray, signals: Sequence[Signal]) -> str:
    """ "0.036 -> 0.037 m/s", one of every signal: what a figure (n,) was and is."""
    return ", ".join(
        f"{significant(float(a))} -> {significant(float(b))} {s.unit}".rstrip()
        for a, b, s in zip(before, after, signals, strict=True)
    )


def equation(left: str, gains: FloatArray | Sequence[float], terms: Sequence[str], offset: float) -> str:
    """ "v(k) = 0.97 v(k-1) - 0.003 u(k-1) + 0.01"; terms with gain 0 are left out."""
    return extra(Extra.CONCLUSION, partial(_equation, left, gains, terms, offset), f"{left} = ...")


def _equation(left: str, gains: FloatArray | Sequence[float], terms: Sequence[str], offset: float) -> str:
    parts = [(float(g), f"{precise(abs(g))} {t}") for g, t in zip(gains, terms, strict=True) if g != 0]
    if offset != 0 or not parts:
        parts.append((float(offset), significant(abs(offset))))
    text = "".join(f" {'-' if value < 0 else '+'} {words}" for value, words in parts)
    return f"{left} = {'-' if parts[0][0] < 0 else ''}{text[3:]}"


def precise(value: float) -> str:
    """Four digits, more where a lag polynomial near 1, 2, 3 needs them to mean anything."""
    return f"{value:.4g}" if value < 0.5 or value >= 1e4 else f"{value:.5f}".rstrip("0").rstrip(".")


def condition_in_words(partition: Partition, r: int, names: Sequence[str], units: Sequence[str]) -> str:
    """ "v_x(k-1) is A2 'forward' (about 0.51 +- 0.2 m/s) and ...", or "always" for a single rule.

    With one antecedent the word is of where the rule is the strongest, which is given in numbers too where
    the centre does not tell it. With several, an antecedent that tells this rule from no other is left out.
    """
    make = partial(_condition, partition, r, names, units)
    return extra(Extra.CONDITION, make, UNTOLD, f"R{r + 1}")


def _condition(partition: Partition, r: int, names: Sequence[str], units: Sequence[str]) -> str:
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
    centre = float(partition.centre[r, j])
    about = "" if word == f"near {axis.place(centre)}" else f"about {significant(centre)} "
    return f"{axis.name} is A{r + 1} '{word}' ({about}+- {axis.place(width)}{where})"


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
        return f"below {significant(piece.high)}"
    if piece.high >= axis.high:
        return f"above {significant(piece.low)}"
    return f"from {significant(piece.low)} to {significant(piece.high)}"


def in_words(
    title: str,
    rules: Sequence[Rule],
    notes: Sequence[str],
    signals: Signals = ((), ()),
    said: Sequence[str] = (),
) -> str:
    """A whole model as text: title, what it does from slow to fast, rules with what they mean, notes.

    Parameters
    ----------
    signals : outputs and inputs, for the names and units of gains.
    said : sentences on what the model does where its vehicle rests.
    """
    lines = [title, *(f"  * {sentence}" for sentence in said)]
    told = extra(Extra.MEANING, partial(meanings, rules, signals), [""] * len(rules))
    for rule, means in zip(rules, told, strict=True):
        if len(rules) == 1:
            means = "" if said else means
            then = rule.conclusion
        else:
            always = rule.condition.startswith("always")
            condition = f"{rule.condition.capitalize()}:" if always else f"If {rule.condition}, then"
            then = f"{rule.label}. {condition} {rule.conclusion}"
        lines.append(f"  {then}  [{means}]" if means else f"  {then}")
    return "\n".join([*lines, *(f"  - {note}" for note in notes)])


def meanings(rules: Sequence[Rule], signals: Signals = ((), ())) -> list[str]:
    """For which share of the samples every rule is the strongest, and what the model does where it is.

    Of a model that comes to no rest, or whose operating points nobody looked for: the rule's own gain and
    slowest time constant.
    """
    told = []
    for at, rule in enumerate(rules):
        known = bool(places_of(at, rules))
        alone = [f"strongest for {100 * rule.support:.0f} % of the samples"] if len(rules) > 1 else []
        means = _at_rest(at, rules, signals) if known else _by_itself(rule, signals)
        told.append("; ".join([*alone, *means, *([rule.push] if rule.push else [])]))
    return told


def _at_rest(at: int, rules: Sequence[Rule], signals: Signals) -> list[str]:
    """Where a rule is the loudest at rest, and what the model does there; or which other it does as."""
    rule = rules[at]
    if not rule.here:
        return [_never_strongest(at, rules, signals)]
    like = next((other.label for other in rules[:at] if answer_alike(rule, other)), None)
    said = []
    for point in rule.here:
        output = signals[0][point.output]
        figures = zip(point.gain.tolist(), signals[1], strict=True)
        several = len(signals[1]) > 1
        gain = ", ".join(_gain_text(g, given, output) + several * f" of {given.name}" for g, given in figures)
        reached = [float(t) for t in point.reached_s if np.isfinite(t)]
        times = f"{' and '.join(dict.fromkeys(map(significant, reached)))} s"
        does = f"as {like}" if like else f"gain {gain}"
        does += f", 63 % {after(reached, [point], times)}" if reached and not like else ""
        said.append(f"at rest {near(point, output)}: {does}")
    return said


def places_of(at: int, rules: Sequence[Rule]) -> list[OperatingPoint]:
    """The operating points at which a rule has a say: those of its own model, where there are several."""
    return [p for rule in rules for p in rule.here if np.isfinite(p.shares[at])]


def _never_strongest(at: int, rules: Sequence[Rule], signals: Signals) -> str:
    """How loudly at most a rule speaks at the operating points of the others, and where."""
    loudest = max(places_of(at, rules), key=lambda p: float(p.shares[at]))
    share = significant(100.0 * float(loudest.shares[at]))
    return f"never the strongest at rest, at most {share} % {near(loudest, signals[0][loudest.output])}"


def answer_alike(rule: Rule, other: Rule) -> bool:
    """Whether the model answers alike where either is the loudest, and is known to, see `answers_like`."""
    same = len(rule.here) == len(other.here) > 0
    return same and all(answers_like(p, q) for p, q in zip(rule.here, other.here, strict=True))


def _by_itself(rule: Rule, signals: Signals) -> list[str]:
    """Gain and slowest time constant, where the digits of its equation tell them."""
    if rule.pole_radius >= 1.0 + ROUNDING:
        return ["unstable by itself"]
    if not np.isfinite(rule.dc_gain).all():
        return ["integrates"]
    if rule.pole_radius > NEARLY_ONE:
        return ["nearly integrates"]
    slow = [f"time constant {significant(rule.time_constant_s)} s"] if rule.pole_radius > 0.0 else []
    return [f"gain {', '.join(gains(rule, signals))}", *slow]


def gains(rule: Rule, signals: Signals = ((), ())) -> list[str]:
    """Every steady gain of the rule by itself: "0.29 m/s per deg".

    Of several, each with its names: "theta_in -> v_x 0.29".
    """
    figures = np.ravel(rule.dc_gain).tolist()
    pairs = [(i, o) for o in signals[0] for i in signals[1]]
    if len(pairs) != len(figures):
        return [significant(g) for g in figures]
    named = len(pairs) > 1
    return [
        named * f"{i.name} -> {o.name} " + _gain_text(g, i, o)
        for g, (i, o) in zip(figures, pairs, strict=True)
    ]


def _gain_text(gain: float, given: Signal, answer: Signal) -> str:
    """ "0.29 m/s per deg"; the figure alone where a unit is not known, or both are one."""
    if not (given.unit and answer.unit) or given.unit == answer.unit:
        return significant(gain)
    return f"{significant(gain)} {answer.unit} per {given.unit}"
