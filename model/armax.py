"""ARMAX: an ARX model whose equation error is a moving average.

    A(q) y(k) = B(q) u(k) + c + C(q) e(k)        (Ljung, 1999, System Identification, 4.2)

Maximum-likelihood for normal e: unbiased also in closed loop when the orders suffice. Outputs have an
equation each and do not feed each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.dataset import Dataset
from flysid.model.base import Structure
from flysid.model.linear.data import Parts
from flysid.model.linear.model import FittedLinear, from_dict
from flysid.model.linear.pem_fit import ARMAX_NOISES, fit_prediction_error
from flysid.model.linear.stability import settled
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class ARMAX:
    """Settings of an ARMAX model; the defaults choose by themselves.

    Parameters
    ----------
    na, nb, nk, offset, n_init, nk_hint : as of `OE`.
    stable : as of `ARX`.
    nc : order of C, or "auto": 1 to 4 by BIC.
    """

    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    nc: int | Literal["auto"] = "auto"
    offset: bool = True
    n_init: int | None = None
    nk_hint: Sequence[int] = ()
    stable: bool = False

    @on_one_thread
    def fit(self, train: Dataset, validation: Dataset | None = None) -> FittedLinear:
        """Choose orders, fit by prediction error.

        Raises
        ------
        UsageError : settings that cannot be.
        DataError : no or too few samples, a signal that never changes.
        FitError : no stable start was found.
        """
        parts = Parts.of(train, validation, centred=self.offset)
        orders = ARMAX_NOISES if self.nc == "auto" else (self.nc,)
        return settled(
            fit_prediction_error("armax", self, parts, [(n, 0) for n in orders]), train, stable=self.stable
        )


MODEL = Structure("armax", from_dict)
