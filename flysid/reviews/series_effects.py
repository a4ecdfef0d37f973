"""Which change of a gain did what, beyond the scatter between flights of equal gains.

A figure is regressed on the logarithms of the gains that changed. Gains that rose together cannot be
separated, and count as one. The interval is Student's t of the residuals, never less than flights of equal
gains scatter. Where neither is there, as of one flight each, nothing separates gains from flights.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from flysid.dataset import FloatArray
from flysid.showing import significant

Gains = Mapping[str, float]
ONE_EACH = "one flight each cannot tell what gains did from how flights differ"
TOGETHER = 0.9
"""Correlation from which on two gains changed together."""


@dataclass(frozen=True, eq=False)
class Figure:
    """One figure over the flights of a series.

    `key`, `name`, `unit`: "lag", "roll lag", "ms".
    `values`, `halves`: (N,) NaN where it is not determined, and half of its own interval.
    """

    key: str
    name: str
    unit: str
    values: FloatArray
    halves: FloatArray


@dataclass(frozen=True)
class Effect:
    """What one gain, or several that changed together, did to a figure.

    `figure`, `unit`: whose.
    `gains`: names of what changed, and from where to where: ("p_roll", 46, 74).
    `start`, `end`: the figure at both.
    `change`, `interval`: between them, with 95 %.
    `flights`: on which it rests.
    `note`: what limits it.
    `knows_scatter`: whether the interval holds the scatter between flights; else that inside them alone.
    """

    figure: str
    unit: str
    gains: tuple[tuple[str, float, float], ...]
    start: float
    end: float
    change: float
    interval: tuple[float, float]
    flights: int
    note: str = ""
    knows_scatter: bool = True

    @property
    def is_clear(self) -> bool:
        """Beyond the scatter between flights."""
        return self.knows_scatter and (self.interval[0] > 0.0 or self.interval[1] < 0.0)

    @property
    def words(self) -> str:
        """ "roll lag 12 -> 6.3 ms while p_roll 46 -> 74 (change -5.6 ms [-8.4, -2.9])"."""
        gains = " and ".join(f"{name} {low:g} -> {high:g}" for name, low, high in self.gains)
        low, high = (significant(edge, 2) for edge in self.interval)
        change = f"change {significant(self.change, 2)} {self.unit} [{low}, {high}]"
        ends = f"{significant(self.start, 2)} -> {significant(self.end, 2)} {self.unit}"
        moved = ends if self.is_clear or not self.knows_scatter else "unchanged beyond the scatter"
        return f"{self.figure} {moved} while {gains} ({change}{'; ' + self.note if self.note else ''})"

    def to_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "figure": self.figure,
            "unit": self.unit,
            "gains": [{"name": name, "from": low, "to": high} for name, low, high in self.gains],
            "change": self.change,
            "ci95": list(self.interval),
            "clear": self.is_clear,
            "knows_scatter": self.knows_scatter,
            "flights": self.flights,
            "note": self.note,
        }


def effects(figure: Figure, gains: Sequence[Gains]) -> Iterator[Effect]:
    """Of the gains of an axis on one of its figures; none where nothing changed or too little is known."""
    known = np.flatnonzero(np.isfinite(figure.values)).tolist()
    if len(known) < 2:
        return
    stated = [gains[i] for i in known]
    groups = _groups_of_gains(stated)
    if not groups:
        return
    values, halves = figure.values[known], figure.halves[known]
    design = np.column_stack([np.log([own[names[0]] for own in stated]) for names in groups])
    spare = len(known) - design.shape[1] - 1
    if spare < 1:
        yield from _between_neighbours(figure, stated, values, halves)
        return
    yield from _regressed(figure, stated, groups, design, values)


def scatter_of_equals(values: FloatArray, gains: Sequence[Gains]) -> tuple[float, int]:
    """Standard deviation between flights of equal gains, and its degrees of freedom; NaN and 0 of none."""
    found: dict[tuple[tuple[str, float], ...], list[float]] = {}
    for value, own in zip(values.tolist(), gains, strict=True):
        if np.isfinite(value):
            found.setdefault(tuple(sorted(own.items())), []).append(value)
    alike = [np.asarray(group) for group in found.values() if len(group) > 1]
    free = sum(len(group) - 1 for group in alike)
    if not free:
        return float("nan"), 0
    squares = sum(float(((group - group.mean()) ** 2).sum()) for group in alike)
    return float(np.sqrt(squares / free)), free


def _groups_of_gains(stated: Sequence[Gains], *, least: float = 1.1) -> list[list[str]]:
    """Names of the gains that changed, those together that changed together; positive ones only.

    `least`: ratio of the largest to the smallest from which on a gain counts as changed.
    """
    names = []
    for name in stated[0]:
        values = [own.get(name, 0.0) for own in stated]
        if min(values) > 0.0 and max(values) >= least * min(values):
            names.append(name)
    groups: list[list[str]] = []
    for name in names:
        own = np.log([gains[name] for gains in stated])
        for group in groups:
            other = np.log([gains[group[0]] for gains in stated])
            if abs(float(np.corrcoef(own, other)[0, 1])) >= TOGETHER:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _regressed(
    figure: Figure,
    stated: Sequence[Gains],
    groups: Sequence[Sequence[str]],
    design: FloatArray,
    values: FloatArray,
) -> Iterator[Effect]:
    rows = np.column_stack([np.ones(len(values)), design - design.mean(axis=0)])
    found, *_ = np.linalg.lstsq(rows, values, rcond=None)
    spare = len(values) - rows.shape[1]
    left = float(np.sqrt(np.sum((values - rows @ found) ** 2) / spare))
    alike, free = scatter_of_equals(values, stated)
    scatter = max(left, alike) if free else left
    spread = scatter * np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))
    reach = float(stdtrit(spare, 0.975))
    level = float(found[0])
    for k, names in enumerate(groups, 1):
        column = rows[:, k]
        low, high = float(column.min()), float(column.max())
        change, half = (high - low) * float(found[k]), (high - low) * reach * float(spread[k])
        yield Effect(
            figure.name,
            figure.unit,
            tuple((n, min(own[n] for own in stated), max(own[n] for own in stated)) for n in names),
            level + low * float(found[k]),
            level + high * float(found[k]),
            change,
            (change - half, change + half),
            len(values),
            "not to be told apart" if len(names) > 1 else "",
        )


def _between_neighbours(
    figure: Figure, stated: Sequence[Gains], values: FloatArray, halves: FloatArray
) -> Iterator[Effect]:
    """Flight against the one before it, by the scatter of equal gains; without it nothing is clear."""
    alike, free = scatter_of_equals(values, stated)
    between = float(stdtrit(free, 0.975)) * np.sqrt(2.0) * alike if free else 0.0
    for i in range(1, len(values)):
        before, after = stated[i - 1], stated[i]
        changed = [name for name in before if before[name] != after.get(name, before[name])]
        half = max(float(np.hypot(halves[i - 1], halves[i])), between)
        if not changed or not np.isfinite(half):
            continue
        change = float(values[i] - values[i - 1])
        yield Effect(
            figure.name,
            figure.unit,
            tuple((name, before[name], after[name]) for name in changed),
            float(values[i - 1]),
            float(values[i]),
            change,
            (change - half, change + half),
            2,
            "" if free else ONE_EACH,
            free > 0,
        )
