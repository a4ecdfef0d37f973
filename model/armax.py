"""ARMAX: an ARX model whose equation error is a moving average.

    A(q) y(k) = B(q) u(k) + c + C(q) e(k)        (Ljung, 1999, System Identification, 4.2)

Maximum-likelihood for normal e: unbiased also in closed loop when the orders suffice. Outputs have an
equation each and do not feed each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from flysid.dataset import Dataset
from flysid.model.flight_offsets import with_own_constants
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.pem_fit import ARMAX_NOISES, fit_prediction_error
from flysid.model.linear.settings import Auto, PolynomialSettings
from flysid.model.shared import fit_key, once
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class ARMAX(PolynomialSettings):
    """Settings of an ARMAX model: those of `PolynomialSettings`, and of its noise.

    Parameters
    ----------
    nc : order of C, or "auto": 1 to 4 by BIC.

    Source: Ljung (1999), System Identification, 4.2.

    Examples
    --------
    >>> model = flysid.ARMAX(na=1, nb=1, nk=1, nc=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.ma.shape  # 1 and c1, of one output
    (2, 1)
    """

    nc: int | Auto = field(default="auto", kw_only=True)

    @on_one_thread
    @once(fit_key)
    @with_own_constants
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedLinear:
        """Choose orders, fit by prediction error.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : no stable start was found.
        """
        orders = ARMAX_NOISES if self.nc == "auto" else (self.nc,)
        return fit_prediction_error("armax", self, (train, validation), [(n, 0) for n in orders])
