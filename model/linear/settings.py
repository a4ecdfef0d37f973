"""Settings that all polynomial structures share: orders, delays, offset, start, trend, stability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import ClassVar, Literal, TypeAlias

import numpy as np

from flysid.dataset import Dataset
from flysid.errors import UsageError
from flysid.model.arguments import check_inputs
from flysid.model.detrend import Trend, check_trend, detrend
from flysid.model.own_constants import FlightOffsets
from flysid.model.settings import Settings
from flysid.model.stream import OnDisk, Source
from flysid.showing import counted

Auto: TypeAlias = Literal["auto"]


@dataclass(frozen=True)
class PolynomialSettings(Settings):
    """The settings that ARX, OE, ARMAX, BJ and IV share; the defaults choose by themselves.

    `na`: order of the denominator (A, or F of OE and BJ), or "auto": the simplest within one standard error
        of the best free run on validation data.
    `nb`: coefficients of every B, one number or one per input, or "auto" (as many as na).
    `nk`: delay in samples from input to output, one number or one per input, or "auto". 0 is feed-through.
    `offset`: estimate a constant.
    `n_init`: measured samples that start a simulation; None chooses.
    `nk_hint`: delays that "auto" tries besides its own, one per input: the dead time the log shows
        (`flysid.ingest.excitation.dead_time`).
    `trend`: "remove" takes a straight line out of every segment's signals first; see `detrend`.
    `stable`: poles outside the unit circle are mirrored into it and B is fitted again; see `stability`.
    `flight_offsets`: a constant of every flight beside the model, see `flysid.model.flight_offsets`: "auto"
        where flights differ beyond chance, True or False to force.
    """

    na: int | Auto = "auto"
    nb: int | Sequence[int] | Auto = "auto"
    nk: int | Sequence[int] | Auto = "auto"
    _: KW_ONLY
    offset: bool = True
    n_init: int | None = None
    nk_hint: Sequence[int] = ()
    trend: Trend = "none"
    stable: bool = False
    flight_offsets: FlightOffsets = "auto"

    trends: ClassVar[tuple[str, ...]] = ("none", "remove")

    def check_values(self) -> None:
        """Raise UsageError for a trend that this structure does not take, and for a start from nothing."""
        check_trend(self.trend, self.trends)
        self.at_least(1, "n_init")

    def check(self, data: Source) -> None:
        """Raise UsageError for settings that cannot be, or not for these data."""
        check_orders(self, len(data.inputs))
        if isinstance(data, OnDisk) and self.trend != "none":
            raise UsageError("a trend is not taken out of data on disk", hint="use trend='none'")

    def detrended(self, train: Dataset, validation: Dataset | None) -> tuple[Dataset, Dataset | None]:
        """Both parts, without their trends where that is set."""
        return detrend(train, self.trend), None if validation is None else detrend(validation, self.trend)


def check_orders(settings: PolynomialSettings, n_u: int) -> None:
    """Raise UsageError for orders that cannot be."""
    check_inputs(n_u)
    for name in ("nb", "nk"):
        value = getattr(settings, name)
        if value == "auto":
            continue
        if not np.isscalar(value) and len(value) != n_u:
            raise UsageError(f"{name} has {counted(len(value), 'number')} for {counted(n_u, 'input')}")
    check_hint(settings.nk_hint, n_u)


def check_hint(nk_hint: Sequence[int], n_u: int, name: str = "nk_hint") -> None:
    """Raise UsageError unless there is none or one whole number of at least 0 per input."""
    if len(nk_hint) not in (0, n_u) or not all(isinstance(k, int) and k >= 0 for k in nk_hint):
        raise UsageError(
            f"{name}={nk_hint!r}", hint=f"give () or {counted(n_u, 'whole number')}, one per input"
        )
