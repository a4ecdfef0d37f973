"""What is asked of a search for rules, and how it weighs and how long it looks (`TS(search=...)`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.errors import UsageError
from flysid.model.own_constants import FlightOffsets
from flysid.model.settings import Settings


@dataclass(frozen=True)
class SearchSettings(Settings):
    """What the search for rules weighs; the defaults were measured (docs/measured/search.md).

    Parameters
    ----------
    rule_gain : share of the validation's mean square that a rule must win; 0.05 is about 2.5 % of the error.
    highest_order : lags of the outputs up to which linear models are tried.
    width : models of every number of rules that are refined fully and split further.
    hidden_gain : logarithms of the mean square that hidden states must win; 0.3 is about 14 % of the error.
    hidden_states : rules over hidden states compete where the data hint at them.
    ridges : weights on the difference of rules, in shares of the error that is left, rising; those after the
        first are for rules that ran away. Over hidden states the first is left out.

    Examples
    --------
    >>> SearchSettings().width
    4
    >>> SearchSettings.of("quick").hidden_states
    False
    """

    rule_gain: float = 0.05
    highest_order: int = 4
    width: int = 4
    hidden_gain: float = 0.3
    hidden_states: bool = True
    ridges: tuple[float, ...] = (0.01, 0.1, 1.0)

    @classmethod
    def of(cls, effort: str) -> SearchSettings:
        """The settings of an effort.

        "quick" looks at fewer models and at lags only; "thorough" at more models, orders and systems.

        Raises
        ------
        UsageError : no such effort.
        """
        if effort not in EFFORTS:
            raise UsageError(f"effort={effort!r}", hint="one of " + ", ".join(EFFORTS))
        return EFFORTS[effort]

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be."""
        self.at_least(1, "highest_order", "width")
        gains = (self.rule_gain, self.hidden_gain, *self.ridges)
        if not self.ridges or min(gains) < 0.0:
            raise UsageError(f"gains and ridges {gains}", hint="numbers of 0 or more, and one ridge at least")


NORMAL = SearchSettings()
"""What the models take by themselves."""
_MORE = SearchSettings(highest_order=6, width=8)
EFFORTS: Mapping[str, SearchSettings] = {
    "quick": SearchSettings(highest_order=3, width=2, hidden_states=False),
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
