"""BJ: the Box-Jenkins model, dynamics and noise with polynomials of their own.

    y(k) = B(q) / F(q) u(k) + c' + C(q) / D(q) e(k)        (Box & Jenkins, 1970; Ljung, 1999, 4.2)

Reaches the Cramer-Rao bound for normal e in open loop, whatever the colour of the noise. Outputs have an
equation each and do not feed each other.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.flight_offsets import with_own_constants
from flysid.model.linear.difference_equation import FittedLinear
from flysid.model.linear.pem_fit import BJ_NOISES, fit_prediction_error
from flysid.model.linear.settings import Auto, PolynomialSettings
from flysid.model.shared import fit_key, once
from flysid.model.threads import on_one_thread


@dataclass(frozen=True)
class BJ(PolynomialSettings):
    """Settings of a Box-Jenkins model: those of `PolynomialSettings`, and of its noise.

    Parameters
    ----------
    nc, nd : orders of C and D, both numbers, or both "auto": by BIC among a few.

    Source: Box & Jenkins (1976), Time Series Analysis; Ljung (1999), 4.2.

    Examples
    --------
    >>> model = flysid.BJ(na=1, nb=1, nk=1, nc=1, nd=1).fit(train)  # train: see `flysid.Dataset`
    >>> model.poles.real.round(2)
    array([0.9])
    """

    nc: int | Auto = field(default="auto", kw_only=True)
    nd: int | Auto = field(default="auto", kw_only=True)

    def check_values(self) -> None:
        """Raise UsageError where one order of the noise is given and the other is open."""
        super().check_values()
        if (self.nc == "auto") != (self.nd == "auto"):
            raise UsageError("give both nc and nd, or neither")

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
        noises = BJ_NOISES if self.nc == "auto" or self.nd == "auto" else ((self.nc, self.nd),)
        return fit_prediction_error("bj", self, (train, validation), noises)
