"""Words for the sets of rules on one axis, from where a rule speaks.

Where sets overlap, a centre alone would mislead: a wide set under a narrow one speaks on both sides of it. So
with one antecedent the axis is cut wherever another rule becomes the strongest, the pieces are named in their
order, and a rule is called by its pieces: "backward", "slow or fast to the left", "away from 0.5 m". With
several antecedents no axis says alone who is the strongest; sets are named by the order of their centres,
those at one place by their widths. Rules that no word tells apart are counted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby, pairwise

import numpy as np

from flysid.dataset import FloatArray
from flysid.model.rules.memberships import Partition
from flysid.model.rules.vocabulary import Axis, Name, Vocabulary, name_directions, name_sizes, tongue_of

_AT_ZERO = 0.08  # of the range: a centre nearer to zero is at zero
_AROUND_ZERO = 0.15  # of the range: a piece around zero that reaches no farther is at zero
_SAME_PLACE = 0.25  # of the narrowest width: centres closer than this are at one place
_WIDER = 1.5  # a set is told from another at the same place when it is this much wider
_SHORT = 0.03  # of the range: shorter pieces are not worth a word
_STEPS = 1000  # of the axis, where it is looked who is the strongest


@dataclass(frozen=True)
class Piece:
    """Where one rule, or several that are alike, are the strongest on an axis, in its unit."""

    level: int
    low: float
    high: float


# ---------------------------------------------------------------------------------------- one antecedent


def pieces(partition: Partition) -> tuple[list[Piece], list[list[int]]]:
    """Who is the strongest along the only antecedent, in order; and the rules of every level.

    Rules with nearly the same set are one level. Pieces below 3 % of the range are left to their neighbours;
    a level that is nowhere the strongest, or hardly anywhere, has none.
    """
    low = float(partition.low[0])
    high = float(partition.high[0])
    levels = _levels_of(partition)
    centre, left, right = (
        np.array([[side[rules, 0].mean()] for rules in levels])
        for side in (partition.centre, partition.left, partition.right)
    )
    merged = replace(partition, centre=centre, left=left, right=right)
    x = np.linspace(low, high, _STEPS + 1)
    strongest = merged.firing(0.5 * (x[1:] + x[:-1])[:, None]).argmax(axis=1)
    cuts = [0, *(np.flatnonzero(np.diff(strongest)) + 1).tolist(), _STEPS]
    found = [Piece(int(strongest[a]), float(x[a]), float(x[b])) for a, b in pairwise(cuts)]
    return _without_short(found, _SHORT * (1.0 - 1e-9) * (high - low)), levels


def _without_short(found: Sequence[Piece], least: float) -> list[Piece]:
    """The longer pieces, or all where none is; gaps go half to either side, pieces of one level are one."""
    long = [p for p in found if p.high - p.low >= least] or list(found)
    runs = [list(run) for _, run in groupby(long, key=lambda p: p.level)]
    cuts = [0.5 * (one[-1].high + other[0].low) for one, other in pairwise(runs)]
    ends = [found[0].low, *cuts, found[-1].high]
    return [Piece(run[0].level, *between) for run, between in zip(runs, pairwise(ends), strict=True)]


def words_of_one(partition: Partition, axis: Axis) -> tuple[list[str], list[list[Piece]]]:
    """A word for every rule over the only antecedent, all different; and where each is the strongest."""
    found, levels = pieces(partition)
    centre = [float(partition.centre[rules, 0].mean()) for rules in levels]
    said = _words_of_levels(found, centre, axis)
    words = [""] * len(partition)
    places: list[list[Piece]] = [[] for _ in range(len(partition))]
    for level, rules in enumerate(levels):
        for r in rules:
            words[r] = said[level]
            places[r] = [p for p in found if p.level == level]
    return distinct(words, partition, 0), places


def _words_of_levels(found: Sequence[Piece], centre: Sequence[float], axis: Axis) -> list[str]:
    """A word per level, from the pieces in which it is the strongest."""
    tongue = tongue_of(axis)
    named = _named_pieces(found, axis, tongue)
    if named is None:  # more pieces than words
        return [f"near {axis.place(c)}" for c in centre]
    around = _around_one(found, centre, axis)
    if around and (tongue is None or len(found) == 1):
        return around
    of = [[name for level, name in named if level == i] for i in range(len(centre))]
    said = [
        _join(names, tongue) if names else f"near {axis.place(c)}"
        for names, c in zip(of, centre, strict=True)
    ]
    most = max(range(len(of)), key=lambda i: len(of[i]))
    if len(of) > 1 and (len(of[most]) > 2 or len(found) == 1):
        said[most] = "anywhere else"
    return [word or "anywhere" for word in said]


def _around_one(found: Sequence[Piece], centre: Sequence[float], axis: Axis) -> list[str]:
    """ "near 0.5 m" and "away from 0.5 m" where one of two sets lies within the other; nothing otherwise.

    The inner one may be the strongest nowhere: at one centre a narrow set just reaches a wide one.
    """
    if len(centre) != 2 or [p.level for p in found] not in ([0, 1, 0], [1, 0, 1], [0], [1]):
        return []
    outer = found[0].level
    at = centre[1 - outer]
    if len(found) == 3 and not found[1].low <= at <= found[1].high:
        at = 0.5 * (found[1].low + found[1].high)
    return [f"{'away from' if i == outer else 'near'} {axis.place(at)}" for i in range(2)]


def _named_pieces(
    found: Sequence[Piece], axis: Axis, tongue: Vocabulary | None
) -> list[tuple[int, Name]] | None:
    """(level, name) of every piece in order; None where there are more than words."""
    if tongue is None:
        scale = name_sizes(axis).get(len(found))
        return None if scale is None else [(p.level, ("", w)) for p, w in zip(found, scale, strict=True)]
    parts: list[tuple[int, int]] = []
    for p in found:
        parts += [(p.level, sign) for sign in _signs(p, axis.span)]
    names = name_directions([sign for _, sign in parts], tongue)
    return None if names is None else [(level, n) for (level, _), n in zip(parts, names, strict=True)]


def _signs(piece: Piece, span: float) -> tuple[int, ...]:
    """-1, 0, 1: below, at, above zero; a piece that reaches far to both sides is cut there."""
    below = max(-piece.low, 0.0)
    above = max(piece.high, 0.0)
    if piece.high <= 0.0 or piece.low >= 0.0:
        return (-1,) if piece.high <= 0.0 else (1,)
    if max(below, above) <= _AROUND_ZERO * span:
        return (0,)
    if min(below, above) <= _AT_ZERO * span:
        return (-1,) if below > above else (1,)
    return (-1, 1)


def _join(names: Sequence[Name], tongue: Vocabulary | None) -> str:
    """ "slow or fast to the left", "backward or slow forward", "low or high"."""
    if tongue is None:
        return " or ".join(size for _, size in names)
    directions = dict.fromkeys(direction for direction, _ in names)
    said = []
    for direction in directions:
        sizes = [size for d, size in names if d == direction]
        said.append(tongue.say(direction, sizes[::-1] if direction == tongue.below else sizes))
    return " or ".join(said)


# ------------------------------------------------------------------------------------ several antecedents


def words_of_several(partition: Partition, axes: Sequence[Axis]) -> list[list[str]]:
    """[rule][antecedent]: a word where it tells this rule from another, else "".

    Sets that cover the whole range say nothing. Rules of equal words get numbers.
    """
    columns = [_words_along(partition, j, axis) for j, axis in enumerate(axes)]
    words = [list(row) for row in zip(*columns, strict=True)]
    whole = ["; ".join(row) for row in words]
    for row, plain, text in zip(words, whole, distinct(whole, partition, None), strict=True):
        if text != plain:
            at = max((j for j, word in enumerate(row) if word), default=0)
            row[at] = (row[at] or "anywhere") + text[len(plain) :]
    return words


def _words_along(partition: Partition, j: int, axis: Axis) -> list[str]:
    width = 0.5 * (partition.left[:, j] + partition.right[:, j])
    words = [""] * len(partition)
    speaking = np.flatnonzero(width <= axis.span)
    if not len(speaking):
        return words
    said = set_words(partition.centre[speaking, j], width[speaking], axis, alone=len(speaking) < len(words))
    for r, word in zip(speaking.tolist(), said, strict=True):
        words[r] = word
    return words


def set_words(centre: FloatArray, width: FloatArray, axis: Axis, *, alone: bool = False) -> list[str]:
    """A word for every set by the order of centres (R,); sets at one place differ by their widths (R,).

    Parameters
    ----------
    alone : other rules say nothing of this axis, so that one place is worth a word as well.
    """
    words = labels(centre, axis, apart=_SAME_PLACE * float(width.min()))
    if alone and not any(words):
        words = [f"near {axis.place(float(c))}" for c in centre]
    for word in set(words):
        same = [r for r, w in enumerate(words) if w == word]
        if len(same) < 2 or width[same].max() < _WIDER * width[same].min():
            continue
        middle = np.sqrt(width[same].max() * width[same].min())
        place = axis.place(float(centre[same].mean()))
        for r in same:
            near = width[r] < middle
            only = f"near {place}" if near else f"away from {place}"
            words[r] = f"{word}, {'narrowly' if near else 'widely'}" if word else only
    return words


def labels(values: FloatArray, axis: Axis, *, apart: float = 0.0) -> list[str]:
    """A word for each value from its position among the others; values closer than `apart` share one.

    Speeds are told by size and direction ("fast forward", "hovering"), changes of a signal from sample to
    sample as falling or rising, what has both signs as negative or positive, everything else as low, middle,
    high. Where all values are at one place, words are empty.
    """
    levels, level = _levels(values, max(apart, 0.02 * axis.span))
    if len(levels) < 2:
        return ["" for _ in values]
    tongue = tongue_of(axis)
    if tongue is None:
        scale = name_sizes(axis).get(len(levels))
        said = None if scale is None else list(scale)
    else:
        nearest = min(levels, key=abs)
        zero = nearest if abs(nearest) <= _AT_ZERO * axis.span else None
        names = name_directions([0 if v == zero else -1 if v < 0 else 1 for v in levels], tongue)
        said = None if names is None else [tongue.say(d, [size]) for d, size in names]
    if said is None:
        said = [f"near {axis.place(v)}" for v in levels]
    return [said[i] for i in level]


def distinct(words: Sequence[str], partition: Partition, j: int | None) -> list[str]:
    """The same words, equal ones told apart: by width, by order, or at last by a number.

    Parameters
    ----------
    j : the antecedent that they are about; None for several.
    """
    told = list(words)
    for word in dict.fromkeys(words):
        same = [r for r, w in enumerate(words) if w == word]
        if len(same) > 1:
            for r, suffix in zip(same, _suffixes(partition, same, j), strict=True):
                told[r] = f"{word}, {suffix}"
    return told


def _suffixes(partition: Partition, same: Sequence[int], j: int | None) -> list[str]:
    if j is not None and len(same) == 2:
        width = 0.5 * (partition.left[same, j] + partition.right[same, j])
        centre = partition.centre[same, j]
        if width.max() > 1.1 * width.min():
            return ["narrowly" if w == width.min() else "widely" for w in width]
        if centre[0] != centre[1]:
            return ["the lower" if c == centre.min() else "the higher" for c in centre]
    order = sorted(same, key=lambda r: tuple(partition.centre[r].tolist()))
    return [f"{order.index(r) + 1} of {len(same)}" for r in same]


def _levels(values: FloatArray, tolerance: float) -> tuple[list[float], list[int]]:
    """Distinct values in order, and which of them each value is."""
    levels: list[float] = []
    for value in np.sort(values):
        if not levels or value - levels[-1] > tolerance:
            levels.append(float(value))
    level = [int(np.abs(np.array(levels) - v).argmin()) for v in values]
    return levels, level


def _levels_of(partition: Partition) -> list[list[int]]:
    """Rules by level, in the order of their centres: those whose sets are nearly one set share a level."""
    centre = partition.centre[:, 0]
    width = 0.5 * (partition.left[:, 0] + partition.right[:, 0])
    span = float(partition.high[0] - partition.low[0])
    apart = float(np.clip(_SAME_PLACE * width.min(), 0.02 * span, 0.1 * span))
    levels: list[list[int]] = []
    for r in np.argsort(centre, kind="stable").tolist():
        like = next(
            (
                level
                for level in levels
                if centre[r] - centre[level[0]] <= apart
                and max(width[r], width[level[0]]) < _WIDER * min(width[r], width[level[0]])
            ),
            None,
        )
        if like is None:
            levels.append([r])
        else:
            like.append(r)
    return levels
