"""OE: the output-error model, the strongest linear baseline for free runs.

    y(k) = B(q) / F(q) u(k) + c' + v(k)        (Ljung, 1999, System Identification, 4.2)

fitted so that the free run is closest to the measurement (`simulation_error`), output by output. What the
free run leaves over, v, gets an autoregression of its own, which serves predictions and the covariance and
leaves the free run alone. With feedback from y to u and coloured v the estimate is biased.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from flysid.dataset import Dataset
from flysid.model.detrend import TRENDS
from flysid.model.flight_offsets import with_own_constants
from flysid.model.linear.data import Parts
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.oe_search import search
from flysid.model.linear.settings import PolynomialSettings
from flysid.model.shared import fit_key, once
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class OE(PolynomialSettings):
    """Settings of an output-error model: those of `PolynomialSettings`.

    Parameters
    ----------
    trend : "estimate" fits an offset and a drift of the output per segment along with the model.
    stable : always so; no other model is admitted.

    Source: Ljung (1999), System Identification, 4.2.

    Examples
    --------
    >>> model = flysid.OE(na=1, nb=1, nk=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.poles.real.round(2)
    array([0.9])
    """

    trends: ClassVar[tuple[str, ...]] = TRENDS

    @on_one_thread
    @once(fit_key)
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedLinear:
        """Choose delays and orders, refine.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : no stable model was found.
        """
        self.check(train)
        train, validation = self.detrended(train, validation)
        return search("oe", self, Parts.of(train, validation, centred=self.offset)).final()
