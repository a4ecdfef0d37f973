"""BJ: the Box-Jenkins model, dynamics and noise with polynomials of their own.

    y(k) = B(q) / F(q) u(k) + c' + C(q) / D(q) e(k)        (Box & Jenkins, 1970; Ljung, 1999, 4.2)

Reaches the Cramer-Rao bound for normal e in open loop, whatever the colour of the noise. Outputs have an
equation each and do not feed each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.base import Structure
from flysid.model.linear.data import Parts
from flysid.model.linear.model import FittedLinear, from_dict
from flysid.model.linear.pem_fit import BJ_NOISES, fit_prediction_error
from flysid.model.linear.stability import settled
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class BJ:
    """Settings of a Box-Jenkins model; the defaults choose by themselves.

    Parameters
    ----------
    na, nb, nk, offset, n_init, nk_hint : as of `OE` (na is the order of F).
    stable : as of `ARX`.
    nc, nd : orders of C and D, both numbers, or both "auto": by BIC among a few.
    """

    na: int | Literal["auto"] = "auto"
    nb: int | Sequence[int] | Literal["auto"] = "auto"
    nk: int | Sequence[int] | Literal["auto"] = "auto"
    nc: int | Literal["auto"] = "auto"
    nd: int | Literal["auto"] = "auto"
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
        if (self.nc == "auto") != (self.nd == "auto"):
            raise UsageError("give both nc and nd, or neither")
        noises = BJ_NOISES if self.nc == "auto" or self.nd == "auto" else ((self.nc, self.nd),)
        return settled(
            fit_prediction_error("bj", self, Parts.of(train, validation, centred=self.offset), noises),
            train,
            stable=self.stable,
        )


MODEL = Structure("bj", from_dict)
