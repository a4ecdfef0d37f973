"""OE: the output-error model, the strongest linear baseline for free runs.

    y(k) = B(q) / F(q) u(k) + c' + v(k)        (Ljung, 1999, System Identification, 4.2)

fitted so that the free run is closest to the measurement (`simulation_error`), output by output. What the
free run leaves over, v, gets an autoregression of its own, which serves predictions and the covariance and
leaves the free run alone. With feedback from y to u and coloured v the estimate is biased.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.dataset import Dataset
from flysid.model.base import Structure
from flysid.model.detrend import Trend, check_trend, detrended
from flysid.model.linear.data import Parts
from flysid.model.linear.model import FittedLinear, from_dict
from flysid.model.linear.oe_search import check_orders, search
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class OE:
    """Settings of an output-error model; the defaults choose by themselves.

    Parameters
    ----------
    na : order of the denominator F, or "auto": the simplest within one standard error of the best free run on
        validation data.
    nb : coefficients of every B, one number or one per input, or "auto" (as many as na).
    nk : delay in samples, one number or one per input, or "auto". 0 is feed-through.
    offset : estimate a constant.
    n_init : measured samples that start a simulation; None chooses.
    nk_hint : delays that "auto" tries besides its own, one per input: the dead time the log shows
        (`flysid.ingest.deadtime`).
    trend : "remove" takes a straight line out of every segment's signals first; see `detrend`.
    """

    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    offset: bool = True
    n_init: int | None = None
    nk_hint: Sequence[int] = ()
    trend: Trend = "none"

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedLinear:
        """Choose delays and orders, refine.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : no stable model was found.
        """
        check_orders(self, len(train.inputs))
        check_trend(self.trend, ("none", "remove"))
        train = detrended(train, self.trend)
        validation = None if validation is None else detrended(validation, self.trend)
        return search("oe", self, Parts.of(train, validation, centred=self.offset)).final()


MODEL = Structure("oe", from_dict)
