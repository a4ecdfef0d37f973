"""The goal of a search for rules, its weights and its length (`TS(search=...)`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.errors import UsageError
from flysid.model.own_constants import FlightOffsets
from flysid.model.settings import Settings

QUARTERS = 4
"""Of a short record, each held out in turn."""


@dataclass(frozen=True)
class SearchSettings(Settings):
    """What the search for rules weighs; the defaults were measured (docs/measured/search.md).

    Parameters
    ----------
    folds : quarters of a short record that are held out in turn to choose the number of rules, 1 to 4.
    short : samples below which a record is short.
    rule_gain : share of the validation's mean square that a rule must win; 0.05 is about 2.5 % of the error.
    highest_order : lags of the outputs up to which linear models are tried.
    lanes : linear starts, those from which two rules do best, that are grown over all parts.
    exchanges : rounds in which a chosen model of long records is found again by way of one rule more.
    hidden_gain : logarithms of the mean square that hidden states must win; 0.3 is about 14 % of the error.
    hidden_states : rules over hidden states compete where the data hint at them.
    linear_systems : linear state spaces, best first, whose coordinates hidden rules are grown in.
    ridges : weights on the difference of rules, in shares of the error that is left, rising; those after the
        first are for rules that ran away. Over hidden states the first is left out.

    Examples
    --------
    >>> SearchSettings().lanes
    2
    >>> SearchSettings.of("quick").hidden_states
    False
    """

    folds: int = 4
    short: int = 4000
    rule_gain: float = 0.05
    highest_order: int = 4
    lanes: int = 2
    exchanges: int = 3
    hidden_gain: float = 0.3
    hidden_states: bool = True
    linear_systems: int = 4
    ridges: tuple[float, ...] = (0.01, 0.1, 1.0)

    @classmethod
    def of(cls, effort: str) -> SearchSettings:
        """The settings of an effort.

        "quick" looks at one part, one lane and lags only; "thorough" at more lanes, orders and systems.

        Raises
        ------
        UsageError : no such effort.
        """
        if effort not in EFFORTS:
            raise UsageError(f"effort={effort!r}", hint="one of " + ", ".join(EFFORTS))
        return EFFORTS[effort]

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be."""
        self.at_least(1, "folds", "highest_order", "lanes", "linear_systems")
        if self.folds > QUARTERS:
            raise UsageError(f"folds={self.folds!r}", hint="a record has four quarters")
        gains = (self.rule_gain, self.hidden_gain, *self.ridges)
        if not self.ridges or min(gains) < 0.0:
            raise UsageError(f"gains and ridges {gains}", hint="numbers of 0 or more, and one ridge at least")


NORMAL = SearchSettings()
"""What the models take by themselves."""
_MORE = SearchSettings(highest_order=6, lanes=4, exchanges=6, linear_systems=8)
EFFORTS: Mapping[str, SearchSettings] = {
    "quick": SearchSettings(folds=1, highest_order=3, lanes=1, exchanges=0, hidden_states=False),
    "normal": NORMAL,
    "thorough": _MORE,
}
"""Settings by effort, as `flysid fit --effort` takes them."""


@dataclass(frozen=True)
class RuleSettings(Settings):
    """What is asked of a search for rules; `flysid.TS` says what each means."""

    rules: int | Literal["auto"] = "auto"
    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    refine: bool = True
    most_rules: int = 5
    iterations: int = 30
    nk_hint: Sequence[int] = ()
    nk_least: Sequence[int] = ()
    stable: bool = False
    search: SearchSettings = NORMAL
    states: int | Literal["auto"] = 0
    ridge: float | Literal["auto"] = "auto"
    flight_offsets: FlightOffsets = "auto"

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be."""
        self.at_least(1, "rules", "most_rules", "iterations")
        if self.ridge != "auto" and self.ridge < 0.0:
            raise UsageError(f"ridge={self.ridge!r}", hint='give "auto", or 0 or more; 0.01 is usual')
        if not len(self.antecedents):
            raise UsageError(f"antecedents={self.antecedents!r}", hint='give "auto" or a list of names')
