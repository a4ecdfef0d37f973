"""Takagi-Sugeno state-space models by a name of their own: `TS(states=...)` with the states never 0.

    R_r: If z_1 is A_r1 and ... then x(k) = A_r x(k-1) + B_r w(k) + c_r,   y(k) = the first states

with the firing strengths and the weighted mean of the paper's eq. (1)-(3) (Takagi and Sugeno, 1985). Models
over lagged outputs must see the state in the outputs; where a tank, an actuator or a friction element stands
between, a hidden state says it with fewer lags. Only simulation needs it: nothing measures it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.dataset import Dataset
from flysid.model.flight_offsets import with_own_constants
from flysid.model.own_constants import FlightOffsets
from flysid.model.rules.fitted import FittedTS
from flysid.model.rules.search_settings import NORMAL, SearchSettings
from flysid.model.settings import Settings
from flysid.model.threads import on_one_thread
from flysid.model.ts import TS, gated, over_states


@dataclass(frozen=True)
class TSStateSpace(Settings):
    """Settings of a TS state-space model; the defaults choose by themselves.

    Parameters
    ----------
    states : number of states, the outputs included, or "auto".
    rules : number of rules, or "auto": as many as the validation free run supports.
    nk : delay of the inputs, one number, one per input, or "auto".
    antecedents : names such as ("v_x(k-1)", "hidden 1(k-1)", "theta_in(k-1)"), or "auto": found by growing.
    most_rules : where "auto" stops.
    iterations : Levenberg-Marquardt steps per rule.
    ridge : weight on the difference of the rules, in shares of the error that is left, or "auto".
    nk_hint : delays that "auto" tries as well, one per input: the dead time that the log shows
        (`flysid.ingest.excitation.dead_time`).
    search : what the search weighs and how long it looks, see `SearchSettings`.
    flight_offsets : a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.

    Source: Takagi & Sugeno (1985), IEEE Trans. SMC 15, over states instead of lagged outputs.

    Examples
    --------
    >>> model = flysid.TSStateSpace(states=1, rules=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> len(model.rules())
    1
    """

    states: int | Literal["auto"] = "auto"
    rules: int | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    most_rules: int = 5
    iterations: int = 30
    ridge: float | Literal["auto"] = "auto"
    nk_hint: Sequence[int] = ()
    search: SearchSettings = NORMAL
    flight_offsets: FlightOffsets = "auto"

    def check_values(self) -> None:
        """Raise UsageError for settings that cannot be."""
        self.at_least(1, "states")
        TS(**vars(self))

    @on_one_thread
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Realise linear models, grow rules, refine and choose.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        return gated(TS(**vars(self)), over_states, train, validation)
