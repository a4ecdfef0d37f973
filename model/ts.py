"""Dynamic Takagi-Sugeno models, refined on the simulation error: the estimator.

It grows the model from a refined linear one, rule by rule, and stops by the validation free run; what comes
out is a `FittedTS`, flysid.model.rules.fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.dataset import Dataset
from flysid.model.one_rule import linear_choice
from flysid.model.rules.fitted import FittedTS, finished
from flysid.model.rules.learning import learn
from flysid.model.rules.search_settings import NORMAL, SearchSettings
from flysid.model.rules.stabilise import with_stable_rules
from flysid.model.threads import on_one_thread

__all__ = ["TS", "FittedTS"]


@dataclass(frozen=True)
class TS:
    """Settings of a dynamic TS model; the defaults choose by themselves.

    Parameters
    ----------
    rules : number of rules, or "auto": as many as the validation free run supports.
    na : past outputs in every consequent, or "auto".
    nb, nk : past inputs and their delay, one number, one per input, or "auto".
    antecedents : names such as ("v_x(k-1)", "theta_in(k-1)"), or "auto": found by splitting. An input
        without a lag, "theta_in", is the one after its delay: theta_in(k-nk).
    refine : lower the simulation error; False keeps clusters and one-step least squares, the
        literature's default, whose free run shows what refinement is for.
    most_rules : where "auto" stops.
    iterations : Levenberg-Marquardt steps per stage.
    nk_hint : delays that "auto" tries as well, one per input: the dead time that the log shows
        (`flysid.ingest.excitation.dead_time`).
    stable : no rule keeps a pole outside the unit circle (`rules.stabilise`); without it a rule may,
        as long as the blend comes back from random inputs. The pole at one of an integrating process stays.
    search : what the search weighs and how long it looks, see `SearchSettings`.

    Source: Takagi & Sugeno (1985), IEEE Trans. SMC 15; the search: `flysid.model.rules.learning`.

    Examples
    --------
    >>> model = flysid.TS(rules=1, na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> len(model.rules())
    1
    """

    rules: int | Literal["auto"] = "auto"
    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    antecedents: Sequence[str] | Literal["auto"] = "auto"
    refine: bool = True
    most_rules: int = 5
    iterations: int = 30
    nk_hint: Sequence[int] = ()
    stable: bool = False
    search: SearchSettings = NORMAL

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedTS:
        """Grow, refine and choose a model.

        Raises
        ------
        UsageError : settings that cannot be; antecedents that are not there.
        DataError : no or too few samples, a signal that never moves.
        FitError : no stable model was found.
        """
        learned = learn(self, train, validation, linear_choice)
        model = finished(
            learned.stage, train, learned.notes, intervals=self.refine, neighbour=learned.neighbour
        )
        if not self.stable or learned.stage.problem.integrates:
            return model
        return with_stable_rules(model, train)
