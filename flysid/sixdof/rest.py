"""What physics leaves of flights, and the rules on it that hold on flights which are left out in turn."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from flysid.sixdof.descent import Places
from flysid.sixdof.fitted import FittedVehicle
from flysid.sixdof.horizons import conditions_of, drive, force_apart, torque_apart
from flysid.sixdof.record import Record
from flysid.sixdof.rules import CANDIDATES, QUANTITIES, ROLL, Conditions, HingeRule, base_of, hinge
from flysid.sixdof.thrust_fit import WINDOW_S
from flysid.sixdof.torque_fit import BLOCK_S, band_of, filter_columns
from flysid.stretch import FloatArray


@dataclass(frozen=True, eq=False)
class _Part:
    """A whole stretch in the air: (n, 6) what physics leaves of its accelerations, under which conditions."""

    flight: str
    dt_s: float
    conditions: Conditions
    left: FloatArray

    def smoothed(self, axis: int, columns: FloatArray) -> FloatArray:
        """(n', C) means over short windows; of turns, what lies in the band that torques are found in."""
        if axis >= ROLL:
            return filter_columns(band_of(self.dt_s), columns)
        width = max(round(WINDOW_S / self.dt_s), 1)
        whole = columns[: len(columns) // width * width]
        means = whole.reshape(-1, width, columns.shape[1]).mean(axis=1)
        return np.asarray(means - means.mean(axis=0))

    def blocks(self, rows: int) -> int:
        """Blocks of time that so many rows are."""
        return min(max(round(len(self.left) * self.dt_s / BLOCK_S), 1), rows)


@dataclass(frozen=True)
class _Candidate:
    axis: int
    base: str
    quantity: str
    above: float
    reach: float


class _Sums:
    """Of one acceleration: products of bases, candidates and what is left, summed over blocks of time.

    Parameters
    ----------
    rows : (n, B + K + 1) bases, candidates, what is left.
    fold, block : (n,) which rows are left out together, and which hang together.
    base_at : (K,) the base of every candidate; alike : (K,) base and quantity.
    """

    def __init__(
        self,
        rows: FloatArray,
        fold: Places,
        block: Places,
        base_at: Sequence[int],
        alike: Sequence[tuple[str, str]],
    ) -> None:
        self.base_at = base_at
        self.alike = alike
        self._bases = rows.shape[1] - len(base_at) - 1
        size = np.sqrt(np.mean(rows**2, axis=0))
        self._size = np.where(size > 0.0, size, 1.0)
        scaled = rows / self._size
        self._blocks = _products(scaled, block)
        self._folds = _products(scaled, fold)
        self._whole = self._blocks.sum(axis=0)

    def places(self, chosen: Sequence[int]) -> list[int]:
        """Columns of candidates, and behind them those of their bases."""
        return [*(self._bases + k for k in chosen), *sorted({self.base_at[k] for k in chosen})]

    def solve(self, places: Sequence[int]) -> FloatArray:
        """(C,) least squares of what is left on these columns."""
        return np.asarray(_solve(self._whole, places) * self._size[-1] / self._size[list(places)])

    def odds(self, chosen: Sequence[int], candidate: int) -> float:
        """Chance of an effect of this size where there is none; its spread is that of leaving blocks out."""
        from scipy.special import stdtr

        places = self.places([candidate, *chosen])
        each = np.array([_solve(self._whole - block, places)[0] for block in self._blocks])
        count = len(each)
        spread = float(np.sqrt((count - 1) * np.mean((each - each.mean()) ** 2)))
        return 2.0 * float(stdtr(count - 1, -abs(_solve(self._whole, places)[0]) / spread)) if spread else 1.0

    def helps(self, chosen: Sequence[int], candidate: int) -> bool:
        """Whether flights that are left out in turn have smaller errors than with the base alone."""
        places = self.places([candidate, *chosen])
        ratio = [self._left(fold, places) / self._left(fold, places[1:]) for fold in self._folds]
        return float(np.mean(ratio)) < 1.0

    def _left(self, fold: FloatArray, places: Sequence[int]) -> float:
        numbers = np.append(-_solve(self._whole - fold, places), 1.0)
        rows = np.ix_([*places, -1], [*places, -1])
        return float(numbers @ fold[rows] @ numbers) + np.finfo(float).tiny

    def choose(self, chance: float) -> list[int]:
        """Candidates, the surest first, that hold beside those before them: one of a base and a quantity."""
        chosen: list[int] = []
        others = list(range(len(self.base_at)))
        while others:
            odds = {k: self.odds(chosen, k) for k in others}
            best = min(others, key=lambda k: odds[k])
            if odds[best] > chance:
                break
            if not self.helps(chosen, best):
                others.remove(best)
                continue
            chosen.append(best)
            others = [k for k in others if self.alike[k] != self.alike[best]]
        return chosen


def _products(rows: FloatArray, group: Places) -> FloatArray:
    """(G, C, C) sums of products of columns over groups of rows."""
    return np.array([rows[group == g].T @ rows[group == g] for g in np.unique(group)])


def _solve(products: FloatArray, places: Sequence[int]) -> FloatArray:
    """(C,) least squares of the last column on others; of columns that are alike the least."""
    own = list(places)
    return np.asarray(np.linalg.pinv(products[np.ix_(own, own)], hermitian=True) @ products[own, -1])


def find_rules(
    records: Sequence[Record],
    vehicle: FittedVehicle,
    *,
    cuts: Sequence[float] = (0.5, 0.8),
    chance: float = 0.05,
    far: float = 0.98,
    folds: int = 3,
) -> tuple[HingeRule, ...]:
    """Rules that make smaller what is left of flights which are left out in turn.

    Parameters
    ----------
    records : with velocities, attitudes and positions.
    cuts : quantiles of a quantity that are tried as its threshold, beside its least value.
    chance : of any rule at all where none is true. A rule's gain over blocks of time must exceed what chance
        gives to one of all candidates (Student's t, Bonferroni).
    far : quantile of a quantity up to which a rule grows, and at which its effect is stated.
    folds : of fewer flights, so many parts of each are left out in turn.
    """
    parts = [part for record in records for part in _parts_of(record, vehicle)]
    if not parts:
        return ()
    together = {
        name: np.concatenate([quantity.read(part.conditions) for part in parts])
        for name, quantity in QUANTITIES.items()
    }
    reach = {name: float(np.quantile(values, far)) for name, values in together.items()}
    candidates = [
        _Candidate(axis, base, name, above, reach[name])
        for axis, bases in CANDIDATES.items()
        for base, names in bases.items()
        for name in names
        for above in _thresholds(together[name], cuts, reach[name])
    ]
    found = []
    for axis in CANDIDATES:
        own = [each for each in candidates if each.axis == axis]
        sums = _sums_of(parts, axis, own, folds)
        chosen = sums.choose(chance / len(candidates))
        places = sums.places(chosen)
        numbers = dict(zip(places, sums.solve(places).tolist(), strict=True))
        for k, place in zip(chosen, places, strict=False):
            each = own[k]
            plain = numbers.pop(sums.base_at[k], 0.0)  # once, whatever leans on it
            found.append(
                HingeRule(axis, each.base, each.quantity, each.above, plain, numbers[place], each.reach)
            )
    return tuple(found)


def _thresholds(values: FloatArray, cuts: Sequence[float], reach: float) -> list[float]:
    """Zero, or the least value where that is below it, and quantiles; none that hardly anything passes."""
    least = min(float(values.min()), 0.0)
    tried = {least, *np.quantile(values, cuts).tolist()}
    return sorted(each for each in tried if each < reach)


def _parts_of(record: Record, vehicle: FittedVehicle) -> Iterator[_Part]:
    """The stretches of a record, at air speeds where its wind is known."""
    wind = {facts.name: facts.wind for facts in vehicle.flights}.get(record.flight)
    if wind is not None and record.velocity is not None:
        record = replace(record, velocity=record.velocity - [*wind, 0.0])
    driven = drive(record, vehicle)
    conditions = conditions_of(record, driven)
    left = np.hstack([force_apart(record, driven, vehicle), torque_apart(record, driven)])
    for first, last in record.stretches:
        rows = slice(first, last - 1)
        yield _Part(record.flight, record.dt_s, conditions[rows], left[rows])


def _sums_of(parts: Sequence[_Part], axis: int, candidates: Sequence[_Candidate], folds: int) -> _Sums:
    bases = list(CANDIDATES[axis])
    names = list(dict.fromkeys(part.flight for part in parts))
    tables: list[FloatArray] = []
    fold: list[Places] = []
    block: list[Places] = []
    for part in parts:
        at = part.conditions
        own = [base_of(at, axis, base) for base in bases]
        bent = [own[bases.index(c.base)] * hinge(at, c.quantity, c.above, c.reach) for c in candidates]
        table = part.smoothed(axis, np.column_stack([*own, *bent, part.left[:, axis]]))
        rows = np.arange(len(table))
        before = block[-1][-1] + 1 if block else 0
        block.append(before + rows * part.blocks(len(table)) // len(table))
        few = len(names) < folds
        fold.append(rows * folds // len(table) if few else np.full(len(table), names.index(part.flight)))
        tables.append(table)
    return _Sums(
        np.concatenate(tables),
        np.concatenate(fold),
        np.concatenate(block),
        [bases.index(each.base) for each in candidates],
        [(each.base, each.quantity) for each in candidates],
    )
