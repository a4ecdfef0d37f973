"""The words there are for places on a physical axis: signs, sizes, scales."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from flysid.showing import significant

_SCALES: Mapping[int, tuple[str, ...]] = {
    1: ("",),
    2: ("low", "high"),
    3: ("low", "middle", "high"),
    4: ("very low", "low", "high", "very high"),
    5: ("very low", "low", "middle", "high", "very high"),
    6: ("extremely low", "very low", "low", "high", "very high", "extremely high"),
    7: ("extremely low", "very low", "low", "middle", "high", "very high", "extremely high"),
}
_SPEEDS: Mapping[int, tuple[str, ...]] = {
    1: ("",),
    2: ("slow", "fast"),
    3: ("slow", "moderately fast", "fast"),
    4: ("very slow", "slow", "fast", "very fast"),
    5: ("very slow", "slow", "moderately fast", "fast", "very fast"),
}
_CHANGES: Mapping[int, tuple[str, ...]] = {
    1: ("",),
    2: ("slowly", "quickly"),
    3: ("slowly", "steadily", "quickly"),
    4: ("very slowly", "slowly", "quickly", "very quickly"),
}
_SIZES: Mapping[int, tuple[str, ...]] = {
    1: ("",),
    2: ("slightly", "strongly"),
    3: ("slightly", "moderately", "strongly"),
    4: ("slightly", "moderately", "strongly", "very strongly"),
}
_DIRECTIONS: Mapping[str, tuple[str, str]] = {
    "vx": ("backward", "forward"),
    "vy": ("to the left", "to the right"),
    "vz": ("down", "up"),
}
_SPEED_UNITS = frozenset({"m/s", "m s-1", "m*s-1", "cm/s", "mm/s", "km/h"})
_BOTH_SIGNS = 0.15  # of the range on either side of zero: then signs have words


@dataclass(frozen=True)
class Axis:
    """A physical axis: its name and unit, the range seen in training."""

    name: str
    unit: str
    low: float
    high: float

    @property
    def span(self) -> float:
        return self.high - self.low

    @property
    def has_both_signs(self) -> bool:
        """Whether there is enough of it on either side of zero for signs to have words."""
        return min(-self.low, self.high) > _BOTH_SIGNS * self.span

    def place(self, value: float) -> str:
        """ "0.5 m"."""
        return significant(value) + (f" {self.unit}" if self.unit else "")


@dataclass(frozen=True)
class Vocabulary:
    """How signs and sizes of a quantity are called; `size_first`: "slow forward", not "falling slowly"."""

    below: str
    still: str
    above: str
    sizes: Mapping[int, tuple[str, ...]]
    size_first: bool = True

    def say(self, direction: str, sizes: Sequence[str]) -> str:
        size = " or ".join(s for s in sizes if s)
        return " ".join(filter(None, (size, direction) if self.size_first else (direction, size)))


Name = tuple[str, str]  # direction, size


def tongue_of(axis: Axis) -> Vocabulary | None:
    """How signs are called on this axis; None where it has none."""
    if ")-" in axis.name:
        return Vocabulary("falling", "steady", "rising", _CHANGES, size_first=False)
    key = "".join(c for c in axis.name.lower() if c.isalnum())
    known = next((d for k, d in _DIRECTIONS.items() if key.startswith(k)), None)
    if axis.unit in _SPEED_UNITS and known:
        return Vocabulary(known[0], "hovering", known[1], _SPEEDS)
    if axis.has_both_signs:
        return Vocabulary("negative", "near zero", "positive", _SIZES)
    return None


def name_sizes(axis: Axis) -> Mapping[int, tuple[str, ...]]:
    return _SPEEDS if axis.unit in _SPEED_UNITS and axis.low >= 0.0 else _SCALES


def name_directions(signs: Sequence[int], tongue: Vocabulary) -> list[Name] | None:
    """Direction and size of every place in order; one alone on its side needs no size. None: too many."""
    below, above = (sum(s == side for s in signs) for side in (-1, 1))
    if below not in (0, *tongue.sizes) or above not in (0, *tongue.sizes):
        return None
    left = [(tongue.below, size) for size in reversed(tongue.sizes[below])] if below else []
    right = [(tongue.above, size) for size in tongue.sizes[above]] if above else []
    return [*left, *[(tongue.still, "")] * signs.count(0), *right]
